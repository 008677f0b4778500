// The samplers that divide points into cells, against counting by hand.
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <set>
#include <tuple>
#include <utility>
#include <vector>

#include "core/cloud/merge_duplicates.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/point_hash.h"
#include "core/sampling/cells.h"
#include "core/sampling/octree_sample.h"
#include "core/sampling/sampler.h"
#include "core/sampling/surface_sample.h"
#include "core/sampling/voxel_sample.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"
#include "tests/testing/symmetric3.h"

namespace mapsieve::core {
namespace {

using Points = std::vector<LatticePoint>;
/// Cells, each as its points in ascending order.
using Cells = std::set<Points>;

Points SceneAroundTheOrigin(int count, uint64_t seed) {
  return DistinctPoints(
      testing::Concatenated(testing::SceneCloud(count, 2, seed),
                            testing::GridCloud(6, 128))
          .positions);
}

Cells ToCells(const Points& positions, std::span<const uint32_t> order,
              std::span<const CellRange> ranges) {
  Cells cells;
  for (const CellRange& range : ranges) {
    Points points;
    for (uint32_t i = range.begin; i < range.end; ++i) {
      points.push_back(positions[order[i]]);
    }
    std::sort(points.begin(), points.end());
    cells.insert(points);
  }
  return cells;
}

std::vector<uint32_t> Ascending(size_t size) {
  std::vector<uint32_t> order(size);
  std::iota(order.begin(), order.end(), uint32_t{0});
  return order;
}

/// Divides `cell`, of `level`, as the octree's definition says.
void AddLeaves(const Points& cell, int level, size_t max_points, int leaf_level,
               Cells& leaves) {
  if (cell.size() <= max_points || level <= leaf_level) {
    leaves.insert(cell);
    return;
  }
  std::map<std::array<int64_t, 3>, Points> children;
  for (const LatticePoint& q : cell) {
    children[{q.x >> (level - 1), q.y >> (level - 1), q.z >> (level - 1)}]
        .push_back(q);
  }
  for (auto& [key, child] : children) {
    AddLeaves(child, level - 1, max_points, leaf_level, leaves);
  }
}

TEST(OctreeLeaves, AreTheCellsThatTheDefinitionDivides) {
  const Points positions = SceneAroundTheOrigin(3000, 1);
  Points sorted = positions;
  std::sort(sorted.begin(), sorted.end());
  const std::vector<uint32_t> order = Ascending(positions.size());
  for (const auto& [max_points, leaf_level] : {std::pair(1, 0),
                                               {1, 7},
                                               {4, 0},
                                               {9, 5},
                                               {50, 9},
                                               {100000, 0},
                                               {1, 43}}) {
    Cells expected;
    AddLeaves(sorted, kMaxCellLevel + 1, static_cast<size_t>(max_points),
              leaf_level, expected);
    const std::vector<CellRange> leaves =
        OctreeLeaves(positions, max_points, leaf_level);
    EXPECT_EQ(leaves.size(), expected.size());
    EXPECT_TRUE(ToCells(positions, order, leaves) == expected)
        << max_points << " " << leaf_level;
  }
}

TEST(OctreeLeaves, LieInTheSamePlacesWhereverTheCloudEnds) {
  // A part of a cloud has the leaves that the whole has there.
  const Points whole = SceneAroundTheOrigin(4000, 2);
  Points part;
  for (const LatticePoint& q : whole) {
    if (CellKey::Of(q, 10) == CellKey{10, 0, 0, 0}) part.push_back(q);
  }
  ASSERT_GT(part.size(), 200u);
  const Cells all =
      ToCells(whole, Ascending(whole.size()), OctreeLeaves(whole, 5, 0));
  for (const Points& leaf :
       ToCells(part, Ascending(part.size()), OctreeLeaves(part, 5, 0))) {
    EXPECT_TRUE(all.contains(leaf));
  }
}

TEST(OctreeSample, CellEdgeIsRoundedDownToAnOctreeCell) {
  const LatticeCloud cloud = testing::SceneCloud(3000, 2, 3);
  std::set<std::array<int64_t, 3>> cells;
  for (const LatticePoint& q : cloud.positions) {
    cells.insert({q.x >> 7, q.y >> 7, q.z >> 7});
  }
  for (const double edge_m : {0.128, 0.2, 0.2559}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const CloudSample sample,
        Sample(cloud,
               {.method = SampleMethod::kOctree, .cell_edge_m = edge_m}));
    EXPECT_EQ(sample.rows.size(), cells.size()) << edge_m;
  }
}

TEST(OctreeHalves, AreAsManyAsWantedAndTheFullestIsHalvedFirst) {
  const Points positions = SceneAroundTheOrigin(2000, 4);
  for (const int64_t count : {1, 2, 7, 64, 1000}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<CellRange> cells,
                                  OctreeHalves(positions, count, {}));
    EXPECT_EQ(static_cast<int64_t>(cells.size()), count);
    std::vector<uint8_t> seen(positions.size());
    uint32_t largest = 0;
    for (const CellRange& cell : cells) {
      largest = std::max(largest, cell.size());
      for (uint32_t i = cell.begin; i < cell.end; ++i) ++seen[i];
    }
    EXPECT_EQ(std::count(seen.begin(), seen.end(), 1),
              static_cast<ptrdiff_t>(seen.size()));
    // One more: the fullest, of equal ones the first, is gone for it.
    CellRange fullest = {.begin = static_cast<uint32_t>(positions.size())};
    for (const CellRange& cell : cells) {
      if (cell.size() == largest && cell.begin < fullest.begin) fullest = cell;
    }
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<CellRange> more,
                                  OctreeHalves(positions, count + 1, {}));
    for (const CellRange& cell : cells) {
      EXPECT_EQ(std::find(more.begin(), more.end(), cell) != more.end(),
                cell != fullest);
    }
  }
}

