// Prints, as a markdown table, the density that both rules reach on lines,
// planes and volumes over the one aimed at, and the spread of the count in the
// ball of the density radius over that of random thinning to the same count.
//   density_table [SEEDS]   seeds a row is the mean of, default 5
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "core/spdf/spdf_options.h"
#include "tests/testing/ideal_shape.h"

namespace mapsieve::bench {
namespace {

using core::DensityRule;
using testing::IdealShape;
using testing::IdealShapeOptions;
using testing::ReachedDensity;

constexpr double kTolerance = 0.05;
constexpr std::array kRules = {DensityRule::kPaper, DensityRule::kQuota};

/// What one rule reached in the mean over the seeds.
struct RuleMean {
  double per_measure = 0;
  double per_ball = 0;
  double relative_spread = 0;
};

/// Of all rows.
struct RuleTotal {
  int row_count = 0;
  int within_count = 0;
  int within_per_ball_count = 0;
  int below_random_count = 0;
  double lowest = HUGE_VAL;
  double highest = 0;
};

void AddRow(IdealShapeOptions options, int seed_count,
            std::array<RuleTotal, 2>& totals) {
  std::array<RuleMean, 2> means;
  double start = 0;
  for (int seed = 1; seed <= seed_count; ++seed) {
    options.seed = static_cast<uint64_t>(seed);
    const IdealShape shape = testing::MakeIdealShape(options);
    start += shape.start / seed_count;
    for (size_t rule = 0; rule < kRules.size(); ++rule) {
      const auto kept = testing::Survivors(
          shape.cloud, {.neighbor_count = options.neighbor_count,
                        .density_radius_m = options.radius_m,
                        .rule = kRules[rule],
                        .seed = seed});
      const ReachedDensity reached =
          testing::MeasureDensity(shape, options, kept);
      const ReachedDensity random = testing::MeasureDensity(
          shape, options,
          testing::RandomlyThinned(shape.cloud, kept.size(), seed));
      means[rule].per_measure += reached.per_measure / seed_count;
      means[rule].per_ball += reached.per_ball / seed_count;
      means[rule].relative_spread +=
          reached.spread / random.spread / seed_count;
    }
  }
  constexpr const char* kNames[] = {"line", "plane", "volume"};
  std::printf("| %s | %.1f | %.0f | %.0f | %.1f |",
              kNames[options.dimension - 1], options.radius_m,
              options.noise_m * 100, options.start, start);
  for (size_t rule = 0; rule < kRules.size(); ++rule) {
    const RuleMean& mean = means[rule];
    RuleTotal& total = totals[rule];
    std::printf(" %.2f | %.2f | %.2f |", mean.per_measure, mean.per_ball,
                mean.relative_spread);
    ++total.row_count;
    total.within_count += std::abs(mean.per_measure - 1) <= kTolerance;
    total.within_per_ball_count += std::abs(mean.per_ball - 1) <= kTolerance;
    total.below_random_count += mean.relative_spread < 1;
    total.lowest = std::fmin(total.lowest, mean.per_measure);
    total.highest = std::fmax(total.highest, mean.per_measure);
  }
  std::printf("\n");
  std::fflush(stdout);
}

void PrintTable(int seed_count) {
  std::printf(
      "| shape | rho, m | noise, cm | start asked | start | paper: density | "
      "in the ball | spread | quota: density | in the ball | spread |\n"
      "|---|---|---|---|---|---|---|---|---|---|---|\n");
  std::array<RuleTotal, 2> totals;
  for (const int dimension : {1, 2, 3}) {
    for (const double radius_m : {0.1, 0.2, 0.4, 0.8}) {
      for (const double noise_m : {0.0, 0.01}) {
        for (const double start : {3.0, 10.0, 30.0}) {
          AddRow({.dimension = dimension,
                  .radius_m = radius_m,
                  .start = start,
                  .noise_m = noise_m},
                 seed_count, totals);
        }
      }
    }
  }
  std::printf("\n");
  for (size_t rule = 0; rule < kRules.size(); ++rule) {
    const RuleTotal& total = totals[rule];
    std::printf(
        "%s: density within 5 %% in %d of %d rows (%.2f to %.2f), count in the "
        "ball in %d, spread below random thinning's in %d\n",
        kRules[rule] == DensityRule::kPaper ? "paper" : "quota",
        total.within_count, total.row_count, total.lowest, total.highest,
        total.within_per_ball_count, total.below_random_count);
  }
}

}  // namespace
}  // namespace mapsieve::bench

int main(int argc, char** argv) {
  const int seed_count = argc > 1 ? std::atoi(argv[1]) : 5;
  if (seed_count < 1) {
    std::fprintf(stderr, "usage: %s [SEEDS]\n", argv[0]);
    return 2;
  }
  mapsieve::bench::PrintTable(seed_count);
}
