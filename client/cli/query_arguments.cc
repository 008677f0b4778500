#include "client/cli/query_arguments.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <utility>

#include "core/base/status.h"

namespace mapsieve::client {
namespace {

using core::Point3;

double Radians(double degrees) { return degrees * std::numbers::pi / 180; }

/// The frame of a camera that looks along `forward`, its image upright.
absl::StatusOr<Quaternion> LookAlong(const Point3& forward) {
  const double horizontal = std::hypot(forward.x, forward.y);
  if (!(horizontal > 0)) {
    return absl::InvalidArgumentError(
        "--frustum: the target is the eye, or straight above or below it; "
        "move it a little to the side");
  }
  // Half the turn about z from looking north, then half the tilt about x. With
  // neither, the camera's z is north and its y is down.
  const double turn = std::atan2(-forward.x, forward.y) / 2;
  const double tilt =
      (std::atan2(forward.z, horizontal) - std::numbers::pi / 2) / 2;
  return Quaternion{.x = std::cos(turn) * std::sin(tilt),
                    .y = std::sin(turn) * std::sin(tilt),
                    .z = std::sin(turn) * std::cos(tilt),
                    .w = std::cos(turn) * std::cos(tilt)};
}

absl::StatusOr<QueryRegion> MakeFrustum(const std::vector<double>& f) {
  const Point3 eye = {f[0], f[1], f[2]};
  MAPSIEVE_ASSIGN_OR_RETURN(
      const Quaternion orientation,
      LookAlong({f[3] - eye.x, f[4] - eye.y, f[5] - eye.z}));
  const double angle = f[6];
  const double aspect = f[7];
  if (!(angle > 0 && angle < 180 && aspect > 0)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--frustum: the angle of view is ", angle, " and the aspect ", aspect,
        "; above 0 and below 180 degrees, and above 0, are possible"));
  }
  const double half_height = std::tan(Radians(angle) / 2);
  return FrustumRegion{.position = eye,
                       .orientation = orientation,
                       .half_width = half_height * aspect,
                       .half_height = half_height,
                       .near = f[8],
                       .far = f[9]};
}

}  // namespace

absl::StatusOr<QueryRegion> MakeQueryRegion(const RegionArguments& arguments) {
  std::optional<double> min_z;
  std::optional<double> max_z;
  if (!arguments.z_range.empty()) {
    min_z = arguments.z_range[0];
    max_z = arguments.z_range[1];
  }
  if (const auto& b = arguments.box; !b.empty()) {
    return BoxRegion{{b[0], b[1], b[2]}, {b[3], b[4], b[5]}};
  }
  if (const auto& s = arguments.sphere; !s.empty()) {
    return SphereRegion{{s[0], s[1], s[2]}, s[3]};
  }
  if (const auto& b = arguments.oriented_box; !b.empty()) {
    const double half_turn = Radians(b[6]) / 2;
    return OrientedBoxRegion{
        .center = {b[0], b[1], b[2]},
        .orientation = {.z = std::sin(half_turn), .w = std::cos(half_turn)},
        .half_size = {b[3] / 2, b[4] / 2, b[5] / 2}};
  }
  if (const auto& c = arguments.cylinder; !c.empty()) {
    return CylinderRegion{c[0], c[1], c[2], min_z, max_z};
  }
  if (const auto& p = arguments.polygon; !p.empty()) {
    if (p.size() % 2 != 0) {
      return absl::InvalidArgumentError(absl::StrCat(
          "--polygon: ", p.size(), " numbers; give x y for each vertex"));
    }
    PolygonRegion region{.min_z = min_z, .max_z = max_z};
    for (size_t i = 0; i < p.size(); i += 2) {
      region.vertices.push_back({p[i], p[i + 1]});
    }
    return region;
  }
  if (!arguments.frustum.empty()) return MakeFrustum(arguments.frustum);
  if (const auto& c = arguments.corridor; !c.empty()) {
    if (c.size() % 3 != 1) {
      return absl::InvalidArgumentError(
          absl::StrCat("--corridor: ", c.size(),
                       " numbers; give the radius, then x y z of each point"));
    }
    CorridorRegion region{.radius = c[0]};
    for (size_t i = 1; i < c.size(); i += 3) {
      region.path.push_back({c[i], c[i + 1], c[i + 2]});
    }
    return region;
  }
  return QueryRegion();
}

std::optional<ColumnSelection> MakeColumnSelection(
    const std::vector<std::string>& names) {
  static const std::pair<const char*, FilterColumn> kFilterColumns[] = {
      {"label", FilterColumn::kLabel},
      {"confidence", FilterColumn::kConfidence},
      {"normal", FilterColumn::kNormal},
      {"tangent", FilterColumn::kTangent},
      {"eigenvalues", FilterColumn::kEigenvalues},
      {"saliencies", FilterColumn::kSaliencies},
      {"covariance", FilterColumn::kCovariance}};
  if (names.empty()) return std::nullopt;
  ColumnSelection selection;
  for (const std::string& name : names) {
    const auto* const column =
        std::find_if(std::begin(kFilterColumns), std::end(kFilterColumns),
                     [&](const auto& c) { return name == c.first; });
    if (column != std::end(kFilterColumns)) {
      selection.filter_columns.push_back(column->second);
    } else if (name == "attributes") {
      selection.all_attributes = true;
    } else {
      selection.attributes.push_back(name);
    }
  }
  return selection;
}

absl::StatusOr<std::vector<AttributeRange>> MakeAttributeRanges(
    const std::vector<std::string>& words) {
  std::vector<AttributeRange> ranges;
  for (size_t i = 0; i + 2 < words.size(); i += 3) {
    double ends[2];
    for (size_t end = 0; end < 2; ++end) {
      const std::string& word = words[i + 1 + end];
      char* rest = nullptr;
      ends[end] = std::strtod(word.c_str(), &rest);
      if (word.empty() || *rest != '\0') {
        return absl::InvalidArgumentError(absl::StrCat(
            "--range ", words[i], ": \"", word,
            "\" is no number; give NAME MIN MAX, for instance intensity 0 "
            "inf"));
      }
    }
    ranges.push_back({words[i], {ends[0], ends[1]}});
  }
  return ranges;
}

}  // namespace mapsieve::client