TEST(RepresentCells, AgreesWithTheDefinitionOfEachRepresentative) {
  const Points positions = SceneAroundTheOrigin(1500, 5);
  const std::vector<uint32_t> order = Ascending(positions.size());
  const std::vector<CellRange> cells = OctreeLeaves(positions, 30, 0);
  const auto represent = [&](Representative kind, int64_t seed) {
    return RepresentCells(positions, order, cells, kind, seed, {}).value();
  };
  const CellSample first = represent(Representative::kFirst, 0);
  const CellSample nearest = represent(Representative::kNearest, 0);
  const CellSample centroid = represent(Representative::kCentroid, 0);
  EXPECT_EQ(centroid.rows, nearest.rows);
  const auto row_in = [](const CellSample& sample, const CellRange& cell) {
    std::vector<size_t> found;
    for (size_t i = 0; i < sample.rows.size(); ++i) {
      if (sample.rows[i] >= cell.begin && sample.rows[i] < cell.end) {
        found.push_back(i);
      }
    }
    EXPECT_EQ(found.size(), 1u);
    return found.front();
  };
  std::map<uint32_t, int> places;
  for (int64_t seed = 0; seed < 40; ++seed) {
    const CellSample random = represent(Representative::kRandom, seed);
    for (const CellRange& cell : cells) {
      const uint32_t row = random.rows[row_in(random, cell)];
      if (cell.size() >= 8) ++places[(row - cell.begin) * 4 / cell.size()];
    }
  }
  // Any quarter of a cell's points is drawn as often as another.
  int total = 0;
  for (const auto& [quarter, count] : places) total += count;
  for (const auto& [quarter, count] : places) {
    EXPECT_NEAR(count, total / 4, total / 25) << quarter;
  }
  for (const CellRange& cell : cells) {
    EXPECT_EQ(first.rows[row_in(first, cell)], cell.begin);
    Point3 mean;
    // Sums of squared distances to all others, in integers.
    int64_t smallest = -1;
    LatticePoint medoid;
    for (uint32_t i = cell.begin; i < cell.end; ++i) {
      const LatticePoint& p = positions[i];
      int64_t sum = 0;
      for (uint32_t j = cell.begin; j < cell.end; ++j) {
        const LatticePoint& q = positions[j];
        sum += (p.x - q.x) * (p.x - q.x) + (p.y - q.y) * (p.y - q.y) +
               (p.z - q.z) * (p.z - q.z);
      }
      if (smallest < 0 || sum < smallest || (sum == smallest && p < medoid)) {
        smallest = sum;
        medoid = p;
      }
      mean.x += static_cast<double>(p.x) / cell.size();
      mean.y += static_cast<double>(p.y) / cell.size();
      mean.z += static_cast<double>(p.z) / cell.size();
    }
    const size_t n = row_in(nearest, cell);
    EXPECT_EQ(positions[nearest.rows[n]], medoid);
    EXPECT_NEAR(centroid.centroids[n].x, mean.x, 1e-6);
    EXPECT_NEAR(centroid.centroids[n].y, mean.y, 1e-6);
    EXPECT_NEAR(centroid.centroids[n].z, mean.z, 1e-6);
  }
}

