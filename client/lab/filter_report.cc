#include "client/lab/filter_report.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <string_view>
#include <utility>

#include "client/lab/ball_counter.h"
#include "client/lab/scene.h"
#include "core/spdf/labels.h"

namespace mapsieve::client {
namespace {

using core::FilteredCloud;
using core::Label;
using core::LatticeCloud;
using core::LatticePoint;

constexpr size_t kPointsPerTask = 4096;

size_t Index(Label label) { return static_cast<size_t>(label); }

/// Volume of the ball of radius 1 in `dimension` dimensions, 1 to 3.
double UnitBallVolume(int dimension) {
  constexpr double kPi = std::numbers::pi;
  return dimension == 1 ? 2 : dimension == 2 ? kPi : 4 * kPi / 3;
}

double Saliency(const std::array<float, 3>& lambda, Label label) {
  switch (label) {
    case Label::kSurface:
      return double{lambda[0]} - double{lambda[1]};
    case Label::kCurve:
      return double{lambda[1]} - double{lambda[2]};
    default:
      return lambda[2];
  }
}

/// The bin of `position`, in bins from the first one's lower edge.
size_t Bin(double position, size_t bin_count) {
  const double last = static_cast<double>(bin_count - 1);
  return static_cast<size_t>(std::clamp(std::floor(position), 0.0, last));
}

size_t RatioBin(double ratio) {
  return Bin(
      (std::log2(ratio) - RatioBins::kFirstExponent) * RatioBins::kPerOctave,
      RatioBins::kCount);
}

/// `values`: counts, to be divided by `unit`.
Distribution Summarize(std::vector<int64_t> values, double unit) {
  Distribution result;
  if (values.empty()) return result;
  std::sort(values.begin(), values.end());
  double sum = 0;
  for (const int64_t value : values) sum += static_cast<double>(value);
  const auto last = static_cast<double>(values.size() - 1);
  const auto quantile = [&](double share) {
    const auto at = static_cast<size_t>(std::lround(share * last));
    return static_cast<double>(values[at]) / unit;
  };
  result.count = static_cast<int64_t>(values.size());
  result.mean = sum / static_cast<double>(values.size()) / unit;
  result.p10 = quantile(0.1);
  result.median = quantile(0.5);
  result.p90 = quantile(0.9);
  return result;
}

BallCounter CounterOf(const LatticeCloud& cloud,
                      const std::vector<uint32_t>& rows) {
  std::vector<LatticePoint> points;
  points.reserve(rows.size());
  for (const uint32_t row : rows) points.push_back(cloud.positions[row]);
  return BallCounter(std::move(points));
}

/// For each of `centers`, which are points of `counter`, the number of others
/// within the radius.
std::vector<int64_t> CountOthers(const BallCounter& counter,
                                 const std::vector<LatticePoint>& centers,
                                 int64_t radius_d2, Executor& executor) {
  std::vector<int64_t> counts(centers.size());
  ForEachPart(executor, centers.size(), kPointsPerTask,
              [&](size_t, size_t begin, size_t end) {
                for (size_t i = begin; i < end; ++i) {
                  counts[i] = counter.Count(centers[i], radius_d2) - 1;
                }
              });
  return counts;
}

PerLabel<LabelDensity> MeasureDensity(const LatticeCloud& cloud,
                                      const BallCounter& input,
                                      const FilteredCloud& filtered,
                                      const core::SpdfConstants& constants,
                                      Executor& executor) {
  const BallCounter survivors = CounterOf(cloud, filtered.rows);
  const std::vector<int64_t> before =
      CountOthers(input, survivors.points(), constants.density_d2, executor);
  const std::vector<int64_t> after = CountOthers(
      survivors, survivors.points(), constants.density_d2, executor);
  const double k = constants.neighbor_count;
  PerLabel<LabelDensity> density;
  for (const Label label : kGeometricLabels) {
    LabelDensity& result = density[Index(label)];
    std::vector<int64_t> dense_before;
    std::vector<int64_t> dense_after;
    for (size_t i = 0; i < after.size(); ++i) {
      if (filtered.columns.label[i] != label) continue;
      ++result.survivor_count;
      if (before[i] < constants.neighbor_count) {
        ++result.sparse_count;
        continue;
      }
      dense_before.push_back(before[i]);
      dense_after.push_back(after[i]);
      ++result.reached_histogram[RatioBin(static_cast<double>(after[i]) / k)];
    }
    result.input = Summarize(std::move(dense_before), k);
    result.reached = Summarize(std::move(dense_after), k);
  }
  return density;
}

PerLabel<SaliencyHistogram> MeasureSaliencies(
    const core::LabelColumns& columns) {
  PerLabel<SaliencyHistogram> histograms;
  for (size_t i = 0; i < columns.size(); ++i) {
    for (const Label label : kGeometricLabels) {
      const size_t bin =
          Bin(Saliency(columns.lambda[i], label) / SaliencyBins::kWidth,
              SaliencyBins::kCount);
      SaliencyHistogram& histogram = histograms[Index(label)];
      ++histogram.all[bin];
      if (columns.label[i] == label) ++histogram.labeled[bin];
    }
  }
  return histograms;
}

std::string ClassName(uint8_t value) {
  switch (static_cast<ObjectClass>(value)) {
    case ObjectClass::kGround:
      return "ground";
    case ObjectClass::kVegetation:
      return "vegetation";
    case ObjectClass::kBuilding:
      return "building";
    case ObjectClass::kNoise:
      return "noise";
    case ObjectClass::kPole:
      return "pole";
    case ObjectClass::kCar:
      return "car";
  }
  return "class " + std::to_string(value);
}

std::string TruthName(uint8_t value) {
  return value < core::kLabelCount
             ? std::string(core::LabelName(static_cast<Label>(value)))
             : "class " + std::to_string(value);
}

/// `input`, `kept`: numbers of rows of `values`, and of entries of `filtered`.
Confusion Compare(const core::Column& values, std::string (*name)(uint8_t),
                  const std::vector<uint32_t>& input,
                  const FilteredCloud& filtered,
                  const std::vector<uint32_t>& kept) {
  std::map<uint8_t, ClassOutcome> classes;
  const auto outcome = [&](uint32_t row) -> ClassOutcome* {
    return values.IsMissing(row) ? nullptr : &classes[values.Get<uint8_t>(row)];
  };
  for (const uint32_t row : input) {
    if (ClassOutcome* of = outcome(row)) ++of->thinned_count;
  }
  for (const uint32_t row : filtered.rows) {
    if (ClassOutcome* of = outcome(row)) {
      --of->thinned_count;
      ++of->outlier_count;
    }
  }
  for (const uint32_t i : kept) {
    if (ClassOutcome* of = outcome(filtered.rows[i])) {
      --of->outlier_count;
      ++of->kept[Index(filtered.columns.label[i])];
    }
  }
  Confusion confusion{.attribute = values.name()};
  for (auto& [value, of] : classes) {
    of.value = value;
    of.name = name(value);
    confusion.classes.push_back(std::move(of));
  }
  return confusion;
}

RuleReport ReportRule(const LatticeCloud& cloud, const BallCounter& input,
                      const std::vector<uint32_t>& input_rows,
                      const RuleRun& run, const core::SpdfOptions& options,
                      Executor& executor) {
  const FilteredCloud& filtered = run.filtered;
  const std::vector<uint32_t> kept = filtered.Inliers(options.outlier_share);
  RuleReport report{
      .rule = run.rule,
      .filter_s = run.filter_s,
      .round_count = filtered.summary.round_count,
      .survivor_count = filtered.summary.survivor_count,
      .kept_count = static_cast<int64_t>(kept.size()),
      .survivor_label_counts = filtered.summary.label_counts,
      .density = MeasureDensity(cloud, input, filtered,
                                core::MakeSpdfConstants(options, cloud.lattice),
                                executor),
      .saliency = MeasureSaliencies(filtered.columns)};
  for (const uint32_t i : kept) {
    ++report.kept_label_counts[Index(filtered.columns.label[i])];
  }
  const std::pair<std::string_view, std::string (*)(uint8_t)> known[] = {
      {"classification", ClassName}, {"truth", TruthName}};
  for (const auto& [attribute, name] : known) {
    const core::Column* values = cloud.attributes.Find(attribute);
    if (values == nullptr || values->type() != core::ScalarType::kUint8) {
      continue;
    }
    report.confusions.push_back(
        Compare(*values, name, input_rows, filtered, kept));
  }
  return report;
}

}  // namespace

int LabelDimension(Label label) {
  return label == Label::kCurve ? 1 : label == Label::kSurface ? 2 : 3;
}

double RatioBins::LowerEdge(size_t bin) {
  return std::exp2(kFirstExponent + static_cast<double>(bin) / kPerOctave);
}

FilterReport MakeFilterReport(const LatticeCloud& cloud,
                              const FilteredCloud& unfiltered,
                              std::span<const RuleRun> runs,
                              const core::SpdfOptions& options,
                              const ExecutionContext& context) {
  FilterReport report{.options = options,
                      .step = cloud.lattice.step(),
                      .point_count = unfiltered.summary.point_count,
                      .input_label_counts = unfiltered.summary.label_counts,
                      .input_saliency = MeasureSaliencies(unfiltered.columns)};
  for (const Label label : kGeometricLabels) {
    const int dimension = LabelDimension(label);
    report.target_density[Index(label)] =
        options.neighbor_count /
        (UnitBallVolume(dimension) *
         std::pow(options.density_radius_m, dimension));
    report.expected_strength[Index(label)] = core::ExpectedStrength(
        dimension, options.vote_scale_m2, options.density_radius_m);
    report.expected_saliency[Index(label)] =
        core::ExpectedSaliency(dimension, options);
  }
  const BallCounter input = CounterOf(cloud, unfiltered.rows);
  for (const RuleRun& run : runs) {
    report.rules.push_back(ReportRule(cloud, input, unfiltered.rows, run,
                                      options, *context.executor));
  }
  return report;
}

}  // namespace mapsieve::client
