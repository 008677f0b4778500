// Prints, as markdown tables, the filter's labels against known geometry and
// the error of its normals, for both rules.
//   label_table [FOLDER]     with yard_100k.bin, room_370k.bin and their .truth
//                            files; without it these clouds are left out
//   label_table --held-out [K]   the first table alone, of clouds that no
//                            criterion was chosen on; K neighbours instead of
//                            50; and what principal axes say of the same points
// A point counts if its ball of the density radius holds at least k others in
// the input: there the density reaches the one aimed at.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "client/lab/ball_counter.h"
#include "core/base/status.h"
#include "core/geometry/vector3.h"
#include "core/registration/kd_tree.h"
#include "core/spdf/cloud_filter.h"
#include "tests/bench/known_clouds.h"
#include "tests/testing/clouds.h"
#include "tests/testing/ideal_shape.h"
#include "tests/testing/normal_error.h"
#include "tests/testing/symmetric3.h"

namespace mapsieve::bench {
namespace {

using core::DensityRule;
using core::Label;
using core::LabelCounts;

constexpr std::array kRules = {DensityRule::kPaper, DensityRule::kQuota};

constexpr int kNeighborCount = core::SpdfOptions().neighbor_count;

/// A post deserves to be a curve if the ball is this many times as thick.
constexpr double kSlenderness = 10;
/// Shares of fewer points are not printed.
constexpr int64_t kFewestPoints = 20;

struct Setting {
  double density_radius_m;
  double vote_scale_m2;
  int label_neighbor_count = 0;
};
constexpr int kMany = core::kMaxNeighborCount;
/// sigma: the default, rho², 5 rho²; labels by as many neighbours as the
/// density. Then by as many as may be, and a kernel so wide that each counts
/// alike.
constexpr std::array kSettings = {
    Setting{0.1, 0.2},        Setting{0.1, 0.01},
    Setting{0.1, 0.05},       Setting{0.2, 0.2},
    Setting{0.2, 0.04},       Setting{0.4, 0.2},
    Setting{0.4, 0.16},       Setting{0.4, 0.8},
    Setting{0.1, 0.2, kMany}, Setting{0.1, 0.05, kMany},
    Setting{0.1, 0.8, kMany}, Setting{0.2, 0.2, kMany},
    Setting{0.2, 0.8, kMany}, Setting{0.4, 0.2, kMany},
    Setting{0.4, 0.8, kMany}};

/// As in a row's first cells.
std::string LabelNeighbors(const Setting& setting) {
  return setting.label_neighbor_count > 0
             ? std::to_string(setting.label_neighbor_count)
             : "k";
}

int64_t Sum(const LabelCounts& counts) {
  int64_t sum = 0;
  for (const int64_t count : counts) sum += count;
  return sum;
}

/// Labels of the survivors that count.
struct Outcome {
  LabelCounts before{};
  LabelCounts after{};
  /// What the axes of their neighbours say.
  LabelCounts by_axes{};

