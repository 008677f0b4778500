#include "client/lab/place.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <vector>

#include "client/lab/campus.h"
#include "client/lab/draws.h"

namespace mapsieve::client {
namespace {

using core::Point3;
using std::numbers::pi;

constexpr double kMaxTurn = 40 * pi / 180;

Polyhedron Box(const Point3& base, double half_length, double half_width,
               double height, double yaw, ObjectClass object) {
  Polyhedron box = UprightBox(base, half_length, half_width, height, yaw);
  box.object = object;
  return box;
}

Polyhedron Person(const Point3& base, double yaw) {
  return Box(base, 0.25, 0.16, 1.75, yaw, ObjectClass::kNoise);
}

/// Two stations, the second at a distance from the first in a direction within
/// `max_bearing` of +x or -x.
std::array<Station, 2> DrawStations(double x, double y, double min_distance,
                                    double max_distance, double max_bearing,
                                    Draws& draws) {
  const double distance = draws.Uniform(min_distance, max_distance);
  const double bearing = draws.Uniform(-max_bearing, max_bearing);
  const double sign = draws.Integer(0, 1) == 0 ? 1 : -1;
  const double half_x = sign * std::cos(bearing) * distance / 2;
  const double half_y = std::sin(bearing) * distance / 2;
  const double yaw = draws.Uniform(-pi, pi);
  return {Station{x - half_x, y - half_y, yaw},
          Station{x + half_x, y + half_y,
                  yaw + draws.Uniform(-kMaxTurn, kMaxTurn)}};
}

bool IsClear(const std::array<Station, 2>& stations, double x, double y,
             double distance) {
  return stations[0].Distance(x, y) >= distance &&
         stations[1].Distance(x, y) >= distance;
}

// Rooms -----------------------------------------------------------------------

constexpr double kCeiling = 2.7;
constexpr double kHalfWall = 0.2;

/// A wall between two corners, with windows.
void AddWall(double x0, double y0, double x1, double y1, int window_count,
             SceneDescription& scene) {
  const double length = std::hypot(x1 - x0, y1 - y0);
  Polyhedron wall =
      Box({(x0 + x1) / 2, (y0 + y1) / 2, 0}, length / 2, kHalfWall, kCeiling,
          std::atan2(y1 - y0, x1 - x0), ObjectClass::kBuilding);
  wall.openings.center = {(x0 + x1) / 2, (y0 + y1) / 2, 0.95};
  wall.openings.column_counts = {0, window_count};
  wall.openings.row_count = window_count > 0 ? 1 : 0;
  wall.openings.height = 1.2;
  wall.openings.depth = 0.12;
  wall.openings.column_spacing = 2;
  scene.polyhedra.push_back(wall);
}

void AddTable(double x, double y, double yaw, SceneDescription& scene) {
  scene.polyhedra.push_back(
      Box({x, y, 0.71}, 0.7, 0.4, 0.03, yaw, ObjectClass::kBuilding));
  for (const double along : {-0.62, 0.62}) {
    for (const double across : {-0.33, 0.33}) {
      scene.cylinders.push_back(
          {{x + std::cos(yaw) * along - std::sin(yaw) * across,
            y + std::sin(yaw) * along + std::cos(yaw) * across, 0},
           0.03,
           0.71,
           ObjectClass::kBuilding,
           0.5F});
    }
  }
}

/// Room A is [0, width] x [0, depth]; B lies behind its wall at x = width.
Place MakeRooms(int number) {
  Draws draws(static_cast<uint64_t>(number), 1);
  const double width = draws.Uniform(7, 10);
  const double depth = draws.Uniform(5, 8);
  const double end = width + draws.Uniform(4, 6);
  const double door = draws.Uniform(1, depth - 2);
  Place place;
  place.scanner_height = 1.2;
  place.max_range_m = 30;
  place.range_noise_m = 0.01;
  SceneDescription& scene = place.scene;
  scene.ground = Ground::Flat(24, 0);
  AddWall(0, 0, end, 0, draws.Integer(2, 4), scene);
  AddWall(0, depth, end, depth, draws.Integer(0, 3), scene);
  AddWall(0, 0, 0, depth, draws.Integer(0, 2), scene);
  AddWall(end, 0, end, depth, draws.Integer(0, 2), scene);
  AddWall(width, 0, width, door, 0, scene);
  AddWall(width, door + 1, width, depth, 0, scene);
  scene.polyhedra.push_back(Box({end / 2, depth / 2, kCeiling}, end / 2 + 1,
                                depth / 2 + 1, 0.3, 0, ObjectClass::kBuilding));
  place.stations = DrawStations(width / 2, depth / 2, 1.2, 3, pi / 6, draws);
  const auto add_somewhere = [&](double distance, const auto& add) {
    const double x = draws.Uniform(0.9, end - 0.9);
    const double y = draws.Uniform(0.9, depth - 0.9);
    const double yaw = draws.Uniform(-0.1, 0.1) + draws.Integer(0, 1) * pi / 2;
    if (IsClear(place.stations, x, y, distance)) add(x, y, yaw);
  };
  for (int i = 0; i < 6; ++i) {
    add_somewhere(1.4, [&](double x, double y, double yaw) {
      AddTable(x, y, yaw, scene);
    });
  }
  for (int i = 0; i < 5; ++i) {
    const double x = draws.Uniform(1, end - 1);
    const bool at_far_wall = draws.Integer(0, 1) == 1;
    scene.polyhedra.push_back(
        Box({x, at_far_wall ? depth - 0.4 : 0.4, 0}, draws.Uniform(0.3, 0.6),
            0.2, draws.Uniform(0.9, 2.1), 0, ObjectClass::kBuilding));
  }
  for (std::vector<Polyhedron>& moving : place.moving) {
    for (int i = 0; i < 3; ++i) {
      add_somewhere(1, [&](double x, double y, double yaw) {
        moving.push_back(Person({x, y, 0}, yaw + 0.4));
      });
    }
  }
  return place;
}

// Streets ---------------------------------------------------------------------

Place MakeStreet(int number) {
  // Away from the seeds that people give surveys.
  constexpr uint64_t kFirstSeed = 7'000'000;
  const Campus campus(kFirstSeed + static_cast<uint64_t>(number));
  Draws draws(static_cast<uint64_t>(number), 2);
  Place place;
  place.scanner_height = 1.8;
  place.max_range_m = 60;
  place.range_noise_m = 0.015;
  place.scene = campus.Surroundings(0, 0, place.max_range_m);
  constexpr double kMiddle = Campus::kStreetWidth / 2;
  place.stations =
      DrawStations(draws.Uniform(20, 48), kMiddle, 3, 6, 0.1, draws);
  for (std::vector<Polyhedron>& moving : place.moving) {
    for (int i = 0; i < 6; ++i) {
      const bool is_car = i < 2;
      const double x = draws.Uniform(5, 60);
      const double y = is_car ? draws.Uniform(1.2, 2.2)
                              : draws.Uniform(0.3, Campus::kStreetWidth - 0.3);
      if (!IsClear(place.stations, x, y, is_car ? 5 : 2)) continue;
      const Point3 base = {x, y, campus.TerrainHeight(x, y)};
      moving.push_back(is_car ? Box({x, y, base.z + 0.2}, 2.1, 0.9, 1.3, 0,
                                    ObjectClass::kCar)
                              : Person(base, draws.Uniform(0, pi)));
    }
  }
  return place;
}

// Woods -----------------------------------------------------------------------

Ground RoughGround(double half_edge, Draws& draws) {
  Ground ground = Ground::Flat(half_edge, 0);
  const double phase_x = draws.Uniform(0, 2 * pi);
  const double phase_y = draws.Uniform(0, 2 * pi);
  size_t corner = 0;
  for (int j = 0; j <= ground.size_y; ++j) {
    for (int i = 0; i <= ground.size_x; ++i) {
      const double x = Ground::kCellSize * static_cast<double>(i);
      const double y = Ground::kCellSize * static_cast<double>(j);
      ground.corners[corner++] = static_cast<float>(
          0.9 * std::sin(x / 11 + phase_x) + 0.7 * std::sin(y / 9 + phase_y) +
          draws.Uniform(-0.18, 0.18));
    }
  }
  return ground;
}

void AddCrown(const Point3& center, double radius, double half_height,
              double density, Draws& draws, SceneDescription& scene) {
  scene.crowns.push_back({center,
                          {radius, radius, half_height},
                          density,
                          0.4F,
                          static_cast<int64_t>(scene.crowns.size())});
  // Not two alike.
  scene.crowns.back().radii[0] *= draws.Uniform(0.8, 1.2);
}

Place MakeWood(int number) {
  constexpr double kHalfEdge = 44;
  Draws draws(static_cast<uint64_t>(number), 3);
  Place place;
  place.scanner_height = 1.5;
  place.max_range_m = 40;
  place.range_noise_m = 0.02;
  SceneDescription& scene = place.scene;
  scene.ground = RoughGround(kHalfEdge, draws);
  place.stations = DrawStations(draws.Uniform(-2, 2), draws.Uniform(-2, 2), 3,
                                5, pi / 2, draws);
  const Scene bare(scene);
  const double reach = kHalfEdge - 4;
  std::vector<std::array<double, 2>> trunks;
  for (int i = 0; i < 420; ++i) {
    const double x = draws.Uniform(-reach, reach);
    const double y = draws.Uniform(-reach, reach);
    bool is_free = IsClear(place.stations, x, y, 1.6);
    for (const std::array<double, 2>& t : trunks) {
      is_free = is_free && std::hypot(t[0] - x, t[1] - y) > 2.2;
    }
    if (!is_free) continue;
    trunks.push_back({x, y});
    const double ground = bare.GroundHeight(x, y);
    const double height = draws.Uniform(5, 11);
    scene.cylinders.push_back({{x, y, ground - 0.5},
                               draws.Uniform(0.08, 0.28),
                               height + 0.5,
                               ObjectClass::kVegetation,
                               0.35F});
    for (int part = 0; part < 3; ++part) {
      AddCrown({x + draws.Uniform(-0.8, 0.8), y + draws.Uniform(-0.8, 0.8),
                ground + height * draws.Uniform(0.55, 1)},
               draws.Uniform(0.8, 1.9), draws.Uniform(0.8, 1.8),
               draws.Uniform(0.4, 0.9), draws, scene);
    }
  }
  for (int i = 0; i < 160; ++i) {
    const double x = draws.Uniform(-reach, reach);
    const double y = draws.Uniform(-reach, reach);
    if (!IsClear(place.stations, x, y, 2)) continue;
    AddCrown({x, y, bare.GroundHeight(x, y) + 0.3}, draws.Uniform(0.3, 1),
             draws.Uniform(0.3, 0.8), draws.Uniform(1, 2.5), draws, scene);
  }
  for (std::vector<Polyhedron>& moving : place.moving) {
    for (int i = 0; i < 3; ++i) {
      const double x = draws.Uniform(-12, 12);
      const double y = draws.Uniform(-12, 12);
      if (!IsClear(place.stations, x, y, 1.5)) continue;
      moving.push_back(
          Person({x, y, bare.GroundHeight(x, y) - 0.1}, draws.Uniform(0, pi)));
    }
  }
  return place;
}

}  // namespace

Place MakePlace(Environment environment, int number) {
  switch (environment) {
    case Environment::kStructured:
      return MakeRooms(number);
    case Environment::kSemiStructured:
      return MakeStreet(number);
    default:
      return MakeWood(number);
  }
}

}  // namespace mapsieve::client
