#ifndef MAPSIEVE_TESTS_TESTING_BRUTE_FORCE_FILTER_H_
#define MAPSIEVE_TESTS_TESTING_BRUTE_FORCE_FILTER_H_

#include <vector>

#include "core/geometry/lattice.h"
#include "core/spdf/labels.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::testing {

/// The filter written down once more in the plainest way: every round looks at
/// every pair of points. The oracle of the real one, which must agree bit for
/// bit.
struct BruteForceResult {
  std::vector<core::LatticePoint> positions;
  core::LabelColumns columns;
};

/// `points`: distinct, in Morton order.
BruteForceResult BruteForceFilter(const std::vector<core::LatticePoint>& points,
                                  const core::Lattice& lattice,
                                  const core::SpdfOptions& options);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_BRUTE_FORCE_FILTER_H_
