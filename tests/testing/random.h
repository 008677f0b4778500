#ifndef MAPSIEVE_TESTS_TESTING_RANDOM_H_
#define MAPSIEVE_TESTS_TESTING_RANDOM_H_

#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>

namespace mapsieve::testing {

/// Numbers that are the same with every standard library.
class Random {
 public:
  explicit Random(uint64_t seed) : random_(seed) {}
  double Uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(random_() >> 11) * 0x1p-53;
  }
  double Normal() {
    return std::sqrt(-2 * std::log(1 - Uniform(0, 1))) *
           std::cos(Uniform(0, 2 * std::numbers::pi));
  }

 private:
  std::mt19937_64 random_;
};

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_RANDOM_H_
