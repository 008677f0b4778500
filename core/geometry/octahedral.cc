#include "core/geometry/octahedral.h"

#include <cmath>

namespace mapsieve::core {
namespace {

constexpr int kUnusedBits = 4;
constexpr double kScale = 2047.0;

double SignOf(double v) { return v < 0.0 ? -1.0 : 1.0; }

/// Folds the lower half of the octahedron over the edges of the upper one,
/// and back.
void Fold(double& u, double& v) {
  const double folded_u = (1.0 - std::abs(v)) * SignOf(u);
  const double folded_v = (1.0 - std::abs(u)) * SignOf(v);
  u = folded_u;
  v = folded_v;
}

}  // namespace

OctahedralVector EncodeOctahedral(const Vector3& unit) {
  const double sum = std::abs(unit[0]) + std::abs(unit[1]) + std::abs(unit[2]);
  double u = sum > 0.0 ? unit[0] / sum : 0.0;
  double v = sum > 0.0 ? unit[1] / sum : 0.0;
  if (unit[2] < 0.0) Fold(u, v);
  const auto quantize = [](double x) {
    return static_cast<uint16_t>(static_cast<int>(std::nearbyint(x * kScale)) *
                                 (1 << kUnusedBits));
  };
  return static_cast<uint32_t>(quantize(u)) | static_cast<uint32_t>(quantize(v))
                                                  << 16;
}

std::array<float, 3> DecodeOctahedral(OctahedralVector code) {
  const auto coordinate = [](uint32_t half) {
    return static_cast<double>(static_cast<int16_t>(half)) /
           (kScale * (1 << kUnusedBits));
  };
  double u = coordinate(code & 0xffff);
  double v = coordinate(code >> 16);
  const double z = 1.0 - std::abs(u) - std::abs(v);
  if (z < 0.0) Fold(u, v);
  const double length = std::sqrt(u * u + v * v + z * z);
  return {static_cast<float>(u / length), static_cast<float>(v / length),
          static_cast<float>(z / length)};
}

}  // namespace mapsieve::core
