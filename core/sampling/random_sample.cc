#include "core/sampling/random_sample.h"

#include <algorithm>
#include <utility>

#include "core/geometry/point_hash.h"

namespace mapsieve::core {

std::vector<uint32_t> RandomSample(std::span<const LatticePoint> positions,
                                   int64_t count, int64_t seed) {
  std::vector<std::pair<uint64_t, uint32_t>> draws;
  draws.reserve(positions.size());
  for (uint32_t i = 0; i < positions.size(); ++i) {
    draws.emplace_back(PointHash(positions[i], seed), i);
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

std::vector<uint32_t> RandomShare(std::span<const LatticePoint> positions,
                                  double probability, int64_t seed) {
  std::vector<uint32_t> rows;
  for (uint32_t i = 0; i < positions.size(); ++i) {
    if (PointDraw(positions[i], seed) < probability) rows.push_back(i);
  }
  return rows;
}

}  // namespace mapsieve::core
