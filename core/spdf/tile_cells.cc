#include "core/spdf/tile_cells.h"

#include <optional>

namespace mapsieve::core {

void TileCells::Add(const LatticeBox& box) {
  const LatticeBox tile = grid_.tile().box();
  if (!tile.Intersects(box)) return;
  const int level = grid_.level();
  const CellKey first = CellKey::Of(
      {std::max(box.min.x, tile.min.x), std::max(box.min.y, tile.min.y),
       std::max(box.min.z, tile.min.z)},
      level);
  const CellKey last = CellKey::Of(
      {std::min(box.max.x, tile.max.x) - 1, std::min(box.max.y, tile.max.y) - 1,
       std::min(box.max.z, tile.max.z) - 1},
      level);
  for (int64_t z = first.z; z <= last.z; ++z) {
    for (int64_t y = first.y; y <= last.y; ++y) {
      for (int64_t x = first.x; x <= last.x; ++x) {
        cells_.set(grid_.NumberOf(CellKey{level, x, y, z}.corner()));
      }
    }
  }
}

LatticeBox TileCells::Bounds() const {
  std::optional<LatticeBox> bounds;
  ForEach([&bounds](const LatticeBox& cell) {
    bounds = bounds.has_value() ? bounds->Union(cell) : cell;
  });
  return *bounds;
}

TileDirectory::TileDirectory(const CellKey& tile,
                             std::span<const LatticePoint> points)
    : row_count_(static_cast<uint32_t>(points.size())) {
  constexpr size_t kPointsPerCell = 64;
  const size_t max_cells = std::max(points.size() / kPointsPerCell, size_t{1});
  // The finest cells that are few enough; the tile itself always is.
  for (int level = tile.level - TileGrid::kAxisBits; level <= tile.level;
       ++level) {
    grid_ = TileGrid(tile, level);
    cells_.clear();
    for (uint32_t row = 0; row < row_count_ && cells_.size() <= max_cells;
         ++row) {
      const auto number = static_cast<uint32_t>(grid_.NumberOf(points[row]));
      if (cells_.empty() || cells_.back().number != number) {
        cells_.push_back({number, row});
      }
    }
    if (cells_.size() <= max_cells) break;
  }
  cells_.shrink_to_fit();
}

std::vector<RowRange> TileDirectory::RowsIn(
    std::span<const LatticeBox> boxes) const {
  std::vector<RowRange> rows;
  for (size_t i = 0; i < cells_.size(); ++i) {
    const LatticeBox cell = grid_.BoxOf(cells_[i].number);
    if (std::none_of(boxes.begin(), boxes.end(), [&](const LatticeBox& box) {
          return box.Intersects(cell);
        })) {
      continue;
    }
    const uint32_t begin = cells_[i].begin;
    const uint32_t end =
        i + 1 < cells_.size() ? cells_[i + 1].begin : row_count_;
    if (!rows.empty() && rows.back().end == begin) {
      rows.back().end = end;
    } else {
      rows.push_back({begin, end});
    }
  }
  return rows;
}

}  // namespace mapsieve::core
