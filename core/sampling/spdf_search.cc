#include "core/sampling/spdf_search.h"

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
  return SearchParameter(
      step, kMaxRadiusSteps * step, kPrecision, count, context,
      [&](double radius_m) -> absl::StatusOr<int64_t> {
        context.ReportProgress(run_count++, kMaxRuns);
        SpdfOptions tried = options;
        tried.density_radius_m = radius_m;
        MAPSIEVE_ASSIGN_OR_RETURN(const FilteredCloud filtered,
                                  FilterCloud(distinct, tried, quiet));
        return static_cast<int64_t>(
            filtered.Inliers(options.outlier_share).size());
      });
}

}  // namespace mapsieve::core
