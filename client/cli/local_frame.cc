#include "client/cli/local_frame.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"

namespace mapsieve::client {

WriteOptions OptionsOfLocalFrame(const MapInfo& map,
                                 const core::Point3& origin) {
  WriteOptions options = {.float_positions = true};
  // Around another origin the points are in no frame that has a name.
  if (origin == core::Point3()) {
    options.crs_wkt = map.crs_wkt;
    options.frame_id = map.frame_id;
  }
  return options;
}

absl::Status MoveToLocalFrame(const core::Point3& origin,
                              core::PointCloud& points) {
  constexpr double kMaxRounding = 0.01;
  for (core::Point3& p : points.positions) {
    p = {p.x - origin.x, p.y - origin.y, p.z - origin.z};
    const double rounding =
        0x1p-24 * std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
    if (rounding > kMaxRounding) {
      return absl::InvalidArgumentError(
          absl::StrCat("the files hold float32, which would move points near (",
                       p.x, ", ", p.y, ", ", p.z, ") by up to ", rounding,
                       "; give an --origin near them"));
    }
  }
  return absl::OkStatus();
}

}  // namespace mapsieve::client
