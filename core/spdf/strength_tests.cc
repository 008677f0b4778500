#include "core/spdf/strength_tests.h"

#include "core/spdf/labels.h"

namespace mapsieve::core {
namespace {

__extension__ using Int128 = __int128;

/// ⌊numerator / denominator⌋ for a positive denominator.
int64_t FloorDivide(int64_t numerator, int64_t denominator) {
  const int64_t quotient = numerator / denominator;
  return numerator % denominator < 0 ? quotient - 1 : quotient;
}

/// λ ≥ (numerator / denominator) ξ k for the eigenvalue λ = c0 - µ / 2 of the
/// ball vote asks for µ ≤ this, µ the matching eigenvalue of A.
int64_t LargestMu(const BallSums& sums, int neighbor_count, int32_t strength,
                  int64_t numerator, int64_t denominator) {
  return FloorDivide(
      2 * (denominator * sums.c0 - numerator * neighbor_count * strength),
      denominator);
}

}  // namespace

int CountEigenvaluesAbove(const BallSums& sums, int64_t threshold) {
  // M = A - threshold I has real eigenvalues, so by Descartes' rule exactly as
  // many are positive as its characteristic polynomial has changes of sign.
  const int64_t xx = sums.xx - threshold;
  const int64_t yy = sums.yy - threshold;
  const int64_t zz = int64_t{sums.c0} - sums.xx - sums.yy - threshold;
  const int64_t xy = sums.xy;
  const int64_t xz = sums.xz;
  const int64_t yz = sums.yz;
  const Int128 trace = Int128{xx} + yy + zz;
  const Int128 minor_z = Int128{xx} * yy - Int128{xy} * xy;
  const Int128 minor_y = Int128{xx} * zz - Int128{xz} * xz;
  const Int128 minor_x = Int128{yy} * zz - Int128{yz} * yz;
  const Int128 determinant = zz * minor_z -
                             yz * (Int128{xx} * yz - Int128{xy} * xz) +
                             xz * (Int128{xy} * yz - Int128{yy} * xz);
  const Int128 coefficients[3] = {-trace, minor_x + minor_y + minor_z,
                                  -determinant};
  int changes = 0;
  bool negative = false;
  for (const Int128& coefficient : coefficients) {
    if (coefficient == 0) continue;
    if ((coefficient < 0) != negative) {
      ++changes;
      negative = !negative;
    }
  }
  return changes;
}

uint32_t StrengthFlags(const BallSums& sums, const SpdfConstants& constants) {
  const int k = constants.neighbor_count;
  const auto [curve, surface, volume] = constants.strength;
  // λ1 ≥ λ2 ≥ λ3 belong to ascending µ: "λd ≥ t k" holds if at most 3 - d
  // eigenvalues of A are above the threshold.
  const auto all_above = [&](int d, int32_t strength, int64_t numerator,
                             int64_t denominator) {
    return CountEigenvaluesAbove(sums, LargestMu(sums, k, strength, numerator,
                                                 denominator)) <= 3 - d;
  };
  uint32_t flags = 0;
  const auto flag = [&flags](Label label) {
    flags |= 1u << static_cast<unsigned>(label);
  };
  if (all_above(3, volume, 5, 6)) flag(Label::kJunction);
  if (all_above(2, curve, 1, 1) && all_above(3, curve, 1, 2)) {
    flag(Label::kCurve);
  }
  if (all_above(1, surface, 1, 1) && all_above(3, surface, 3, 4)) {
    flag(Label::kSurface);
  }
  return flags;
}

}  // namespace mapsieve::core
