#include "core/registration/label_covariance.h"

namespace mapsieve::core {

Covariance LabelCovariance(Label label, const std::array<float, 3>& normal) {
  if (label != Label::kSurface && label != Label::kCurve) {
    return {1, 0, 0, 1, 0, 1};
  }
  constexpr float kAlongNormal = kVarianceAcross - 1;
  const auto& [x, y, z] = normal;
  return {1 + kAlongNormal * x * x, kAlongNormal * x * y,
          kAlongNormal * x * z,     1 + kAlongNormal * y * y,
          kAlongNormal * y * z,     1 + kAlongNormal * z * z};
}

}  // namespace mapsieve::core
