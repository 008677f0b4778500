// What an upload tells of its points, compared with counting by hand.

#include <algorithm>
#include <array>
#include <bit>
#include <map>
#include <optional>
#include <random>
#include <set>
#include <span>
#include <vector>

#include "gtest/gtest.h"
#include "server/engine/point_census.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::LatticeCloud;
using core::LatticePoint;

using Cells = std::set<std::array<int64_t, 3>>;

std::array<int64_t, 3> CellOf(const LatticePoint& q, int level) {
  return {q.x >> level, q.y >> level, q.z >> level};
}

/// Counts `points` beside the cells `before`, to which theirs are added.
PointCensus CountByHand(const std::vector<LatticePoint>& points, int level,
                        Cells& before) {
  PointCensus census = {.overlapping_point_count = 0,
                        .density_cell_level = level};
  Cells own;
  std::map<std::array<int64_t, 3>, uint64_t> points_of;
  for (const LatticePoint& q : points) {
    if (!own.insert(CellOf(q, 0)).second) ++census.duplicate_point_count;
    ++points_of[CellOf(q, level)];
  }
  for (const auto& cell : own) {
    *census.overlapping_point_count += before.contains(cell) ? 1 : 0;
  }
  before.insert(own.begin(), own.end());
  for (const auto& [cell, count] : points_of) {
    const auto bin = static_cast<size_t>(std::bit_width(count)) - 1;
    if (census.density_histogram.size() <= bin) {
      census.density_histogram.resize(bin + 1);
    }
    ++census.density_histogram[bin];
  }
  return census;
}

/// Points around some places of both signs, many of them in one cell.
std::vector<LatticePoint> Clusters(size_t count, uint32_t seed) {
  std::mt19937 random(seed);
  const auto draw = [&random](int64_t range) {
    return static_cast<int64_t>(random() % static_cast<uint32_t>(range));
  };
  std::vector<LatticePoint> points;
  while (points.size() < count) {
    const int64_t place = 900 * draw(12) - 5000;
    const int64_t width = int64_t{2} << draw(8);
    points.push_back({place + draw(width), draw(width) - 40, draw(6) - 3});
  }
  return points;
}

LatticeCloud CloudOf(std::span<const LatticePoint> points) {
  LatticeCloud cloud;
  cloud.positions.assign(points.begin(), points.end());
  return cloud;
}

