#ifndef MAPSIEVE_CORE_SAMPLING_OCTREE_SAMPLE_H_
#define MAPSIEVE_CORE_SAMPLING_OCTREE_SAMPLE_H_

#include <cstdint>
#include <span>
#include <stop_token>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/lattice.h"
#include "core/sampling/cells.h"

namespace mapsieve::core {

/// The leaves of the absolute octree over `positions` (distinct, in Morton
/// order) as ranges, in order: from the whole lattice on, a cell q >> level is
/// divided in eight while it holds more than `max_points` and is of a level
/// above `leaf_level` (0 to kMaxCellLevel). Cells lie where they lie, whatever
/// the points' bounds.
/// Source: the octree of Hornung et al., "OctoMap", 2013; one point a leaf as
/// libpointmatcher's OctreeGrid takes it.
std::vector<CellRange> OctreeLeaves(std::span<const LatticePoint> positions,
                                    int64_t max_points, int leaf_level);

/// The points as exactly min(count, N) cells, `count` at least 1: octree cells,
/// or halves and quarters of them. The fullest is halved along its next Morton
/// bit again and again. kCancelled.
absl::StatusOr<std::vector<CellRange>> OctreeHalves(
    std::span<const LatticePoint> positions, int64_t count,
    const std::stop_token& stop);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_OCTREE_SAMPLE_H_