  void Add(const Outcome& other) {
    for (size_t i = 0; i < before.size(); ++i) {
      before[i] += other.before[i];
      after[i] += other.after[i];
      by_axes[i] += other.by_axes[i];
    }
  }
};

/// Outcomes by kind.
using RuleOutcome = std::vector<Outcome>;

struct CloudResult {
  std::string name;
  std::vector<Kind> kinds;
  /// By setting and rule.
  std::array<std::array<RuleOutcome, kRules.size()>, kSettings.size()> outcomes;
};

/// For each point of `input` the number of others in its ball.
std::vector<int64_t> CountOthers(const client::BallCounter& input,
                                 double radius_m,
                                 const core::Lattice& lattice) {
  const int64_t radius_d2 =
      core::MakeSpdfConstants({.density_radius_m = radius_m}, lattice)
          .density_d2;
  std::vector<int64_t> counts;
  for (const core::LatticePoint& q : input.points()) {
    counts.push_back(input.Count(q, radius_d2) - 1);
  }
  return counts;
}

/// The label by the largest difference of the standard deviations along the
/// principal axes of `points` (Demantké et al. 2011, "Dimensionality based
/// scale selection in 3D lidar point clouds"). A vote takes the directions of
/// the neighbours, this their positions.
Label LabelByAxes(std::span<const core::Vector3> points) {
  core::Vector3 mean{};
  for (const core::Vector3& p : points) {
    for (size_t a = 0; a < 3; ++a) {
      mean[a] += p[a] / static_cast<double>(points.size());
    }
  }
  testing::Symmetric3 moments;
  for (const core::Vector3& p : points) {
    const double x = p[0] - mean[0];
    const double y = p[1] - mean[1];
    const double z = p[2] - mean[2];
    moments.xx += x * x;
    moments.xy += x * y;
    moments.xz += x * z;
    moments.yy += y * y;
    moments.yz += y * z;
    moments.zz += z * z;
  }
  std::array<double, 3> deviation = testing::Decompose(moments).values;
  for (double& d : deviation) d = std::sqrt(std::max(d, 0.0));
  const double curve = deviation[0] - deviation[1];
  const double surface = deviation[1] - deviation[2];
  if (curve >= std::max(surface, deviation[2])) return Label::kCurve;
  return surface >= deviation[2] ? Label::kSurface : Label::kJunction;
}

/// LabelByAxes of each survivor and the 31 nearest to it.
std::vector<Label> LabelsByAxes(const core::LatticeCloud& cloud,
                                const core::FilteredCloud& filtered) {
  std::vector<core::Vector3> positions;
  for (const uint32_t row : filtered.rows) {
    const core::Point3 p = cloud.lattice.Position(cloud.positions[row]);
    positions.push_back({p.x, p.y, p.z});
  }
  const core::KdTree tree(positions);
  std::vector<Label> labels;
  for (const core::Vector3& p : positions) {
    std::array<core::KdTree::Neighbor, 32> found;
    const size_t count = tree.FindNearest(p, found);
    std::vector<core::Vector3> near;
    for (size_t i = 0; i < count; ++i) near.push_back(positions[found[i].row]);
    labels.push_back(LabelByAxes(near));
  }
  return labels;
}

/// `with_axes`: by axes too, of quota's survivors.
absl::StatusOr<CloudResult> Evaluate(const KnownCloud& known,
                                     int neighbor_count, bool with_axes) {
  CloudResult result{.name = known.name, .kinds = known.kinds};
  const client::BallCounter input(known.cloud.positions);
  std::map<double, std::vector<int64_t>> others_of_radius;
  for (size_t s = 0; s < kSettings.size(); ++s) {
    core::SpdfOptions options = {
        .neighbor_count = neighbor_count,
        .label_neighbor_count = kSettings[s].label_neighbor_count,
        .vote_scale_m2 = kSettings[s].vote_scale_m2,
        .density_radius_m = kSettings[s].density_radius_m};
    std::vector<int64_t>& others = others_of_radius[options.density_radius_m];
    if (others.empty()) {
      others =
          CountOthers(input, options.density_radius_m, known.cloud.lattice);
    }
    for (size_t rule = 0; rule < kRules.size(); ++rule) {
      options.rule = kRules[rule];
      MAPSIEVE_ASSIGN_OR_RETURN(const core::FilteredCloud filtered,
                                core::FilterCloud(known.cloud, options));
      RuleOutcome& outcome = result.outcomes[s][rule];
      outcome.resize(known.kinds.size());
      const auto count = [&](uint32_t i, Label label,
                             LabelCounts Outcome::*counts) {
        const uint32_t row = filtered.rows[i];
        if (others[row] < options.neighbor_count) return;
        ++(outcome[known.kind_of[row]].*counts)[static_cast<size_t>(label)];
      };
      std::vector<Label> by_axes;
      if (with_axes && options.rule == DensityRule::kQuota) {
        by_axes = LabelsByAxes(known.cloud, filtered);
      }
      for (uint32_t i = 0; i < filtered.rows.size(); ++i) {
        count(i, filtered.columns.label[i], &Outcome::before);
        if (!by_axes.empty()) count(i, by_axes[i], &Outcome::by_axes);
      }
      for (const uint32_t i : filtered.Inliers(options.outlier_share)) {
        count(i, filtered.columns.label[i], &Outcome::after);
      }
    }
  }
  return result;
}

/// "99.5": `part` in percent of `whole`; "-" of too few.
std::string Percent(int64_t part, int64_t whole) {
  if (whole < kFewestPoints) return "-";
  std::array<char, 16> text;
  std::snprintf(text.data(), text.size(), "%.1f",
                100 * static_cast<double>(part) / static_cast<double>(whole));
  return text.data();
}

std::string Share(const LabelCounts& counts, Label label) {
  return Percent(counts[static_cast<size_t>(label)], Sum(counts));
}

std::string Shares(const LabelCounts& counts) {
  if (Sum(counts) < kFewestPoints) return "-";
  return Share(counts, Label::kJunction) + " / " +
         Share(counts, Label::kCurve) + " / " + Share(counts, Label::kSurface);
}

std::string OutlierShare(const Outcome& outcome) {
  const int64_t before = Sum(outcome.before);
  return Percent(before - Sum(outcome.after), before);
}

void PrintConfusion(const CloudResult& result) {
  std::printf("\n### %s\n\n", result.name.c_str());
  std::printf(
      "| on | rho, m | sigma, m2 | label neighbors | paper: points | junction "
      "/ curve / surface | outliers | after them | quota: points | junction / "
      "curve / surface | outliers | after them "
      "|\n|---|---|---|---|---|---|---|---|---|---|---|---|\n");
  std::vector<std::pair<std::string, size_t>> order;
  for (size_t kind = 0; kind < result.kinds.size(); ++kind) {
    order.emplace_back(result.kinds[kind].name, kind);
  }
  std::sort(order.begin(), order.end());
  for (size_t s = 0; s < kSettings.size(); ++s) {
    for (const auto& [name, kind] : order) {
      const auto& rules = result.outcomes[s];
      if (std::max(Sum(rules[0][kind].before), Sum(rules[1][kind].before)) <
          kFewestPoints) {
        continue;
      }
      std::printf("| %s | %.1f | %.2f | %s |", name.c_str(),
                  kSettings[s].density_radius_m, kSettings[s].vote_scale_m2,
                  LabelNeighbors(kSettings[s]).c_str());
      for (const RuleOutcome& rule : rules) {
        const Outcome& outcome = rule[kind];
        std::printf(" %lld | %s | %s | %s |",
                    static_cast<long long>(Sum(outcome.before)),
                    Shares(outcome.before).c_str(),
                    OutlierShare(outcome).c_str(),
                    Shares(outcome.after).c_str());
      }
      std::printf("\n");
    }
  }
}

/// The outcome of all kinds that deserve `expected`; of posts, the slender.
Outcome OfExpected(const CloudResult& result, const RuleOutcome& rule,
                   Label expected, double density_radius_m) {
  Outcome sum;
  for (size_t kind = 0; kind < result.kinds.size(); ++kind) {
    const Kind& k = result.kinds[kind];
    if (k.expected == expected &&
        k.radius_m * kSlenderness <= density_radius_m * (1 + 1e-9)) {
      sum.Add(rule[kind]);
    }
  }
  return sum;
}

/// `results`: of one cloud, with more and more noise.
void PrintBar(const std::string& name,
              const std::vector<CloudResult>& results) {
  for (size_t s = 0; s < kSettings.size(); ++s) {
    const double rho = kSettings[s].density_radius_m;
    std::string row;
    bool is_empty = true;
    for (size_t rule = 0; rule < kRules.size(); ++rule) {
      for (const Label expected : {Label::kSurface, Label::kCurve}) {
        std::string kept;
        for (const CloudResult& result : results) {
          const Outcome outcome =
              OfExpected(result, result.outcomes[s][rule], expected, rho);
          const std::string share = Share(outcome.after, expected);
          kept += (kept.empty() ? " " : " / ") + share;
          is_empty &= share == "-";
        }
        row += kept + " |";
      }
    }
    if (is_empty) continue;
    std::printf("| %s | %.1f | %.2f | %s |%s\n", name.c_str(), rho,
                kSettings[s].vote_scale_m2,
                LabelNeighbors(kSettings[s]).c_str(), row.c_str());
  }
}

/// How the share of curves falls with the radius of a post.
void PrintPosts(const std::vector<CloudResult>& results) {
  for (size_t s = 0; s < kSettings.size(); ++s) {
    const double rho = kSettings[s].density_radius_m;
    std::vector<std::pair<double, std::string>> posts;
    for (const Kind& kind : results.front().kinds) {
      if (kind.expected == Label::kCurve) {
        posts.emplace_back(kind.radius_m, kind.name);
      }
    }
    std::sort(posts.begin(), posts.end());
    for (const auto& [radius, name] : posts) {
      std::printf("| %.2f | %.2f | %.1f | %.2f | %s |", radius / rho,
                  radius * 100, rho, kSettings[s].vote_scale_m2,
                  LabelNeighbors(kSettings[s]).c_str());
      for (size_t rule = 0; rule < kRules.size(); ++rule) {
        std::string before;
        std::string after;
        for (const CloudResult& result : results) {
          for (size_t kind = 0; kind < result.kinds.size(); ++kind) {
            if (result.kinds[kind].name != name) continue;
            const Outcome& outcome = result.outcomes[s][rule][kind];
            before += (before.empty() ? " " : " / ") +
                      Share(outcome.before, Label::kCurve);
            after += (after.empty() ? " " : " / ") + OutlierShare(outcome);
          }
        }
        std::printf("%s |%s |", before.c_str(), after.c_str());
      }
      std::printf("\n");
    }
  }
}

/// Two half planes at right angles, six times as dense as aimed at.
void AddEdgeCounts(const Setting& setting, DensityRule rule, uint64_t seed,
                   const std::vector<double>& limits,
                   std::vector<LabelCounts>& counts) {
  constexpr double kHalfEdge = 1.5;
  constexpr int kPointCount = 20000;
  constexpr double kRim = 0.5;
  const core::LatticeCloud cloud =
      testing::EdgeCloud(kPointCount, kHalfEdge, seed);
  const auto filtered =
      core::FilterCloud(cloud,
                        {.label_neighbor_count = setting.label_neighbor_count,
                         .vote_scale_m2 = setting.vote_scale_m2,
                         .density_radius_m = setting.density_radius_m,
                         .rule = rule})
          .value();
  for (size_t i = 0; i < filtered.rows.size(); ++i) {
    const core::Point3 p =
        cloud.lattice.Position(cloud.positions[filtered.rows[i]]);
    if (std::abs(p.x) > kHalfEdge - kRim) continue;
    const double distance = std::max(p.y, p.z) / setting.density_radius_m;
    const auto at = std::upper_bound(limits.begin(), limits.end(), distance);
    if (at == limits.end()) continue;
    ++counts[static_cast<size_t>(at - limits.begin())]
            [static_cast<size_t>(filtered.columns.label[i])];
  }
}

void PrintEdges() {
  const std::vector<double> limits = {0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 1};
  constexpr Setting kEdgeSettings[] = {
      {0.2, 0.2}, {0.2, 0.04}, {0.2, 0.2, kMany}};
  constexpr uint64_t kSeedCount = 20;
  std::printf(
      "\n## Edges\n\nTwo walls at right angles without noise; junction / curve "
      "/ surface before the outlier test, %%.\n\n| from the edge, rho |");
  for (const Setting& setting : kEdgeSettings) {
    std::printf(" paper, sigma %.2f, label neighbors %s | quota |",
                setting.vote_scale_m2, LabelNeighbors(setting).c_str());
  }
  std::printf("\n|---|---|---|---|---|---|---|\n");
  std::vector<std::vector<LabelCounts>> columns;
  for (const Setting& setting : kEdgeSettings) {
    for (const DensityRule rule : kRules) {
      std::vector<LabelCounts>& counts =
          columns.emplace_back(limits.size(), LabelCounts{});
      for (uint64_t seed = 1; seed <= kSeedCount; ++seed) {
        AddEdgeCounts(setting, rule, seed, limits, counts);
      }
    }
  }
  for (size_t i = 0; i < limits.size(); ++i) {
    std::printf("| to %.2f |", limits[i]);
    for (const std::vector<LabelCounts>& counts : columns) {
      std::printf(" %s |", Shares(counts[i]).c_str());
    }
    std::printf("\n");
  }
}

testing::NormalError MeanNormalError(testing::IdealShapeOptions plane,
                                     core::SpdfOptions options) {
  constexpr int kSeedCount = 5;
  testing::NormalError mean;
  for (int seed = 1; seed <= kSeedCount; ++seed) {
    plane.seed = static_cast<uint64_t>(seed);
    options.seed = seed;
    const testing::NormalError error =
        testing::MeasureNormalError(testing::MakeIdealShape(plane), options);
    mean.median += error.median / kSeedCount;
    mean.p90 += error.p90 / kSeedCount;
  }
  return mean;
}

void PrintNormals() {
  std::printf(
      "\n## Normals\n\n| rho, m | noise, cm | start | paper: median | 90 %% | "
      "quota: median | 90 %% | with %d label neighbors, paper: median | 90 %% "
      "| quota: median | 90 %% |\n|---|---|---|---|---|---|---|---|---|---|---"
      "|\n",
      kMany);
  for (const double radius_m : {0.1, 0.2, 0.4}) {
    for (const double noise_m : {0.0, 0.01, 0.02}) {
      for (const double start : {1.5, 3.0, 10.0}) {
        std::printf("| %.1f | %.0f | %.1f |", radius_m, noise_m * 100, start);
        for (const int label_neighbor_count : {0, kMany}) {
          for (const DensityRule rule : kRules) {
            const testing::NormalError mean =
                MeanNormalError({.dimension = 2,
                                 .radius_m = radius_m,
                                 .start = start,
                                 .noise_m = noise_m},
                                {.label_neighbor_count = label_neighbor_count,
                                 .density_radius_m = radius_m,
                                 .rule = rule});
            std::printf(" %.2f | %.2f |", mean.median, mean.p90);
          }
        }
        std::printf("\n");
      }
    }
  }
}

struct Simulated {
  /// With more and more noise.
  std::vector<CloudResult> campus;
  std::vector<CloudResult> yard;
};

absl::StatusOr<Simulated> EvaluateSimulated(Scenes scenes, int neighbor_count,
                                            bool with_axes) {
  Simulated results;
  for (const double noise : {0.0, 0.012, 0.02}) {
    std::array<char, 32> suffix;
    std::snprintf(suffix.data(), suffix.size(), ", noise %.1f cm", noise * 100);
    MAPSIEVE_ASSIGN_OR_RETURN(KnownCloud known, CampusCloud(scenes, noise));
    known.name += suffix.data();
    MAPSIEVE_ASSIGN_OR_RETURN(results.campus.emplace_back(),
                              Evaluate(known, neighbor_count, with_axes));
    MAPSIEVE_ASSIGN_OR_RETURN(known, YardCloud(scenes, noise));
    known.name += suffix.data();
    MAPSIEVE_ASSIGN_OR_RETURN(results.yard.emplace_back(),
                              Evaluate(known, neighbor_count, with_axes));
  }
  return results;
}

void PrintDeserved(const Simulated& simulated,
                   const std::vector<CloudResult>& references) {
  std::printf(
      "## Labels deserved\n\nOf what is kept: clear surfaces that are surface, "
      "clear posts with 10 r <= rho that are curve, %%; noise 0 / 1.2 / 2 cm."
      "\n\n| cloud | rho, m | sigma, m2 | label neighbors | paper: surfaces | "
      "posts | quota: surfaces | posts |\n|---|---|---|---|---|---|---|---|"
      "\n");
  PrintBar("campus", simulated.campus);
  PrintBar("yard", simulated.yard);
  for (const CloudResult& result : references) PrintBar(result.name, {result});
}

/// What the axes say, of the survivors that quota has with the default sigma.
void PrintAxes(const std::string& name,
               const std::vector<CloudResult>& results) {
  for (size_t s = 0; s < kSettings.size(); ++s) {
    const auto [rho, sigma, label_neighbor_count] = kSettings[s];
    if (sigma != core::SpdfOptions().vote_scale_m2 ||
        label_neighbor_count != 0) {
      continue;
    }
    std::string row;
    bool is_empty = true;
    for (const Label expected : {Label::kSurface, Label::kCurve}) {
      std::string shares;
      for (const CloudResult& result : results) {
        const Outcome outcome =
            OfExpected(result, result.outcomes[s][1], expected, rho);
        const std::string share = Share(outcome.by_axes, expected);
        shares += (shares.empty() ? " " : " / ") + share;
        is_empty &= share == "-";
      }
      row += shares + " |";
    }
    if (is_empty) continue;
    std::printf("| %s | %.1f |%s\n", name.c_str(), rho, row.c_str());
  }
}

absl::Status PrintHeldOut(int neighbor_count) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const Simulated simulated,
      EvaluateSimulated(Scenes::kHeldOut, neighbor_count, true));
  PrintDeserved(simulated, {});
  std::printf(
      "\n## By principal axes\n\nThe same points before the outlier test, by "
      "the principal axes of the 32 nearest survivors, %%.\n\n"
      "| cloud | rho, m | surfaces | posts |\n|---|---|---|---|\n");
  PrintAxes("campus", simulated.campus);
  PrintAxes("yard", simulated.yard);
  return absl::OkStatus();
}

