#include "server/engine/request_checks.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/lattice.h"

namespace mapsieve::engine {

absl::Status CheckAtLeastOne(const char* field, int value) {
  if (value >= 1) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(field, " is ", value, "; it must be at least 1"));
}

absl::Status CheckLength(const char* field, const std::string& text,
                         size_t limit) {
  if (text.size() <= limit) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      field, " has ", text.size(), " bytes; it must have at most ", limit));
}

absl::StatusOr<int64_t> PageSize(const PageRequest& page) {
  if (page.page_size < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("page_size is ", page.page_size, "; it must be 0 (",
                     kDefaultPageSize, ") or above"));
  }
  return page.page_size == 0 ? kDefaultPageSize
                             : std::min(page.page_size, kMaxPageSize);
}

absl::StatusOr<int> TileLevel(const MapSpec& spec) {
  if (spec.tile_edge == 0) return kDefaultTileLevel;
  const core::Lattice lattice(spec.step_nm);
  const auto edge = [&](int level) {
    return lattice.Coordinate(int64_t{1} << level);
  };
  // The negation refuses NaN too.
  if (!(spec.tile_edge > 0 && spec.tile_edge <= edge(core::kMaxTileLevel))) {
    return absl::InvalidArgumentError(absl::StrCat(
        "tile_edge is ", spec.tile_edge, "; it must be above 0 and at most ",
        edge(core::kMaxTileLevel), " (2^", core::kMaxTileLevel, " steps)"));
  }
  int level = kMinTileLevel;
  while (edge(level) < spec.tile_edge) ++level;
  return level;
}

}  // namespace mapsieve::engine
