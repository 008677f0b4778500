#ifndef MAPSIEVE_CORE_CLOUD_POINT_CLOUD_H_
#define MAPSIEVE_CORE_CLOUD_POINT_CLOUD_H_

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/executor.h"
#include "core/cloud/column.h"
#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// Points as files hold them: positions in map units and attributes, all
/// columns of the same length. Positions may be non-finite: ingest refuses and
/// counts those.
struct PointCloud {
  std::vector<Point3> positions;
  ColumnSet attributes;

  size_t size() const { return positions.size(); }
};

/// Points of a map's lattice and their attributes, all columns of the same
/// length.
struct LatticeCloud {
  Lattice lattice;
  std::vector<LatticePoint> positions;
  ColumnSet attributes;

  size_t size() const { return positions.size(); }
  /// The points at `rows`, in that order.
  LatticeCloud Select(std::span<const uint32_t> rows) const;
};

/// How many points quantisation refused, by reason.
struct RefusedCounts {
  int64_t non_finite = 0;
  int64_t out_of_lattice = 0;

  int64_t total() const { return non_finite + out_of_lattice; }
  friend bool operator==(const RefusedCounts&, const RefusedCounts&) = default;
};

/// Puts `cloud` on `lattice`, in its order, without the refused points, which
/// are added to `refused`.
LatticeCloud Quantize(PointCloud cloud, const Lattice& lattice,
                      RefusedCounts& refused,
                      Executor& executor = InlineExecutor());

/// Positions back in map units.
PointCloud ToPointCloud(const LatticeCloud& cloud);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CLOUD_POINT_CLOUD_H_
