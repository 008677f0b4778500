#include "client/lab/trial_file.h"

#include <array>
#include <fstream>
#include <optional>
#include <sstream>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

constexpr size_t kColumnCount = 20;

constexpr std::array kOutcomes = {
    TrialOutcome::kConverged, TrialOutcome::kIterationLimit,
    TrialOutcome::kTooFewPairs, TrialOutcome::kNoSample,
    TrialOutcome::kSkipped};

std::optional<TrialOutcome> OutcomeOfName(std::string_view name) {
  for (const TrialOutcome outcome : kOutcomes) {
    if (TrialOutcomeName(outcome) == name) return outcome;
  }
  return std::nullopt;
}

std::optional<core::IcpMethod> IcpMethodOfName(std::string_view name) {
  for (const core::IcpMethod method :
       {core::IcpMethod::kPointToPlane, core::IcpMethod::kPlaneToPlane}) {
    if (IcpMethodName(method) == name) return method;
  }
  return std::nullopt;
}

absl::StatusOr<std::string> ReadText(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  if (!stream.is_open() || stream.bad()) {
    return absl::NotFoundError(absl::StrCat(file.string(), ": cannot be read"));
  }
  return text.str();
}

}  // namespace

std::string_view TrialOutcomeName(TrialOutcome outcome) {
  switch (outcome) {
    case TrialOutcome::kConverged:
      return "converged";
    case TrialOutcome::kIterationLimit:
      return "iteration-limit";
    case TrialOutcome::kTooFewPairs:
      return "too-few-pairs";
    case TrialOutcome::kNoSample:
      return "no-sample";
    case TrialOutcome::kSkipped:
      break;
  }
  return "skipped";
}

std::string_view TrialHeader() {
  return "pair,environment,method,icp,min_normal_cosine,"
         "label_neighbor_count,reading_point_count,count,trial,"
         "initial_translation_m,initial_rotation_deg,outcome,reading_points,"
         "reference_points,iterations,degenerate_directions,"
         "translation_error_m,rotation_error_deg,sample_s,icp_s\n";
}

std::string TrialLine(const Trial& t) {
  return absl::StrFormat(
      "%s,%s,%s,%s,%.9f,%d,%d,%d,%d,%.9f,%.9f,%s,%d,%d,%d,%d,%.9f,%.9f,%.6f,%."
      "6f\n",
      t.pair, std::string(EnvironmentName(t.environment)), t.method,
      std::string(IcpMethodName(t.icp)), t.min_normal_cosine,
      t.label_neighbor_count, t.reading_point_count, t.count, t.number,
      t.initial_translation_m, t.initial_rotation_deg,
      std::string(TrialOutcomeName(t.outcome)), t.reading_points,
      t.reference_points, t.iteration_count, t.degenerate_count,
      t.translation_error_m, t.rotation_error_deg, t.sample_s, t.icp_s);
}

absl::StatusOr<Trial> ParseTrial(std::string_view line) {
  const std::vector<std::string> cells = absl::StrSplit(ToAbsl(line), ',');
  if (cells.size() != kColumnCount) {
    return absl::InvalidArgumentError(absl::StrCat(
        "has ", cells.size(), " columns; expected ", kColumnCount));
  }
  Trial t;
  t.pair = cells[0];
  const std::optional<Environment> environment = EnvironmentOfName(cells[1]);
  t.method = cells[2];
  const std::optional<core::IcpMethod> icp = IcpMethodOfName(cells[3]);
  const std::optional<TrialOutcome> outcome = OutcomeOfName(cells[11]);
  if (!environment || !icp || !outcome ||
      !absl::SimpleAtod(cells[4], &t.min_normal_cosine) ||
      !absl::SimpleAtoi(cells[5], &t.label_neighbor_count) ||
      !absl::SimpleAtoi(cells[6], &t.reading_point_count) ||
      !absl::SimpleAtoi(cells[7], &t.count) ||
      !absl::SimpleAtoi(cells[8], &t.number) ||
      !absl::SimpleAtod(cells[9], &t.initial_translation_m) ||
      !absl::SimpleAtod(cells[10], &t.initial_rotation_deg) ||
      !absl::SimpleAtoi(cells[12], &t.reading_points) ||
      !absl::SimpleAtoi(cells[13], &t.reference_points) ||
      !absl::SimpleAtoi(cells[14], &t.iteration_count) ||
      !absl::SimpleAtoi(cells[15], &t.degenerate_count) ||
      !absl::SimpleAtod(cells[16], &t.translation_error_m) ||
      !absl::SimpleAtod(cells[17], &t.rotation_error_deg) ||
      !absl::SimpleAtod(cells[18], &t.sample_s) ||
      !absl::SimpleAtod(cells[19], &t.icp_s)) {
    return absl::InvalidArgumentError("is not the line of a registration");
  }
  t.environment = *environment;
  t.icp = *icp;
  t.outcome = *outcome;
  return t;
}

absl::StatusOr<TrialLines> ReadTrialLines(const std::filesystem::path& file) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::string text, ReadText(file));
  if (!std::string_view(text).starts_with(TrialHeader())) {
    return absl::InvalidArgumentError(absl::StrCat(
        file.string(), ": does not begin like the CSV of an evaluation"));
  }
  TrialLines lines;
  size_t begin = TrialHeader().size();
  for (size_t end = text.find('\n', begin); end != std::string::npos;
       end = text.find('\n', begin)) {
    absl::StatusOr<Trial> trial =
        ParseTrial(std::string_view(text).substr(begin, end - begin));
    if (!trial.ok()) {
      return Annotate(trial.status(), absl::StrCat(file.string(), ": line ",
                                                   lines.trials.size() + 2));
    }
    lines.trials.push_back(*std::move(trial));
    begin = end + 1;
    lines.ends.push_back(begin);
  }
  return lines;
}

absl::StatusOr<std::vector<Trial>> ReadTrials(
    const std::filesystem::path& file) {
  MAPSIEVE_ASSIGN_OR_RETURN(TrialLines lines, ReadTrialLines(file));
  return std::move(lines.trials);
}

}  // namespace mapsieve::client
