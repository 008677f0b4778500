#include "client/formats/header_comments.h"

#include "absl/strings/str_cat.h"
#include "client/formats/batch_columns.h"
#include "client/formats/coordinate_systems.h"
#include "core/base/status.h"
#include "core/geometry/crs.h"

namespace mapsieve::client {
namespace {

constexpr std::string_view kFrameId = "frame_id: ";
constexpr std::string_view kCrs = "crs: ";
/// Some readers give up at lines of 1024 bytes.
constexpr size_t kMaxTextBytes = 900;

}  // namespace

void TakeHeaderComment(std::string_view comment, PointFileInfo& info) {
  const std::string text = CleanText(comment, ' ');
  const std::string_view view = text;
  if (view.starts_with(kFrameId)) {
    info.frame_id = CleanText(view.substr(kFrameId.size()), ' ');
  } else if (view.starts_with(kCrs)) {
    std::string crs = CleanText(view.substr(kCrs.size()), ' ');
    std::string unit = UnitOfCodeOrWkt(crs);
    if (core::ParseEpsgName(crs) == 0 && unit.empty()) return;
    info.crs_wkt = std::move(crs);
    info.unit = std::move(unit);
  }
}

std::string MakeHeaderComments(std::string_view prefix,
                               const WriteOptions& options) {
  std::string lines;
  const auto add = [&](std::string_view key, const std::string& text) {
    const std::string clean = CleanText(text, ' ');
    if (clean.empty() || clean.size() > kMaxTextBytes) return;
    absl::StrAppend(&lines, ToAbsl(prefix), ToAbsl(key), clean, "\n");
  };
  add(kFrameId, options.frame_id);
  const int code = core::EpsgCodeOf(options.crs_wkt);
  const int heights = core::VerticalEpsgCodeOf(options.crs_wkt);
  if (options.crs_wkt.size() <= kMaxTextBytes || code == 0) {
    add(kCrs, options.crs_wkt);
  } else if (heights == 0) {
    add(kCrs, absl::StrCat("EPSG:", code));
  } else {
    add(kCrs, absl::StrCat("EPSG:", code, "+", heights));
  }
  return lines;
}

}  // namespace mapsieve::client
