#ifndef MAPSIEVE_CORE_SPDF_MEMORY_TILES_H_
#define MAPSIEVE_CORE_SPDF_MEMORY_TILES_H_

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "core/base/executor.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// A part [begin, end) of points in memory that is a tile.
struct MemoryTile {
  CellKey key;
  size_t begin = 0;
  size_t end = 0;
};

/// Points are cut into at most so many tiles: what is copied tile by tile is
/// then small beside them.
inline constexpr int64_t kMaxMemoryTiles = 1024;
/// Eight such tiles around the origin, or along a border, are still one unit.
inline constexpr int kMaxMemoryTileLevel = 28;

/// The finest level, at most kMaxMemoryTileLevel, at which `size` points in
/// Morton order lie in at most kMaxMemoryTiles cells. `point(i)` gives them.
template <typename PointAt>
int ChooseMemoryTileLevel(size_t size, const PointAt& point,
                          Executor& executor) {
  // How many neighbours in the order part at each level.
  using Counts = std::array<int64_t, kMaxCellLevel + 2>;
  constexpr size_t kTaskPoints = 1 << 14;
  std::vector<Counts> counts(PartCount(size, kTaskPoints));
  ForEachPart(
      executor, size, kTaskPoints, [&](size_t part, size_t begin, size_t end) {
        for (size_t i = std::max(begin, size_t{1}); i < end; ++i) {
          const LatticePoint& a = point(i - 1);
          const LatticePoint& b = point(i);
          const auto differing =
              static_cast<uint64_t>((a.x ^ b.x) | (a.y ^ b.y) | (a.z ^ b.z));
          const int level = 64 - std::countl_zero(differing);
          ++counts[part]
                  [static_cast<size_t>(std::min(level, kMaxCellLevel + 1))];
        }
      });
  Counts parting{};
  for (const Counts& part : counts) {
    std::transform(part.begin(), part.end(), parting.begin(), parting.begin(),
                   std::plus<>());
  }
  int64_t cells = 1;
  int level = kMaxCellLevel;
  for (; level > kMaxMemoryTileLevel; --level) {
    cells += parting[static_cast<size_t>(level)];
  }
  while (level > 0 &&
         cells + parting[static_cast<size_t>(level)] <= kMaxMemoryTiles) {
    cells += parting[static_cast<size_t>(level)];
    --level;
  }
  return level;
}

/// `size` points in Morton order as tiles of the level so chosen, in order.
template <typename PointAt>
std::vector<MemoryTile> MakeMemoryTiles(size_t size, const PointAt& point,
                                        Executor& executor) {
  const int level = ChooseMemoryTileLevel(size, point, executor);
  std::vector<MemoryTile> tiles;
  for (size_t begin = 0; begin < size;) {
    const CellKey key = CellKey::Of(point(begin), level);
    const size_t end = CellEnd(begin, size, level, point);
    tiles.push_back({key, begin, end});
    begin = end;
  }
  return tiles;
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_MEMORY_TILES_H_
