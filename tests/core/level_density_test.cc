#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "core/spdf/levels.h"
#include "gtest/gtest.h"
#include "tests/testing/ideal_shape.h"

namespace mapsieve::core {
namespace {

namespace shapes = ::mapsieve::testing;

// Level `level` of shapes that are 12 times as dense as it: on a line all of
// the finer ones are denser than the next, in a volume the last.
TEST(DensityOfLevels, IsTheOneAimedAt) {
  for (const int dimension : {1, 2, 3}) {
    for (const int level : {1, 2, 3}) {
      SCOPED_TRACE("dimension " + std::to_string(dimension) + " level " +
                   std::to_string(level));
      constexpr int kSeedCount = 3;
      double per_measure = 0;
      double per_ball = 0;
      for (uint64_t seed = 1; seed <= kSeedCount; ++seed) {
        const shapes::IdealShapeOptions options = {
            .dimension = dimension, .start = 12, .seed = seed};
        const shapes::IdealShape shape = shapes::MakeIdealShape(options);
        const SpdfOptions spdf = {
            .neighbor_count = options.neighbor_count,
            .density_radius_m = std::ldexp(options.radius_m, -level),
            .seed = static_cast<int64_t>(seed)};
        const auto depths =
            ComputeDepths(shape.cloud.positions, shape.cloud.lattice, spdf);
        ASSERT_TRUE(depths.ok()) << depths.status();
        std::vector<LatticePoint> kept;
        for (size_t i = 0; i < depths->size(); ++i) {
          if ((*depths)[i] >= level) kept.push_back(shape.cloud.positions[i]);
        }
        const auto reached = shapes::MeasureDensity(shape, options, kept);
        per_measure += reached.per_measure / kSeedCount;
        per_ball += reached.per_ball / kSeedCount;
      }
      EXPECT_NEAR(per_measure, 1, 0.1);
      EXPECT_NEAR(per_ball, 1, 0.1);
    }
  }
}

}  // namespace
}  // namespace mapsieve::core
