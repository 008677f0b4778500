#ifndef MAPSIEVE_TESTS_TESTING_NORMAL_ERROR_H_
#define MAPSIEVE_TESTS_TESTING_NORMAL_ERROR_H_

#include "core/spdf/spdf_options.h"
#include "tests/testing/ideal_shape.h"

namespace mapsieve::testing {

/// Angles in degrees, 0 to 90, between the filter's normals and a plane's own.
struct NormalError {
  double median = 0;
  double p90 = 0;
};

/// The error over the survivors in the interior of `plane`, an ideal shape of
/// dimension 2. `options` must be valid and leave survivors there.
NormalError MeasureNormalError(const IdealShape& plane,
                               const core::SpdfOptions& options);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_NORMAL_ERROR_H_
