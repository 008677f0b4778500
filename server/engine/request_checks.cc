#include "server/engine/request_checks.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/lattice.h"
#include "storage/names.h"

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

absl::Status CheckName(const char* field, const std::string& text,
                       size_t limit) {
  MAPSIEVE_RETURN_IF_ERROR(CheckLength(field, text, limit));
  for (const char c : text) {
    if ((c >= '\0' && c < ' ') || c == '\x7f') {
      return absl::InvalidArgumentError(
          absl::StrCat(field, " is ", storage::Quoted(text),
                       "; it must have no control characters"));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckUploadSpec(const UploadSpec& spec) {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckResourceId(spec.upload_id));
  if (!storage::IsHexId(spec.content_hash)) {
    return absl::InvalidArgumentError(
        absl::StrCat("content_hash is ", storage::Quoted(spec.content_hash),
                     "; it must be 32 lower-case hexadecimal digits"));
  }
  for (const auto& [field, value] :
       {std::pair{"expected_bytes", spec.expected_bytes},
        {"refused.non_finite", spec.refused.non_finite},
        {"refused.out_of_lattice", spec.refused.out_of_lattice}}) {
    if (value >= 0) continue;
    return absl::InvalidArgumentError(
        absl::StrCat(field, " is ", value, "; it must be 0 or above"));
  }
  const UploadSource& source = spec.source;
  MAPSIEVE_RETURN_IF_ERROR(
      CheckLength("source.crs_wkt", source.crs_wkt, kMaxCrsWktBytes));
  MAPSIEVE_RETURN_IF_ERROR(
      CheckName("source.frame_id", source.frame_id, kMaxFrameIdBytes));
  MAPSIEVE_RETURN_IF_ERROR(
      CheckName("source.unit", source.unit, kMaxUnitBytes));
  if (!std::isfinite(source.coordinate_step) || source.coordinate_step < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("source.coordinate_step is ", source.coordinate_step,
                     "; it must be 0 or above, and finite"));
  }
  return absl::OkStatus();
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
