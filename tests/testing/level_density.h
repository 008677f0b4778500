#ifndef MAPSIEVE_TESTS_TESTING_LEVEL_DENSITY_H_
#define MAPSIEVE_TESTS_TESTING_LEVEL_DENSITY_H_

#include <cstdint>
#include <vector>

#include "core/geometry/lattice.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::testing {

/// How dense a level of detail is where its input was denser than it is to be.
struct LevelDensity {
  /// Of the level.
  int64_t point_count = 0;
  /// Of those, points whose ball held k others or more in the finer level.
  int64_t dense_count = 0;
  /// Of the counts of others in the balls of these, in the level, over k.
  double mean = 0;
  double median = 0;
};

/// Levels 1, 2, … as far as their radius is within core::kMaxRadiusSteps.
/// `points`: level 0, distinct and in Morton order; `depths`: one a point.
std::vector<LevelDensity> MeasureLevels(
    const std::vector<core::LatticePoint>& points,
    const std::vector<uint8_t>& depths, const core::Lattice& lattice,
    const core::SpdfOptions& options);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_LEVEL_DENSITY_H_
