#ifndef MAPSIEVE_SERVER_ENGINE_SOLID_H_
#define MAPSIEVE_SERVER_ENGINE_SOLID_H_

#include <memory>

#include "absl/status/statusor.h"
#include "core/geometry/lattice.h"
#include "server/engine/shapes.h"

namespace mapsieve::engine {

/// A closed axis-aligned box of positions; the ends may be infinite.
struct PositionBox {
  core::Point3 min;
  core::Point3 max;

  /// The box grown by `margin` on every side.
  PositionBox Grown(double margin) const {
    return {{min.x - margin, min.y - margin, min.z - margin},
            {max.x + margin, max.y + margin, max.z + margin}};
  }
  /// The largest magnitude of a coordinate.
  double Magnitude() const;
};

/// More than all rounding in tests among coordinates of at most `magnitude`,
/// and less than the lattice tells apart.
constexpr double RoundingMargin(double magnitude) {
  return 0x1p-40 * magnitude;
}

/// A shape prepared for tests of positions. Immutable, so thread-safe.
class Solid {
 public:
  virtual ~Solid() = default;

  /// Whether `p` is inside, evaluated in double.
  virtual bool Contains(const core::Point3& p) const = 0;

  /// Whether a position of `box` may be inside; false only if Contains is
  /// false for all of them.
  virtual bool Meets(const PositionBox& box) const = 0;

  /// Whether all positions of `box` are inside; true only if Contains is true
  /// for all of them.
  virtual bool Encloses(const PositionBox& box) const = 0;

  /// Holds every position inside.
  virtual PositionBox Bounds() const = 0;
};

/// kInvalidArgument, naming the field (FieldOf): a number that is not finite or
/// too large, a box without extent, a radius or a half size not above 0, limits
/// of z that are not in order, a quaternion not of length 1, a polygon with too
/// few or too many vertices or one that crosses or touches itself, a path with
/// too few or too many points.
absl::StatusOr<std::shared_ptr<const Solid>> MakeSolid(const QueryShape& shape);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_SOLID_H_
