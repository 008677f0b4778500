#ifndef MAPSIEVE_CORE_GEOMETRY_VECTOR3_H_
#define MAPSIEVE_CORE_GEOMETRY_VECTOR3_H_

#include <array>

namespace mapsieve::core {

using Vector3 = std::array<double, 3>;

/// `v` or -v: the component of largest magnitude is positive (ties x, y, z).
Vector3 WithCanonicalSign(const Vector3& v);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_VECTOR3_H_
