// The samplers that go by density and by normals, against brute force.
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "Eigen/Eigenvalues"
#include "core/cloud/merge_duplicates.h"
#include "core/geometry/point_hash.h"
#include "core/sampling/covariance_sample.h"
#include "core/sampling/density_sample.h"
#include "core/sampling/neighbor_balls.h"
#include "core/sampling/normal_space_sample.h"
#include "core/sampling/random_sample.h"
#include "core/sampling/sampler.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using Points = std::vector<LatticePoint>;
using Normal = std::array<float, 3>;

/// Squared distances of all others, ascending.
std::vector<int64_t> DistancesFrom(const Points& positions, size_t i) {
  std::vector<int64_t> distances;
  for (size_t j = 0; j < positions.size(); ++j) {
    if (j == i) continue;
    const LatticePoint& p = positions[i];
    const LatticePoint& q = positions[j];
    distances.push_back((p.x - q.x) * (p.x - q.x) + (p.y - q.y) * (p.y - q.y) +
                        (p.z - q.z) * (p.z - q.z));
  }
  std::sort(distances.begin(), distances.end());
  return distances;
}

TEST(FindNeighborBalls, AgreesWithBruteForce) {
  // Dense and sparse places, ties, a far-off part across a border of the cells
  // of the index, and a point that is alone.
  LatticeCloud cloud = testing::SceneCloud(700, 3, 1);
  cloud = testing::Concatenated(cloud, testing::GridCloud(6, 50));
  cloud = testing::Concatenated(
      cloud, testing::Shifted(testing::VolumeCloud(200, 4, 2),
                              {int64_t{1} << 28, -(int64_t{1} << 28), 0}));
  cloud.positions.push_back({int64_t{1} << 30, 0, 0});
  const Points positions = DistinctPoints(cloud.positions);
  constexpr int64_t kReach2 = 8191 * 8191;
  for (const int k : {1, 10, 127}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<NeighborBall> balls,
                                  FindNeighborBalls(positions, k, {}));
    for (size_t i = 0; i < positions.size(); ++i) {
      const std::vector<int64_t> distances = DistancesFrom(positions, i);
      const int64_t radius_d2 =
          std::min(distances[static_cast<size_t>(k) - 1], kReach2);
      const auto count =
          std::upper_bound(distances.begin(), distances.end(), radius_d2) -
          distances.begin();
      EXPECT_EQ(balls[i], (NeighborBall{static_cast<int32_t>(radius_d2),
                                        static_cast<int32_t>(count)}))
          << i << " " << k;
    }
  }
}

TEST(FindDropDensities, IsADrawOfTheDensityAround) {
  const Points positions =
      DistinctPoints(testing::SceneCloud(400, 1, 3).positions);
  const Lattice lattice;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const std::vector<double> densities,
      FindDropDensities(positions, lattice, 20, 7, {}));
  for (size_t i = 0; i < positions.size(); ++i) {
    const double r =
        1e-3 * std::sqrt(static_cast<double>(DistancesFrom(positions, i)[19]));
    const double density = 21 / (4.0 / 3 * std::numbers::pi * std::pow(r, 3));
    const double share = densities[i] / density;
    // More than 21 points where several are the twentieth.
    EXPECT_NEAR(share / PointDraw(positions[i], 7), 1, 0.15);
  }
}

