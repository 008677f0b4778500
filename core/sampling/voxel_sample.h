#ifndef MAPSIEVE_CORE_SAMPLING_VOXEL_SAMPLE_H_
#define MAPSIEVE_CORE_SAMPLING_VOXEL_SAMPLE_H_

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/lattice.h"
#include "core/sampling/cells.h"

namespace mapsieve::core {

/// Points by voxel.
struct VoxelCells {
  /// An order of the points that keeps those of a voxel together; within a
  /// voxel they ascend.
  std::vector<uint32_t> order;
  /// The voxels as parts of `order`.
  std::vector<CellRange> cells;
};

/// Divides `positions` in cubes with an edge of `edge_steps` (at least 1)
/// lattice steps, the corner of one of which is the lattice's origin. Indices
/// are 64-bit and found by hash: memory grows with the points alone, whatever
/// the extent of the cloud.
VoxelCells DivideInVoxels(std::span<const LatticePoint> positions,
                          double edge_steps);

/// How many voxels DivideInVoxels makes, or nothing if more than `limit`.
std::optional<int64_t> CountVoxels(std::span<const LatticePoint> positions,
                                   double edge_steps, int64_t limit);

/// The edge in map units that gives at most `count` voxels, at least 1, of
/// `positions`, and of such edges that with the most. As the edge grows the
/// number of voxels falls, but not always: a bisection (parameter_search.h) may
/// miss an edge with a few voxels more. kFailedPrecondition if there is none:
/// up to eight voxels meet at the lattice's origin. kCancelled.
absl::StatusOr<double> FindVoxelEdge(std::span<const LatticePoint> positions,
                                     const Lattice& lattice, int64_t count,
                                     const ExecutionContext& context);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_VOXEL_SAMPLE_H_
