#ifndef MAPSIEVE_CLIENT_CLI_EVALUATE_REPORT_H_
#define MAPSIEVE_CLIENT_CLI_EVALUATE_REPORT_H_

#include <filesystem>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "client/cli/needed_report.h"
#include "client/cli/output.h"
#include "client/lab/evaluation_summary.h"

/// What `mapsieve evaluate` writes of its results.
namespace mapsieve::client {

/// Writes summary.csv, summary.json (with `needed` and `settings`),
/// needed_points.csv, the figures translation_… and rotation_… of each ICP and
/// times, .svg and .png, and report.html, which holds tables and figures
/// itself, into `folder`. The methods come in the order of `summaries`, which
/// are not empty. Errors: those of WritePlot.
absl::Status WriteEvaluation(const std::vector<GroupSummary>& summaries,
                             const NeededTable& needed, const Json& settings,
                             const std::filesystem::path& folder);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_EVALUATE_REPORT_H_
