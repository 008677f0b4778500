#ifndef MAPSIEVE_CORE_SPDF_INTEGER_ROOT_H_
#define MAPSIEVE_CORE_SPDF_INTEGER_ROOT_H_

#include <cmath>
#include <cstdint>

namespace mapsieve::core {

/// The smallest integer whose square is at least `square`, up to 2^52.
inline int64_t CeilRoot(int64_t square) {
  return static_cast<int64_t>(
      std::ceil(std::sqrt(static_cast<double>(square))));
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_INTEGER_ROOT_H_
