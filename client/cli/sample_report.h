#ifndef MAPSIEVE_CLIENT_CLI_SAMPLE_REPORT_H_
#define MAPSIEVE_CLIENT_CLI_SAMPLE_REPORT_H_

#include <filesystem>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/lab/filter_report.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/spdf_options.h"

/// `mapsieve sample --report`.
namespace mapsieve::client {

/// Both density rules on `cloud`, paper first: `filtered`, which took
/// FilterCloud `filter_s` seconds with `options`, beside the other rule, for
/// which the filter is run. The errors of FilterCloud.
absl::StatusOr<FilterReport> CompareRules(const core::LatticeCloud& cloud,
                                          core::FilteredCloud filtered,
                                          double filter_s,
                                          const core::SpdfOptions& options,
                                          Executor& executor);

/// Writes report.json, then density and saliencies as .svg and .png, into
/// `folder`, which is made if there is none. Errors: the folder's, those of
/// RunGnuplot.
absl::Status WriteReport(const FilterReport& report,
                         const std::filesystem::path& folder);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_SAMPLE_REPORT_H_
