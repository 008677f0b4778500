#include "server/engine/upload_warnings.h"

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "core/geometry/crs.h"
#include "core/geometry/lattice.h"
#include "storage/names.h"

namespace mapsieve::engine {
namespace {

/// The name of a CRS in quotes, with its code where it has one.
std::string Told(const std::string& crs) {
  const std::string name = storage::Quoted(core::NameOfCrs(crs));
  const int code = core::EpsgCodeOf(crs);
  if (code == 0 || core::ParseEpsgName(crs) != 0) return name;
  return absl::StrCat(name, " (EPSG:", code, ")");
}

}  // namespace

std::vector<UploadWarning> WarningsOf(const UploadSource& source,
                                      const storage::MapSpec& map,
                                      bool has_points) {
  std::vector<UploadWarning> warnings;
  const auto warn = [&warnings](const char* code, std::string message) {
    warnings.push_back({code, std::move(message)});
  };
  if (source.crs_wkt.empty()) {
    // Nothing to compare.
  } else if (!map.crs_wkt.empty()) {
    if (!core::IsSameCrs(source.crs_wkt, map.crs_wkt)) {
      warn("crs_differs",
           absl::StrCat("the points have the CRS ", Told(source.crs_wkt),
                        ", the map has ", Told(map.crs_wkt),
                        "; coordinates are never converted"));
    }
  } else if (has_points) {
    warn("crs_not_taken",
         absl::StrCat("the points have the CRS ", Told(source.crs_wkt),
                      ", the map has points and no CRS; it stays without one"));
  }
  if (!source.unit.empty() && source.unit != core::kMetre) {
    warn("unit_not_metre",
         absl::StrCat("the unit of the coordinates is ",
                      storage::Quoted(source.unit),
                      "; they are not converted, and all lengths of this map "
                      "are in that unit"));
  }
  // A file's step may be a rounded number, of single precision too.
  const double step = core::Lattice(map.step_nm).step();
  constexpr double kRounding = 1e-6;
  if (source.coordinate_step > 0 &&
      step > source.coordinate_step * (1 + kRounding)) {
    warn(
        "step_too_coarse",
        absl::StrCat("the map's step of ", step,
                     " is coarser than that of the points, ",
                     source.coordinate_step, ": positions were rounded to it"));
  }
  if (source.frame_id.empty()) {
    // Nothing to compare.
  } else if (!map.frame_id.empty()) {
    if (source.frame_id != map.frame_id) {
      warn("frame_id_differs",
           absl::StrCat("the points have the frame ",
                        storage::Quoted(source.frame_id), ", the map has ",
                        storage::Quoted(map.frame_id),
                        "; coordinates are never converted"));
    }
  } else if (has_points) {
    warn("frame_id_not_taken",
         absl::StrCat("the points have the frame ",
                      storage::Quoted(source.frame_id),
                      ", the map has points and no frame; it stays without "
                      "one"));
  }
  return warnings;
}

}  // namespace mapsieve::engine
