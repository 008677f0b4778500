#include "server/engine/convex_solid.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/base/status.h"
#include "server/engine/field_error.h"
#include "server/engine/shape_checks.h"

namespace mapsieve::engine {
namespace {

using core::Point3;
using core::Vector3;

Vector3 Scaled(const Vector3& v, double s) {
  return {s * v[0], s * v[1], s * v[2]};
}

Vector3 Sum(const Vector3& a, const Vector3& b) {
  return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}

/// The corner of `box` farthest along `v`.
Point3 Farthest(const PositionBox& box, const Vector3& v) {
  return {v[0] > 0 ? box.max.x : box.min.x, v[1] > 0 ? box.max.y : box.min.y,
          v[2] > 0 ? box.max.z : box.min.z};
}

absl::Status CheckHalfView(std::string_view field, double value) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPositive(field, value));
  if (value <= kMaxHalfView) return absl::OkStatus();
  return FieldError(field, absl::StrCat("it is ", value, "; at most ",
                                        kMaxHalfView, " is possible"));
}

}  // namespace

ConvexSolid::ConvexSolid(const Point3& origin,
                         std::vector<HalfSpace> half_spaces,
                         const std::array<Vector3, 8>& corners)
    : origin_(origin), half_spaces_(std::move(half_spaces)) {
  Vector3 low = corners[0];
  Vector3 high = corners[0];
  for (const Vector3& corner : corners) {
    for (size_t axis = 0; axis < corner.size(); ++axis) {
      low[axis] = std::min(low[axis], corner[axis]);
      high[axis] = std::max(high[axis], corner[axis]);
    }
  }
  bounds_ = {{origin.x + low[0], origin.y + low[1], origin.z + low[2]},
             {origin.x + high[0], origin.y + high[1], origin.z + high[2]}};
  bounds_ = bounds_.Grown(RoundingMargin(bounds_.Magnitude()));
}

absl::StatusOr<std::shared_ptr<const Solid>> ConvexSolid::Make(
    const OrientedBox& box) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPoint("oriented_box.center", box.center));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const auto axes, CheckAxes("oriented_box.orientation", box.orientation));
  const auto& [hx, hy, hz] = box.half_size;
  MAPSIEVE_RETURN_IF_ERROR(CheckPositive("oriented_box.half_size.x", hx));
  MAPSIEVE_RETURN_IF_ERROR(CheckPositive("oriented_box.half_size.y", hy));
  MAPSIEVE_RETURN_IF_ERROR(CheckPositive("oriented_box.half_size.z", hz));
  const Vector3 half = {hx, hy, hz};
  std::vector<HalfSpace> half_spaces;
  for (size_t i = 0; i < axes.size(); ++i) {
    half_spaces.push_back({axes[i], half[i]});
    half_spaces.push_back({Scaled(axes[i], -1), half[i]});
  }
  std::array<Vector3, 8> corners{};
  for (size_t c = 0; c < corners.size(); ++c) {
    for (size_t i = 0; i < axes.size(); ++i) {
      const double h = (c >> i & 1) != 0 ? half[i] : -half[i];
      corners[c] = Sum(corners[c], Scaled(axes[i], h));
    }
  }
  return std::shared_ptr<const Solid>(
      new ConvexSolid(box.center, std::move(half_spaces), corners));
}

absl::StatusOr<std::shared_ptr<const Solid>> ConvexSolid::Make(
    const Frustum& frustum) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPoint("frustum.position", frustum.position));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const auto axes, CheckAxes("frustum.orientation", frustum.orientation));
  const auto& [right, down, forward] = axes;
  const double width = frustum.half_width;
  const double height = frustum.half_height;
  MAPSIEVE_RETURN_IF_ERROR(CheckHalfView("frustum.half_width", width));
  MAPSIEVE_RETURN_IF_ERROR(CheckHalfView("frustum.half_height", height));
  MAPSIEVE_RETURN_IF_ERROR(CheckNumber("frustum.near", frustum.near));
  MAPSIEVE_RETURN_IF_ERROR(CheckNumber("frustum.far", frustum.far));
  if (!(frustum.near >= 0 && frustum.near < frustum.far)) {
    return FieldError("frustum.near",
                      absl::StrCat("it is ", frustum.near, " and far is ",
                                   frustum.far, "; 0 <= near < far must hold"));
  }
  // |x| <= w z is the half space +-x - w z <= 0.
  std::vector<HalfSpace> half_spaces = {
      {Sum(right, Scaled(forward, -width)), 0},
      {Sum(Scaled(right, -1), Scaled(forward, -width)), 0},
      {Sum(down, Scaled(forward, -height)), 0},
      {Sum(Scaled(down, -1), Scaled(forward, -height)), 0},
      {Scaled(forward, -1), -frustum.near},
      {forward, frustum.far}};
  std::array<Vector3, 8> corners{};
  for (size_t c = 0; c < corners.size(); ++c) {
    const double z = (c & 1) != 0 ? frustum.far : frustum.near;
    corners[c] =
        Scaled(Sum(forward, Sum(Scaled(right, (c & 2) != 0 ? width : -width),
                                Scaled(down, (c & 4) != 0 ? height : -height))),
               z);
  }
  return std::shared_ptr<const Solid>(
      new ConvexSolid(frustum.position, std::move(half_spaces), corners));
}

double ConvexSolid::Along(const Vector3& normal, const Point3& p) const {
  return normal[0] * (p.x - origin_.x) + normal[1] * (p.y - origin_.y) +
         normal[2] * (p.z - origin_.z);
}

bool ConvexSolid::Contains(const Point3& p) const {
  return std::all_of(
      half_spaces_.begin(), half_spaces_.end(),
      [&](const HalfSpace& h) { return Along(h.normal, p) <= h.limit; });
}

bool ConvexSolid::Meets(const PositionBox& box) const {
  return std::all_of(
      half_spaces_.begin(), half_spaces_.end(), [&](const HalfSpace& h) {
        const Point3 nearest = Farthest(box, Scaled(h.normal, -1));
        return Along(h.normal, nearest) <= h.limit;
      });
}

bool ConvexSolid::Encloses(const PositionBox& box) const {
  return std::all_of(
      half_spaces_.begin(), half_spaces_.end(), [&](const HalfSpace& h) {
        return Along(h.normal, Farthest(box, h.normal)) <= h.limit;
      });
}

}  // namespace mapsieve::engine
