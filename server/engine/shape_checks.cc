#include "server/engine/shape_checks.h"

#include <cmath>
#include <string>
#include <utility>

#include "core/base/status.h"
#include "server/engine/field_error.h"

namespace mapsieve::engine {
namespace {

std::string Member(std::string_view field, const char* name) {
  return std::string(field).append(name);
}

}  // namespace

absl::Status CheckNumber(std::string_view field, double value) {
  // False for NaN and the infinities too.
  if (std::abs(value) <= kMaxCoordinate) return absl::OkStatus();
  return FieldError(
      field, absl::StrCat("it is ", value,
                          "; it must be a finite number of at most 1e100"));
}

absl::Status CheckPoint(std::string_view field, const core::Point3& point) {
  for (const auto& [axis, value] :
       {std::pair{".x", point.x}, {".y", point.y}, {".z", point.z}}) {
    MAPSIEVE_RETURN_IF_ERROR(CheckNumber(Member(field, axis), value));
  }
  return absl::OkStatus();
}

absl::Status CheckPositive(std::string_view field, double value) {
  MAPSIEVE_RETURN_IF_ERROR(CheckNumber(field, value));
  if (value > 0) return absl::OkStatus();
  return FieldError(field,
                    absl::StrCat("it is ", value, "; it must be above 0"));
}

absl::StatusOr<HeightRange> CheckHeights(std::string_view shape,
                                         std::optional<double> min_z,
                                         std::optional<double> max_z) {
  HeightRange range;
  if (min_z.has_value()) range.min = *min_z;
  if (max_z.has_value()) range.max = *max_z;
  MAPSIEVE_RETURN_IF_ERROR(CheckNumber(Member(shape, ".min_z"), range.min));
  MAPSIEVE_RETURN_IF_ERROR(CheckNumber(Member(shape, ".max_z"), range.max));
  if (range.min < range.max) return range;
  return FieldError(Member(shape, ".min_z"),
                    absl::StrCat("it is ", range.min, " and max_z is ",
                                 range.max, "; min_z must be below max_z"));
}

absl::StatusOr<std::array<core::Vector3, 3>> CheckAxes(
    std::string_view field, const Quaternion& orientation) {
  for (const auto& [name, value] : {std::pair{".x", orientation.x},
                                    {".y", orientation.y},
                                    {".z", orientation.z},
                                    {".w", orientation.w}}) {
    MAPSIEVE_RETURN_IF_ERROR(CheckNumber(Member(field, name), value));
  }
  const auto& [x, y, z, w] = orientation;
  const double square = x * x + y * y + z * z + w * w;
  if (!(std::abs(square - 1) <= 2e-3)) {
    return FieldError(field, absl::StrCat("its length is ", std::sqrt(square),
                                          "; it must be a unit quaternion: no "
                                          "rotation is x = y = z = 0, w = 1"));
  }
  const double s = 2 / square;
  return std::array<core::Vector3, 3>{
      core::Vector3{1 - s * (y * y + z * z), s * (x * y + w * z),
                    s * (x * z - w * y)},
      core::Vector3{s * (x * y - w * z), 1 - s * (x * x + z * z),
                    s * (y * z + w * x)},
      core::Vector3{s * (x * z + w * y), s * (y * z - w * x),
                    1 - s * (x * x + y * y)}};
}

}  // namespace mapsieve::engine