TEST(MaxDensity, ThinsDensePlacesToTheDensityAndNoOthers) {
  // 5000 and 250 points per cubic metre, far apart.
  const LatticeCloud cloud = testing::Concatenated(
      testing::VolumeCloud(40000, 1, 4),
      testing::Shifted(testing::VolumeCloud(2000, 1, 5), {30000, 0, 0}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const CloudSample sample,
      Sample(cloud,
             {.method = SampleMethod::kMaxDensity, .max_density = 1000}));
  int dense = 0;
  int sparse = 0;
  for (const LatticePoint& q : sample.cloud.positions) {
    // Of the dense one its inside: at the rim half of a ball is empty.
    if (q.x > 20000) {
      ++sparse;
    } else if (std::abs(q.x) < 700 && std::abs(q.y) < 700 &&
               std::abs(q.z) < 700) {
      ++dense;
    }
  }
  EXPECT_NEAR(dense / (1.4 * 1.4 * 1.4), 1000, 60);
  EXPECT_EQ(sparse, 2000);
}

TEST(RandomShare, KeepsTheShareAndIsNested) {
  const Points positions =
      DistinctPoints(testing::VolumeCloud(20000, 1, 6).positions);
  const std::vector<uint32_t> more = RandomShare(positions, 0.3, 1);
  const std::vector<uint32_t> fewer = RandomShare(positions, 0.1, 1);
  // Within four standard deviations.
  EXPECT_NEAR(static_cast<double>(more.size()), 6000, 260);
  EXPECT_NEAR(static_cast<double>(fewer.size()), 2000, 170);
  EXPECT_TRUE(
      std::includes(more.begin(), more.end(), fewer.begin(), fewer.end()));
  EXPECT_EQ(fewer,
            RandomSample(positions, static_cast<int64_t>(fewer.size()), 1));
  EXPECT_EQ(RandomShare(positions, 1, 1).size(), positions.size());
}

/// Directions uniform on the sphere.
std::vector<Normal> RandomNormals(int count, uint64_t seed) {
  std::vector<Normal> normals;
  for (const LatticePoint& q :
       testing::SphereCloud(count, 1000, seed).positions) {
    const double length =
        std::hypot(static_cast<double>(q.x), static_cast<double>(q.y),
                   static_cast<double>(q.z));
    normals.push_back({static_cast<float>(static_cast<double>(q.x) / length),
                       static_cast<float>(static_cast<double>(q.y) / length),
                       static_cast<float>(static_cast<double>(q.z) / length)});
  }
  return normals;
}

TEST(AxisCell, CellsHaveNearlyTheSameAreaAndNoSign) {
  constexpr int kPerCell = 1000;
  std::vector<int> hits(kAxisCellCount);
  for (const Normal& n : RandomNormals(kPerCell * kAxisCellCount, 7)) {
    const size_t cell = AxisCell(n);
    ASSERT_LT(cell, kAxisCellCount);
    ASSERT_EQ(cell, AxisCell({-n[0], -n[1], -n[2]}));
    ++hits[cell];
  }
  const auto [low, high] = std::minmax_element(hits.begin(), hits.end());
  // The extremes of 867 counts add 3 standard deviations on either side.
  EXPECT_LT(static_cast<double>(*high) / *low, 1.5 * 1.2);
  EXPECT_GT(*low, kPerCell / 2);
}

TEST(AxisCell, NormalsThatScatterAroundAnAxisShareACell) {
  for (size_t axis = 0; axis < 3; ++axis) {
    Normal exact{};
    exact[axis] = 1;
    for (double angle = 0; angle < 6.28; angle += 0.1) {
      Normal n = exact;
      n[(axis + 1) % 3] = static_cast<float>(0.045 * std::cos(angle));
      n[(axis + 2) % 3] = static_cast<float>(0.045 * std::sin(angle));
      EXPECT_EQ(AxisCell(n), AxisCell(exact));
    }
  }
}

TEST(SampleNormalSpace, CellsGiveTheSameNumberOrAllThatTheyHave) {
  const Points positions =
      DistinctPoints(testing::VolumeCloud(6000, 1, 8).positions);
  // Half of all normals point up, a few points have none.
  std::vector<Normal> normals =
      RandomNormals(static_cast<int>(positions.size()), 9);
  for (size_t i = 0; i < normals.size(); ++i) {
    if (i % 2 == 0) normals[i] = {0, 0, 1};
    if (i % 100 == 1) normals[i] = {};
  }
  const auto no_normal = static_cast<int64_t>(
      std::count(normals.begin(), normals.end(), Normal{}));
  std::map<size_t, int> available;
  for (const Normal& n : normals) {
    if (n != Normal{}) ++available[AxisCell(n)];
  }
  const auto size = static_cast<int64_t>(positions.size());
  for (const int64_t count : {int64_t{10}, int64_t{500}, int64_t{2500},
                              size - no_normal, size - 5, size + 1}) {
    const std::vector<uint32_t> rows =
        SampleNormalSpace(positions, normals, count, 3);
    EXPECT_EQ(static_cast<int64_t>(rows.size()), std::min(count, size));
    std::map<size_t, int> taken;
    int64_t without = 0;
    for (const uint32_t row : rows) {
      if (normals[row] == Normal{}) {
        ++without;
      } else {
        ++taken[AxisCell(normals[row])];
      }
    }
    EXPECT_EQ(without,
              std::max(std::min(count, size) - (size - no_normal), int64_t{0}));
    int most = 0;
    int least_of_open = static_cast<int>(size);
    for (const auto& [cell, all] : available) {
      most = std::max(most, taken[cell]);
      if (taken[cell] < all) {
        least_of_open = std::min(least_of_open, taken[cell]);
      }
    }
    EXPECT_LE(most, least_of_open + 1) << count;
  }
}

/// The faces of a box, 2 m wide: of z 20 times as many points as of x and y.
LatticeCloud UnevenBox() {
  LatticeCloud box;
  const auto add = [&](int count, uint64_t seed, const auto& place) {
    for (const int64_t side : {-1000, 1000}) {
      box = testing::Concatenated(
          box,
          testing::Mapped(
              testing::PlaneCloud(count, 0.6,
                                  seed + static_cast<uint64_t>(side > 0)),
              [&](const LatticePoint& q) { return place(q.x, q.y, side); }));
    }
  };
  add(400, 20, [](int64_t u, int64_t v, int64_t side) {
    return LatticePoint{side, u, v};
  });
  add(400, 30, [](int64_t u, int64_t v, int64_t side) {
    return LatticePoint{u, side, v};
  });
  add(8000, 40, [](int64_t u, int64_t v, int64_t side) {
    return LatticePoint{u, v, side};
  });
  return box;
}

/// Points of a cloud in UnevenBox, by the axis of their face.
std::array<int, 3> CountByFace(const Points& positions) {
  std::array<int, 3> counts{};
  for (const LatticePoint& q : positions) {
    ++counts[std::abs(q.x) == 1000 ? 0 : std::abs(q.y) == 1000 ? 1 : 2];
  }
  return counts;
}

TEST(Nss, TakesAsManyPointsOfEveryFaceOfABox) {
  // Voters within 0.3 m are of the same face.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const CloudSample sample,
      Sample(UnevenBox(), {.method = SampleMethod::kNss,
                           .max_points = 900,
                           .spdf = {.reach_m = 0.3}}));
  // Random sampling takes 41, 41 and 818.
  EXPECT_EQ(CountByFace(sample.cloud.positions),
            (std::array<int, 3>{300, 300, 300}));
}

