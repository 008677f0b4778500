#include "core/spdf/levels.h"

#include <vector>

#include "client/lab/simulate.h"
#include "core/spdf/cloud_filter.h"
#include "gtest/gtest.h"
#include "tests/testing/level_density.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

// tests/bench/levels_table prints the same of a larger survey.
TEST(LevelsOfACampus, HoldAsManyPointsInABallAsAimedAt) {
  const core::SpdfOptions options = {.density_radius_m = 0.2};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      CampusScanner scanner, CampusScanner::Create({.point_count = 150'000}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::PointCloud survey,
                                scanner.NextBatch(150'000));
  core::RefusedCounts refused;
  const core::LatticeCloud cloud =
      core::Quantize(survey, core::Lattice(), refused);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::FilteredCloud filtered,
                                core::FilterCloud(cloud, options));
  const std::vector<core::LatticePoint> points =
      cloud.Select(filtered.rows).positions;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const std::vector<uint8_t> depths,
      core::ComputeDepths(points, cloud.lattice, options));
  const std::vector<testing::LevelDensity> densities =
      testing::MeasureLevels(points, depths, cloud.lattice, options);
  ASSERT_EQ(densities.size(), 5u);
  for (size_t i = 0; i < densities.size(); ++i) {
    SCOPED_TRACE("level " + std::to_string(i + 1));
    EXPECT_GT(densities[i].dense_count, 1000);
    EXPECT_NEAR(densities[i].mean, 1, 0.1);
    EXPECT_NEAR(densities[i].median, 1, 0.1);
  }
}

}  // namespace
}  // namespace mapsieve::client
