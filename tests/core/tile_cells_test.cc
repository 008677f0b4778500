#include "core/spdf/tile_cells.h"

#include <random>

#include "core/cloud/merge_duplicates.h"
#include "tests/testing/clouds.h"

namespace mapsieve::core {
namespace {

namespace clouds = ::mapsieve::testing;

LatticePoint RandomPoint(const LatticeBox& box, std::mt19937_64& random) {
  const auto along = [&](int64_t min, int64_t max) {
    return min +
           static_cast<int64_t>(random() % static_cast<uint64_t>(max - min));
  };
  return {along(box.min.x, box.max.x), along(box.min.y, box.max.y),
          along(box.min.z, box.max.z)};
}

TEST(TileGrid, EveryPointLiesInTheBoxOfItsCell) {
  std::mt19937_64 random(11);
  for (const CellKey& tile :
       {CellKey{15, 3, -2, 0}, CellKey{2, -1, -1, 5}, CellKey{0, 7, 8, 9}}) {
    for (const int level : {0, 3, 11, 14, 20}) {
      const TileGrid grid(tile, level);
      EXPECT_GE(grid.level(), tile.level - TileGrid::kAxisBits);
      EXPECT_LE(grid.level(), tile.level);
      for (int i = 0; i < 200; ++i) {
        const LatticePoint q = RandomPoint(tile.box(), random);
        const size_t number = grid.NumberOf(q);
        ASSERT_LT(number, TileGrid::kMaxCellCount);
        EXPECT_TRUE(grid.BoxOf(number).Contains(q));
      }
    }
  }
}

TEST(TileCells, ABoxAddsTheCellsThatItIntersects) {
  std::mt19937_64 random(12);
  const CellKey tile = {10, -1, 0, 2};
  for (int i = 0; i < 50; ++i) {
    const TileGrid grid(tile, 7);
    TileCells cells(grid);
    const LatticePoint min = RandomPoint(tile.box().Grown(200), random);
    const LatticeBox box = {
        min, {min.x + 1 + i * 5, min.y + 1 + i * 3, min.z + 1 + i * 7}};
    cells.Add(box);
    ASSERT_EQ(cells.Any(), box.Intersects(tile.box()));
    if (cells.Any()) {
      const LatticeBox bounds = cells.Bounds();
      EXPECT_TRUE(tile.box().Grown(1).Contains(bounds.min));
      cells.ForEach([&](const LatticeBox& cell) {
        EXPECT_TRUE(cell.Intersects(box));
        EXPECT_EQ(bounds.Union(cell), bounds);
      });
    }
    for (int j = 0; j < 200; ++j) {
      const LatticePoint q = RandomPoint(tile.box(), random);
      EXPECT_EQ(cells.Contains(q),
                box.Intersects(grid.BoxOf(grid.NumberOf(q))));
    }
  }
}

TEST(TileDirectory, FindsEveryPointOfABoxAndFewOthers) {
  std::mt19937_64 random(13);
  const CellKey tile = {12, 0, 0, 0};
  std::vector<LatticePoint> points;
  for (const LatticePoint& q :
       DistinctPoints(clouds::SceneCloud(40000, 5.0, 14).positions)) {
    if (tile.box().Contains(q)) points.push_back(q);
  }
  ASSERT_GT(points.size(), 1000u);
  const TileDirectory directory(tile, points);
  ASSERT_TRUE(directory.IsMade());
  size_t wanted = 0;
  size_t given = 0;
  for (int i = 0; i < 50; ++i) {
    const LatticePoint min = RandomPoint(tile.box().Grown(100), random);
    const std::vector<LatticeBox> boxes = {
        {min, {min.x + 900, min.y + 800, min.z + 2000}},
        BoxOf(points[random() % points.size()])};
    std::vector<bool> is_given(points.size());
    uint32_t end = 0;
    for (const RowRange& part : directory.RowsIn(boxes)) {
      // Parts that touch are one.
      EXPECT_TRUE(part.begin > end || part.begin == 0);
      EXPECT_LT(part.begin, part.end);
      end = part.end;
      for (uint32_t row = part.begin; row < part.end; ++row) {
        is_given.at(row) = true;
      }
      given += part.end - part.begin;
    }
    for (size_t row = 0; row < points.size(); ++row) {
      if (!boxes[0].Contains(points[row]) && !boxes[1].Contains(points[row])) {
        continue;
      }
      ++wanted;
      EXPECT_TRUE(is_given[row]);
    }
  }
  EXPECT_GT(wanted, 0u);
  EXPECT_LT(given, 50 * points.size() / 3);
}

TEST(TileDirectory, OfFewPointsIsTheTile) {
  const CellKey tile = {12, 0, 0, 0};
  const std::vector<LatticePoint> points = {{1, 2, 3}, {4000, 4000, 4000}};
  const TileDirectory directory(tile, points);
  const std::vector<LatticeBox> box = {BoxOf(points[0])};
  EXPECT_EQ(directory.RowsIn(box), (std::vector<RowRange>{{0, 2}}));
  EXPECT_FALSE(TileDirectory(tile, {}).IsMade());
}

}  // namespace
}  // namespace mapsieve::core
