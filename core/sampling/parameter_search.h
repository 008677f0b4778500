#ifndef MAPSIEVE_CORE_SAMPLING_PARAMETER_SEARCH_H_
#define MAPSIEVE_CORE_SAMPLING_PARAMETER_SEARCH_H_

#include <cmath>
#include <cstdint>
#include <optional>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/base/status.h"

namespace mapsieve::core {

/// Looks in [low, high] (above 0) for the parameter with which a method keeps
/// the most points, but at most `wanted`, where it keeps fewer the larger that
/// is: by bisection of its logarithm until the bounds differ by the factor
/// `precision` at most. Where the count is not monotone the bounds close in on
/// one of the places where it passes `wanted`, and the best parameter met on
/// the way is taken. `count(parameter)`, a StatusOr<int64_t>, may give any
/// number above `wanted` for one that is.
/// Errors: kFailedPrecondition if not even `high` keeps so few, those of
/// `count`, kCancelled.
template <typename Count>
absl::StatusOr<double> SearchParameter(double low, double high,
                                       double precision, int64_t wanted,
                                       const ExecutionContext& context,
                                       const Count& count) {
  std::optional<double> best;
  int64_t best_count = -1;
  const auto fits = [&](double parameter) -> absl::StatusOr<bool> {
    MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t kept, count(parameter));
    if (kept > wanted) return false;
    if (kept > best_count) {
      best = parameter;
      best_count = kept;
    }
    return true;
  };
  while (best_count < wanted && high > low * precision) {
    const double middle = std::sqrt(low) * std::sqrt(high);
    MAPSIEVE_ASSIGN_OR_RETURN(const bool is_enough, fits(middle));
    (is_enough ? high : low) = middle;
  }
  if (!best.has_value()) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool is_enough, fits(high));
    if (!is_enough) {
      return absl::FailedPreconditionError(
          absl::StrCat("no parameter leaves as few as ", wanted, " points"));
    }
  }
  return *best;
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_PARAMETER_SEARCH_H_
