#include "core/registration/label_covariance.h"

namespace mapsieve::core {
namespace {

/// `isotropic` I + `along` v vᵀ.
Covariance WithAxis(float isotropic, float along,
                    const std::array<float, 3>& v) {
  const auto& [x, y, z] = v;
  return {isotropic + along * x * x, along * x * y, along * x * z,
          isotropic + along * y * y, along * y * z, isotropic + along * z * z};
}

}  // namespace

Covariance LabelCovariance(Label label, const std::array<float, 3>& normal,
                           const std::array<float, 3>& tangent) {
  switch (label) {
    case Label::kSurface:
      return WithAxis(1, kVarianceAcross - 1, normal);
    case Label::kCurve:
      return WithAxis(kVarianceAcross, 1 - kVarianceAcross, tangent);
    default:
      return {1, 0, 0, 1, 0, 1};
  }
}

}  // namespace mapsieve::core
