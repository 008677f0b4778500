#include "core/sampling/random_sample.h"

#include <algorithm>
#include <utility>

#include "core/base/hash.h"

namespace mapsieve::core {

std::vector<uint32_t> RandomSample(std::span<const LatticePoint> positions,
                                   int64_t count, int64_t seed) {
  std::vector<std::pair<uint64_t, uint32_t>> draws;
  draws.reserve(positions.size());
  for (uint32_t i = 0; i < positions.size(); ++i) {
    const LatticePoint& q = positions[i];
    const int64_t key[4] = {q.x, q.y, q.z, seed};
    draws.emplace_back(HashIntegers(key), i);
  }
  const auto kept =
      std::min(static_cast<size_t>(std::max<int64_t>(count, 0)), draws.size());
  std::nth_element(draws.begin(), draws.begin() + static_cast<ptrdiff_t>(kept),
                   draws.end());
  std::vector<uint32_t> rows;
  rows.reserve(kept);
  for (size_t i = 0; i < kept; ++i) rows.push_back(draws[i].second);
  std::sort(rows.begin(), rows.end());
  return rows;
}

}  // namespace mapsieve::core
