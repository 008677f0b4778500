#ifndef MAPSIEVE_CORE_SAMPLING_COVARIANCE_SAMPLE_H_
#define MAPSIEVE_CORE_SAMPLING_COVARIANCE_SAMPLE_H_

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// What a point-to-plane residual changes by with the six parameters of a
/// motion: v = (p × n, n).
using Leverage = std::array<double, 6>;

/// The leverages of `positions`, moved to their centroid and scaled to a mean
/// distance of 1 from it, so that turning and moving weigh the same. Points
/// with a zero normal have zero leverage and no say in centroid and scale.
std::vector<Leverage> FindLeverages(
    std::span<const LatticePoint> positions,
    std::span<const std::array<float, 3>> normals);

/// Covariance sampling: rows, ascending, of exactly min(count, N) points that
/// hold a point-to-plane registration as steady as possible in every direction.
/// In the axes of the covariance Σ v vᵀ of all points, again and again the
/// direction that the points chosen so far hold least gets the point that holds
/// it most. `positions` are distinct and in Morton order; `normals` are unit
/// vectors of either sign, one a point, or zero if it has none: such points are
/// chosen last. Ties go to the first direction and the first point, so the
/// choice is a function of the set of points; sums are added up in one order,
/// and the one 6 x 6 decomposition is of operations that every processor rounds
/// alike, as long as the build does not use more of it than the baseline.
/// kCancelled. Cost O(N log N), memory 72 bytes a point.
/// Source: Gelfand, Ikemoto, Rusinkiewicz and Levoy, "Geometrically stable
/// sampling for the ICP algorithm", 2003.
absl::StatusOr<std::vector<uint32_t>> SampleCovariance(
    std::span<const LatticePoint> positions,
    std::span<const std::array<float, 3>> normals, int64_t count,
    const ExecutionContext& context);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_COVARIANCE_SAMPLE_H_
