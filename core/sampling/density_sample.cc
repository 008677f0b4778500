#include "core/sampling/density_sample.h"

#include <cmath>
#include <cstddef>
#include <numbers>

#include "core/base/status.h"
#include "core/geometry/point_hash.h"
#include "core/sampling/neighbor_balls.h"

namespace mapsieve::core {

absl::StatusOr<std::vector<double>> FindDropDensities(
    std::span<const LatticePoint> positions, const Lattice& lattice,
    int neighbor_count, int64_t seed, const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<NeighborBall> balls,
      FindNeighborBalls(positions, neighbor_count, context));
  constexpr size_t kTaskPoints = 1 << 14;
  std::vector<double> densities(positions.size());
  ForEachPart(*context.executor, positions.size(), kTaskPoints,
              [&](size_t, size_t begin, size_t end) {
                for (size_t i = begin; i < end; ++i) {
                  const double radius =
                      std::sqrt(static_cast<double>(balls[i].radius_d2)) *
                      lattice.step();
                  const double density =
                      (balls[i].count + 1) /
                      (4.0 / 3.0 * std::numbers::pi * radius * radius * radius);
                  densities[i] = PointDraw(positions[i], seed) * density;
                }
              });
  return densities;
}

}  // namespace mapsieve::core
