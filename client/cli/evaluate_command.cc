#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <iterator>
#include <memory>
#include <utility>

#include "absl/strings/str_format.h"
#include "client/cli/commands.h"
#include "client/cli/evaluate_report.h"
#include "client/cli/output.h"
#include "client/cli/plot_file.h"
#include "client/cli/progress_bar.h"
#include "client/lab/evaluation_summary.h"
#include "core/base/executor.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

absl::StatusOr<std::vector<PairSource>> AllPairs(
    const EvaluateCommand& command) {
  std::vector<PairSource> pairs = SimulatedPairs(command.simulated);
  for (const std::string& list : command.pair_lists) {
    MAPSIEVE_ASSIGN_OR_RETURN(std::vector<PairSource> more,
                              ReadPairList(list, command.pair_folder));
    std::move(more.begin(), more.end(), std::back_inserter(pairs));
  }
  return pairs;
}

Json SettingsJson(const EvaluateCommand& command,
                  const std::vector<PairSource>& pairs) {
  Json methods = Json::array();
  for (const EvaluatedMethod& method : command.options.methods) {
    methods.push_back(method.name());
  }
  Json icps = Json::array();
  for (const core::IcpMethod icp : command.options.icp_methods) {
    icps.push_back(std::string(IcpMethodName(icp)));
  }
  Json names = Json::array();
  for (const PairSource& pair : pairs) names.push_back(pair.name);
  return {{"pairs", std::move(names)},
          {"methods", std::move(methods)},
          {"icp", std::move(icps)},
          {"counts", command.options.counts},
          {"trials", command.options.trial_count},
          {"seed", command.options.seed},
          {"max_translation_m", command.options.max_translation_m},
          {"max_rotation_deg", command.options.max_rotation_deg}};
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
  const bool has_simulated =
      std::any_of(simulated.pair_counts.begin(), simulated.pair_counts.end(),
                  [](int count) { return count > 0; });
  if (has_simulated || !pair_lists.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError("there is no pair: give --pairs");
}

absl::Status RunEvaluate(const CommonOptions& common,
                         const EvaluateCommand& command) {
  const auto start = std::chrono::steady_clock::now();
  const std::filesystem::path folder(command.output);
  const std::filesystem::path trial_file = folder / "trials.csv";
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<PairSource> pairs,
                            AllPairs(command));
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t done,
                            CountDone(command.options, pairs, trial_file));
  const int64_t total = TrialCount(command.options, pairs);
  const std::unique_ptr<Executor> workers = MakeWorkerPool(command.threads);
  MAPSIEVE_ASSIGN_OR_RETURN(
      const double estimated_s,
      EstimateEvaluation(command.options, pairs, done, *workers));
  std::fprintf(stderr, "evaluate: %lld registrations, %lld done; about %s\n",
               static_cast<long long>(total), static_cast<long long>(done),
               DurationText(estimated_s).c_str());
  Json result = {{"registrations", total},
                 {"registrations_before", done},
                 {"pairs", pairs.size()},
                 {"estimated_s", RoundSeconds(estimated_s)}};
  if (command.only_estimate) {
    PrintResult(common.json, result);
    return absl::OkStatus();
  }
  MAPSIEVE_RETURN_IF_ERROR(MakeFolder(folder));
  {
    ProgressBar bar("evaluate", "registrations");
    MAPSIEVE_RETURN_IF_ERROR(
        RunEvaluation(command.options, pairs, trial_file,
                      {.executor = workers.get(), .progress = &bar}));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<Trial> trials,
                            ReadTrials(trial_file));
  MAPSIEVE_RETURN_IF_ERROR(
      WriteEvaluation(Summarize(trials), SettingsJson(command, pairs), folder));
  result["skipped"] =
      std::count_if(trials.begin(), trials.end(), [](const Trial& trial) {
        return trial.outcome == TrialOutcome::kSkipped;
      });
  result["evaluate_s"] = RoundSeconds(
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
          .count());
  result["peak_rss_bytes"] = PeakRssBytes();
  result["report"] = (folder / "report.html").string();
  PrintResult(common.json, result);
  return absl::OkStatus();
}

}  // namespace mapsieve::client
