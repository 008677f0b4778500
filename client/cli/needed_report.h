#ifndef MAPSIEVE_CLIENT_CLI_NEEDED_REPORT_H_
#define MAPSIEVE_CLIENT_CLI_NEEDED_REPORT_H_

#include <string>
#include <vector>

#include "client/cli/output.h"
#include "client/lab/needed_points.h"

/// The answer to "which sampler, and how many points for this error?".
namespace mapsieve::client {

struct NeededTable {
  double target_m = 0;
  /// In the order of FindNeededPoints, not empty.
  std::vector<NeededPoints> rows;
};

/// The best answer in a sentence, without a full stop.
std::string NeededSentence(const NeededTable& table);

/// The sentence, and a line for each row.
std::string NeededText(const NeededTable& table);

/// The same as a part of a page.
std::string NeededHtml(const NeededTable& table);

/// A line for each row, after their head.
std::string NeededCsv(const NeededTable& table);

/// An object for each row.
Json NeededJson(const NeededTable& table);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_NEEDED_REPORT_H_
