#include "server/engine/region.h"

#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <tuple>
#include <utility>

#include "core/base/status.h"

namespace mapsieve::engine {
namespace {

using core::kLatticeLimit;
using core::Lattice;
using core::LatticeBox;
using core::LatticePoint;
using core::Point3;

/// Squares of coordinates up to it are finite, so comparisons mean something.
constexpr double kMaxCoordinate = 1e100;

absl::Status CheckNumber(std::string_view field, double value) {
  // False for NaN and the infinities too.
  if (std::abs(value) <= kMaxCoordinate) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(ToAbsl(field), " is ", value,
                   "; it must be a finite number of at most 1e100"));
}

absl::Status CheckPoint(std::string_view field, const Point3& point) {
  for (const auto& [axis, value] :
       {std::pair{".x", point.x}, {".y", point.y}, {".z", point.z}}) {
    MAPSIEVE_RETURN_IF_ERROR(
        CheckNumber(std::string(field).append(axis), value));
  }
  return absl::OkStatus();
}

/// The smallest lattice coordinate at or above `x`, within the limits.
int64_t FirstAtOrAbove(double x, const Lattice& lattice) {
  constexpr auto kLimit = static_cast<double>(kLatticeLimit);
  const double guess = std::ceil(x / lattice.step());
  if (guess <= -kLimit) return -kLatticeLimit;
  if (guess >= kLimit) return kLatticeLimit;
  auto q = static_cast<int64_t>(guess);
  // The division was rounded, so the guess may be a cell off.
  while (q > -kLatticeLimit && lattice.Coordinate(q - 1) >= x) --q;
  while (q < kLatticeLimit && lattice.Coordinate(q) < x) ++q;
  return q;
}

LatticePoint FirstAtOrAbove(const Point3& p, const Lattice& lattice) {
  return {FirstAtOrAbove(p.x, lattice), FirstAtOrAbove(p.y, lattice),
          FirstAtOrAbove(p.z, lattice)};
}

double SquaredDistance(const Point3& p, const Point3& c) {
  const double dx = p.x - c.x;
  const double dy = p.y - c.y;
  const double dz = p.z - c.z;
  return dx * dx + dy * dy + dz * dz;
}

/// The coordinate nearest to `c` among those of the lattice in [min, max).
double Nearest(double c, int64_t min, int64_t max, const Lattice& lattice) {
  const double low = lattice.Coordinate(min);
  const double high = lattice.Coordinate(max - 1);
  return c < low ? low : c > high ? high : c;
}

absl::StatusOr<LatticeBox> BoundsOf(const Box& box, const Lattice& lattice) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPoint("box.min", box.min));
  MAPSIEVE_RETURN_IF_ERROR(CheckPoint("box.max", box.max));
  for (const auto& [axis, min, max] : {std::tuple{"x", box.min.x, box.max.x},
                                       {"y", box.min.y, box.max.y},
                                       {"z", box.min.z, box.max.z}}) {
    if (min < max) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("box.min.", axis, " is ", min, " and box.max.", axis,
                     " is ", max, "; min must be below max"));
  }
  return LatticeBox{FirstAtOrAbove(box.min, lattice),
                    FirstAtOrAbove(box.max, lattice)};
}

absl::StatusOr<LatticeBox> BoundsOf(const Sphere& sphere,
                                    const Lattice& lattice) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPoint("sphere.center", sphere.center));
  MAPSIEVE_RETURN_IF_ERROR(CheckNumber("sphere.radius", sphere.radius));
  if (!(sphere.radius > 0)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "sphere.radius is ", sphere.radius, "; it must be above 0"));
  }
  const auto& [c, r] = sphere;
  const LatticeBox box = {FirstAtOrAbove({c.x - r, c.y - r, c.z - r}, lattice),
                          FirstAtOrAbove({c.x + r, c.y + r, c.z + r}, lattice)};
  // The sums were rounded, and max is exclusive.
  return box.Grown(2);
}

}  // namespace

absl::StatusOr<Region> Region::Make(const RegionShape& shape,
                                    const Lattice& lattice) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const LatticeBox bounds,
      std::visit([&](const auto& s) { return BoundsOf(s, lattice); }, shape));
  return Region(shape, lattice, bounds);
}

bool Region::Contains(const LatticePoint& q) const {
  if (!bounds_.Contains(q)) return false;
  const Sphere* sphere = std::get_if<Sphere>(&shape_);
  return sphere == nullptr ||
         SquaredDistance(lattice_.Position(q), sphere->center) <=
             sphere->radius * sphere->radius;
}

bool Region::Encloses(const LatticeBox& box) const {
  const LatticePoint last = {box.max.x - 1, box.max.y - 1, box.max.z - 1};
  const Sphere* sphere = std::get_if<Sphere>(&shape_);
  if (sphere == nullptr) {
    return bounds_.Contains(box.min) && bounds_.Contains(last);
  }
  // As below: no point of the box comes out farther away than this corner.
  const Point3 low = lattice_.Position(box.min);
  const Point3 high = lattice_.Position(last);
  const auto farthest = [](double c, double a, double b) {
    return std::abs(a - c) > std::abs(b - c) ? a : b;
  };
  const Point3& c = sphere->center;
  const Point3 corner = {farthest(c.x, low.x, high.x),
                         farthest(c.y, low.y, high.y),
                         farthest(c.z, low.z, high.z)};
  return bounds_.Contains(box.min) && bounds_.Contains(last) &&
         SquaredDistance(corner, c) <= sphere->radius * sphere->radius;
}

bool Region::Intersects(const LatticeBox& box) const {
  if (!bounds_.Intersects(box)) return false;
  const Sphere* sphere = std::get_if<Sphere>(&shape_);
  if (sphere == nullptr) return true;
  // Every operation of the distance is monotone, rounding included: no point
  // of the box comes out nearer than this one.
  const Point3 nearest = {
      Nearest(sphere->center.x, box.min.x, box.max.x, lattice_),
      Nearest(sphere->center.y, box.min.y, box.max.y, lattice_),
      Nearest(sphere->center.z, box.min.z, box.max.z, lattice_)};
  return SquaredDistance(nearest, sphere->center) <=
         sphere->radius * sphere->radius;
}

}  // namespace mapsieve::engine
