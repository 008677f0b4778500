#include "core/sampling/voxel_sample.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>
#include <utility>

#include "core/geometry/cell_key.h"
#include "core/sampling/parameter_search.h"

namespace mapsieve::core {
namespace {

/// Calls use(i, voxel) for every point; voxels are numbered in the order in
/// which their first points come. Returns how many there are, or nothing, and
/// ends early, if more than `limit`.
template <typename Use>
std::optional<int64_t> NumberVoxels(std::span<const LatticePoint> positions,
                                    double edge_steps, int64_t limit,
                                    const Use& use) {
  // Both are exact, and the quotient is rounded once: never across an integer.
  const auto index = [&](int64_t q) {
    return static_cast<int64_t>(
        std::floor(static_cast<double>(q) / edge_steps));
  };
  std::unordered_map<CellKey, uint32_t, CellKeyHash> numbers;
  CellKey last = {.level = -1};
  uint32_t number = 0;
  for (uint32_t i = 0; i < positions.size(); ++i) {
    const LatticePoint& q = positions[i];
    const CellKey voxel = {0, index(q.x), index(q.y), index(q.z)};
    if (!(voxel == last)) {
      number = numbers.try_emplace(voxel, static_cast<uint32_t>(numbers.size()))
                   .first->second;
      if (static_cast<int64_t>(numbers.size()) > limit) return std::nullopt;
      last = voxel;
    }
    use(i, number);
  }
  return static_cast<int64_t>(numbers.size());
}

}  // namespace

VoxelCells DivideInVoxels(std::span<const LatticePoint> positions,
                          double edge_steps) {
  std::vector<uint32_t> voxel_of(positions.size());
  const int64_t count =
      *NumberVoxels(positions, edge_steps, std::numeric_limits<int64_t>::max(),
                    [&](uint32_t i, uint32_t voxel) { voxel_of[i] = voxel; });
  VoxelCells result;
  result.cells.resize(static_cast<size_t>(count));
  for (const uint32_t voxel : voxel_of) ++result.cells[voxel].end;
  uint32_t begin = 0;
  for (CellRange& cell : result.cells) {
    begin += std::exchange(cell.end, begin);
    cell.begin = cell.end;
  }
  result.order.resize(positions.size());
  for (uint32_t i = 0; i < positions.size(); ++i) {
    result.order[result.cells[voxel_of[i]].end++] = i;
  }
  return result;
}

std::optional<int64_t> CountVoxels(std::span<const LatticePoint> positions,
                                   double edge_steps, int64_t limit) {
  return NumberVoxels(positions, edge_steps, limit, [](uint32_t, uint32_t) {});
}

absl::StatusOr<double> FindVoxelEdge(std::span<const LatticePoint> positions,
                                     const Lattice& lattice, int64_t count,
                                     const ExecutionContext& context) {
  // With an edge beyond every coordinate all indices are 0 or -1.
  int64_t farthest = 1;
  for (const LatticePoint& q : positions) {
    farthest =
        std::max({farthest, std::abs(q.x), std::abs(q.y), std::abs(q.z)});
  }
  return SearchParameter(
      lattice.step(), lattice.Coordinate(farthest + 1), 1 + 1e-6, count,
      context, [&](double edge_m) -> absl::StatusOr<int64_t> {
        return CountVoxels(positions, edge_m / lattice.step(), count)
            .value_or(count + 1);
      });
}

}  // namespace mapsieve::core
