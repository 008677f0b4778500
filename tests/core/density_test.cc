#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "core/cloud/merge_duplicates.h"
#include "core/geometry/morton.h"
#include "core/spdf/cloud_filter.h"
#include "gtest/gtest.h"
#include "tests/testing/clouds.h"
#include "tests/testing/ideal_shape.h"

namespace mapsieve::core {
namespace {

namespace shapes = ::mapsieve::testing;

std::vector<LatticePoint> Kept(const LatticeCloud& cloud, double rho, int k,
                               int64_t seed = 0) {
  return shapes::Survivors(cloud, {.neighbor_count = k,
                                   .density_radius_m = rho,
                                   .rule = DensityRule::kQuota,
                                   .seed = seed});
}

bool Includes(const std::vector<LatticePoint>& all,
              const std::vector<LatticePoint>& some) {
  const auto less = [](const LatticePoint& a, const LatticePoint& b) {
    return MortonLess(a, b);
  };
  return std::includes(all.begin(), all.end(), some.begin(), some.end(), less);
}

/// A scene that is a different one for every seed, up to far beyond target.
LatticeCloud RandomScene(uint64_t seed) {
  const int count = 500 + static_cast<int>(seed * 577 % 3000);
  LatticeCloud scene = shapes::SceneCloud(count, 0.5, 100 + seed);
  scene.positions = DistinctPoints(scene.positions);
  return scene;
}

// The whole matrix of radii, starts and seeds is tests/bench/density_table.
TEST(DensityOfQuota, IsTheOneAimedAt) {
  for (const int dimension : {1, 2, 3}) {
    for (const double noise_m : {0.0, 0.01}) {
      SCOPED_TRACE("dimension " + std::to_string(dimension) + " noise " +
                   std::to_string(noise_m));
      constexpr int kSeedCount = 3;
      double per_measure = 0;
      double per_ball = 0;
      double spread = 0;
      double random_spread = 0;
      for (uint64_t seed = 1; seed <= kSeedCount; ++seed) {
        const shapes::IdealShapeOptions options = {.dimension = dimension,
                                                   .start = 6,
                                                   .noise_m = noise_m,
                                                   .seed = seed};
        const shapes::IdealShape shape = shapes::MakeIdealShape(options);
        const auto kept = Kept(shape.cloud, options.radius_m,
                               options.neighbor_count, int64_t(seed));
        const auto reached = shapes::MeasureDensity(shape, options, kept);
        const auto random = shapes::MeasureDensity(
            shape, options,
            shapes::RandomlyThinned(shape.cloud, kept.size(), int64_t(seed)));
        per_measure += reached.per_measure / kSeedCount;
        per_ball += reached.per_ball / kSeedCount;
        spread += reached.spread / kSeedCount;
        random_spread += random.spread / kSeedCount;
      }
      EXPECT_NEAR(per_measure, 1, 0.05);
      EXPECT_NEAR(per_ball, 1, 0.05);
      EXPECT_LT(spread, 0.85 * random_spread);
    }
  }
}

TEST(DensityOfQuota, IsNestedInTheRadius) {
  for (uint64_t seed = 0; seed < 20; ++seed) {
    SCOPED_TRACE(seed);
    const LatticeCloud scene = RandomScene(seed);
    const int k = 6 + static_cast<int>(seed * 3);
    std::vector<LatticePoint> finer = scene.positions;
    for (const double rho : {0.03, 0.05, 0.0501, 0.1, 0.2, 0.7}) {
      std::vector<LatticePoint> coarser =
          Kept(scene, rho, k, static_cast<int64_t>(seed));
      EXPECT_TRUE(Includes(finer, coarser)) << "rho " << rho;
      finer = std::move(coarser);
    }
    EXPECT_LT(finer.size(), scene.size());
  }
}

TEST(DensityOfQuota, IsNestedInTheNeighborCount) {
  for (uint64_t seed = 0; seed < 20; ++seed) {
    SCOPED_TRACE(seed);
    const LatticeCloud scene = RandomScene(seed);
    std::vector<LatticePoint> more = scene.positions;
    for (const int k : {127, 100, 50, 49, 20, 6}) {
      std::vector<LatticePoint> fewer =
          Kept(scene, 0.1, k, static_cast<int64_t>(seed));
      EXPECT_TRUE(Includes(more, fewer)) << "k " << k;
      more = std::move(fewer);
    }
    EXPECT_LT(more.size(), scene.size());
  }
}

TEST(DensityOfQuota, LosesOnlyPointsNearAnAddedOne) {
  constexpr double kRho = 0.1;
  int64_t lost_count = 0;
  for (uint64_t seed = 0; seed < 60; ++seed) {
    SCOPED_TRACE(seed);
    LatticeCloud scene = RandomScene(seed);
    const auto before = Kept(scene, kRho, 10);
    // Beside a point of the scene, which is where it matters.
    LatticePoint added = scene.positions[seed * 131 % scene.size()];
    added.x += 3;
    added.z += 5;
    scene.positions.push_back(added);
    std::vector<LatticePoint> expected_at_most = before;
    expected_at_most.push_back(added);
    const auto after = Kept(scene, kRho, 10);
    for (const LatticePoint& q : after) {
      EXPECT_NE(std::find(expected_at_most.begin(), expected_at_most.end(), q),
                expected_at_most.end());
    }
    for (const LatticePoint& q : before) {
      if (std::find(after.begin(), after.end(), q) != after.end()) continue;
      ++lost_count;
      const double step = scene.lattice.step();
      EXPECT_LE(std::hypot(static_cast<double>(q.x - added.x) * step,
                           static_cast<double>(q.y - added.y) * step,
                           static_cast<double>(q.z - added.z) * step),
                kRho + 1e-9);
    }
  }
  EXPECT_GT(lost_count, 10);
}

}  // namespace
}  // namespace mapsieve::core
