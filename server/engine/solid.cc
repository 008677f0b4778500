#include "server/engine/solid.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <variant>

#include "core/base/status.h"
#include "server/engine/convex_solid.h"
#include "server/engine/corridor_solid.h"
#include "server/engine/field_error.h"
#include "server/engine/prism_solid.h"
#include "server/engine/shape_checks.h"

namespace mapsieve::engine {
namespace {

using core::Point3;

using SolidOr = absl::StatusOr<std::shared_ptr<const Solid>>;

/// Of the coordinates from `low` to `high` the one nearest to `c`.
double Nearest(double c, double low, double high) {
  return std::clamp(c, low, high);
}

/// Of `low` and `high` the one farther from `c`.
double Farthest(double c, double low, double high) {
  return std::abs(low - c) > std::abs(high - c) ? low : high;
}

class BoxSolid final : public Solid {
 public:
  explicit BoxSolid(const Box& box) : box_(box) {}

  bool Contains(const Point3& p) const override {
    const auto& [min, max] = box_;
    return p.x >= min.x && p.x < max.x && p.y >= min.y && p.y < max.y &&
           p.z >= min.z && p.z < max.z;
  }
  bool Meets(const PositionBox& box) const override {
    return box.max.x >= box_.min.x && box.min.x < box_.max.x &&
           box.max.y >= box_.min.y && box.min.y < box_.max.y &&
           box.max.z >= box_.min.z && box.min.z < box_.max.z;
  }
  bool Encloses(const PositionBox& box) const override {
    return Contains(box.min) && Contains(box.max);
  }
  PositionBox Bounds() const override { return {box_.min, box_.max}; }

 private:
  const Box box_;
};

/// Every operation of a distance to a center is monotone, rounding included:
/// no position of a box comes out nearer than its nearest one, or farther away
/// than its farthest corner.
class SphereSolid final : public Solid {
 public:
  explicit SphereSolid(const Sphere& sphere) : sphere_(sphere) {}

  bool Contains(const Point3& p) const override {
    const auto& [c, radius] = sphere_;
    const double dx = p.x - c.x;
    const double dy = p.y - c.y;
    const double dz = p.z - c.z;
    return dx * dx + dy * dy + dz * dz <= radius * radius;
  }
  bool Meets(const PositionBox& box) const override {
    const Point3& c = sphere_.center;
    return Contains({Nearest(c.x, box.min.x, box.max.x),
                     Nearest(c.y, box.min.y, box.max.y),
                     Nearest(c.z, box.min.z, box.max.z)});
  }
  bool Encloses(const PositionBox& box) const override {
    const Point3& c = sphere_.center;
    return Contains({Farthest(c.x, box.min.x, box.max.x),
                     Farthest(c.y, box.min.y, box.max.y),
                     Farthest(c.z, box.min.z, box.max.z)});
  }
  PositionBox Bounds() const override {
    const PositionBox box =
        PositionBox{sphere_.center, sphere_.center}.Grown(sphere_.radius);
    return box.Grown(RoundingMargin(box.Magnitude()));
  }

 private:
  const Sphere sphere_;
};

class CylinderSolid final : public Solid {
 public:
  CylinderSolid(const VerticalCylinder& cylinder, const HeightRange& heights)
      : x_(cylinder.center_x),
        y_(cylinder.center_y),
        radius_(cylinder.radius),
        heights_(heights) {}

  bool Contains(const Point3& p) const override {
    const double dx = p.x - x_;
    const double dy = p.y - y_;
    return p.z >= heights_.min && p.z <= heights_.max &&
           dx * dx + dy * dy <= radius_ * radius_;
  }
  bool Meets(const PositionBox& box) const override {
    return box.min.z <= heights_.max &&
           Contains({Nearest(x_, box.min.x, box.max.x),
                     Nearest(y_, box.min.y, box.max.y),
                     Nearest(heights_.min, box.min.z, box.max.z)});
  }
  bool Encloses(const PositionBox& box) const override {
    const double x = Farthest(x_, box.min.x, box.max.x);
    const double y = Farthest(y_, box.min.y, box.max.y);
    return Contains({x, y, box.min.z}) && Contains({x, y, box.max.z});
  }
  PositionBox Bounds() const override {
    const double margin =
        RoundingMargin(std::max(std::abs(x_), std::abs(y_)) + radius_);
    const double reach = radius_ + margin;
    return {{x_ - reach, y_ - reach, heights_.min},
            {x_ + reach, y_ + reach, heights_.max}};
  }

 private:
  const double x_;
  const double y_;
  const double radius_;
  const HeightRange heights_;
};

SolidOr Make(const Box& box) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPoint("box.min", box.min));
  MAPSIEVE_RETURN_IF_ERROR(CheckPoint("box.max", box.max));
  for (const auto& [field, axis, min, max] :
       {std::tuple{"box.min.x", "x", box.min.x, box.max.x},
        {"box.min.y", "y", box.min.y, box.max.y},
        {"box.min.z", "z", box.min.z, box.max.z}}) {
    if (min < max) continue;
    return FieldError(
        field, absl::StrCat("it is ", min, " and box.max.", axis, " is ", max,
                            "; min must be below max"));
  }
  return std::make_shared<const BoxSolid>(box);
}

SolidOr Make(const Sphere& sphere) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPoint("sphere.center", sphere.center));
  MAPSIEVE_RETURN_IF_ERROR(CheckPositive("sphere.radius", sphere.radius));
  return std::make_shared<const SphereSolid>(sphere);
}

SolidOr Make(const VerticalCylinder& cylinder) {
  MAPSIEVE_RETURN_IF_ERROR(CheckNumber("cylinder.center_x", cylinder.center_x));
  MAPSIEVE_RETURN_IF_ERROR(CheckNumber("cylinder.center_y", cylinder.center_y));
  MAPSIEVE_RETURN_IF_ERROR(CheckPositive("cylinder.radius", cylinder.radius));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const HeightRange heights,
      CheckHeights("cylinder", cylinder.min_z, cylinder.max_z));
  return std::make_shared<const CylinderSolid>(cylinder, heights);
}

SolidOr Make(const OrientedBox& box) { return ConvexSolid::Make(box); }
SolidOr Make(const Frustum& frustum) { return ConvexSolid::Make(frustum); }
SolidOr Make(const PolygonPrism& prism) { return PrismSolid::Make(prism); }
SolidOr Make(const Corridor& corridor) { return CorridorSolid::Make(corridor); }

}  // namespace

double PositionBox::Magnitude() const {
  double largest = 0;
  for (const Point3& p : {min, max}) {
    largest = std::max({largest, std::abs(p.x), std::abs(p.y), std::abs(p.z)});
  }
  return largest;
}

SolidOr MakeSolid(const QueryShape& shape) {
  return std::visit([](const auto& s) { return Make(s); }, shape);
}

}  // namespace mapsieve::engine
