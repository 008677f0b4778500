#ifndef MAPSIEVE_SERVER_ENGINE_REGION_H_
#define MAPSIEVE_SERVER_ENGINE_REGION_H_

#include <memory>
#include <utility>

#include "absl/status/statusor.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/lattice.h"
#include "server/engine/shapes.h"
#include "server/engine/solid.h"

namespace mapsieve::engine {

/// A shape asked for, as a test on the points of a map's lattice. A point is
/// inside if its position, as Lattice::Position gives it in double, is inside
/// the shape, evaluated in double. Thread-safe.
class Region {
 public:
  /// Errors as MakeSolid.
  static absl::StatusOr<Region> Make(const QueryShape& shape,
                                     const core::Lattice& lattice);
  static absl::StatusOr<Region> OfEdit(const RegionShape& shape,
                                       const core::Lattice& lattice);

  bool Contains(const core::LatticePoint& q) const {
    return bounds_.Contains(q) && solid_->Contains(lattice_.Position(q));
  }

  /// Whether the region may hold a point of `box`; false only if it holds
  /// none.
  bool Intersects(const core::LatticeBox& box) const;

  /// Whether the region holds every point of `box`; true only if it does.
  bool Encloses(const core::LatticeBox& box) const;

  /// A box that holds every lattice point of the region; empty (min >= max on
  /// an axis) if there is none.
  const core::LatticeBox& bounds() const { return bounds_; }

 private:
  Region(std::shared_ptr<const Solid> solid, const core::Lattice& lattice);

  std::shared_ptr<const Solid> solid_;
  core::Lattice lattice_;
  core::LatticeBox bounds_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_REGION_H_
