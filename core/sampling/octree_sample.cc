#include "core/sampling/octree_sample.h"

#include <bit>

#include "core/geometry/cell_key.h"
#include "core/geometry/morton.h"

namespace mapsieve::core {
namespace {

/// Appends the leaves below the smallest cell that holds the points of `cell`.
void AppendLeaves(std::span<const LatticePoint> positions,
                  const CellRange& cell, int64_t max_points, int leaf_level,
                  std::vector<CellRange>& leaves) {
  const LatticePoint& first = positions[cell.begin];
  const LatticePoint& last = positions[cell.end - 1];
  // The ends of a Morton range differ in the highest bit that differs in it.
  const auto differing = static_cast<uint64_t>(
      (first.x ^ last.x) | (first.y ^ last.y) | (first.z ^ last.z));
  const int level = 64 - std::countl_zero(differing);
  if (cell.size() <= max_points || level <= leaf_level) {
    leaves.push_back(cell);
    return;
  }
  const auto point = [&](uint32_t i) -> const LatticePoint& {
    return positions[i];
  };
  for (uint32_t begin = cell.begin; begin < cell.end;) {
    const uint32_t end = CellEnd(begin, cell.end, level - 1, point);
    AppendLeaves(positions, {begin, end}, max_points, leaf_level, leaves);
    begin = end;
  }
}

}  // namespace

std::vector<CellRange> OctreeLeaves(std::span<const LatticePoint> positions,
                                    int64_t max_points, int leaf_level) {
  std::vector<CellRange> leaves;
  if (!positions.empty()) {
    AppendLeaves(positions, {0, static_cast<uint32_t>(positions.size())},
                 max_points, leaf_level, leaves);
  }
  return leaves;
}

absl::StatusOr<std::vector<CellRange>> OctreeHalves(
    std::span<const LatticePoint> positions, int64_t count,
    const std::stop_token& stop) {
  if (positions.empty()) return std::vector<CellRange>();
  return SplitFullest(
      static_cast<uint32_t>(positions.size()), count, 1,
      [&](const CellRange& cell) {
        return MortonSplit(cell.begin, cell.end,
                           [&](uint32_t i) { return positions[i]; });
      },
      stop);
}

}  // namespace mapsieve::core
