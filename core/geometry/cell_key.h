#ifndef MAPSIEVE_CORE_GEOMETRY_CELL_KEY_H_
#define MAPSIEVE_CORE_GEOMETRY_CELL_KEY_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "core/geometry/lattice.h"
#include "core/geometry/morton.h"

namespace mapsieve::core {

/// Half-open box of lattice points: min <= q < max on every axis.
struct LatticeBox {
  LatticePoint min;
  LatticePoint max;

  bool Contains(const LatticePoint& q) const {
    return q.x >= min.x && q.x < max.x && q.y >= min.y && q.y < max.y &&
           q.z >= min.z && q.z < max.z;
  }
  bool Intersects(const LatticeBox& other) const {
    return min.x < other.max.x && other.min.x < max.x && min.y < other.max.y &&
           other.min.y < max.y && min.z < other.max.z && other.min.z < max.z;
  }
  /// The box grown by `margin` steps on every side.
  LatticeBox Grown(int64_t margin) const {
    return {{min.x - margin, min.y - margin, min.z - margin},
            {max.x + margin, max.y + margin, max.z + margin}};
  }
  /// The smallest box that holds both.
  LatticeBox Union(const LatticeBox& other) const {
    return {{std::min(min.x, other.min.x), std::min(min.y, other.min.y),
             std::min(min.z, other.min.z)},
            {std::max(max.x, other.max.x), std::max(max.y, other.max.y),
             std::max(max.z, other.max.z)}};
  }
  friend bool operator==(const LatticeBox&, const LatticeBox&) = default;
};

/// The box of one point.
inline LatticeBox BoxOf(const LatticePoint& q) {
  return {q, {q.x + 1, q.y + 1, q.z + 1}};
}

/// Levels of cells: an edge of 2^0 to 2^kMaxCellLevel steps.
inline constexpr int kMaxCellLevel = 43;

/// A cell of the absolute octree: the lattice points with q >> level equal to
/// (x, y, z), so with an edge of 2^level steps. A tile is a cell of its map's
/// tile level, at most kMaxTileLevel.
struct CellKey {
  int level = 0;
  int64_t x = 0;
  int64_t y = 0;
  int64_t z = 0;

  static CellKey Of(const LatticePoint& q, int level) {
    return {level, q.x >> level, q.y >> level, q.z >> level};
  }
  /// The cell of a coarser (or the same) level that contains this one.
  CellKey Ancestor(int coarser_level) const {
    const int shift = coarser_level - level;
    return {coarser_level, x >> shift, y >> shift, z >> shift};
  }
  LatticePoint corner() const {
    return {x * (int64_t{1} << level), y * (int64_t{1} << level),
            z * (int64_t{1} << level)};
  }
  LatticeBox box() const {
    const LatticePoint c = corner();
    const int64_t edge = int64_t{1} << level;
    return {c, {c.x + edge, c.y + edge, c.z + edge}};
  }
  /// "level-x-y-z", as in resource names.
  std::string ToString() const {
    return std::to_string(level) + "-" + std::to_string(x) + "-" +
           std::to_string(y) + "-" + std::to_string(z);
  }

  friend bool operator==(const CellKey&, const CellKey&) = default;
};

/// Codes of the points of a tile fit 63 bits.
inline constexpr int kMaxTileLevel = 21;

/// Orders cells of one level along the Morton curve; by level before that.
struct CellKeyLess {
  bool operator()(const CellKey& a, const CellKey& b) const {
    if (a.level != b.level) return a.level < b.level;
    return MortonLess(a.x, a.y, a.z, b.x, b.y, b.z);
  }
};

/// The end of the cell of `level` that begins at `begin`, of points [begin,
/// end) in Morton order. `point(i)` gives them.
template <typename Index, typename PointAt>
Index CellEnd(Index begin, Index end, int level, const PointAt& point) {
  const CellKey key = CellKey::Of(point(begin), level);
  for (Index low = begin + 1; low < end;) {
    const Index middle = low + (end - low) / 2;
    if (CellKey::Of(point(middle), level) == key) {
      low = middle + 1;
    } else {
      end = middle;
    }
  }
  return end;
}

struct CellKeyHash {
  size_t operator()(const CellKey& key) const {
    uint64_t h = static_cast<uint64_t>(key.level);
    for (const int64_t v : {key.x, key.y, key.z}) {
      h = (h ^ static_cast<uint64_t>(v)) * 0x9e3779b97f4a7c15;
      h ^= h >> 32;
    }
    return h;
  }
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_CELL_KEY_H_
