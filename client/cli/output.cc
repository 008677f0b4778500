#include "client/cli/output.h"

#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "absl/strings/str_format.h"

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

std::string Title(std::string key) {
  std::replace(key.begin(), key.end(), '_', ' ');
  return key;
}

void PrintMembers(const Json& object) {
  size_t width = 0;
  for (const auto& [key, value] : object.items()) {
    width = std::max(width, key.size());
  }
  for (const auto& [key, value] : object.items()) {
    std::printf("%-*s  %s\n", static_cast<int>(width), Title(key).c_str(),
                Plain(value).c_str());
  }
}

/// Whether a value is an object of so many members that they do not fit a line.
bool IsLong(const Json& value) {
  constexpr size_t kMaxMembersOfALine = 3;
  return value.is_object() && value.size() > kMaxMembersOfALine;
}

}  // namespace

void PrintResult(bool as_json, const Json& result) {
  if (as_json) {
    std::printf(
        "%s\n",
        result.dump(2, ' ', false, Json::error_handler_t::replace).c_str());
    return;
  }
  Json members = Json::object();
  for (const auto& [key, value] : result.items()) {
    const bool is_list =
        value.is_array() && !value.empty() && value.front().is_object();
    if (!is_list && !IsLong(value)) members[key] = value;
  }
  PrintMembers(members);
  bool is_first = members.empty();
  const auto begin_block = [&is_first] {
    if (!is_first) std::printf("\n");
    is_first = false;
  };
  for (const auto& [key, value] : result.items()) {
    if (members.contains(key)) continue;
    if (value.is_array() && !IsLong(value.front())) {
      begin_block();
      std::printf("%s\n", Title(key).c_str());
      for (size_t i = 0; i < value.size(); ++i) {
        std::printf("%4zu  %s\n", i, Plain(value[i]).c_str());
      }
      continue;
    }
    if (value.is_object()) {
      begin_block();
      std::printf("%s\n", Title(key).c_str());
      PrintMembers(value);
      continue;
    }
    // A list of maps, of files, …: a block of lines each.
    for (const Json& block : value) {
      begin_block();
      PrintMembers(block);
    }
  }
}

Json LabelCountsJson(const core::LabelCounts& counts) {
  return {
      {"junction", counts[1]}, {"curve", counts[2]}, {"surface", counts[3]}};
}

Json NumberJson(double value) {
  return std::isfinite(value) ? Json(value) : Json(nullptr);
}

std::string FewDigits(double value) {
  if (!std::isfinite(value)) return "∞";
  return value < 100 ? absl::StrFormat("%.3g", value)
                     : absl::StrFormat("%.0f", value);
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
