#include "client/lab/scene.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/base/hash.h"

namespace mapsieve::client {
namespace {

using core::Dot;
using core::Label;
using core::Point3;
using core::Vector3;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kCell = Ground::kCellSize;
/// Ground this much lower at a border than the ray is rounding, not a kerb.
constexpr double kKerbTolerance = 1e-6;

double Height(const HalfSpace& face, const Point3& p) {
  return face.normal[0] * p.x + face.normal[1] * p.y + face.normal[2] * p.z -
         face.offset;
}

/// A place relative to the lower left corner of the nearest opening of a face.
struct OpeningPlace {
  Vector3 tangent;
  double u = 0;
  double v = 0;
};

std::optional<OpeningPlace> NearestOpening(const Openings& openings,
                                           const HalfSpace& face, int index,
                                           const Point3& p) {
  if (index >= 4 || openings.row_count == 0) return std::nullopt;
  const int count = openings.column_counts[static_cast<size_t>(index % 2)];
  if (count == 0) return std::nullopt;
  OpeningPlace place;
  place.tangent = {-face.normal[1], face.normal[0], 0};
  const double u = place.tangent[0] * (p.x - openings.center.x) +
                   place.tangent[1] * (p.y - openings.center.y);
  const double v = p.z - openings.center.z;
  const double first = -0.5 * (count - 1);
  const double column = std::clamp(
      std::nearbyint(u / openings.column_spacing - first), 0.0, count - 1.0);
  const double row = std::clamp(
      std::nearbyint((v - 0.5 * openings.height) / openings.row_spacing), 0.0,
      openings.row_count - 1.0);
  place.u =
      u - (first + column) * openings.column_spacing + 0.5 * openings.width;
  place.v = v - row * openings.row_spacing;
  return place;
}

/// Collects the directions of the planes near a point.
class PlaneDirections {
 public:
  void Add(const Vector3& normal) {
    for (int i = 0; i < count_; ++i) {
      // Within 26 degrees: one plane for the filter, too.
      if (std::abs(Dot(normals_[static_cast<size_t>(i)], normal)) > 0.9) return;
    }
    if (count_ < 3) normals_[static_cast<size_t>(count_++)] = normal;
  }

  Label Truth() const {
    return count_ >= 3   ? Label::kJunction
           : count_ == 2 ? Label::kCurve
                         : Label::kSurface;
  }

 private:
  std::array<Vector3, 3> normals_;
  int count_ = 0;
};

void AddPlanes(const Polyhedron& body, const Point3& p,
               PlaneDirections& planes) {
  constexpr double kNear = kTruthRadius;
  std::array<double, Polyhedron::kMaxFaceCount> heights;
  for (int i = 0; i < body.face_count; ++i) {
    const auto face = static_cast<size_t>(i);
    heights[face] = Height(body.faces[face], p);
    if (heights[face] >= kNear) return;
  }
  for (int i = 0; i < body.face_count; ++i) {
    const HalfSpace& face = body.faces[static_cast<size_t>(i)];
    const double w = -heights[static_cast<size_t>(i)];
    if (w < body.openings.depth + kNear) {
      if (const auto place = NearestOpening(body.openings, face, i, p)) {
        const double right = body.openings.width - place->u;
        const double above = body.openings.height - place->v;
        const double inside_u = std::min(place->u, right);
        const double inside_v = std::min(place->v, above);
        if (std::min(inside_u, inside_v) > -kNear) {
          if (std::abs(w - body.openings.depth) < kNear) {
            planes.Add(face.normal);
          }
          if (std::abs(inside_u) < kNear) planes.Add(place->tangent);
          if (std::abs(inside_v) < kNear) planes.Add({0, 0, 1});
        }
      }
    }
    if (w < kNear) planes.Add(face.normal);
  }
}

}  // namespace

Polyhedron UprightBox(const Point3& base, double half_length, double half_width,
                      double height, double yaw) {
  const double c = std::cos(yaw);
  const double s = std::sin(yaw);
  const double along = c * base.x + s * base.y;
  const double across = c * base.y - s * base.x;
  Polyhedron box;
  box.AddFace({c, s, 0}, along + half_length);
  box.AddFace({-s, c, 0}, across + half_width);
  box.AddFace({-c, -s, 0}, half_length - along);
  box.AddFace({s, -c, 0}, half_width - across);
  box.AddFace({0, 0, 1}, base.z + height);
  box.AddFace({0, 0, -1}, -base.z);
  const double extent_x = std::abs(c) * half_length + std::abs(s) * half_width;
  const double extent_y = std::abs(s) * half_length + std::abs(c) * half_width;
  box.min_corner = {base.x - extent_x, base.y - extent_y, base.z};
  box.max_corner = {base.x + extent_x, base.y + extent_y, base.z + height};
  return box;
}

Ground Ground::Flat(double half_edge, double z) {
  Ground ground;
  const auto half = static_cast<int>(std::ceil(half_edge / kCellSize));
  ground.min_x = -half;
  ground.min_y = -half;
  ground.size_x = 2 * half;
  ground.size_y = 2 * half;
  const auto edge = static_cast<size_t>(2 * half);
  ground.corners.assign((edge + 1) * (edge + 1), static_cast<float>(z));
  ground.steps.assign(edge * edge, 0);
  ground.reflectances.assign(edge * edge, 0.3F);
  return ground;
}

struct Scene::Ray {
  Point3 origin;
  Vector3 direction;

