#ifndef MAPSIEVE_CORE_SAMPLING_SURFACE_SAMPLE_H_
#define MAPSIEVE_CORE_SAMPLING_SURFACE_SAMPLE_H_

#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/lattice.h"
#include "core/geometry/vector3.h"
#include "core/sampling/cells.h"

namespace mapsieve::core {

/// A point of each cell and the normal of the cell.
struct SurfaceSample {
  CellSample points;
  /// One a row: the unit axis along which the points of the cell spread least,
  /// its largest component positive; zero if they lie on a line or are fewer
  /// than three.
  std::vector<Vector3> normals;
  /// Points of the fullest cell.
  int64_t largest_cell = 0;
};

/// Sampling by surface normals: `positions` (distinct, in Morton order) are
/// halved at the median along their widest axis, the fullest part first, until
/// there are `max_cells` or none has more than `max_points`, and each part
/// keeps one point, its `representative`, and one normal. kCancelled.
/// Source: libpointmatcher's SamplingSurfaceNormal.
absl::StatusOr<SurfaceSample> SampleSurfaces(
    std::span<const LatticePoint> positions, int64_t max_cells,
    int64_t max_points, Representative representative, int64_t seed,
    const ExecutionContext& context);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_SURFACE_SAMPLE_H_
