#ifndef MAPSIEVE_CORE_SPDF_STRENGTH_TESTS_H_
#define MAPSIEVE_CORE_SPDF_STRENGTH_TESTS_H_

#include <cstdint>

#include "core/spdf/kernels.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::core {

/// How many eigenvalues of the matrix A of `sums` are above the integer
/// `threshold`, exactly.
int CountEigenvaluesAbove(const BallSums& sums, int64_t threshold);

/// The tests of the rule kPaper that flag a point with these ball votes, bit l
/// for Label l. Exact integer arithmetic.
uint32_t StrengthFlags(const BallSums& sums, const SpdfConstants& constants);

/// False if no point with a sum of weights `c0` or less can be flagged: it is
/// settled, since the sum never grows.
inline bool MayBeFlagged(int64_t c0, const SpdfConstants& constants) {
  return c0 >= int64_t{constants.neighbor_count} * constants.strength[2];
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_STRENGTH_TESTS_H_