TEST(RepresentCells, TheSurestAreTheQuarterOfLargestConfidence) {
  const Points positions = SceneAroundTheOrigin(1500, 5);
  std::vector<uint32_t> order = Ascending(positions.size());
  const std::vector<CellRange> cells = OctreeLeaves(positions, 30, 0);
  // Few values, so that many are equal.
  std::vector<uint16_t> confidences;
  for (const LatticePoint& q : positions) {
    confidences.push_back(static_cast<uint16_t>(PointHash(q, 3) % 9));
  }
  std::vector<uint32_t> expected;
  for (const CellRange& cell : cells) {
    // The distance from the mean, times the number of points, in integers.
    const auto size = static_cast<int64_t>(cell.size());
    LatticePoint sum;
    for (uint32_t i = cell.begin; i < cell.end; ++i) {
      const LatticePoint& q = positions[i];
      sum = {sum.x + q.x, sum.y + q.y, sum.z + q.z};
    }
    std::vector<std::tuple<int64_t, LatticePoint, uint32_t>> surest;
    for (uint32_t i = cell.begin; i < cell.end; ++i) {
      uint32_t surer = 0;
      for (uint32_t j = cell.begin; j < cell.end; ++j) {
        if (confidences[j] > confidences[i]) ++surer;
      }
      if (4 * surer >= cell.size()) continue;
      const LatticePoint& q = positions[i];
      const int64_t x = size * q.x - sum.x;
      const int64_t y = size * q.y - sum.y;
      const int64_t z = size * q.z - sum.z;
      surest.emplace_back(x * x + y * y + z * z, q, i);
    }
    expected.push_back(
        std::get<2>(*std::min_element(surest.begin(), surest.end())));
  }
  std::sort(expected.begin(), expected.end());
  const auto represent = [&](Representative kind) {
    return RepresentCells(positions, order, cells, kind, 0, {}, confidences)
        .value();
  };
  const CellSample sample = represent(Representative::kSurest);
  EXPECT_EQ(sample.rows, expected);
  EXPECT_NE(sample.rows, represent(Representative::kNearest).rows);
  EXPECT_EQ(sample.centroids.size(), sample.rows.size());
  // Whatever the order of a cell's points.
  for (const CellRange& cell : cells) {
    std::reverse(order.begin() + cell.begin, order.begin() + cell.end);
  }
  EXPECT_EQ(represent(Representative::kSurest).rows, expected);
}

TEST(VoxelSample, HasOnePointInEachVoxel) {
  const LatticeCloud cloud = testing::SceneCloud(4000, 2, 6);
  const auto floor_div = [](int64_t a, int64_t b) {
    return a / b - (a % b < 0 ? 1 : 0);
  };
  for (const int64_t edge : {1, 7, 43, 100, 333}) {
    std::map<std::array<int64_t, 3>, Points> voxels;
    for (const LatticePoint& q : DistinctPoints(cloud.positions)) {
      voxels[{floor_div(q.x, edge), floor_div(q.y, edge), floor_div(q.z, edge)}]
          .push_back(q);
    }
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const CloudSample sample,
        Sample(cloud, {.method = SampleMethod::kVoxel,
                       .cell_edge_m = static_cast<double>(edge) / 1000}));
    EXPECT_EQ(sample.cloud.size(), voxels.size());
    for (const LatticePoint& c : sample.cloud.positions) {
      const std::array<int64_t, 3> key = {
          floor_div(c.x, edge), floor_div(c.y, edge), floor_div(c.z, edge)};
      ASSERT_TRUE(voxels.contains(key));
      LatticePoint sum;
      for (const LatticePoint& q : voxels[key]) {
        sum = {sum.x + q.x, sum.y + q.y, sum.z + q.z};
      }
      const auto n = static_cast<double>(voxels[key].size());
      EXPECT_NEAR(static_cast<double>(c.x), static_cast<double>(sum.x) / n,
                  .51);
      EXPECT_NEAR(static_cast<double>(c.y), static_cast<double>(sum.y) / n,
                  .51);
      EXPECT_NEAR(static_cast<double>(c.z), static_cast<double>(sum.z) / n,
                  .51);
      voxels.erase(key);
    }
  }
}

