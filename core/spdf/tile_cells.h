#ifndef MAPSIEVE_CORE_SPDF_TILE_CELLS_H_
#define MAPSIEVE_CORE_SPDF_TILE_CELLS_H_

#include <algorithm>
#include <bitset>
#include <cstddef>
#include <cstdint>

#include "core/geometry/cell_key.h"

namespace mapsieve::core {

/// A set of cells of one tile, which is divided into up to 16 cells along each
/// axis.
class TileCells {
 public:
  /// Cells are of `level` if that makes as many, else of the next that does.
  TileCells(const CellKey& tile, int level)
      : tile_(tile),
        level_(std::clamp(level, std::max(tile.level - kAxisBits, 0),
                          tile.level)) {}

  bool Any() const { return cells_.any(); }
  /// `q` is a point of the tile.
  bool Contains(const LatticePoint& q) const { return cells_[IndexOf(q)]; }

  /// Adds the cells that intersect `box`.
  void Add(const LatticeBox& box) {
    const LatticeBox tile = tile_.box();
    if (!tile.Intersects(box)) return;
    const LatticePoint low = {std::max(box.min.x, tile.min.x),
                              std::max(box.min.y, tile.min.y),
                              std::max(box.min.z, tile.min.z)};
    const CellKey first = CellKey::Of(low, level_);
    const CellKey last = CellKey::Of({std::min(box.max.x, tile.max.x) - 1,
                                      std::min(box.max.y, tile.max.y) - 1,
                                      std::min(box.max.z, tile.max.z) - 1},
                                     level_);
    for (int64_t z = first.z; z <= last.z; ++z) {
      for (int64_t y = first.y; y <= last.y; ++y) {
        for (int64_t x = first.x; x <= last.x; ++x) {
          cells_.set(IndexOf(CellKey{level_, x, y, z}.corner()));
        }
      }
    }
  }
  /// Both sets are of one tile.
  void Add(const TileCells& other) { cells_ |= other.cells_; }
  void Remove(const TileCells& other) { cells_ &= ~other.cells_; }

  /// Calls use(box) for every cell of the set.
  template <typename Use>
  void ForEach(const Use& use) const {
    for (size_t i = 0; i < cells_.size(); ++i) {
      if (!cells_[i]) continue;
      const auto n = static_cast<int64_t>(i);
      const int bits = tile_.level - level_;
      const int64_t mask = (int64_t{1} << kAxisBits) - 1;
      use(CellKey{level_, (tile_.x << bits) + (n & mask),
                  (tile_.y << bits) + ((n >> kAxisBits) & mask),
                  (tile_.z << bits) + (n >> (2 * kAxisBits))}
              .box());
    }
  }

 private:
  static constexpr int kAxisBits = 4;

  size_t IndexOf(const LatticePoint& q) const {
    const int64_t mask = (int64_t{1} << (tile_.level - level_)) - 1;
    const auto along = [&](int64_t v) {
      return static_cast<size_t>((v >> level_) & mask);
    };
    return along(q.x) | (along(q.y) << kAxisBits) |
           (along(q.z) << (2 * kAxisBits));
  }

  CellKey tile_;
  int level_;
  std::bitset<size_t{1} << (3 * kAxisBits)> cells_;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_TILE_CELLS_H_
