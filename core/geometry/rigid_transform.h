#ifndef MAPSIEVE_CORE_GEOMETRY_RIGID_TRANSFORM_H_
#define MAPSIEVE_CORE_GEOMETRY_RIGID_TRANSFORM_H_

#include <array>

#include "absl/status/statusor.h"
#include "core/geometry/lattice.h"
#include "core/geometry/vector3.h"

namespace mapsieve::core {

/// A 3 x 3 matrix, by rows.
using Matrix3 = std::array<Vector3, 3>;

/// A rigid motion: x becomes rotation * x + translation. T_a_b moves points of
/// frame b to frame a.
struct RigidTransform {
  /// Orthogonal, of determinant 1.
  Matrix3 rotation = {Vector3{1, 0, 0}, Vector3{0, 1, 0}, Vector3{0, 0, 1}};
  /// In metres.
  Vector3 translation = {0, 0, 0};

  Point3 operator()(const Point3& p) const;
  /// `v` turned, as directions are.
  Vector3 Rotate(const Vector3& v) const;
  RigidTransform Inverse() const;

  friend bool operator==(const RigidTransform&,
                         const RigidTransform&) = default;
};

/// First b, then a: (a * b)(x) = a(b(x)).
RigidTransform operator*(const RigidTransform& a, const RigidTransform& b);

/// The rotation by |v| radians about the axis v: the exponential map of SO(3),
/// by Rodrigues' formula.
Matrix3 RotationFromVector(const Vector3& v);

/// `transform` with the rotation nearest to its own, for one that was read
/// from rounded numbers. kInvalidArgument: a value that is not finite, or a
/// matrix more than 0.01 (Frobenius norm) from any rotation.
absl::StatusOr<RigidTransform> Orthonormalized(const RigidTransform& transform);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_RIGID_TRANSFORM_H_
