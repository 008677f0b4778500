#include "core/sampling/spdf_search.h"

#include <optional>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/sampling/parameter_search.h"
#include "core/spdf/cloud_filter.h"

namespace mapsieve::core {
namespace {

constexpr double kPrecision = 1.001;
/// log2(ln(kMaxRadiusSteps) / ln(kPrecision)), and one with the largest radius.
constexpr int kMaxRuns = 15;

}  // namespace

absl::StatusOr<double> FindDensityRadius(const LatticeCloud& cloud,
                                         const SpdfOptions& options,
                                         int64_t count,
                                         const ExecutionContext& context) {
  LatticeCloud distinct{.lattice = cloud.lattice};
  for (const uint32_t row : MergeDuplicates(cloud, *context.executor)) {
    distinct.positions.push_back(cloud.positions[row]);
  }
  const double step = cloud.lattice.step();
  if (static_cast<int64_t>(distinct.size()) <= count) return step;
  // What one run reports would start anew with each.
  const ExecutionContext quiet = {.executor = context.executor,
                                  .stop = context.stop};
  int run_count = 0;
  const double largest = kMaxRadiusSteps * step;
  const auto count_kept = [&](double radius_m) -> absl::StatusOr<int64_t> {
    context.ReportProgress(run_count++, kMaxRuns);
    SpdfOptions tried = options;
    tried.density_radius_m = radius_m;
    MAPSIEVE_ASSIGN_OR_RETURN(const FilteredCloud filtered,
                              FilterCloud(distinct, tried, quiet));
    return static_cast<int64_t>(filtered.Inliers(options.outlier_share).size());
  };
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::optional<double> found,
      SearchParameter(step, largest, kPrecision, count, context, count_kept));
  if (!found.has_value()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "no density radius up to ", largest, " (", kMaxRadiusSteps,
        " lattice steps) leaves as few as ", count,
        " points: take more points, larger steps or method spatial-spdf"));
  }
  return *found;
}

}  // namespace mapsieve::core
