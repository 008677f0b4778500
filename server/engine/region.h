#ifndef MAPSIEVE_SERVER_ENGINE_REGION_H_
#define MAPSIEVE_SERVER_ENGINE_REGION_H_

#include <variant>

#include "absl/status/statusor.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/lattice.h"

namespace mapsieve::engine {

/// An axis-aligned box in map units: a position p is inside if min <= p < max
/// on every axis.
struct Box {
  core::Point3 min;
  core::Point3 max;

  friend bool operator==(const Box&, const Box&) = default;
};

/// A ball in map units: a position is inside if its distance to `center` is at
/// most `radius`.
struct Sphere {
  core::Point3 center;
  double radius = 0;

  friend bool operator==(const Sphere&, const Sphere&) = default;
};

using RegionShape = std::variant<Box, Sphere>;

/// A shape asked for, as a test on the points of a map's lattice. A point is
/// inside if its position, as Lattice::Position gives it in double, is inside
/// the shape, evaluated in double. Thread-safe.
class Region {
 public:
  /// kInvalidArgument, naming the field: a number that is not finite, a box
  /// whose min is not below its max on every axis, a radius not above 0.
  static absl::StatusOr<Region> Make(const RegionShape& shape,
                                     const core::Lattice& lattice);

  bool Contains(const core::LatticePoint& q) const;

  /// Whether the region may hold a point of `box`; false only if it holds
  /// none.
  bool Intersects(const core::LatticeBox& box) const;

  /// Whether the region holds every point of `box`; true only if it does.
  bool Encloses(const core::LatticeBox& box) const;

  /// A box that holds every lattice point of the region; empty (min >= max on
  /// an axis) if there is none.
  const core::LatticeBox& bounds() const { return bounds_; }

 private:
  Region(const RegionShape& shape, const core::Lattice& lattice,
         const core::LatticeBox& bounds)
      : shape_(shape), lattice_(lattice), bounds_(bounds) {}

  RegionShape shape_;
  core::Lattice lattice_;
  core::LatticeBox bounds_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_REGION_H_
