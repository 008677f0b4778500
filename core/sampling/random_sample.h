#ifndef MAPSIEVE_CORE_SAMPLING_RANDOM_SAMPLE_H_
#define MAPSIEVE_CORE_SAMPLING_RANDOM_SAMPLE_H_

#include <cstdint>
#include <span>
#include <vector>

#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// The rows, ascending, of min(count, N) points drawn at random without
/// replacement: those with the smallest hashes of (coordinates, seed), ties by
/// row. So with distinct points the choice does not depend on their order.
std::vector<uint32_t> RandomSample(std::span<const LatticePoint> positions,
                                   int64_t count, int64_t seed);

/// The rows, ascending, of the points whose draw, a hash of (coordinates,
/// seed), falls below `probability`: of what RandomSample orders, the first.
std::vector<uint32_t> RandomShare(std::span<const LatticePoint> positions,
                                  double probability, int64_t seed);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_RANDOM_SAMPLE_H_
