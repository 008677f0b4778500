#include "core/cloud/merge_duplicates.h"

#include <algorithm>
#include <random>

#include "core/geometry/morton.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

TEST(MortonOrder, SortsPointsFarApartAndAcrossZero) {
  std::mt19937_64 random(6);
  std::vector<LatticePoint> points;
  for (int i = 0; i < 5000; ++i) {
    const auto coordinate = [&] {
      const int bits = 1 + static_cast<int>(random() % 42);
      return (static_cast<int64_t>(random()) >> (64 - bits));
    };
    points.push_back({coordinate(), coordinate(), coordinate()});
  }
  std::vector<uint32_t> expected(points.size());
  for (uint32_t i = 0; i < expected.size(); ++i) expected[i] = i;
  std::stable_sort(
      expected.begin(), expected.end(),
      [&](uint32_t a, uint32_t b) { return MortonLess(points[a], points[b]); });
  EXPECT_EQ(MortonOrder(points), expected);
}

TEST(MortonOrder, KeepsTheOrderOfEqualPointsOfAscendingRuns) {
  for (int run_count = 0; run_count <= 10; ++run_count) {
    SCOPED_TRACE(run_count);
    std::vector<LatticePoint> points;
    for (int run = 0; run < run_count; ++run) {
      const LatticeCloud cloud = testing::SceneCloud(200 + 50 * run, 0.02, 8);
      const std::vector<LatticePoint> part = DistinctPoints(cloud.positions);
      points.insert(points.end(), part.begin(), part.end());
    }
    std::vector<uint32_t> expected(points.size());
    for (uint32_t i = 0; i < expected.size(); ++i) expected[i] = i;
    std::stable_sort(expected.begin(), expected.end(),
                     [&](uint32_t a, uint32_t b) {
                       return MortonLess(points[a], points[b]);
                     });
    EXPECT_EQ(MortonOrder(points), expected);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<uint32_t> merged,
                                  MergeMortonRuns(points, {}));
    EXPECT_EQ(merged, expected);
    EXPECT_EQ(IsMortonSorted(points), run_count < 2);
  }
}

TEST(MergeMortonRuns, SortsAnyOrder) {
  std::vector<LatticePoint> points =
      testing::SceneCloud(3000, 0.02, 8).positions;
  std::mt19937 random(3);
  std::shuffle(points.begin(), points.end(), random);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<uint32_t> merged,
                                MergeMortonRuns(points, {}));
  EXPECT_EQ(merged, MortonOrder(points));
}

TEST(MergeMortonRuns, StopsWhenAsked) {
  std::vector<LatticePoint> points = {{5, 0, 0}, {1, 0, 0}};
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THAT(MergeMortonRuns(points, stop.get_token()),
              testing::StatusIs(absl::StatusCode::kCancelled, ::testing::_));
}

TEST(MergeDuplicates, KeepsTheSmallestAttributesWhateverTheOrder) {
  LatticeCloud cloud = testing::SceneCloud(2000, 0.02, 8);  // many collisions
  cloud = testing::WithAttributes(std::move(cloud), 9);
  const LatticeCloud first = cloud.Select(MergeDuplicates(cloud));
  EXPECT_LT(first.size(), cloud.size());
  EXPECT_EQ(first.positions, DistinctPoints(cloud.positions));
  for (uint64_t seed = 0; seed < 3; ++seed) {
    const LatticeCloud shuffled = testing::Shuffled(cloud, seed);
    const LatticeCloud again = shuffled.Select(MergeDuplicates(shuffled));
    EXPECT_EQ(again.positions, first.positions);
    EXPECT_EQ(again.attributes, first.attributes);
  }
}

TEST(MergeDuplicates, PrefersMissingThenSmallerBytesByName) {
  LatticeCloud cloud;
  cloud.positions.assign(3, {1, 2, 3});
  Column b({"b", ScalarType::kUint8});
  Column a({"a", ScalarType::kUint8});
  for (const uint8_t v : {uint8_t{1}, uint8_t{2}, uint8_t{3}}) b.Append(v);
  for (const uint8_t v : {uint8_t{9}, uint8_t{7}, uint8_t{7}}) a.Append(v);
  // "a" decides first, although it is the second column.
  cloud.attributes.columns() = {b, a};
  EXPECT_EQ(MergeDuplicates(cloud), std::vector<uint32_t>{1});
  cloud.attributes.Find("a")->SetMissing(0);
  EXPECT_EQ(MergeDuplicates(cloud), std::vector<uint32_t>{0});
}

}  // namespace
}  // namespace mapsieve::core
