#include "core/registration/transform_error.h"

#include <cmath>

namespace mapsieve::core {

TransformError CompareTransforms(const RigidTransform& estimate,
                                 const RigidTransform& truth) {
  const RigidTransform difference = truth.Inverse() * estimate;
  const Vector3& t = difference.translation;
  const Matrix3& r = difference.rotation;
  // The arc cosine alone would lose half of the digits of a small angle.
  const double sine =
      0.5 * std::hypot(r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]);
  const double cosine = 0.5 * (r[0][0] + r[1][1] + r[2][2] - 1);
  return {.translation_m = std::hypot(t[0], t[1], t[2]),
          .rotation_rad = std::atan2(sine, cosine)};
}

}  // namespace mapsieve::core