Eigen::Matrix<double, 6, 6> CovarianceOf(const std::vector<Leverage>& leverages,
                                         const std::vector<uint32_t>& rows) {
  Eigen::Matrix<double, 6, 6> sum = Eigen::Matrix<double, 6, 6>::Zero();
  for (const uint32_t row : rows) {
    const Eigen::Map<const Eigen::Matrix<double, 6, 1>> v(
        leverages[row].data());
    sum += v * v.transpose();
  }
  return sum;
}

double ConditionNumber(const Eigen::Matrix<double, 6, 6>& covariance) {
  const auto values =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>>(covariance)
          .eigenvalues();
  return values[5] / values[0];
}

struct WithNormals {
  Points positions;
  std::vector<Normal> normals;
};

/// A plane 8 m wide with three small crosses on it, which alone hold a motion
/// along it.
WithNormals PlaneWithFeatures() {
  WithNormals scene;
  std::map<LatticePoint, Normal> normal_of;
  for (const LatticePoint& q : testing::PlaneCloud(8000, 4, 11).positions) {
    normal_of[q] = {0, 0, 1};
  }
  for (const LatticePoint& q : testing::PlaneCloud(30, 0.1, 12).positions) {
    for (const auto& [x, y] :
         {std::pair(2000, 1000), {2500, -3000}, {-3000, 1500}}) {
      normal_of[{x, y + q.x, q.y + 110}] = {1, 0, 0};
      normal_of[{x + q.x, y, q.y + 110}] = {0, 1, 0};
    }
  }
  for (const auto& [q, n] : normal_of) scene.positions.push_back(q);
  scene.positions = DistinctPoints(scene.positions);
  for (const LatticePoint& q : scene.positions) {
    scene.normals.push_back(normal_of[q]);
  }
  return scene;
}