absl::Status PrintTables(const std::string& reference_folder) {
  std::vector<CloudResult> references;
  if (!reference_folder.empty()) {
    // One scan: farther away its rings on the ground are 0.7 rho apart and
    // more for the largest rho.
    constexpr double kRingsApart = 5;
    const std::pair<const char*, double> files[] = {
        {"/yard_100k.bin", kRingsApart}, {"/room_370k.bin", 0}};
    for (const auto& [file, split] : files) {
      MAPSIEVE_ASSIGN_OR_RETURN(const KnownCloud known,
                                ReferenceCloud(reference_folder + file, split));
      MAPSIEVE_ASSIGN_OR_RETURN(references.emplace_back(),
                                Evaluate(known, kNeighborCount, false));
    }
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      const Simulated simulated,
      EvaluateSimulated(Scenes::kChosenOn, kNeighborCount, false));
  PrintDeserved(simulated, references);

  std::printf(
      "\n## Posts\n\nOf the yard; curve before the outlier test, and outliers, "
      "%%; noise 0 / 1.2 / 2 cm.\n\n| r / rho | r, cm | rho, m | sigma, m2 | "
      "label neighbors | paper: curve | outliers | quota: curve | outliers |\n"
      "|---|---|---|---|---|---|---|---|---|\n");
  PrintPosts(simulated.yard);

  std::printf("\n## Confusion\n");
  for (const std::span<const CloudResult> results :
       {std::span<const CloudResult>(simulated.campus),
        std::span<const CloudResult>(simulated.yard),
        std::span<const CloudResult>(references)}) {
    for (const CloudResult& result : results) PrintConfusion(result);
  }
  PrintEdges();
  PrintNormals();
  return absl::OkStatus();
}

}  // namespace
}  // namespace mapsieve::bench

int main(int argc, char** argv) {
  using namespace mapsieve::bench;
  const std::string argument = argc > 1 ? argv[1] : "";
  const bool held_out = argument == "--held-out";
  const int neighbor_count =
      held_out && argc == 3 ? std::atoi(argv[2]) : kNeighborCount;
  if (argc > (held_out ? 3 : 2) || neighbor_count < 1) {
    std::fprintf(stderr, "usage: %s [FOLDER | --held-out [K]]\n", argv[0]);
    return 2;
  }
  const absl::Status status =
      held_out ? PrintHeldOut(neighbor_count) : PrintTables(argument);
  if (!status.ok()) {
    std::fprintf(stderr, "%s\n", status.ToString().c_str());
    return 1;
  }
}
