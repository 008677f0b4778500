#include "client/lab/map_pair.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::client {
namespace {

using core::Point3;
using core::RigidTransform;
using mapsieve::testing::StatusIs;
using mapsieve::testing::TemporaryDirectory;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// A place in a projected system.
constexpr Point3 kFarAway = {331000, 5183000, 90};

class MapPairTest : public ::testing::Test {
 protected:
  std::string Write(const std::string& name,
                    const std::vector<Point3>& points) {
    std::ofstream file(folder_ / name);
    file.precision(12);
    file << "x,y,z\n";
    for (const Point3& p : points) {
      file << p.x << "," << p.y << "," << p.z << "\n";
    }
    return folder_ / name;
  }

  const TemporaryDirectory folder_;
};

std::vector<Point3> Scene(const Point3& origin) {
  const core::LatticeCloud cloud = mapsieve::testing::SceneCloud(3000, 3, 1);
  std::vector<Point3> points;
  for (const core::LatticePoint& q : cloud.positions) {
    const Point3 p = cloud.lattice.Position(q);
    points.push_back({p.x + origin.x, p.y + origin.y, p.z + origin.z});
  }
  return points;
}

TEST_F(MapPairTest, HasItsOriginAmongItsPoints) {
  const std::vector<Point3> points = Scene(kFarAway);
  RigidTransform T_b_a;
  T_b_a.rotation = core::RotationFromVector({0, 0, 0.5});
  T_b_a.translation = {400, -300, 7};
  std::vector<Point3> moved;
  for (const Point3& p : points) moved.push_back(T_b_a(p));
  const RigidTransform T_a_b = T_b_a.Inverse();

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const MapPair pair,
      LoadMapPair(Write("a.csv", points), Write("b.csv", moved), T_a_b));
  EXPECT_EQ(pair.overlap, 1);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair scans, pair.source.load());
  EXPECT_EQ(pair.point_count,
            static_cast<int64_t>(
                std::min(scans.reference.size(), scans.reading.size())));
  for (const core::LatticeCloud* cloud : {&scans.reference, &scans.reading}) {
    Point3 sum = {0, 0, 0};
    for (const core::LatticePoint& q : cloud->positions) {
      const Point3 p = cloud->lattice.Position(q);
      sum = {sum.x + p.x, sum.y + p.y, sum.z + p.z};
    }
    const auto count = static_cast<double>(cloud->size());
    // Of distinct points; the origin is the mean of all.
    EXPECT_LT(std::hypot(sum.x, sum.y, sum.z) / count, 0.5);
  }
  EXPECT_EQ(scans.T_reference_reading.rotation, T_a_b.rotation);
  // The truth still lays points of the reading on ones of the reference:
  // 3 mm are the rounding of both lattices.
  for (size_t i = 0; i < scans.reading.size(); i += 30) {
    const Point3 p = scans.T_reference_reading(
        scans.reading.lattice.Position(scans.reading.positions[i]));
    bool is_near = false;
    for (const core::LatticePoint& r : scans.reference.positions) {
      const Point3 s = scans.reference.lattice.Position(r);
      is_near = is_near || std::hypot(p.x - s.x, p.y - s.y, p.z - s.z) < 0.003;
    }
    EXPECT_TRUE(is_near);
  }
}

TEST_F(MapPairTest, IsNamedAfterFilesAndContent) {
  std::vector<Point3> points = Scene({0, 0, 0});
  const std::string a = Write("a,1.csv", points);
  const auto name_of = [&](const std::string& b, const RigidTransform& truth) {
    return LoadMapPair(a, b, truth).value().source.name;
  };
  const std::string name = name_of(a, {});
  EXPECT_THAT(name, ::testing::StartsWith("a_1.csv a_1.csv "));
  EXPECT_EQ(name_of(a, {}), name);
  RigidTransform turned;
  turned.rotation = core::RotationFromVector({0, 0, 0.01});
  EXPECT_NE(name_of(a, turned), name);
  std::filesystem::create_directory(folder_ / "other");
  points.pop_back();
  EXPECT_NE(name_of(Write("other/a,1.csv", points), {}), name);
}

TEST_F(MapPairTest, LeavesOutPointsThatAreNone) {
  std::vector<Point3> points = Scene({0, 0, 0});
  const std::string a = Write("a.csv", points);
  points.push_back({NAN, 1, 2});
  points.push_back({1, 2, HUGE_VAL});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapPair pair,
                                LoadMapPair(a, Write("b.csv", points), {}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair scans, pair.source.load());
  EXPECT_EQ(scans.reading.size(), scans.reference.size());
}

TEST_F(MapPairTest, SaysWhichFileIsWrong) {
  const std::string good = Write("good.csv", Scene({0, 0, 0}));
  const auto expect = [](const absl::StatusOr<MapPair>& result,
                         absl::StatusCode code, const std::string& file,
                         const std::string& what) {
    EXPECT_THAT(result,
                StatusIs(code, AllOf(HasSubstr(file), HasSubstr(what))));
  };
  expect(LoadMapPair(good, folder_ / "none.csv", {}),
         absl::StatusCode::kNotFound, "none.csv", "");
  expect(LoadMapPair(Write("empty.csv", {}), good, {}),
         absl::StatusCode::kInvalidArgument, "empty.csv", "0 distinct points");
  expect(LoadMapPair(good, Write("empty.csv", {}), {}),
         absl::StatusCode::kInvalidArgument, "empty.csv", "0 distinct points");
  expect(LoadMapPair(good, Write("one.csv", {{1, 2, 3}, {1, 2, 3}}), {}),
         absl::StatusCode::kInvalidArgument, "one.csv", "1 distinct points");
  RigidTransform far;
  far.translation = {0, 0, 40};
  expect(LoadMapPair(good, good, far), absl::StatusCode::kInvalidArgument,
         "good.csv", "do not overlap: 0.0 %");
}

}  // namespace
}  // namespace mapsieve::client
