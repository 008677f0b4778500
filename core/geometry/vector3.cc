#include "core/geometry/vector3.h"

#include <cmath>
#include <cstddef>

namespace mapsieve::core {

Vector3 WithCanonicalSign(const Vector3& v) {
  size_t largest = 0;
  for (size_t i = 1; i < 3; ++i) {
    if (std::abs(v[i]) > std::abs(v[largest])) largest = i;
  }
  if (v[largest] >= 0.0) return v;
  return {-v[0], -v[1], -v[2]};
}

}  // namespace mapsieve::core