TEST(FindLeverages, AreCenteredAndOfUnitMeanDistance) {
  WithNormals scene = PlaneWithFeatures();
  // No say for points without a normal.
  scene.positions.push_back({int64_t{1} << 40, 0, 0});
  scene.normals.push_back({});
  const std::vector<Leverage> leverages =
      FindLeverages(scene.positions, scene.normals);
  EXPECT_EQ(leverages.back(), Leverage{});
  // On the plane p × n = (y, -x, 0): the coordinates can be read off.
  const auto n = static_cast<double>(leverages.size() - 1);
  Point3 mean;
  for (size_t i = 0; i + 1 < leverages.size(); ++i) {
    mean.x += static_cast<double>(scene.positions[i].x) / n;
    mean.y += static_cast<double>(scene.positions[i].y) / n;
    mean.z += static_cast<double>(scene.positions[i].z) / n;
  }
  double mean_distance = 0;
  for (size_t i = 0; i + 1 < leverages.size(); ++i) {
    const LatticePoint& q = scene.positions[i];
    mean_distance += std::hypot(static_cast<double>(q.x) - mean.x,
                                static_cast<double>(q.y) - mean.y,
                                static_cast<double>(q.z) - mean.z) /
                     n;
  }
  for (size_t i = 0; i + 1 < leverages.size(); ++i) {
    const LatticePoint& q = scene.positions[i];
    if (scene.normals[i][2] != 1) continue;
    EXPECT_NEAR(leverages[i][0],
                (static_cast<double>(q.y) - mean.y) / mean_distance, 1e-9);
    EXPECT_NEAR(leverages[i][1],
                -(static_cast<double>(q.x) - mean.x) / mean_distance, 1e-9);
    EXPECT_EQ(leverages[i][5], 1);
  }
}

TEST(SampleCovariance, HoldsAMotionThatRandomPointsDoNot) {
  const WithNormals scene = PlaneWithFeatures();
  const std::vector<Leverage> leverages =
      FindLeverages(scene.positions, scene.normals);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const std::vector<uint32_t> rows,
      SampleCovariance(scene.positions, scene.normals, 200, {}));
  ASSERT_EQ(rows.size(), 200u);
  const double condition = ConditionNumber(CovarianceOf(leverages, rows));
  const double random = ConditionNumber(
      CovarianceOf(leverages, RandomSample(scene.positions, 200, 1)));
  EXPECT_GT(random, 5 * condition);
}

TEST(SampleCovariance, ChoosesWhatTheGreedyRuleChooses) {
  WithNormals scene = PlaneWithFeatures();
  const std::vector<Leverage> leverages =
      FindLeverages(scene.positions, scene.normals);
  std::vector<uint32_t> all(leverages.size());
  for (uint32_t i = 0; i < all.size(); ++i) all[i] = i;
  const Eigen::Matrix<double, 6, 6> axes =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>>(
          CovarianceOf(leverages, all))
          .eigenvectors();
  const auto along = [&](uint32_t row, int axis) {
    double sum = 0;
    for (int c = 0; c < 6; ++c) {
      sum += axes(c, axis) * leverages[row][static_cast<size_t>(c)];
    }
    return sum;
  };
  std::vector<uint32_t> expected;
  std::array<double, 6> held{};
  for (int step = 0; step < 60; ++step) {
    const auto axis = static_cast<int>(
        std::min_element(held.begin(), held.end()) - held.begin());
    uint32_t best = 0;
    double best_leverage = -1;
    for (const uint32_t row : all) {
      if (std::find(expected.begin(), expected.end(), row) != expected.end()) {
        continue;
      }
      if (std::abs(along(row, axis)) > best_leverage) {
        best_leverage = std::abs(along(row, axis));
        best = row;
      }
    }
    expected.push_back(best);
    for (int a = 0; a < 6; ++a) {
      held[static_cast<size_t>(a)] += along(best, a) * along(best, a);
    }
  }
  std::sort(expected.begin(), expected.end());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const std::vector<uint32_t> rows,
      SampleCovariance(scene.positions, scene.normals, 60, {}));
  EXPECT_EQ(rows, expected);
}

TEST(SampleCovariance, PointsWithoutANormalComeLast) {
  WithNormals scene = PlaneWithFeatures();
  scene.positions.resize(100);
  scene.normals.assign(100, Normal{});
  for (size_t i = 0; i < 100; i += 2) scene.normals[i] = {0, 0, 1};
  for (const int64_t count : {30, 50, 70, 200}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const std::vector<uint32_t> rows,
        SampleCovariance(scene.positions, scene.normals, count, {}));
    EXPECT_EQ(static_cast<int64_t>(rows.size()), std::min<int64_t>(count, 100));
    const auto without = std::count_if(
        rows.begin(), rows.end(), [](uint32_t row) { return row % 2 == 1; });
    EXPECT_EQ(without, std::clamp<int64_t>(count - 50, 0, 50));
  }
}

}  // namespace
}  // namespace mapsieve::core
