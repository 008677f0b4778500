#ifndef MAPSIEVE_CORE_SAMPLING_SPDF_SEARCH_H_
#define MAPSIEVE_CORE_SAMPLING_SPDF_SEARCH_H_

#include <cstdint>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::core {

/// The density_radius_m with which the filter keeps, after outliers, the most
/// points of `cloud`, but at most `count`, at least 1: to a thousandth, by a
/// bisection (parameter_search.h) in which the filter runs up to 15 times. What
/// is kept need not fall as the radius grows: another radius may come nearer.
/// The radius in `options` has no say. kFailedPrecondition if the filter keeps
/// more even at the largest radius, kCancelled.
absl::StatusOr<double> FindDensityRadius(const LatticeCloud& cloud,
                                         const SpdfOptions& options,
                                         int64_t count,
                                         const ExecutionContext& context);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_SPDF_SEARCH_H_
