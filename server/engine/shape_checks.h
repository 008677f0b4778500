#ifndef MAPSIEVE_SERVER_ENGINE_SHAPE_CHECKS_H_
#define MAPSIEVE_SERVER_ENGINE_SHAPE_CHECKS_H_

#include <array>
#include <optional>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/geometry/vector3.h"
#include "server/engine/shapes.h"

/// What the numbers of a shape must obey. kInvalidArgument names the field.
namespace mapsieve::engine {

/// Squares of coordinates up to it are finite, so comparisons mean something.
inline constexpr double kMaxCoordinate = 1e100;

/// A finite number of at most kMaxCoordinate.
absl::Status CheckNumber(std::string_view field, double value);

absl::Status CheckPoint(std::string_view field, const core::Point3& point);

/// CheckNumber, and above 0.
absl::Status CheckPositive(std::string_view field, double value);

/// Limits of z, either of which may be lacking.
struct HeightRange {
  double min = -kMaxCoordinate;
  double max = kMaxCoordinate;
};
/// The fields are `shape`.min_z and .max_z; min is below max.
absl::StatusOr<HeightRange> CheckHeights(std::string_view shape,
                                         std::optional<double> min_z,
                                         std::optional<double> max_z);

/// The axes of a frame in the map, by `orientation`, of which the length is 1
/// within a thousandth.
absl::StatusOr<std::array<core::Vector3, 3>> CheckAxes(
    std::string_view field, const Quaternion& orientation);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_SHAPE_CHECKS_H_
