// The whole matrix of radii, noise and starts is tests/bench/label_table.
#include <algorithm>
#include <cstdint>
#include <string>

#include "core/spdf/spdf_options.h"
#include "gtest/gtest.h"
#include "tests/testing/clouds.h"
#include "tests/testing/ideal_shape.h"
#include "tests/testing/normal_error.h"

namespace mapsieve::core {
namespace {

namespace shapes = ::mapsieve::testing;

constexpr DensityRule kRules[] = {DensityRule::kPaper, DensityRule::kQuota};

/// The median error over both sparse and dense starts and several
/// orientations: the largest.
double WorstMedian(const SpdfOptions& options, double noise_m) {
  double worst = 0;
  for (const double start : {1.5, 10.0}) {
    for (uint64_t seed = 1; seed <= 4; ++seed) {
      const shapes::IdealShape plane =
          shapes::MakeIdealShape({.dimension = 2,
                                  .neighbor_count = options.neighbor_count,
                                  .radius_m = options.density_radius_m,
                                  .start = start,
                                  .noise_m = noise_m,
                                  .seed = seed});
      const shapes::NormalError error =
          shapes::MeasureNormalError(plane, options);
      worst = std::max(worst, error.median);
    }
  }
  return worst;
}

/// The cloud turned so that what was along z is along axis `axis`.
LatticeCloud WithZAlong(const LatticeCloud& cloud, int axis) {
  return shapes::Mapped(cloud, [axis](const LatticePoint& q) {
    return axis == 0   ? LatticePoint{q.z, q.x, q.y}
           : axis == 1 ? LatticePoint{q.y, q.z, q.x}
                       : q;
  });
}

TEST(Normals, OfPlanesWithoutNoiseAreWithinADegree) {
  for (const DensityRule rule : kRules) {
    SCOPED_TRACE(std::string(DensityRuleName(rule)));
    EXPECT_LE(WorstMedian({.density_radius_m = 0.2, .rule = rule}, 0), 1);
  }
}

TEST(Normals, OfPlanesAlongTheAxesAreWithinADegree) {
  const LatticeCloud flat = shapes::PlaneCloud(20000, 1, 7);
  for (const DensityRule rule : kRules) {
    for (int axis = 0; axis < 3; ++axis) {
      SCOPED_TRACE(std::string(DensityRuleName(rule)) + " axis " +
                   std::to_string(axis));
      shapes::IdealShape plane{.cloud = WithZAlong(flat, axis),
                               .half_interior_m = 0.6,
                               .dimension = 2};
      for (int i = 0; i < 3; ++i) plane.axes[i][(axis + 1 + i) % 3] = 1;
      const shapes::NormalError error = shapes::MeasureNormalError(
          plane, {.density_radius_m = 0.2, .rule = rule});
      EXPECT_LE(error.median, 1);
      EXPECT_LE(error.p90, 1);
    }
  }
}

TEST(Normals, OfPlanesWithTwoCentimetresOfNoiseNeedWideOrManyVoters) {
  for (const DensityRule rule : kRules) {
    SCOPED_TRACE(std::string(DensityRuleName(rule)));
    constexpr double kNoise = 0.02;
    SpdfOptions options = {.density_radius_m = 0.4, .rule = rule};
    EXPECT_LE(WorstMedian(options, kNoise), 3);
    // Where the noise is a tenth of the radius, 50 voters do not even it out.
    options.density_radius_m = 0.2;
    EXPECT_GT(WorstMedian(options, kNoise), 3);
    EXPECT_LE(WorstMedian(options, kNoise), 4.5);
    options.label_neighbor_count = kMaxNeighborCount;
    EXPECT_LE(WorstMedian(options, kNoise), 3);
    options.label_neighbor_count = 0;
    options.neighbor_count = 100;
    EXPECT_LE(WorstMedian(options, kNoise), 3);
  }
}

}  // namespace
}  // namespace mapsieve::core
