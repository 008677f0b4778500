// Prints, as markdown, what the levels of detail of the simulated campus cost
// beside the filter, in one run on one thread, and of each level its points,
// its density where its input was denser, and its shares of labels.
//   levels_table [--rule paper|quota] [--repeats N] [POINTS]
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string_view>
#include <vector>

#include "client/lab/simulate.h"
#include "core/base/heap.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/levels.h"
#include "tests/bench/bench_util.h"
#include "tests/testing/level_density.h"

namespace mapsieve::bench {
namespace {

struct TableOptions {
  core::SpdfOptions spdf = {.density_radius_m = 0.2};
  int64_t point_count = 1'000'000;
  int repeats = 3;
};

void PrintLevels(const std::vector<core::LatticePoint>& points,
                 const std::vector<uint8_t>& depths,
                 const std::vector<core::Label>& labels,
                 const TableOptions& options) {
  const std::vector<testing::LevelDensity> densities =
      testing::MeasureLevels(points, depths, core::Lattice(), options.spdf);
  std::printf(
      "| level | spacing m | points | denser input | count in the ball / k: "
      "mean | median | junctions | curves | surfaces |\n"
      "|---|---|---|---|---|---|---|---|---|\n");
  for (int level = 0; level <= core::kMaxDepth; ++level) {
    core::LabelCounts counts{};
    int64_t all = 0;
    for (size_t i = 0; i < depths.size(); ++i) {
      if (depths[i] < level) continue;
      ++counts[static_cast<size_t>(labels[i])];
      ++all;
    }
    std::printf("| %d | %.2f | %lld |", level,
                core::LevelSpacing(options.spdf, level),
                static_cast<long long>(all));
    const auto d = static_cast<size_t>(level) - 1;
    if (level > 0 && d < densities.size()) {
      std::printf(" %lld | %.2f | %.2f |",
                  static_cast<long long>(densities[d].dense_count),
                  densities[d].mean, densities[d].median);
    } else {
      std::printf(" | | |");
    }
    for (const core::Label label :
         {core::Label::kJunction, core::Label::kCurve, core::Label::kSurface}) {
      std::printf(" %.1f %% |",
                  100.0 *
                      static_cast<double>(counts[static_cast<size_t>(label)]) /
                      static_cast<double>(all));
    }
    std::printf("\n");
  }
}

void PrintTable(const TableOptions& options) {
  const std::vector<core::Point3> survey =
      SimulatedPoints({.point_count = options.point_count});
  std::vector<double> filter_s;
  std::vector<double> levels_s;
  std::vector<core::LatticePoint> points;
  std::vector<core::Label> labels;
  std::vector<uint8_t> depths;
  for (int i = 0; i < options.repeats; ++i) {
    core::PointCloud input{survey, {}};
    core::LatticeCloud cloud;
    core::FilteredCloud filtered;
    filter_s.push_back(Seconds([&] {
      core::RefusedCounts refused;
      cloud = core::Quantize(std::move(input), core::Lattice(), refused);
      filtered = ValueOrDie(core::FilterCloud(cloud, options.spdf));
    }));
    points.clear();
    for (const uint32_t row : filtered.rows) {
      points.push_back(cloud.positions[row]);
    }
    labels.assign(filtered.columns.label.begin(), filtered.columns.label.end());
    levels_s.push_back(Seconds([&] {
      depths = ValueOrDie(
          core::ComputeDepths(points, core::Lattice(), options.spdf));
    }));
  }
  std::printf("filter %.3f s, all levels %.3f s, ratio %.2f\n\n",
              Median(filter_s), Median(levels_s),
              Median(levels_s) / Median(filter_s));
  PrintLevels(points, depths, labels, options);
}

}  // namespace
}  // namespace mapsieve::bench

int main(int argc, char** argv) {
  mapsieve::ReturnFreedBlocks();
  mapsieve::bench::TableOptions options;
  for (int i = 1; i < argc; ++i) {
    const std::string_view arg = argv[i];
    if (arg == "--rule" && i + 1 < argc) {
      options.spdf.rule = std::string_view(argv[++i]) == "quota"
                              ? mapsieve::core::DensityRule::kQuota
                              : mapsieve::core::DensityRule::kPaper;
    } else if (arg == "--repeats" && i + 1 < argc) {
      options.repeats = std::atoi(argv[++i]);
    } else {
      options.point_count = std::atoll(argv[i]);
    }
  }
  if (options.point_count < 1 || options.repeats < 1) {
    std::fprintf(stderr,
                 "usage: %s [--rule paper|quota] [--repeats N] [POINTS]\n",
                 argv[0]);
    return 2;
  }
  mapsieve::bench::PrintTable(options);
}
