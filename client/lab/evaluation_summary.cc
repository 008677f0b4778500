#include "client/lab/evaluation_summary.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <set>

#include "client/lab/distinct.h"
#include "client/lab/draws.h"

namespace mapsieve::client {
namespace {

constexpr int kResampleCount = 1000;
constexpr uint64_t kBootstrapSeed = 1;

/// `share` of the way between two values, which may be infinite.
double Between(double low, double high, double share) {
  if (low == high || share == 0 || std::isinf(low)) return low;
  return low + share * (high - low);
}

double MedianOf(std::vector<double> values) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return Quantile(values, 0.5);
}

/// The errors of a group and their medians in the resamples.
struct ErrorSample {
  ErrorSummary summary;
  std::vector<double> resampled;
};

ErrorSample SummarizeErrors(const std::vector<double>& errors,
                            const std::vector<uint32_t>& pairs,
                            uint32_t pair_count) {
  std::vector<double> sorted = errors;
  std::sort(sorted.begin(), sorted.end());
  ErrorSample sample;
  sample.summary.median = Quantile(sorted, 0.5);
  sample.summary.lower_quartile = Quantile(sorted, 0.25);
  sample.summary.upper_quartile = Quantile(sorted, 0.75);
  sample.resampled = BootstrapMedians(errors, pairs, pair_count, kResampleCount,
                                      kBootstrapSeed);
  std::vector<double> medians = sample.resampled;
  std::sort(medians.begin(), medians.end());
  sample.summary.low = Quantile(medians, 0.025);
  sample.summary.high = Quantile(medians, 0.975);
  return sample;
}

/// Sets ties_with_best of methods that are compared.
void FindTies(std::vector<ErrorSample>& samples) {
  const auto best =
      std::min_element(samples.begin(), samples.end(),
                       [](const ErrorSample& a, const ErrorSample& b) {
                         return a.summary.median < b.summary.median;
                       });
  for (ErrorSample& sample : samples) {
    std::vector<double> differences;
    for (size_t i = 0; i < sample.resampled.size(); ++i) {
      const double a = sample.resampled[i];
      const double b = best->resampled[i];
      differences.push_back(a == b ? 0 : a - b);
    }
    std::sort(differences.begin(), differences.end());
    sample.summary.ties_with_best = Quantile(differences, 0.025) <= 0;
  }
}

bool IsFailure(const Trial& trial) {
  return !(trial.translation_error_m <= kFailedTranslation &&
           trial.rotation_error_deg <= kFailedRotationDeg);
}

/// The trials of one method, environment, count and ICP.
using Group = std::vector<const Trial*>;

struct MethodGroup {
  GroupSummary summary;
  ErrorSample translation;
  ErrorSample rotation;
};

/// `pair_numbers` has the pairs of all methods that are compared.
MethodGroup SummarizeGroup(
    const Group& group, const std::map<std::string, uint32_t>& pair_numbers) {
  MethodGroup result;
  GroupSummary& summary = result.summary;
  summary.method = group.front()->method;
  summary.icp = group.front()->icp;
  summary.trial_count = static_cast<int64_t>(group.size());
  std::set<uint32_t> seen;
  std::vector<uint32_t> pairs;
  std::vector<double> translations;
  std::vector<double> rotations;
  std::vector<double> sample_times;
  std::vector<double> icp_times;
  std::vector<double> points;
  for (const Trial* trial : group) {
    pairs.push_back(pair_numbers.at(trial->pair));
    seen.insert(pairs.back());
    translations.push_back(trial->translation_error_m);
    rotations.push_back(trial->rotation_error_deg);
    summary.failure_count += IsFailure(*trial) ? 1 : 0;
    summary.converged_count +=
        trial->outcome == TrialOutcome::kConverged ? 1 : 0;
    summary.degenerate_count += trial->degenerate_count > 0 ? 1 : 0;
    if (trial->outcome != TrialOutcome::kNoSample) {
      sample_times.push_back(trial->sample_s);
      points.push_back(static_cast<double>(trial->reference_points));
    }
    if (HasPose(trial->outcome)) icp_times.push_back(trial->icp_s);
  }
  summary.pair_count = static_cast<int64_t>(seen.size());
  summary.sample_s = MedianOf(std::move(sample_times));
  summary.icp_s = MedianOf(std::move(icp_times));
  summary.points = MedianOf(std::move(points));
  const auto pair_count = static_cast<uint32_t>(pair_numbers.size());
  result.translation = SummarizeErrors(translations, pairs, pair_count);
  result.rotation = SummarizeErrors(rotations, pairs, pair_count);
  return result;
}

/// Appends the summaries of the methods of one environment, count and ICP.
void SummarizeMethods(const std::vector<Group>& groups,
                      std::optional<Environment> environment,
                      std::optional<int64_t> count,
                      std::vector<GroupSummary>& summaries) {
  std::map<std::string, uint32_t> pair_numbers;
  for (const Group& group : groups) {
    for (const Trial* trial : group) pair_numbers[trial->pair] = 0;
  }
  uint32_t number = 0;
  for (auto& [name, value] : pair_numbers) value = number++;
  std::vector<GroupSummary> results;
  std::vector<ErrorSample> translations;
  std::vector<ErrorSample> rotations;
  for (const Group& group : groups) {
    MethodGroup method = SummarizeGroup(group, pair_numbers);
    results.push_back(std::move(method.summary));
    translations.push_back(std::move(method.translation));
    rotations.push_back(std::move(method.rotation));
  }
  FindTies(translations);
  FindTies(rotations);
  for (size_t i = 0; i < results.size(); ++i) {
    results[i].environment = environment;
    results[i].count = count;
    results[i].translation_m = translations[i].summary;
    results[i].rotation_deg = rotations[i].summary;
    summaries.push_back(std::move(results[i]));
  }
}

}  // namespace

