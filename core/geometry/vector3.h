#ifndef MAPSIEVE_CORE_GEOMETRY_VECTOR3_H_
#define MAPSIEVE_CORE_GEOMETRY_VECTOR3_H_

#include <array>

namespace mapsieve::core {

using Vector3 = std::array<double, 3>;

inline double Dot(const Vector3& a, const Vector3& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

inline Vector3 Cross(const Vector3& a, const Vector3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
          a[0] * b[1] - a[1] * b[0]};
}

/// `v` or -v: the component of largest magnitude is positive (ties x, y, z).
Vector3 WithCanonicalSign(const Vector3& v);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_VECTOR3_H_
