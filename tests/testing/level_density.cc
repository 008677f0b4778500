#include "tests/testing/level_density.h"

#include <algorithm>
#include <numeric>

#include "client/lab/ball_counter.h"
#include "core/spdf/levels.h"

namespace mapsieve::testing {

using core::LatticePoint;

std::vector<LevelDensity> MeasureLevels(const std::vector<LatticePoint>& points,
                                        const std::vector<uint8_t>& depths,
                                        const core::Lattice& lattice,
                                        const core::SpdfOptions& options) {
  std::vector<LevelDensity> densities;
  const int64_t k = options.neighbor_count;
  client::BallCounter finer(points);
  for (int level = 1; level <= core::kMaxDepth; ++level) {
    const int64_t radius_d2 = core::LevelRadiusD2(options, lattice, level);
    if (radius_d2 > int64_t{core::kMaxRadiusSteps} * core::kMaxRadiusSteps) {
      break;
    }
    std::vector<LatticePoint> kept;
    for (size_t i = 0; i < points.size(); ++i) {
      if (depths[i] >= level) kept.push_back(points[i]);
    }
    client::BallCounter counter(std::move(kept));
    std::vector<double> ratios;
    for (const LatticePoint& q : counter.points()) {
      if (finer.Count(q, radius_d2) <= k) continue;
      ratios.push_back(static_cast<double>(counter.Count(q, radius_d2) - 1) /
                       static_cast<double>(k));
    }
    LevelDensity& density = densities.emplace_back();
    density.point_count = static_cast<int64_t>(counter.points().size());
    density.dense_count = static_cast<int64_t>(ratios.size());
    if (!ratios.empty()) {
      std::sort(ratios.begin(), ratios.end());
      density.mean = std::accumulate(ratios.begin(), ratios.end(), 0.0) /
                     static_cast<double>(ratios.size());
      density.median = ratios[ratios.size() / 2];
    }
    finer = std::move(counter);
  }
  return densities;
}

}  // namespace mapsieve::testing
