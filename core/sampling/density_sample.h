#ifndef MAPSIEVE_CORE_SAMPLING_DENSITY_SAMPLE_H_
#define MAPSIEVE_CORE_SAMPLING_DENSITY_SAMPLE_H_

#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// For each of `positions` (distinct, in Morton order) the largest density, in
/// points per cubic map unit, to which it may be thinned and still be dropped:
/// a point whose surroundings have density D is kept at `max_density` with
/// probability max_density / D, by a draw that is a hash of its coordinates and
/// `seed`. So whoever keeps the points with a smaller value has thinned them to
/// that density, the sets are nested, and any number of points can be had.
/// D = n / (4/3 π r³), where the ball of radius r around the point holds its
/// `neighbor_count` nearest others and n points with itself. kCancelled.
/// Source: libpointmatcher's MaxDensity, which draws from one generator in the
/// order of the points.
absl::StatusOr<std::vector<double>> FindDropDensities(
    std::span<const LatticePoint> positions, const Lattice& lattice,
    int neighbor_count, int64_t seed, const ExecutionContext& context);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_DENSITY_SAMPLE_H_
