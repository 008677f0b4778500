#ifndef MAPSIEVE_CORE_REGISTRATION_LABEL_COVARIANCE_H_
#define MAPSIEVE_CORE_REGISTRATION_LABEL_COVARIANCE_H_

#include <array>

#include "core/cloud/label.h"

namespace mapsieve::core {

/// A symmetric 3 x 3 matrix: xx, xy, xz, yy, yz, zz.
using Covariance = std::array<float, 6>;

/// Variance across a shape; along it it is 1.
inline constexpr float kVarianceAcross = 0.001f;

/// How freely a point of `label` may slide, for plane-to-plane registration,
/// without a unit: I - 0.999 n nᵀ on a surface, 0.001 I + 0.999 t tᵀ on a
/// curve, I elsewhere, of the unit vectors `normal` n and `tangent` t.
Covariance LabelCovariance(Label label, const std::array<float, 3>& normal,
                           const std::array<float, 3>& tangent);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_REGISTRATION_LABEL_COVARIANCE_H_