/// Chunks of 100 points.
constexpr IngestLimits kRoomy = {.block_bytes = 1 << 26,
                                 .bucket_bytes = 1 << 26,
                                 .chunk_bytes = 2400,
                                 .chunk_count = 100'000};
/// A tile's points come to its chunks in parts, and its set of cells is made
/// in dozens of them.
constexpr IngestLimits kTight = {.block_bytes = 1 << 26,
                                 .bucket_bytes = 4000,
                                 .chunk_bytes = 2400,
                                 .chunk_count = 100'000};

TEST(PointCensus, IsWhatCountingByHandGives) {
  const std::vector<LatticePoint> points = Clusters(12'000, 1);
  for (const IngestLimits& limits : {kRoomy, kTight}) {
    for (const int tile_level : {7, 10, 12}) {
      Workshop shop(tile_level, 2);
      const int level = std::min(tile_level, 10);
      Cells before;
      for (size_t begin = 0; begin < points.size(); begin += 4000) {
        const auto part = std::span(points).subspan(begin, 4000);
        MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadReport report,
                                      shop.Add(CloudOf(part), limits));
        const PointCensus expected =
            CountByHand({part.begin(), part.end()}, level, before);
        EXPECT_GT(expected.duplicate_point_count, 100);
        EXPECT_EQ(report.census, expected);
      }
    }
  }
}

TEST(PointCensus, DoesNotDependOnHowPointsWereDivided) {
  std::vector<LatticePoint> points = Clusters(6000, 2);
  const auto last = std::span(points).last(2000);
  std::optional<PointCensus> expected;
  int64_t expected_growth = -1;
  for (const size_t part_size : {size_t{4000}, size_t{1300}, size_t{70}}) {
    Workshop shop(9);
    int64_t growth = 0;
    const auto add = [&](std::span<const LatticePoint> part) {
      const auto report = shop.Add(CloudOf(part), kRoomy);
      EXPECT_TRUE(report.ok()) << report.status();
      const PointCensus& census = *report->census;
      growth += report->added_point_count - census.duplicate_point_count -
                *census.overlapping_point_count;
      return census;
    };
    for (size_t begin = 0; begin < 4000; begin += part_size) {
      add(std::span(points).subspan(begin, std::min(part_size, 4000 - begin)));
    }
    const PointCensus census = add(last);
    if (!expected.has_value()) expected = census;
    EXPECT_EQ(census, *expected);
    // Together all uploads bring each cell once.
    if (expected_growth < 0) {
      Cells all;
      CountByHand(points, 0, all);
      expected_growth = static_cast<int64_t>(all.size());
    }
    EXPECT_EQ(growth, expected_growth);
    std::shuffle(points.begin(), points.begin() + 4000, std::mt19937(3));
    std::shuffle(last.begin(), last.end(), std::mt19937(4));
  }
}

TEST(PointCensus, LeavesOutWhatTheUploadReplaces) {
  const std::vector<LatticePoint> points = Clusters(5000, 5);
  Workshop shop(10);
  MAPSIEVE_ASSERT_OK(shop.Add(CloudOf(points), kRoomy));
  // Cuts through tiles and chunks.
  const Box region = {{-5, -0.03, -1}, {0.35, 0.01, 0.002}};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadReport report,
                                shop.Add(CloudOf(points), kRoomy, region));
  ASSERT_GT(report.removed_point_count, 500);
  Cells before;
  for (const LatticePoint& q : points) {
    const bool is_replaced = q.x >= -5000 && q.x < 350 && q.y >= -30 &&
                             q.y < 10 && q.z >= -1000 && q.z < 2;
    if (!is_replaced) before.insert(CellOf(q, 0));
  }
  EXPECT_GT(before.size(), 100u);
  EXPECT_EQ(report.census, CountByHand(points, 10, before));
}

TEST(PointCensus, IsNotComparedWithVeryManyPoints) {
  // The most that an upload of one point is compared with.
  constexpr int64_t kMost = kMaxComparedShare * kMinComparedPoints;
  Workshop shop(15);
  LatticeCloud many;
  many.positions.assign(static_cast<size_t>(kMost), {1, 2, 3});
  MAPSIEVE_ASSERT_OK(shop.Add(many, IngestLimits::Of(int64_t{1} << 30)));
  const LatticeCloud one = CloudOf(std::vector<LatticePoint>{{1, 2, 3}});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadReport compared,
                                shop.Add(one, kRoomy));
  EXPECT_EQ(compared.census->overlapping_point_count, 1);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadReport open, shop.Add(one, kRoomy));
  EXPECT_EQ(open.census->overlapping_point_count, std::nullopt);
  EXPECT_EQ(open.census->density_histogram, std::vector<int64_t>{1});
}

TEST(PointCensus, OldDamageKeepsNoPointsOut) {
  const std::vector<LatticePoint> points = Clusters(3000, 6);
  Workshop shop(10);
  MAPSIEVE_ASSERT_OK(shop.Add(CloudOf(points), kRoomy));
  shop.DamageBlob(shop.Chunks(storage::ChunkKind::kRaw)[3].blob_id);
  const std::vector<LatticePoint> more = Clusters(3000, 7);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadReport report,
                                shop.Add(CloudOf(more), kRoomy));
  Cells none;
  PointCensus expected = CountByHand(more, 10, none);
  expected.overlapping_point_count.reset();
  EXPECT_EQ(report.census, expected);
}

TEST(PointCensus, CellsAreAMapUnitWithinATile) {
  // 1 mm: 1.024 m.
  EXPECT_EQ(DensityCellLevel(1'000'000, 15), 10);
  EXPECT_EQ(DensityCellLevel(1'000'000, 8), 8);
  EXPECT_EQ(DensityCellLevel(1'000'000, 20), 14);
  EXPECT_EQ(DensityCellLevel(1'000'000'000, 4), 0);
  EXPECT_EQ(DensityCellLevel(500'000'000, 4), 1);
  EXPECT_EQ(DensityCellLevel(1, 21), 21);
}

}  // namespace
}  // namespace mapsieve::engine::testing
