#ifndef MAPSIEVE_CLIENT_LAB_NEEDED_POINTS_H_
#define MAPSIEVE_CLIENT_LAB_NEEDED_POINTS_H_

#include <span>
#include <vector>

#include "client/lab/evaluation_summary.h"

namespace mapsieve::client {

/// How many points a method needs, with one ICP, to keep an error.
struct NeededPoints {
  /// Whether the median error of translation is at most the target at a count.
  bool is_reached = false;
  /// At the smallest such count; where there is none, at the count with the
  /// lowest median. Of all environments.
  GroupSummary at;
};

/// One for each method and ICP of `summaries`, from those of all environments
/// and one count. First those that reach `target_m`, by count, then the
/// others; among equals by median, name and ICP.
std::vector<NeededPoints> FindNeededPoints(
    std::span<const GroupSummary> summaries, double target_m);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_NEEDED_POINTS_H_
