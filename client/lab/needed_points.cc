#include "client/lab/needed_points.h"

#include <algorithm>
#include <map>
#include <string>
#include <tuple>
#include <utility>

namespace mapsieve::client {
namespace {

/// Whether `a` answers better than `b`, of the same method or of another.
bool IsBetter(const NeededPoints& a, const NeededPoints& b) {
  const auto key = [](const NeededPoints& n) {
    return std::tuple(!n.is_reached, n.is_reached ? n.at.count.value() : 0,
                      n.at.translation_m.median, n.at.count.value(),
                      n.at.method, n.at.icp);
  };
  return key(a) < key(b);
}

}  // namespace

std::vector<NeededPoints> FindNeededPoints(
    std::span<const GroupSummary> summaries, double target_m) {
  std::map<std::pair<std::string, core::IcpMethod>, NeededPoints> best;
  for (const GroupSummary& s : summaries) {
    if (s.environment || !s.count) continue;
    const NeededPoints found = {s.translation_m.median <= target_m, s};
    const auto [entry, is_first] =
        best.try_emplace(std::pair(s.method, s.icp), found);
    if (!is_first && IsBetter(found, entry->second)) entry->second = found;
  }
  std::vector<NeededPoints> result;
  for (auto& [key, needed] : best) result.push_back(std::move(needed));
  std::sort(result.begin(), result.end(), IsBetter);
  return result;
}

}  // namespace mapsieve::client
