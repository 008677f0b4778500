#include "client/formats/occupancy_file.h"

#include <octomap/OcTree.h>

#include <cmath>
#include <filesystem>
#include <limits>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <tuple>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/formats/file_table.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

using core::Point3;
using core::PointCloud;
using mapsieve::testing::StatusIs;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::TemporaryFile;
using Voxels = std::set<std::tuple<int, int, int>>;

constexpr double kEdge = 0.1;

/// Clumps, of which one fills voxels that become one node.
PointCloud MakeCloud() {
  std::mt19937_64 random(5);
  std::normal_distribution<double> at(0, 0.4);
  PointCloud cloud;
  for (int i = 0; i < 3000; ++i) {
    cloud.positions.push_back({at(random) - 3, at(random), at(random) + 2});
  }
  for (int x = 0; x < 8; ++x) {
    for (int y = 0; y < 8; ++y) {
      for (int z = 0; z < 8; ++z) {
        cloud.positions.push_back(
            {8 + x * 0.1 + 0.05, 8 + y * 0.1 + 0.05, 8 + z * 0.1 + 0.05});
      }
    }
  }
  return cloud;
}

Voxels VoxelsOf(const PointCloud& cloud, const Point3& origin) {
  Voxels voxels;
  const auto index = [](double v) {
    return static_cast<int>(std::floor(v / kEdge));
  };
  for (const Point3& p : cloud.positions) {
    voxels.emplace(index(p.x - origin.x), index(p.y - origin.y),
                   index(p.z - origin.z));
  }
  return voxels;
}

/// Every occupied voxel of a tree; those that are one node, each by itself.
Voxels VoxelsOf(octomap::OcTree& tree) {
  tree.expand();
  Voxels voxels;
  for (auto leaf = tree.begin_leafs(); leaf != tree.end_leafs(); ++leaf) {
    EXPECT_TRUE(tree.isNodeOccupied(*leaf));
    const octomap::OcTreeKey key = leaf.getKey();
    voxels.emplace(key[0] - 32768, key[1] - 32768, key[2] - 32768);
  }
  return voxels;
}

void ExpectVoxelsOfPoints(const std::string& extension) {
  SCOPED_TRACE(extension);
  const TemporaryFile file(extension);
  const PointCloud cloud = MakeCloud();
  const Point3 origin{1, 2, -0.5};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto writer, CreateOccupancyFile(file.path(), {.voxel_edge = kEdge,
                                                           .origin = origin}));
  // A part twice: how many points a voxel holds does not matter.
  MAPSIEVE_ASSERT_OK(writer->Write(cloud));
  MAPSIEVE_ASSERT_OK(writer->Write(
      {{cloud.positions.begin(), cloud.positions.begin() + 1000}, {}}));
  MAPSIEVE_ASSERT_OK(writer->Finish());

  std::unique_ptr<octomap::OcTree> tree;
  if (extension == ".bt") {
    tree = std::make_unique<octomap::OcTree>(1);
    ASSERT_TRUE(tree->readBinary(file.path().string()));
  } else {
    tree.reset(dynamic_cast<octomap::OcTree*>(
        octomap::AbstractOcTree::read(file.path().string())));
    ASSERT_NE(tree, nullptr);
  }
  EXPECT_EQ(tree->getResolution(), kEdge);
  const Voxels expected = VoxelsOf(cloud, origin);
  EXPECT_LT(tree->getNumLeafNodes(), expected.size());
  EXPECT_EQ(VoxelsOf(*tree), expected);
}

TEST(OccupancyFile, HoldsTheVoxelsOfThePoints) {
  ExpectVoxelsOfPoints(".bt");
  ExpectVoxelsOfPoints(".ot");
}

TEST(OccupancyFile, SaysWhichPointIsBeyondItsReach) {
  const TemporaryFile file(".bt", "before");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      auto writer, CreateOccupancyFile(file.path(), {.voxel_edge = kEdge}));
  MAPSIEVE_EXPECT_OK(writer->Write({{{3276.7, 0, -3276.7}}, {}}));
  EXPECT_THAT(writer->Write({{{0, 0, 0}, {500000, 1, 2}}, {}}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("(500000, 1, 2)"),
                             HasSubstr("move the origin"))));
  writer.reset();
  EXPECT_EQ(std::filesystem::file_size(file.path()), 6);
}

TEST(OccupancyFile, RefusesWhatIsNoTree) {
  const TemporaryFile file(".bt");
  const auto refusal = [&](const std::filesystem::path& path,
                           const OccupancyOptions& options) {
    return CreateOccupancyFile(path, options).status();
  };
  EXPECT_THAT(refusal("map.pcd", {}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(".bt")));
  for (const double edge : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN(),
                            std::numeric_limits<double>::infinity()}) {
    EXPECT_THAT(
        refusal(file.path(), {.voxel_edge = edge}),
        StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("voxel_edge")));
  }
  EXPECT_THAT(
      refusal(file.path(),
              {.origin = {0, std::numeric_limits<double>::infinity(), 0}}),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("origin")));
}

}  // namespace
}  // namespace mapsieve::client
