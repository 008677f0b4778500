#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iterator>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands.h"
#include "client/cli/evaluate_report.h"
#include "client/cli/needed_report.h"
#include "client/cli/output.h"
#include "client/cli/plot_file.h"
#include "client/cli/progress_bar.h"
#include "client/lab/evaluation_summary.h"
#include "client/lab/map_pair.h"
#include "client/lab/needed_points.h"
#include "client/lab/surveyed_pair.h"
#include "core/base/executor.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

/// An evaluation, once its files are known.
struct Plan {
  EvaluationOptions options;
  std::vector<PairSource> pairs;
  /// What to print of the pairs.
  Json about;
};

/// Puts `point_count` in place of all counts above it.
void LimitCounts(int64_t point_count, std::vector<int64_t>& counts) {
  if (counts.back() <= point_count) return;
  std::erase_if(counts, [&](int64_t count) { return count >= point_count; });
  counts.push_back(point_count);
  std::fprintf(stderr,
               "evaluate: the smaller map has %lld points, which stand for "
               "the counts above\n",
               static_cast<long long>(point_count));
}

absl::StatusOr<Plan> PlanOfMaps(const EvaluateCommand& command) {
  Plan plan = {.options = command.options};
  core::RigidTransform truth;
  if (command.transform.empty()) {
    std::fprintf(stderr,
                 "evaluate: no --transform, so the coordinates of the maps are "
                 "taken as the truth: they lie on each other as they are\n");
  } else {
    MAPSIEVE_ASSIGN_OR_RETURN(truth, TransformOfRows(command.transform));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      MapPair pair, LoadMapPair(command.maps[0], command.maps[1], truth));
  LimitCounts(pair.point_count, plan.options.counts);
  plan.about = {{"maps", command.maps},
                {"truth", command.transform.empty() ? "identity" : "given"},
                {"points_of_smaller_map", pair.point_count},
                {"overlap", std::round(1000 * pair.overlap) / 1000}};
  plan.pairs.push_back(std::move(pair.source));
  return plan;
}

absl::StatusOr<Plan> PlanOf(const EvaluateCommand& command) {
  if (!command.maps.empty()) return PlanOfMaps(command);
  Plan plan = {.options = command.options,
               .pairs = SimulatedPairs(command.simulated)};
  for (PairSource& pair : SurveyedPairs(command.surveyed_count)) {
    plan.pairs.push_back(std::move(pair));
  }
  for (const std::string& list : command.pair_lists) {
    MAPSIEVE_ASSIGN_OR_RETURN(std::vector<PairSource> more,
                              ReadPairList(list, command.pair_folder));
    std::move(more.begin(), more.end(), std::back_inserter(plan.pairs));
  }
  plan.about = {{"pairs", plan.pairs.size()}};
  return plan;
}

Json SettingsJson(const Plan& plan, double target_m) {
  const EvaluationOptions& options = plan.options;
  Json methods = Json::array();
  for (const EvaluatedMethod& method : options.methods) {
    methods.push_back(method.name());
  }
  Json icps = Json::array();
  for (const core::IcpMethod icp : options.icp_methods) {
    icps.push_back(std::string(IcpMethodName(icp)));
  }
  Json names = Json::array();
  for (const PairSource& pair : plan.pairs) names.push_back(pair.name);
  Json settings = {{"pairs", std::move(names)},
                   {"methods", std::move(methods)},
                   {"icp", std::move(icps)},
                   {"counts", options.counts},
                   {"trials", options.trial_count},
                   {"seed", options.seed},
                   {"max_translation_m", options.max_translation_m},
                   {"max_rotation_deg", options.max_rotation_deg},
                   {"min_normal_cosine", options.min_normal_cosine},
                   {"label_neighbors", options.label_neighbor_count},
                   {"reading_points", options.reading_point_count},
                   {"target_m", target_m}};
  if (plan.about.contains("truth")) settings["truth"] = plan.about["truth"];
  return settings;
}

