#ifndef MAPSIEVE_CORE_SPDF_TILE_CELLS_H_
#define MAPSIEVE_CORE_SPDF_TILE_CELLS_H_

#include <algorithm>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/geometry/cell_key.h"
#include "core/spdf/tile_filter.h"

namespace mapsieve::core {

/// The cells into which a tile is divided, up to 16 along each axis, by number.
class TileGrid {
 public:
  static constexpr int kAxisBits = 4;
  static constexpr size_t kMaxCellCount = size_t{1} << (3 * kAxisBits);

  TileGrid() = default;
  /// Cells are of `level` if that makes no more along an axis, else of the
  /// finest level that does.
  TileGrid(const CellKey& tile, int level)
      : tile_(tile),
        level_(std::clamp(level, std::max(tile.level - kAxisBits, 0),
                          tile.level)) {}

  int level() const { return level_; }
  const CellKey& tile() const { return tile_; }

  /// Number of the cell of a point of the tile, below kMaxCellCount.
  size_t NumberOf(const LatticePoint& q) const {
    const int64_t mask = (int64_t{1} << (tile_.level - level_)) - 1;
    const auto along = [&](int64_t v) {
      return static_cast<size_t>((v >> level_) & mask);
    };
    return along(q.x) | (along(q.y) << kAxisBits) |
           (along(q.z) << (2 * kAxisBits));
  }
  LatticeBox BoxOf(size_t number) const {
    const int bits = tile_.level - level_;
    const auto along = [&](int64_t corner, int shift) {
      return (corner << bits) +
             static_cast<int64_t>((number >> shift) & ((1u << kAxisBits) - 1));
    };
    return CellKey{level_, along(tile_.x, 0), along(tile_.y, kAxisBits),
                   along(tile_.z, 2 * kAxisBits)}
        .box();
  }

 private:
  CellKey tile_;
  int level_ = 0;
};

/// A set of cells of one tile.
class TileCells {
 public:
  explicit TileCells(const TileGrid& grid) : grid_(grid) {}

  bool Any() const { return cells_.any(); }
  /// `q` is a point of the tile.
  bool Contains(const LatticePoint& q) const {
    return cells_[grid_.NumberOf(q)];
  }

  /// Adds the cells that intersect `box`.
  void Add(const LatticeBox& box);
  /// Both sets are of one grid.
  void Add(const TileCells& other) { cells_ |= other.cells_; }
  void Remove(const TileCells& other) { cells_ &= ~other.cells_; }

  /// The smallest box that holds all cells of the set, of which there is one.
  LatticeBox Bounds() const;

  /// Calls use(box) for every cell of the set.
  template <typename Use>
  void ForEach(const Use& use) const {
    for (size_t i = 0; i < cells_.size(); ++i) {
      if (cells_[i]) use(grid_.BoxOf(i));
    }
  }

 private:
  TileGrid grid_;
  std::bitset<TileGrid::kMaxCellCount> cells_;
};

/// Where the points of a tile, in Morton order, are to be found by place.
/// Memory: 8 bytes for some 64 points.
class TileDirectory {
 public:
  /// Of no tile.
  TileDirectory() = default;
  TileDirectory(const CellKey& tile, std::span<const LatticePoint> points);

  /// Whether it is that of a tile.
  bool IsMade() const { return !cells_.empty(); }

  /// The rows of all points that lie in any of `boxes`, and of others near
  /// them, in order.
  std::vector<RowRange> RowsIn(std::span<const LatticeBox> boxes) const;

 private:
  /// The cell `number` begins with row `begin`.
  struct Cell {
    uint32_t number = 0;
    uint32_t begin = 0;
  };

  TileGrid grid_;
  /// Those that hold points, in Morton order.
  std::vector<Cell> cells_;
  uint32_t row_count_ = 0;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_TILE_CELLS_H_
