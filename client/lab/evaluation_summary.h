#ifndef MAPSIEVE_CLIENT_LAB_EVALUATION_SUMMARY_H_
#define MAPSIEVE_CLIENT_LAB_EVALUATION_SUMMARY_H_

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/lab/evaluation.h"

/// What many registrations say of methods.
namespace mapsieve::client {

/// A registration fails if its result is farther from the truth than this, or
/// it has none.
inline constexpr double kFailedTranslation = 0.2;
inline constexpr double kFailedRotationDeg = 5;

/// Errors of a group of registrations; infinite ones are those without result.
struct ErrorSummary {
  double median = 0;
  double lower_quartile = 0;
  double upper_quartile = 0;
  /// Where the median lies with 95 % confidence: bootstrap over pairs, since
  /// the registrations of one pair are not independent.
  double low = 0;
  double high = 0;
  /// Not told apart from the best method of the same environment, count and
  /// ICP: the 95 % bootstrap interval, over the same pairs, of its median minus
  /// the best one's reaches 0. The best one ties with itself.
  bool ties_with_best = false;
};

/// Registrations of one method.
struct GroupSummary {
  /// Nothing: all environments.
  std::optional<Environment> environment;
  /// Nothing: all counts.
  std::optional<int64_t> count;
  std::string method;
  core::IcpMethod icp = core::IcpMethod::kPointToPlane;

  int64_t pair_count = 0;
  int64_t trial_count = 0;
  int64_t failure_count = 0;
  int64_t converged_count = 0;
  /// Registrations whose pairs leave a direction of motion free.
  int64_t degenerate_count = 0;
  ErrorSummary translation_m;
  ErrorSummary rotation_deg;
  /// Medians over the registrations with a sample, those with a pose; 0 if
  /// there are none. Points: of the reference.
  double sample_s = 0;
  double icp_s = 0;
  double points = 0;
};

/// Quantile `q` in [0, 1] of `sorted` (not empty, ascending), linear between
/// the two values next to its place q (n - 1): type 7 of Hyndman and Fan,
/// "Sample quantiles in statistical packages", 1996.
double Quantile(std::span<const double> sorted, double q);

/// Medians of `values` (of group numbers below `group_count`, `groups[i]` that
/// of values[i]) in `resample_count` bootstrap resamples of groups: each draws
/// group_count groups with replacement, a function of `seed` and the
/// resample's number. Neither is empty.
std::vector<double> BootstrapMedians(std::span<const double> values,
                                     std::span<const uint32_t> groups,
                                     uint32_t group_count, int resample_count,
                                     uint64_t seed);

/// A summary for each method and ICP of each environment and of all, of each
/// count and of all: in the order of kEnvironments, then all; of counts, then
/// all; of ICP methods and methods as they come in `trials`. Skipped trials
/// count nowhere, and groups of none are left out. 1000 resamples.
/// The same for any order of trials within a method.
std::vector<GroupSummary> Summarize(std::span<const Trial> trials);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_EVALUATION_SUMMARY_H_