/// "1 h 05 min", "7 min", "12 s".
std::string DurationText(double seconds) {
  if (seconds < 120) return absl::StrFormat("%.0f s", seconds);
  const auto minutes = static_cast<int64_t>(seconds / 60);
  if (minutes < 120) return absl::StrFormat("%d min", minutes);
  return absl::StrFormat("%d h %02d min", minutes / 60, minutes % 60);
}

}  // namespace

absl::Status EvaluateCommand::Validate() const {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  MAPSIEVE_RETURN_IF_ERROR(simulated.Validate());
  if (!(target_m > 0 && target_m <= 1000)) {
    return absl::InvalidArgumentError(
        absl::StrCat("--target is ", target_m, "; expected 0 to 1000 m"));
  }
  if (!transform.empty()) {
    if (maps.empty()) {
      return absl::InvalidArgumentError("--transform needs --maps");
    }
    const absl::Status valid = TransformOfRows(transform).status();
    if (!valid.ok()) return Annotate(valid, "--transform");
  }
  const bool has_simulated =
      surveyed_count > 0 ||
      std::any_of(simulated.pair_counts.begin(), simulated.pair_counts.end(),
                  [](int count) { return count > 0; });
  if (has_simulated || !pair_lists.empty() || !maps.empty()) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError("there is no pair: give --maps or --pairs");
}

absl::Status RunEvaluate(const CommonOptions& common,
                         const EvaluateCommand& command) {
  const auto start = std::chrono::steady_clock::now();
  const std::filesystem::path folder(command.output);
  const std::filesystem::path trial_file = folder / "trials.csv";
  MAPSIEVE_ASSIGN_OR_RETURN(const Plan plan, PlanOf(command));
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t done,
                            CountDone(plan.options, plan.pairs, trial_file));
  const int64_t total = TrialCount(plan.options, plan.pairs);
  const std::unique_ptr<Executor> workers = MakeWorkerPool(command.threads);
  MAPSIEVE_ASSIGN_OR_RETURN(
      const double estimated_s,
      EstimateEvaluation(plan.options, plan.pairs, done, *workers));
  std::fprintf(stderr, "evaluate: %lld registrations, %lld done; about %s\n",
               static_cast<long long>(total), static_cast<long long>(done),
               DurationText(estimated_s).c_str());
  Json result = {{"registrations", total}, {"registrations_before", done}};
  result.update(plan.about);
  result["estimated_s"] = RoundSeconds(estimated_s);
  if (command.only_estimate) {
    PrintResult(common.json, result);
    return absl::OkStatus();
  }
  MAPSIEVE_RETURN_IF_ERROR(MakeFolder(folder));
  {
    ProgressBar bar("evaluate", "registrations");
    MAPSIEVE_RETURN_IF_ERROR(
        RunEvaluation(plan.options, plan.pairs, trial_file,
                      {.executor = workers.get(), .progress = &bar}));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<Trial> trials,
                            ReadTrials(trial_file));
  const std::vector<GroupSummary> summaries = Summarize(trials);
  if (summaries.empty()) {
    return absl::FailedPreconditionError(
        "no pair has as many points as the smallest of --counts");
  }
  const NeededTable needed = {command.target_m,
                              FindNeededPoints(summaries, command.target_m)};
  MAPSIEVE_RETURN_IF_ERROR(WriteEvaluation(
      summaries, needed, SettingsJson(plan, command.target_m), folder));
  result["skipped"] =
      std::count_if(trials.begin(), trials.end(), [](const Trial& trial) {
        return trial.outcome == TrialOutcome::kSkipped;
      });
  result["evaluate_s"] = RoundSeconds(
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
          .count());
  result["peak_rss_bytes"] = PeakRssBytes();
  result["report"] = (folder / "report.html").string();
  if (common.json) {
    result["target_m"] = command.target_m;
    result["needed_points"] = NeededJson(needed);
  }
  PrintResult(common.json, result);
  if (!common.json) std::printf("\n%s", NeededText(needed).c_str());
  return absl::OkStatus();
}

}  // namespace mapsieve::client
