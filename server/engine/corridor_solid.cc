#include "server/engine/corridor_solid.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <tuple>

#include "core/base/status.h"
#include "server/engine/field_error.h"
#include "server/engine/shape_checks.h"

namespace mapsieve::engine {
namespace {

using core::Point3;

bool Overlap(const PositionBox& a, const PositionBox& b) {
  return a.min.x <= b.max.x && b.min.x <= a.max.x && a.min.y <= b.max.y &&
         b.min.y <= a.max.y && a.min.z <= b.max.z && b.min.z <= a.max.z;
}

/// Whether a + t d is in `box` for a t from 0 to 1.
bool LineMeets(const Point3& a, const Point3& d, const PositionBox& box) {
  double from = 0;
  double to = 1;
  for (const auto& [start, step, low, high] :
       {std::tuple{a.x, d.x, box.min.x, box.max.x},
        {a.y, d.y, box.min.y, box.max.y},
        {a.z, d.z, box.min.z, box.max.z}}) {
    if (step == 0) {
      if (start < low || start > high) return false;
      continue;
    }
    const double t0 = (low - start) / step;
    const double t1 = (high - start) / step;
    from = std::max(from, std::min(t0, t1));
    to = std::min(to, std::max(t0, t1));
  }
  return from <= to;
}

}  // namespace

absl::StatusOr<std::shared_ptr<const Solid>> CorridorSolid::Make(
    const Corridor& corridor) {
  const size_t count = corridor.path.size();
  if (count < 2 || count > kMaxVertices) {
    return FieldError("corridor.path",
                      absl::StrCat("it has ", count, " points; 2 to ",
                                   kMaxVertices, " are possible"));
  }
  for (size_t i = 0; i < count; ++i) {
    MAPSIEVE_RETURN_IF_ERROR(
        CheckPoint(absl::StrCat("corridor.path[", i, "]"), corridor.path[i]));
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckPositive("corridor.radius", corridor.radius));
  return std::shared_ptr<const Solid>(new CorridorSolid(corridor));
}

CorridorSolid::CorridorSolid(const Corridor& corridor)
    : radius_(corridor.radius) {
  for (size_t i = 0; i + 1 < corridor.path.size(); ++i) {
    const Point3& a = corridor.path[i];
    const Point3& b = corridor.path[i + 1];
    Piece piece{.a = a, .d = {b.x - a.x, b.y - a.y, b.z - a.z}};
    const auto& [x, y, z] = piece.d;
    piece.square = x * x + y * y + z * z;
    const PositionBox line = {
        {std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)},
        {std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)}};
    piece.bounds = line.Grown(radius_);
    piece.bounds = piece.bounds.Grown(RoundingMargin(piece.bounds.Magnitude()));
    if (i == 0) bounds_ = piece.bounds;
    const auto& [min, max] = piece.bounds;
    bounds_ = {{std::min(bounds_.min.x, min.x), std::min(bounds_.min.y, min.y),
                std::min(bounds_.min.z, min.z)},
               {std::max(bounds_.max.x, max.x), std::max(bounds_.max.y, max.y),
                std::max(bounds_.max.z, max.z)}};
    pieces_.push_back(piece);
  }
}

double CorridorSolid::SquaredDistance(const Piece& piece, const Point3& p) {
  const auto& [a, d, square, bounds] = piece;
  const Point3 v = {p.x - a.x, p.y - a.y, p.z - a.z};
  double t = 0;
  if (square > 0) {
    t = std::clamp((v.x * d.x + v.y * d.y + v.z * d.z) / square, 0.0, 1.0);
  }
  const double x = v.x - t * d.x;
  const double y = v.y - t * d.y;
  const double z = v.z - t * d.z;
  return x * x + y * y + z * z;
}

bool CorridorSolid::Contains(const Point3& p) const {
  return std::any_of(pieces_.begin(), pieces_.end(), [&](const Piece& piece) {
    return Overlap(piece.bounds, {p, p}) &&
           SquaredDistance(piece, p) <= radius_ * radius_;
  });
}

bool CorridorSolid::Meets(const PositionBox& box) const {
  return std::any_of(pieces_.begin(), pieces_.end(), [&](const Piece& piece) {
    if (!Overlap(piece.bounds, box)) return false;
    const PositionBox near = box.Grown(radius_);
    return LineMeets(piece.a, piece.d,
                     near.Grown(RoundingMargin(std::max(
                         near.Magnitude(), piece.bounds.Magnitude()))));
  });
}

bool CorridorSolid::Encloses(const PositionBox& box) const {
  return std::any_of(pieces_.begin(), pieces_.end(), [&](const Piece& piece) {
    const double margin =
        RoundingMargin(std::max(box.Magnitude(), piece.bounds.Magnitude()));
    const double radius = radius_ - margin;
    if (!(radius > 0)) return false;
    // What lies near a straight line is convex, so the corners tell.
    for (int corner = 0; corner < 8; ++corner) {
      const Point3 p = {(corner & 1) != 0 ? box.max.x : box.min.x,
                        (corner & 2) != 0 ? box.max.y : box.min.y,
                        (corner & 4) != 0 ? box.max.z : box.min.z};
      if (!(SquaredDistance(piece, p) <= radius * radius)) return false;
    }
    return true;
  });
}

}  // namespace mapsieve::engine
