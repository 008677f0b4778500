#include "server/engine/prism_solid.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "core/base/status.h"
#include "server/engine/field_error.h"

namespace mapsieve::engine {
namespace {

using core::Point3;

/// Above 0 where `c` lies to the left of the line from `a` to `b`.
double Side(const Point2& a, const Point2& b, const Point2& c) {
  return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

int SideSign(const Point2& a, const Point2& b, const Point2& c) {
  const double side = Side(a, b, c);
  return (side > 0 ? 1 : 0) - (side < 0 ? 1 : 0);
}

/// Whether `c`, on the line through `a` and `b`, lies between them.
bool IsBetween(const Point2& a, const Point2& b, const Point2& c) {
  return c.x >= std::min(a.x, b.x) && c.x <= std::max(a.x, b.x) &&
         c.y >= std::min(a.y, b.y) && c.y <= std::max(a.y, b.y);
}

/// Whether the closed segments a b and c d have a point in common.
bool Touch(const Point2& a, const Point2& b, const Point2& c, const Point2& d) {
  const int abc = SideSign(a, b, c);
  const int abd = SideSign(a, b, d);
  const int cda = SideSign(c, d, a);
  const int cdb = SideSign(c, d, b);
  if (abc * abd < 0 && cda * cdb < 0) return true;
  return (abc == 0 && IsBetween(a, b, c)) || (abd == 0 && IsBetween(a, b, d)) ||
         (cda == 0 && IsBetween(c, d, a)) || (cdb == 0 && IsBetween(c, d, b));
}

std::string VertexName(size_t i) {
  return absl::StrCat("polygon.vertices[", i, "]");
}

absl::Status CheckSimple(const std::vector<Point2>& v) {
  const size_t n = v.size();
  for (size_t i = 0; i < n; ++i) {
    if (v[i] == v[(i + 1) % n]) {
      return FieldError(VertexName((i + 1) % n),
                        absl::StrCat("equals vertices[", i,
                                     "]; give each vertex once, the first one "
                                     "not again at the end"));
    }
  }
  for (size_t i = 0; i < n; ++i) {
    const Point2& a = v[i];
    const Point2& b = v[(i + 1) % n];
    // The next edge may share its first point and no more.
    const Point2& c = v[(i + 2) % n];
    const double ahead = (b.x - a.x) * (c.x - b.x) + (b.y - a.y) * (c.y - b.y);
    if (SideSign(a, b, c) == 0 && ahead < 0) {
      return FieldError(VertexName((i + 1) % n),
                        "the edges at this vertex lie on each other; the "
                        "polygon must be simple");
    }
    for (size_t j = i + 2; j < n; ++j) {
      if (i == 0 && j + 1 == n) continue;
      if (!Touch(a, b, v[j], v[(j + 1) % n])) continue;
      return FieldError(
          VertexName(j),
          absl::StrCat("the edge from this vertex meets that from vertices[", i,
                       "]; the polygon must not cross or touch itself"));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::shared_ptr<const Solid>> PrismSolid::Make(
    const PolygonPrism& prism) {
  const size_t count = prism.vertices.size();
  if (count < 3 || count > kMaxVertices) {
    return FieldError("polygon.vertices",
                      absl::StrCat("there are ", count, "; 3 to ", kMaxVertices,
                                   " are possible"));
  }
  for (size_t i = 0; i < count; ++i) {
    MAPSIEVE_RETURN_IF_ERROR(
        CheckNumber(VertexName(i) + ".x", prism.vertices[i].x));
    MAPSIEVE_RETURN_IF_ERROR(
        CheckNumber(VertexName(i) + ".y", prism.vertices[i].y));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const HeightRange heights,
                            CheckHeights("polygon", prism.min_z, prism.max_z));
  MAPSIEVE_RETURN_IF_ERROR(CheckSimple(prism.vertices));
  return std::shared_ptr<const Solid>(new PrismSolid(prism.vertices, heights));
}

PrismSolid::PrismSolid(const std::vector<Point2>& vertices,
                       const HeightRange& heights) {
  bounds_ = {{vertices[0].x, vertices[0].y, heights.min},
             {vertices[0].x, vertices[0].y, heights.max}};
  for (size_t i = 0; i < vertices.size(); ++i) {
    const Point2& a = vertices[i];
    const Point2& b = vertices[(i + 1) % vertices.size()];
    bounds_.min = {std::min(bounds_.min.x, a.x), std::min(bounds_.min.y, a.y),
                   heights.min};
    bounds_.max = {std::max(bounds_.max.x, a.x), std::max(bounds_.max.y, a.y),
                   heights.max};
    edges_.push_back(a.y <= b.y ? Edge{a, b} : Edge{b, a});
  }
}

bool PrismSolid::IsInPolygon(double x, double y) const {
  bool inside = false;
  for (const auto& [a, b] : edges_) {
    if (y < a.y || y >= b.y) continue;
    if ((x - a.x) * (b.y - a.y) < (b.x - a.x) * (y - a.y)) inside = !inside;
  }
  return inside;
}

bool PrismSolid::EdgeMeets(const PositionBox& box) const {
  const PositionBox near = box.Grown(RoundingMargin(
      std::max(PositionBox{{bounds_.min.x, bounds_.min.y, 0},
                           {bounds_.max.x, bounds_.max.y, 0}}
                   .Magnitude(),
               PositionBox{{box.min.x, box.min.y, 0}, {box.max.x, box.max.y, 0}}
                   .Magnitude())));
  const Point3& low = near.min;
  const Point3& high = near.max;
  return std::any_of(edges_.begin(), edges_.end(), [&](const Edge& edge) {
    const auto& [a, b] = edge;
    if (std::max(a.x, b.x) < low.x || std::min(a.x, b.x) > high.x ||
        b.y < low.y || a.y > high.y) {
      return false;
    }
    const double sides[] = {
        Side(a, b, {low.x, low.y}), Side(a, b, {low.x, high.y}),
        Side(a, b, {high.x, low.y}), Side(a, b, {high.x, high.y})};
    return !(*std::min_element(sides, sides + 4) > 0 ||
             *std::max_element(sides, sides + 4) < 0);
  });
}

bool PrismSolid::Contains(const Point3& p) const {
  return p.z >= bounds_.min.z && p.z < bounds_.max.z && IsInPolygon(p.x, p.y);
}

bool PrismSolid::Meets(const PositionBox& box) const {
  return box.max.z >= bounds_.min.z && box.min.z < bounds_.max.z &&
         (EdgeMeets(box) || IsInPolygon(box.min.x, box.min.y));
}

bool PrismSolid::Encloses(const PositionBox& box) const {
  return box.min.z >= bounds_.min.z && box.max.z < bounds_.max.z &&
         !EdgeMeets(box) && IsInPolygon(box.min.x, box.min.y);
}

}  // namespace mapsieve::engine
