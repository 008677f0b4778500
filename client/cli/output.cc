#include "client/cli/output.h"

#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace mapsieve::client {
namespace {

/// One line for people: text without quotes, members of objects in a row.
std::string Plain(const Json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (!value.is_object()) return value.dump();
  std::string line;
  for (const auto& [key, member] : value.items()) {
    if (!line.empty()) line += ", ";
    line += Plain(member) + " " + key;
  }
  return line;
}

void PrintMembers(const Json& object) {
  size_t width = 0;
  for (const auto& [key, value] : object.items()) {
    width = std::max(width, key.size());
  }
  for (const auto& [key, value] : object.items()) {
    std::string name = key;
    std::replace(name.begin(), name.end(), '_', ' ');
    std::printf("%-*s  %s\n", static_cast<int>(width), name.c_str(),
                Plain(value).c_str());
  }
}

}  // namespace

void PrintResult(bool as_json, const Json& result) {
  if (as_json) {
    std::printf(
        "%s\n",
        result.dump(2, ' ', false, Json::error_handler_t::replace).c_str());
    return;
  }
  // A list of maps, of files, …: a block of lines each.
  Json members = Json::object();
  Json blocks = Json::array();
  for (const auto& [key, value] : result.items()) {
    if (value.is_array() && !value.empty() && value.front().is_object()) {
      blocks.insert(blocks.end(), value.begin(), value.end());
    } else {
      members[key] = value;
    }
  }
  PrintMembers(members);
  for (const Json& block : blocks) {
    if (!members.empty() || &block != &blocks.front()) std::printf("\n");
    PrintMembers(block);
  }
}

Json LabelCountsJson(const core::LabelCounts& counts) {
  return {
      {"junction", counts[1]}, {"curve", counts[2]}, {"surface", counts[3]}};
}

double RoundSeconds(double seconds) {
  return std::round(seconds * 1000) / 1000;
}

int64_t PeakRssBytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return int64_t{usage.ru_maxrss} * 1024;
}

}  // namespace mapsieve::client
