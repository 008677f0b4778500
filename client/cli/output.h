#ifndef MAPSIEVE_CLIENT_CLI_OUTPUT_H_
#define MAPSIEVE_CLIENT_CLI_OUTPUT_H_

#include <cstdint>
#include <string>
#include <vector>

#include "core/cloud/label.h"
#include "nlohmann/json.hpp"

namespace mapsieve::client {

/// Keys stay in the order in which they are added.
using Json = nlohmann::ordered_json;

/// Prints a command's result on stdout: the document with --json, else its
/// members a line each, and after them a block for each object of many members,
/// alone (titled) or in a list; lists of small ones are titled numbered lines.
void PrintResult(bool as_json, const Json& result);

/// {"junction": …, "curve": …, "surface": …}
Json LabelCountsJson(const core::LabelCounts& counts);

/// null where it is infinite: JSON has no such number.
Json NumberJson(double value);

/// Three digits, or all of a whole number; "∞".
std::string FewDigits(double value);

/// Seconds with millisecond resolution.
double RoundSeconds(double seconds);

/// Largest resident set of this process so far.
int64_t PeakRssBytes();

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_OUTPUT_H_
