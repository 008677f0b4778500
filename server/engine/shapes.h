#ifndef MAPSIEVE_SERVER_ENGINE_SHAPES_H_
#define MAPSIEVE_SERVER_ENGINE_SHAPES_H_

#include <cstddef>
#include <optional>
#include <variant>
#include <vector>

#include "core/geometry/lattice.h"

/// Shapes of regions, in map units. "Inside" is evaluated in double on the
/// position of a lattice point.
namespace mapsieve::engine {

/// An axis-aligned box: a position p is inside if min <= p < max on every axis.
struct Box {
  core::Point3 min;
  core::Point3 max;

  friend bool operator==(const Box&, const Box&) = default;
};

/// A ball: a position is inside if its distance to `center` is at most
/// `radius`.
struct Sphere {
  core::Point3 center;
  double radius = 0;

  friend bool operator==(const Sphere&, const Sphere&) = default;
};

/// A rotation as a unit quaternion w + xi + yj + zk: it takes the coordinates
/// of a vector in a shape's own frame to those in the map.
struct Quaternion {
  double x = 0;
  double y = 0;
  double z = 0;
  double w = 1;

  friend bool operator==(const Quaternion&, const Quaternion&) = default;
};

/// A rotated box: a position is inside if its offset to `center`, in the box's
/// own frame, is at most `half_size` on every axis, both sides included.
struct OrientedBox {
  core::Point3 center;
  Quaternion orientation;
  core::Point3 half_size;

  friend bool operator==(const OrientedBox&, const OrientedBox&) = default;
};

/// A cylinder with an upright axis: a position is inside if its horizontal
/// distance to (center_x, center_y) is at most `radius` and min_z <= z <=
/// max_z.
struct VerticalCylinder {
  double center_x = 0;
  double center_y = 0;
  double radius = 0;
  /// Nothing: no limit.
  std::optional<double> min_z;
  std::optional<double> max_z;

  friend bool operator==(const VerticalCylinder&,
                         const VerticalCylinder&) = default;
};

struct Point2 {
  double x = 0;
  double y = 0;

  friend bool operator==(const Point2&, const Point2&) = default;
};

/// Of PolygonPrism::vertices and Corridor::path.
inline constexpr size_t kMaxVertices = 1000;

/// An upright prism over a simple polygon of 3 to kMaxVertices vertices in
/// either sense, without a closing one. A position is inside if (x, y) is
/// inside the polygon and min_z <= z < max_z. Of the polygon's edge, what
/// bounds it towards smaller x, and along x towards smaller y, is inside and
/// the rest is not: an upright rectangle holds what the Box holds.
struct PolygonPrism {
  std::vector<Point2> vertices;
  /// Nothing: no limit.
  std::optional<double> min_z;
  std::optional<double> max_z;

  friend bool operator==(const PolygonPrism&, const PolygonPrism&) = default;
};

/// Of Frustum: about 179.9 degrees between opposite sides.
inline constexpr double kMaxHalfView = 1000;

/// What a camera at `position` sees between two distances. In its own frame x
/// points to the right, y down and z forward, and a position (x, y, z) is
/// inside if near <= z <= far, |x| <= half_width z and |y| <= half_height z.
struct Frustum {
  core::Point3 position;
  Quaternion orientation;
  /// Half the size of the view at distance 1: the tangents of half the angles
  /// of view. Above 0, at most kMaxHalfView.
  double half_width = 0;
  double half_height = 0;
  /// 0 <= near < far.
  double near = 0;
  double far = 0;

  friend bool operator==(const Frustum&, const Frustum&) = default;
};

/// Everything near a path of 2 to kMaxVertices points: a position is inside if
/// its distance to one of the path's straight pieces is at most `radius`.
struct Corridor {
  std::vector<core::Point3> path;
  double radius = 0;

  friend bool operator==(const Corridor&, const Corridor&) = default;
};

/// The shapes of edits, which are stored with what they made.
using RegionShape = std::variant<Box, Sphere>;

/// The shapes of queries.
using QueryShape = std::variant<Box, Sphere, OrientedBox, VerticalCylinder,
                                PolygonPrism, Frustum, Corridor>;

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_SHAPES_H_
