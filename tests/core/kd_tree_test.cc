#include "core/registration/kd_tree.h"

#include <algorithm>
#include <array>
#include <vector>

#include "gtest/gtest.h"
#include "tests/testing/random.h"

namespace mapsieve::core {
namespace {

using testing::Random;

Vector3 Difference(const Vector3& a, const Vector3& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

TEST(KdTree, FindsTheNeighboursThatBruteForceFinds) {
  Random random(1);
  std::vector<Vector3> points;
  for (int i = 0; i < 500; ++i) {
    points.push_back(
        {random.Uniform(-1, 1), random.Uniform(-1, 1), random.Uniform(-1, 1)});
  }
  for (int i = 0; i < 40; ++i) points.push_back(points[0]);
  const KdTree tree(points);
  for (int q = 0; q < 200; ++q) {
    const Vector3 query = {random.Uniform(-2, 2), random.Uniform(-1, 1),
                           random.Uniform(-1, 1)};
    std::vector<double> expected;
    for (const Vector3& p : points) {
      const Vector3 d = Difference(p, query);
      expected.push_back(Dot(d, d));
    }
    std::sort(expected.begin(), expected.end());
    std::array<KdTree::Neighbor, 7> found;
    ASSERT_EQ(tree.FindNearest(query, found), found.size());
    for (size_t i = 0; i < found.size(); ++i) {
      EXPECT_EQ(found[i].squared_distance, expected[i]);
      const Vector3 d = Difference(points[found[i].row], query);
      EXPECT_EQ(Dot(d, d), expected[i]);
    }
  }
}

TEST(KdTree, OfFewPointsGivesThemAll) {
  const std::vector<Vector3> points = {{1, 0, 0}, {3, 0, 0}};
  std::array<KdTree::Neighbor, 4> found;
  ASSERT_EQ(KdTree(points).FindNearest({2.5, 0, 0}, found), 2);
  EXPECT_EQ(found[0].row, 1);
  EXPECT_EQ(found[1].row, 0);
  EXPECT_EQ(KdTree({}).FindNearest({0, 0, 0}, found), 0);
}

}  // namespace
}  // namespace mapsieve::core