double Quantile(std::span<const double> sorted, double q) {
  const double place = q * static_cast<double>(sorted.size() - 1);
  const auto low = static_cast<size_t>(place);
  const size_t high = std::min(low + 1, sorted.size() - 1);
  return Between(sorted[low], sorted[high], place - std::floor(place));
}

std::vector<double> BootstrapMedians(std::span<const double> values,
                                     std::span<const uint32_t> groups,
                                     uint32_t group_count, int resample_count,
                                     uint64_t seed) {
  std::vector<size_t> order(values.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return values[a] != values[b] ? values[a] < values[b] : a < b;
  });
  std::vector<int64_t> group_sizes(group_count);
  for (const uint32_t group : groups) ++group_sizes[group];
  std::vector<double> medians;
  for (int resample = 0; resample < resample_count; ++resample) {
    Draws draws(seed, resample);
    std::vector<int64_t> weights(group_count);
    int64_t total = 0;
    // Groups without values, which are so by chance, do not make a resample.
    while (total == 0) {
      std::fill(weights.begin(), weights.end(), 0);
      for (uint32_t i = 0; i < group_count; ++i) {
        const auto drawn = static_cast<size_t>(
            draws.Integer(0, static_cast<int>(group_count) - 1));
        ++weights[drawn];
        total += group_sizes[drawn];
      }
    }
    // The median is between the values of these two ranks, mostly one.
    const int64_t low_rank = (total - 1) / 2;
    const int64_t high_rank = total / 2;
    int64_t before = 0;
    double low = 0;
    for (const size_t i : order) {
      const int64_t after = before + weights[groups[i]];
      if (before <= low_rank && low_rank < after) low = values[i];
      if (before <= high_rank && high_rank < after) {
        medians.push_back(Between(low, values[i], 0.5));
        break;
      }
      before = after;
    }
  }
  return medians;
}

std::vector<GroupSummary> Summarize(std::span<const Trial> trials) {
  const std::vector<std::string> methods = DistinctValues<std::string>(
      trials, [](const Trial& trial) { return trial.method; });
  const std::vector<core::IcpMethod> icps = DistinctValues<core::IcpMethod>(
      trials, [](const Trial& trial) { return trial.icp; });
  std::vector<int64_t> counts = DistinctValues<int64_t>(
      trials, [](const Trial& trial) { return trial.count; });
  std::sort(counts.begin(), counts.end());
  std::vector<std::optional<Environment>> environments(kEnvironments.begin(),
                                                       kEnvironments.end());
  environments.push_back(std::nullopt);
  std::vector<std::optional<int64_t>> all_counts(counts.begin(), counts.end());
  all_counts.push_back(std::nullopt);

  std::vector<GroupSummary> summaries;
  for (const auto& environment : environments) {
    for (const auto& count : all_counts) {
      for (const core::IcpMethod icp : icps) {
        std::vector<Group> groups;
        for (const std::string& method : methods) {
          Group group;
          for (const Trial& trial : trials) {
            if (trial.outcome != TrialOutcome::kSkipped &&
                trial.method == method && trial.icp == icp &&
                environment.value_or(trial.environment) == trial.environment &&
                count.value_or(trial.count) == trial.count) {
              group.push_back(&trial);
            }
          }
          if (!group.empty()) groups.push_back(std::move(group));
        }
        if (!groups.empty()) {
          SummarizeMethods(groups, environment, count, summaries);
        }
      }
    }
  }
  return summaries;
}

}  // namespace mapsieve::client
