#ifndef MAPSIEVE_CORE_SAMPLING_NEIGHBOR_BALLS_H_
#define MAPSIEVE_CORE_SAMPLING_NEIGHBOR_BALLS_H_

#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// The smallest closed ball around a point that holds so many others as are
/// wanted.
struct NeighborBall {
  /// Squared radius in steps².
  int32_t radius_d2 = 0;
  /// Others in it: as many as wanted, or more if several lie at its surface.
  /// Fewer, with a radius of kMaxRadiusSteps, if no more lie within that.
  int32_t count = 0;

  friend bool operator==(const NeighborBall&, const NeighborBall&) = default;
};

/// The ball of each of `positions` (distinct, in Morton order) that holds its
/// `neighbor_count` (1 to kMaxNeighborCount) nearest others. A function of the
/// set of points alone. kCancelled. Cost O(N log N).
absl::StatusOr<std::vector<NeighborBall>> FindNeighborBalls(
    std::span<const LatticePoint> positions, int neighbor_count,
    const ExecutionContext& context);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_NEIGHBOR_BALLS_H_