  double Z(double t) const { return origin.z + t * direction[2]; }
  Point3 At(double t) const {
    return {origin.x + t * direction[0], origin.y + t * direction[1], Z(t)};
  }
};

struct Scene::Nearest {
  double range = kInfinity;
  Kind kind = Kind::kNothing;
  uint32_t index = 0;
  Vector3 normal = {0, 0, 1};
};

Scene::Scene(SceneDescription description)
    : description_(std::move(description)) {
  const Ground& ground = description_.ground;
  size_x_ = ground.size_x;
  size_y_ = ground.size_y;
  min_x_ = static_cast<double>(ground.min_x) * kCell;
  min_y_ = static_cast<double>(ground.min_y) * kCell;
  cells_.resize(CellIndex(0, size_y_));
  for (int y = 0; y < size_y_; ++y) {
    for (int x = 0; x < size_x_; ++x) {
      const size_t i = CellIndex(x, y);
      const size_t corner = i + static_cast<size_t>(y);
      const size_t next_row = corner + static_cast<size_t>(size_x_) + 1;
      const float step = ground.steps[i];
      Cell& cell = cells_[i];
      cell.corners = {
          ground.corners[corner] + step, ground.corners[corner + 1] + step,
          ground.corners[next_row] + step, ground.corners[next_row + 1] + step};
      cell.ground_top = *std::ranges::max_element(cell.corners);
      cell.top = cell.ground_top;
    }
  }
  SortBodiesIntoCells();
  for (const Cell& cell : cells_) top_ = std::max(top_, cell.top);
}

int Scene::CellX(double x) const {
  return static_cast<int>(
      std::clamp(std::floor((x - min_x_) / kCell), -1.0, size_x_ + 0.0));
}

int Scene::CellY(double y) const {
  return static_cast<int>(
      std::clamp(std::floor((y - min_y_) / kCell), -1.0, size_y_ + 0.0));
}

void Scene::SortBodiesIntoCells() {
  struct Bounds {
    double min_x, min_y, max_x, max_y, top;
  };
  std::vector<Bounds> bounds;
  for (const Polyhedron& b : description_.polyhedra) {
    bounds.push_back({b.min_corner.x, b.min_corner.y, b.max_corner.x,
                      b.max_corner.y, b.max_corner.z});
  }
  for (const Cylinder& b : description_.cylinders) {
    bounds.push_back({b.base.x - b.radius, b.base.y - b.radius,
                      b.base.x + b.radius, b.base.y + b.radius,
                      b.base.z + b.height});
  }
  for (const Crown& b : description_.crowns) {
    bounds.push_back({b.center.x - b.radii[0], b.center.y - b.radii[1],
                      b.center.x + b.radii[0], b.center.y + b.radii[1],
                      b.center.z + b.radii[2]});
  }
  last_cast_.assign(bounds.size(), 0);

  // Twice over the bodies: count, then fill. Bounds are widened so that a body
  // near a point is always in the point's cell.
  const auto for_each_cell = [&](auto&& f) {
    for (uint32_t body = 0; body < bounds.size(); ++body) {
      const Bounds& b = bounds[body];
      const int x0 = std::max(CellX(b.min_x - kTruthRadius), 0);
      const int x1 = std::min(CellX(b.max_x + kTruthRadius), size_x_ - 1);
      const int y0 = std::max(CellY(b.min_y - kTruthRadius), 0);
      const int y1 = std::min(CellY(b.max_y + kTruthRadius), size_y_ - 1);
      for (int y = y0; y <= y1; ++y) {
        for (int x = x0; x <= x1; ++x) f(cells_[CellIndex(x, y)], body);
      }
    }
  };
  for_each_cell([&](Cell& cell, uint32_t body) {
    ++cell.body_count;
    cell.top = std::max(cell.top, static_cast<float>(bounds[body].top) + 0.01F);
  });
  uint32_t total = 0;
  for (Cell& cell : cells_) {
    cell.first_body = total;
    total += cell.body_count;
    cell.body_count = 0;
  }
  cell_bodies_.resize(total);
  for_each_cell([&](Cell& cell, uint32_t body) {
    cell_bodies_[cell.first_body + cell.body_count++] = body;
  });
}

double Scene::GroundHeight(double x, double y) const {
  const int cx = std::clamp(CellX(x), 0, size_x_ - 1);
  const int cy = std::clamp(CellY(y), 0, size_y_ - 1);
  const auto& z = cells_[CellIndex(cx, cy)].corners;
  const double u = (x - min_x_) / kCell - cx;
  const double v = (y - min_y_) / kCell - cy;
  return (1 - v) * ((1 - u) * z[0] + u * z[1]) +
         v * ((1 - u) * z[2] + u * z[3]);
}

void Scene::MeetGround(const Ray& ray, int x, int y, double enter, double leave,
                       Nearest& nearest) const {
  const auto& z = cells_[CellIndex(x, y)].corners;
  // Height over the bilinear patch is a quadratic along the ray: with
  // s from 0 at `enter` to 1 at `leave`, above = start + b s + a s².
  const double u0 =
      (ray.origin.x + enter * ray.direction[0] - min_x_) / kCell - x;
  const double v0 =
      (ray.origin.y + enter * ray.direction[1] - min_y_) / kCell - y;
  const double length = leave - enter;
  const double du = length * ray.direction[0] / kCell;
  const double dv = length * ray.direction[1] / kCell;
  const double slope_u = z[1] - z[0];
  const double slope_v = z[2] - z[0];
  const double twist = z[3] - z[2] - slope_u;
  const double start =
      ray.Z(enter) - (z[0] + slope_u * u0 + slope_v * v0 + twist * u0 * v0);
  const double b = length * ray.direction[2] -
                   (slope_u * du + slope_v * dv + twist * (u0 * dv + v0 * du));
  const double a = -twist * du * dv;

  double s = kInfinity;
  Vector3 normal = {0, 0, 1};
  if (start < 0) {
    s = 0;
    if (start < -kKerbTolerance) {
      const bool through_x = std::min(std::abs(u0), std::abs(1 - u0)) <
                             std::min(std::abs(v0), std::abs(1 - v0));
      normal = through_x ? Vector3{1, 0, 0} : Vector3{0, 1, 0};
    }
  } else {
    // The smaller root, in the form without cancellation for b < 0; for b >= 0
    // the ray only sinks where a < 0, towards the other side.
    const double discriminant = b * b - 4 * a * start;
    if (discriminant < 0) return;
    const double root = std::sqrt(discriminant);
    if (b < 0) {
      s = 2 * start / (root - b);
    } else if (a < 0) {
      s = (-b - root) / (2 * a);
    }
  }
  if (!(s <= 1)) return;
  const double range = enter + s * length;
  if (range >= nearest.range) return;
  if (normal[2] != 0) {
    const double u = u0 + s * du;
    const double v = v0 + s * dv;
    const double gx = (slope_u + twist * v) / kCell;
    const double gy = (slope_v + twist * u) / kCell;
    const double scale = 1 / std::sqrt(1 + gx * gx + gy * gy);
    normal = {-gx * scale, -gy * scale, scale};
  }
  nearest = {range, Kind::kGround, static_cast<uint32_t>(CellIndex(x, y)),
             normal};
}

void Scene::MeetPolyhedron(const Ray& ray, uint32_t index,
                           Nearest& nearest) const {
  const Polyhedron& body = description_.polyhedra[index];
  double enter = -kInfinity;
  double leave = nearest.range;
  int face = -1;
  for (int i = 0; i < body.face_count; ++i) {
    const HalfSpace& half_space = body.faces[static_cast<size_t>(i)];
    const double height = Height(half_space, ray.origin);
    const double rate = Dot(half_space.normal, ray.direction);
    if (rate < 0) {
      const double t = height / -rate;
      if (t > enter) {
        enter = t;
        face = i;
      }
    } else if (height > 0) {
      return;
    } else if (rate > 0) {
      leave = std::min(leave, -height / rate);
    }
    if (enter >= leave) return;
  }
  if (enter < 0) return;
  const HalfSpace& met = body.faces[static_cast<size_t>(face)];
  double range = enter;
  Vector3 normal = met.normal;
  const Openings& openings = body.openings;
  const auto place = NearestOpening(openings, met, face, ray.At(enter));
  if (place && place->u > 0 && place->u < openings.width && place->v > 0 &&
      place->v < openings.height) {
    const auto to_side = [](double position, double size, double rate) {
      return rate > 0   ? (size - position) / rate
             : rate < 0 ? position / -rate
                        : kInfinity;
    };
    const double to_back = openings.depth / -Dot(met.normal, ray.direction);
    const double to_u =
        to_side(place->u, openings.width, Dot(place->tangent, ray.direction));
    const double to_v = to_side(place->v, openings.height, ray.direction[2]);
    if (to_u < std::min(to_back, to_v)) {
      normal = place->tangent;
    } else if (to_v < to_back) {
      normal = {0, 0, 1};
    }
    range += std::min({to_back, to_u, to_v});
    if (range >= nearest.range) return;
  }
  nearest = {range, Kind::kPolyhedron, index, normal};
}

void Scene::MeetCylinder(const Ray& ray, uint32_t index,
                         Nearest& nearest) const {
  const Cylinder& body = description_.cylinders[index];
  const double x = ray.origin.x - body.base.x;
  const double y = ray.origin.y - body.base.y;
  const double a =
      ray.direction[0] * ray.direction[0] + ray.direction[1] * ray.direction[1];
  const double b = x * ray.direction[0] + y * ray.direction[1];
  const double c = x * x + y * y - body.radius * body.radius;
  const double discriminant = b * b - a * c;
  if (b >= 0 || c <= 0 || discriminant <= 0) return;
  const double range = c / (std::sqrt(discriminant) - b);
  if (range >= nearest.range) return;
  const Point3 p = ray.At(range);
  if (p.z < body.base.z || p.z > body.base.z + body.height) return;
  nearest = {range,
             Kind::kCylinder,
             index,
             {(p.x - body.base.x) / body.radius,
              (p.y - body.base.y) / body.radius, 0}};
}

void Scene::MeetCrown(const Ray& ray, uint32_t index, const PulseKey& key,
                      Nearest& nearest) const {
  const Crown& body = description_.crowns[index];
  // In units of the radii the ellipsoid is the unit sphere.
  const Vector3 o = {(ray.origin.x - body.center.x) / body.radii[0],
                     (ray.origin.y - body.center.y) / body.radii[1],
                     (ray.origin.z - body.center.z) / body.radii[2]};
  const Vector3 d = {ray.direction[0] / body.radii[0],
                     ray.direction[1] / body.radii[1],
                     ray.direction[2] / body.radii[2]};
  const double a = Dot(d, d);
  const double b = Dot(o, d);
  const double discriminant = b * b - a * (Dot(o, o) - 1);
  if (discriminant <= 0) return;
  const double root = std::sqrt(discriminant);
  const double leave = (root - b) / a;
  const double enter = std::max(0.0, (-root - b) / a);
  if (leave <= enter || enter >= nearest.range) return;
  const uint64_t draw = HashIntegers(
      std::array{static_cast<int64_t>(key.seed), key.pulse, body.id});
  const double uniform = static_cast<double>((draw >> 11) + 1) * 0x1p-53;
  const double range = enter - std::log(uniform) / body.density;
  if (range >= leave || range >= nearest.range) return;
  nearest = {range, Kind::kCrown, index, {0, 0, 1}};
}

void Scene::MeetBodies(const Ray& ray, const Cell& cell, const PulseKey& key,
                       Nearest& nearest) {
  const size_t polyhedron_count = description_.polyhedra.size();
  const size_t cylinder_end = polyhedron_count + description_.cylinders.size();
  for (uint32_t i = 0; i < cell.body_count; ++i) {
    const uint32_t body = cell_bodies_[cell.first_body + i];
    if (std::exchange(last_cast_[body], cast_count_) == cast_count_) continue;
    if (body < polyhedron_count) {
      MeetPolyhedron(ray, body, nearest);
    } else if (body < cylinder_end) {
      MeetCylinder(ray, static_cast<uint32_t>(body - polyhedron_count),
                   nearest);
    } else {
      MeetCrown(ray, static_cast<uint32_t>(body - cylinder_end), key, nearest);
    }
  }
}

std::optional<SceneHit> Scene::Cast(const Point3& origin,
                                    const Vector3& direction, double max_range,
                                    const PulseKey& key) {
  const Ray ray = {origin, direction};
  int x = CellX(origin.x);
  int y = CellY(origin.y);
  const int step_x = direction[0] < 0 ? -1 : 1;
  const int step_y = direction[1] < 0 ? -1 : 1;
  // Ranges at which the ray crosses the next border, and from one to the next.
  const auto to_border = [](double from_min, int cell, double rate) {
    if (rate == 0) return kInfinity;
    return ((rate > 0 ? cell + 1 : cell) * kCell - from_min) / rate;
  };
  double next_x = to_border(origin.x - min_x_, x, direction[0]);
  double next_y = to_border(origin.y - min_y_, y, direction[1]);
  const double delta_x = kCell / std::abs(direction[0]);
  const double delta_y = kCell / std::abs(direction[1]);

  ++cast_count_;
  Nearest nearest;
  nearest.range = max_range;
  double enter = 0;
  while (x >= 0 && x < size_x_ && y >= 0 && y < size_y_) {
    const double leave = std::min({next_x, next_y, max_range});
    const Cell& cell = cells_[CellIndex(x, y)];
    const double z_leave = ray.Z(leave);
    const double lowest = std::min(ray.Z(enter), z_leave);
    if (lowest < cell.top) {
      if (lowest < cell.ground_top) {
        MeetGround(ray, x, y, enter, leave, nearest);
      }
      MeetBodies(ray, cell, key, nearest);
    }
    if (nearest.range <= leave) break;
    if (direction[2] >= 0 && z_leave > top_) break;
    if (next_x < next_y) {
      x += step_x;
      next_x += delta_x;
    } else {
      y += step_y;
      next_y += delta_y;
    }
    enter = leave;
  }
  if (nearest.kind == Kind::kNothing) return std::nullopt;

  SceneHit hit;
  hit.range = nearest.range;
  hit.cos_incidence = std::abs(Dot(nearest.normal, direction));
  const Point3 p = ray.At(hit.range);
  switch (nearest.kind) {
    case Kind::kGround:
      hit.reflectance = description_.ground.reflectances[nearest.index];
      hit.object = ObjectClass::kGround;
      hit.truth = TruthAt(p);
      break;
    case Kind::kPolyhedron:
      hit.reflectance = description_.polyhedra[nearest.index].reflectance;
      hit.object = description_.polyhedra[nearest.index].object;
      hit.truth = TruthAt(p);
      break;
    case Kind::kCylinder:
      hit.reflectance = description_.cylinders[nearest.index].reflectance;
      hit.object = description_.cylinders[nearest.index].object;
      hit.truth = Label::kCurve;
      break;
    case Kind::kCrown:
      hit.reflectance = description_.crowns[nearest.index].reflectance;
      hit.object = ObjectClass::kVegetation;
      hit.cos_incidence = 1;
      break;
    case Kind::kNothing:
      break;
  }
  return hit;
}

Label Scene::TruthAt(const Point3& p) const {
  const int x = std::clamp(CellX(p.x), 0, size_x_ - 1);
  const int y = std::clamp(CellY(p.y), 0, size_y_ - 1);
  const Cell& cell = cells_[CellIndex(x, y)];
  PlaneDirections planes;

  const double ground = GroundHeight(p.x, p.y);
  if (std::abs(p.z - ground) < kTruthRadius) planes.Add({0, 0, 1});
  const auto add_kerb = [&](int other_x, int other_y, double distance,
                            const Vector3& normal) {
    if (distance >= kTruthRadius || other_x < 0 || other_x >= size_x_ ||
        other_y < 0 || other_y >= size_y_) {
      return;
    }
    const auto& steps = description_.ground.steps;
    const double rise =
        steps[CellIndex(other_x, other_y)] - steps[CellIndex(x, y)];
    if (rise == 0 || p.z > ground + std::max(rise, 0.0) + kTruthRadius) return;
    planes.Add(normal);
    if (std::abs(p.z - ground - rise) < kTruthRadius) planes.Add({0, 0, 1});
  };
  const double u = p.x - min_x_ - x * kCell;
  const double v = p.y - min_y_ - y * kCell;
  add_kerb(x - 1, y, u, {1, 0, 0});
  add_kerb(x + 1, y, kCell - u, {1, 0, 0});
  add_kerb(x, y - 1, v, {0, 1, 0});
  add_kerb(x, y + 1, kCell - v, {0, 1, 0});

  for (uint32_t i = 0; i < cell.body_count; ++i) {
    const uint32_t body = cell_bodies_[cell.first_body + i];
    if (body < description_.polyhedra.size()) {
      AddPlanes(description_.polyhedra[body], p, planes);
    }
  }
  return planes.Truth();
}

}  // namespace mapsieve::client