TEST(VoxelSample, WorksWithCentimetresOnTenKilometres) {
  // Of 10^18 voxels some that are a multiple of 2^12 apart along each axis, so
  // that any number for them of less than 60 bits would be that of others too.
  LatticeCloud cloud = testing::VolumeCloud(20000, 0.127, 7);
  for (LatticePoint& q : cloud.positions) {
    q = {q.x * 40960, q.y * 40960, q.z * 40960};
  }
  const size_t voxel_count = DistinctPoints(cloud.positions).size();
  cloud = testing::Concatenated(cloud, testing::Shifted(cloud, {9, 9, 9}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const CloudSample sample,
      Sample(cloud, {.method = SampleMethod::kVoxel,
                     .cell_edge_m = 0.01,
                     .representative = Representative::kFirst}));
  EXPECT_EQ(sample.cloud.size(), voxel_count);
  for (const LatticePoint& q : sample.cloud.positions) {
    EXPECT_TRUE(q.x % 40960 == 0 && q.y % 40960 == 0 && q.z % 40960 == 0);
  }
}

TEST(VoxelSample, TakesAMillionPointsOfOneCell) {
  const LatticeCloud cloud =
      testing::Shifted(testing::GridCloud(100, 1), {1000, 1000, 1000});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const CloudSample sample,
      Sample(cloud, {.method = SampleMethod::kVoxel, .cell_edge_m = 10}));
  ASSERT_EQ(sample.cloud.size(), 1u);
  // The mean is half a step off a point, the nearest of eight is the lowest.
  EXPECT_EQ(cloud.positions[sample.rows[0]], (LatticePoint{1049, 1049, 1049}));
}

/// Halves points at the median of their widest axis, as the method says.
void AddParts(Points points, size_t max_points, Cells& parts) {
  std::sort(points.begin(), points.end());
  if (points.size() <= max_points) {
    parts.insert(points);
    return;
  }
  std::array<int64_t, 3> low = {points[0].x, points[0].y, points[0].z};
  std::array<int64_t, 3> high = low;
  const auto along = [](const LatticePoint& q, size_t axis) {
    return std::array{q.x, q.y, q.z}[axis];
  };
  for (const LatticePoint& q : points) {
    for (size_t a = 0; a < 3; ++a) {
      low[a] = std::min(low[a], along(q, a));
      high[a] = std::max(high[a], along(q, a));
    }
  }
  size_t widest = 0;
  for (size_t a = 1; a < 3; ++a) {
    if (high[a] - low[a] > high[widest] - low[widest]) widest = a;
  }
  std::stable_sort(points.begin(), points.end(),
                   [&](const LatticePoint& p, const LatticePoint& q) {
                     return along(p, widest) < along(q, widest);
                   });
  const auto middle =
      points.begin() + static_cast<ptrdiff_t>(points.size() / 2);
  AddParts(Points(points.begin(), middle), max_points, parts);
  AddParts(Points(middle, points.end()), max_points, parts);
}

TEST(SampleSurfaces, HalvesAtMediansUntilPartsAreSmall) {
  const Points positions = SceneAroundTheOrigin(2500, 8);
  for (const int64_t max_points : {1, 7, 60, 100000}) {
    Cells expected;
    AddParts(positions, static_cast<size_t>(max_points), expected);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const SurfaceSample sample,
        SampleSurfaces(positions, int64_t{1} << 40, max_points,
                       Representative::kCentroid, 0, {}));
    size_t largest = 0;
    std::multiset<std::array<int64_t, 3>> expected_means;
    const auto key = [](double x, double y, double z) {
      // Fractions have different denominators: 10^-6 steps tell them apart.
      return std::array{std::lrint(x * 1e6), std::lrint(y * 1e6),
                        std::lrint(z * 1e6)};
    };
    for (const Points& part : expected) {
      largest = std::max(largest, part.size());
      Point3 sum;
      for (const LatticePoint& q : part) {
        sum = {sum.x + static_cast<double>(q.x),
               sum.y + static_cast<double>(q.y),
               sum.z + static_cast<double>(q.z)};
      }
      const auto n = static_cast<double>(part.size());
      expected_means.insert(key(sum.x / n, sum.y / n, sum.z / n));
    }
    std::multiset<std::array<int64_t, 3>> means;
    for (const Point3& c : sample.points.centroids) {
      means.insert(key(c.x, c.y, c.z));
    }
    EXPECT_EQ(sample.largest_cell, static_cast<int64_t>(largest));
    EXPECT_TRUE(means == expected_means) << max_points;
  }
}

