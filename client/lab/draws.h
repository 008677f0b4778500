#ifndef MAPSIEVE_CLIENT_LAB_DRAWS_H_
#define MAPSIEVE_CLIENT_LAB_DRAWS_H_

#include <array>
#include <cstdint>

#include "core/base/hash.h"

namespace mapsieve::client {

/// A sequence of random numbers, a function of `key` and `stream` alone.
class Draws {
 public:
  Draws(uint64_t key, int64_t stream)
      : key_(static_cast<int64_t>(key)), stream_(stream) {}

  uint64_t Bits() {
    return HashIntegers(std::array{key_, stream_, draw_count_++});
  }
  double Uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(Bits() >> 11) * 0x1p-53;
  }
  /// From `low` to `high`, both included.
  int Integer(int low, int high) {
    return low + static_cast<int>(Uniform(0, high - low + 1));
  }

 private:
  int64_t key_;
  int64_t stream_;
  int64_t draw_count_ = 0;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_DRAWS_H_
