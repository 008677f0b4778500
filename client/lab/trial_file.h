#ifndef MAPSIEVE_CLIENT_LAB_TRIAL_FILE_H_
#define MAPSIEVE_CLIENT_LAB_TRIAL_FILE_H_

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "client/lab/evaluation.h"

/// The CSV of an evaluation, line by line.
namespace mapsieve::client {

/// Names of the columns, with its line break. The times come last.
std::string_view TrialHeader();

/// A trial as a line, with its line break. Lengths have nanometres, infinite
/// errors are "inf".
std::string TrialLine(const Trial& trial);

/// The inverse of TrialLine, without the line break. kInvalidArgument.
absl::StatusOr<Trial> ParseTrial(std::string_view line);

/// The lines after the header, but for one that does not end, as trials.
struct TrialLines {
  std::vector<Trial> trials;
  /// Where each ends.
  std::vector<size_t> ends;
};

/// Errors: those of ReadTrials.
absl::StatusOr<TrialLines> ReadTrialLines(const std::filesystem::path& file);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_TRIAL_FILE_H_