TEST(SampleSurfaces, NormalsAreThoseOfTheSurfaceAndOfUnitLength) {
  // Two walls of a roof: z = y / 2 and z = -y / 2 with its ridge along x.
  const LatticeCloud plane = testing::PlaneCloud(4000, 2, 9);
  const Points roof =
      DistinctPoints(testing::Mapped(plane, [](const LatticePoint& q) {
                       return LatticePoint{q.x, 2 * q.y, -std::abs(q.y)};
                     }).positions);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const SurfaceSample sample,
      SampleSurfaces(roof, int64_t{1} << 40, 12, Representative::kNearest, 0,
                     {}));
  int on_ridge = 0;
  for (size_t i = 0; i < sample.normals.size(); ++i) {
    const Vector3& n = sample.normals[i];
    EXPECT_NEAR(std::hypot(n[0], n[1], n[2]), 1, 1e-12);
    EXPECT_GT(n[2], 0);
    const double slope = roof[sample.points.rows[i]].y > 0 ? 1 : -1;
    const bool is_right = std::abs(n[1] - slope / std::sqrt(5)) < 1e-3 &&
                          std::abs(n[2] - 2 / std::sqrt(5)) < 1e-3;
    on_ridge += is_right ? 0 : 1;
  }
  // Parts that lie over the ridge; medians cut there but for a few.
  EXPECT_LT(on_ridge, static_cast<int>(sample.normals.size()) / 10);
}

TEST(SampleSurfaces, NormalsAreTheAxesOfLeastSpreadOfNoisyPoints) {
  const Points positions = SceneAroundTheOrigin(2500, 11);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const SurfaceSample sample,
      SampleSurfaces(positions, int64_t{1} << 40, 20, Representative::kNearest,
                     0, {}));
  Cells parts;
  AddParts(positions, 20, parts);
  std::map<LatticePoint, const Points*> part_of;
  for (const Points& part : parts) {
    for (const LatticePoint& q : part) part_of[q] = &part;
  }
  ASSERT_EQ(sample.normals.size(), parts.size());
  for (size_t i = 0; i < sample.normals.size(); ++i) {
    const Points& part = *part_of.at(positions[sample.points.rows[i]]);
    // n² times the covariance, in exact integers.
    const auto n = static_cast<int64_t>(part.size());
    LatticePoint sum;
    std::array<int64_t, 6> products{};
    for (const LatticePoint& q : part) {
      sum = {sum.x + q.x, sum.y + q.y, sum.z + q.z};
      const std::array<int64_t, 6> of_point = {q.x * q.x, q.x * q.y, q.x * q.z,
                                               q.y * q.y, q.y * q.z, q.z * q.z};
      for (size_t e = 0; e < 6; ++e) products[e] += n * of_point[e];
    }
    const auto entry = [&](size_t e, int64_t a, int64_t b) {
      return static_cast<double>(products[e] - a * b);
    };
    const testing::EigenSystem3 axes =
        testing::Decompose({entry(0, sum.x, sum.x), entry(1, sum.x, sum.y),
                            entry(2, sum.x, sum.z), entry(3, sum.y, sum.y),
                            entry(4, sum.y, sum.z), entry(5, sum.z, sum.z)});
    if (axes.values[1] < 1.01 * axes.values[2]) continue;
    const Vector3 expected = WithCanonicalSign(axes.vectors[2]);
    for (size_t a = 0; a < 3; ++a) {
      EXPECT_NEAR(sample.normals[i][a], expected[a], 1e-9);
    }
  }
}

TEST(SampleSurfaces, ALineHasNoNormal) {
  const LatticeCloud line = testing::LineCloud(200, 2, 10);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const CloudSample sample,
      Sample(line, {.method = SampleMethod::kSsNormal, .max_cell_points = 8}));
  ASSERT_GT(sample.cloud.size(), 10u);
  for (const char* name : {"nx", "ny", "nz"}) {
    const Column& column = *sample.cloud.attributes.Find(name);
    for (size_t i = 0; i < column.size(); ++i) {
      EXPECT_TRUE(column.IsMissing(i));
    }
  }
}

}  // namespace
}  // namespace mapsieve::core
