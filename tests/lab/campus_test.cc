#include "client/lab/campus.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include "client/lab/scene.h"
#include "client/lab/spinning_scanner.h"
#include "gtest/gtest.h"

namespace mapsieve::client {
namespace {

using core::Point3;
using core::Vector3;

/// What a scene's description says of single places, worked out body by body:
/// the oracle of the ray caster, which knows neither rays nor cells.
class Solids {
 public:
  explicit Solids(const SceneDescription& scene) : scene_(scene) {}

  /// Considers only bodies that come within a metre of this segment seen from
  /// above.
  void SelectAlong(const Point3& from, const Vector3& direction,
                   double length) {
    const double level = std::hypot(direction[0], direction[1]);
    const auto near = [&](double x, double y, double radius) {
      const double along = std::clamp(
          ((x - from.x) * direction[0] + (y - from.y) * direction[1]) /
              (level * level),
          0.0, length);
      return std::hypot(x - from.x - along * direction[0],
                        y - from.y - along * direction[1]) < radius + 1;
    };
    polyhedra_.clear();
    cylinders_.clear();
    for (const Polyhedron& b : scene_.polyhedra) {
      const double radius = std::hypot(b.max_corner.x - b.min_corner.x,
                                       b.max_corner.y - b.min_corner.y) /
                            2;
      if (near((b.min_corner.x + b.max_corner.x) / 2,
               (b.min_corner.y + b.max_corner.y) / 2, radius)) {
        polyhedra_.push_back(&b);
      }
    }
    for (const Cylinder& b : scene_.cylinders) {
      if (near(b.base.x, b.base.y, b.radius)) cylinders_.push_back(&b);
    }
  }

  bool Contain(const Point3& p) const {
    return p.z < GroundHeight(p.x, p.y) ||
           std::ranges::any_of(
               cylinders_,
               [&](const Cylinder* b) {
                 return std::hypot(p.x - b->base.x, p.y - b->base.y) <
                            b->radius &&
                        p.z > b->base.z && p.z < b->base.z + b->height;
               }) ||
           std::ranges::any_of(polyhedra_, [&](const Polyhedron* b) {
             return InHull(*b, p) && !InOpening(*b, p);
           });
  }

  bool InCrown(const Point3& p) const {
    return std::ranges::any_of(scene_.crowns, [&](const Crown& b) {
      return std::hypot((p.x - b.center.x) / b.radii[0],
                        (p.y - b.center.y) / b.radii[1],
                        (p.z - b.center.z) / b.radii[2]) < 1 + 1e-9;
    });
  }

  double GroundHeight(double x, double y) const {
    const Ground& g = scene_.ground;
    const double u = x / Ground::kCellSize - static_cast<double>(g.min_x);
    const double v = y / Ground::kCellSize - static_cast<double>(g.min_y);
    const auto i = static_cast<size_t>(u);
    const auto j = static_cast<size_t>(v);
    const auto width = static_cast<size_t>(g.size_x);
    const auto corner = [&](size_t dx, size_t dy) {
      return g.corners[(j + dy) * (width + 1) + i + dx];
    };
    const double s = u - static_cast<double>(i);
    const double t = v - static_cast<double>(j);
    return g.steps[j * width + i] + (1 - s) * (1 - t) * corner(0, 0) +
           s * (1 - t) * corner(1, 0) + (1 - s) * t * corner(0, 1) +
           s * t * corner(1, 1);
  }

 private:
  static double Outside(const HalfSpace& face, const Point3& p) {
    return face.normal[0] * p.x + face.normal[1] * p.y + face.normal[2] * p.z -
           face.offset;
  }

  static bool InHull(const Polyhedron& b, const Point3& p) {
    for (int i = 0; i < b.face_count; ++i) {
      if (Outside(b.faces[static_cast<size_t>(i)], p) > 0) return false;
    }
    return true;
  }

  static bool InOpening(const Polyhedron& b, const Point3& p) {
    const Openings& o = b.openings;
    if (o.row_count == 0) return false;
    for (size_t face = 0; face < 4; ++face) {
      if (Outside(b.faces[face], p) < -o.depth) continue;
      const Vector3& n = b.faces[face].normal;
      const double u = n[0] * (p.y - o.center.y) - n[1] * (p.x - o.center.x);
      const int columns = o.column_counts[face % 2];
      for (int column = 0; column < columns; ++column) {
        const double middle = (column - (columns - 1) / 2.0) * o.column_spacing;
        if (std::abs(u - middle) > o.width / 2) continue;
        for (int row = 0; row < o.row_count; ++row) {
          const double v = p.z - o.center.z - row * o.row_spacing;
          if (v > 0 && v < o.height) return true;
        }
      }
    }
    return false;
  }

  const SceneDescription& scene_;
  std::vector<const Polyhedron*> polyhedra_;
  std::vector<const Cylinder*> cylinders_;
};

TEST(CampusTest, NoReturnLiesBehindOrBeforeWhatBlocksIt) {
  const Campus campus(3);
  std::map<ObjectClass, int> met;
  int missed = 0;
  for (int64_t index = 0; index < 6; ++index) {
    ScannerRotation rotation;
    rotation.index = index;
    rotation.start = SpiralDrive(37.0 * static_cast<double>(index));
    rotation.start.z =
        campus.TerrainHeight(rotation.start.x, rotation.start.y) + 1.8;
    const auto block = [](double place, double size) {
      return static_cast<int64_t>(std::floor(place / size));
    };
    Scene scene(campus.Surroundings(block(rotation.start.x, Campus::kBlockX),
                                    block(rotation.start.y, Campus::kBlockY),
                                    100));
    Solids solids(scene.description());
    const SpinningScanner exact({.range_noise_m = 0, .spurious_share = 0});
    const Point3& eye = rotation.start;
    for (int pulse = 0; pulse < SpinningScanner::kPulseCount; pulse += 37) {
      const auto echo = exact.Fire(scene, rotation, pulse);
      if (!echo) {
        ++missed;
        continue;
      }
      const Point3& p = echo->position;
      const Vector3 way = {p.x - eye.x, p.y - eye.y, p.z - eye.z};
      const double range = std::hypot(way[0], way[1], way[2]);
      const Vector3 d = {way[0] / range, way[1] / range, way[2] / range};
      const auto at = [&](double t) {
        return Point3{eye.x + t * d[0], eye.y + t * d[1], eye.z + t * d[2]};
      };
      solids.SelectAlong(eye, d, range);
      for (double t = 0; t < range - 1e-4; t += 0.02) {
        ASSERT_FALSE(solids.Contain(at(t)))
            << "rotation " << index << " pulse " << pulse << ": class "
            << static_cast<int>(echo->object) << " at " << range
            << " lies behind something solid at " << t;
      }
      ++met[echo->object];
      if (solids.InCrown(p) && echo->object == ObjectClass::kVegetation) {
        continue;
      }
      ASSERT_TRUE(solids.Contain(at(range + 1e-5)))
          << "rotation " << index << " pulse " << pulse << ": class "
          << static_cast<int>(echo->object) << " at " << range
          << " lies in the air";
    }
  }
  EXPECT_GT(met[ObjectClass::kGround], 1000);
  EXPECT_GT(met[ObjectClass::kBuilding], 500);
  EXPECT_GT(met[ObjectClass::kVegetation], 300);
  EXPECT_GT(met[ObjectClass::kCar], 50);
  EXPECT_GT(met[ObjectClass::kPole], 20);
  EXPECT_GT(missed, 500);
}

TEST(CampusTest, PulseWithoutReturnMeetsNothingSolid) {
  const Campus campus(4);
  constexpr double kRange = 60;
  Scene scene(campus.Surroundings(0, 0, kRange));
  Solids solids(scene.description());
  const Point3 eye = {4, 4, campus.TerrainHeight(4, 4) + 1.8};
  int missed = 0;
  for (int i = 0; i < 3000; ++i) {
    const double azimuth = 2.4 * i;
    const double elevation = 0.0002 * i;
    const Vector3 d = {std::cos(elevation) * std::cos(azimuth),
                       std::cos(elevation) * std::sin(azimuth),
                       std::sin(elevation)};
    if (scene.Cast(eye, d, kRange, {1, i})) continue;
    ++missed;
    solids.SelectAlong(eye, d, kRange);
    for (double t = 0; t < kRange; t += 0.05) {
      ASSERT_FALSE(solids.Contain(
          {eye.x + t * d[0], eye.y + t * d[1], eye.z + t * d[2]}))
          << "ray " << i << " at " << t;
    }
  }
  EXPECT_GT(missed, 300);
}

TEST(CampusTest, BlockIsTheSameFromEveryNeighbour) {
  const Campus campus(5);
  // Bodies near the middle of block (10, -7), seen from it and from others.
  const auto bodies = [&](int64_t x, int64_t y) {
    std::vector<std::vector<double>> result;
    const SceneDescription scene = campus.Surroundings(x, y, 80);
    const auto inside = [](double px, double py) {
      return px > 640 && px < 704 && py > -336 && py < -288;
    };
    for (const Polyhedron& b : scene.polyhedra) {
      if (inside(b.min_corner.x, b.min_corner.y)) {
        result.push_back({b.min_corner.x, b.min_corner.y, b.min_corner.z,
                          b.max_corner.x, b.max_corner.y, b.max_corner.z});
      }
    }
    for (const Cylinder& b : scene.cylinders) {
      if (inside(b.base.x, b.base.y)) {
        result.push_back({b.base.x, b.base.y, b.base.z, b.radius, b.height});
      }
    }
    for (const Crown& b : scene.crowns) {
      if (inside(b.center.x, b.center.y)) {
        result.push_back({b.center.x, b.center.y, b.center.z, b.radii[0],
                          static_cast<double>(b.id)});
      }
    }
    std::ranges::sort(result);
    return result;
  };
  const auto own = bodies(10, -7);
  EXPECT_GT(own.size(), 20);
  EXPECT_EQ(own, bodies(9, -7));
  EXPECT_EQ(own, bodies(11, -8));
}

TEST(CampusTest, GroundIsTheSameFromEveryNeighbour) {
  const Campus campus(5);
  const SceneDescription a = campus.Surroundings(0, 0, 50);
  const SceneDescription b = campus.Surroundings(1, -1, 50);
  for (double x = 20; x < 60; x += 1.7) {
    for (double y = -20; y < 20; y += 1.7) {
      ASSERT_NEAR(Solids(a).GroundHeight(x, y), Solids(b).GroundHeight(x, y),
                  1e-9);
    }
  }
}

TEST(CampusTest, GroundUndulatesAndKerbsRise) {
  const Campus campus(6);
  double low = 1e9;
  double high = -1e9;
  for (double x = -500; x < 500; x += 10) {
    for (double y = -500; y < 500; y += 10) {
      const double z = campus.TerrainHeight(x, y);
      low = std::min(low, z);
      high = std::max(high, z);
      EXPECT_LT(std::abs(campus.TerrainHeight(x + 1, y) - z), 0.1);
    }
  }
  EXPECT_GT(high - low, 2);
  EXPECT_LT(high - low, 5);
  const SceneDescription scene = campus.Surroundings(0, 0, 20);
  EXPECT_NEAR(Solids(scene).GroundHeight(30, 8.001) -
                  Solids(scene).GroundHeight(30, 7.999),
              Campus::kKerbHeight, 0.001);
}

TEST(CampusTest, OtherSeedsAndBlocksDiffer) {
  const auto size = [](uint64_t seed, int64_t x, int64_t y) {
    const Polyhedron first =
        Campus(seed).Surroundings(x, y, 10).polyhedra.at(0);
    return first.max_corner.x - first.min_corner.x;
  };
  EXPECT_NE(size(1, 0, 0), size(2, 0, 0));
  EXPECT_NE(size(1, 0, 0), size(1, 5, 0));
  EXPECT_NE(size(1, 0, 0), size(1, 0, 5));
}

TEST(CampusTest, SurroundingsReachAsFarAsTheRange) {
  const Campus campus(8);
  constexpr double kRange = 100;
  Scene enough(campus.Surroundings(0, 0, kRange));
  Scene plenty(campus.Surroundings(0, 0, kRange + 150));
  int far = 0;
  for (const double x : {0.0, Campus::kBlockX}) {
    for (const double y : {0.0, Campus::kBlockY}) {
      // High up, so that much is in sight.
      const Point3 eye = {x, y, 15};
      for (int i = 0; i < 2000; ++i) {
        const double azimuth = 2.4 * i;
        const double elevation = -0.25 + 0.0001 * i;
        const Vector3 d = {std::cos(elevation) * std::cos(azimuth),
                           std::cos(elevation) * std::sin(azimuth),
                           std::sin(elevation)};
        const auto a = enough.Cast(eye, d, kRange, {1, i});
        const auto b = plenty.Cast(eye, d, kRange, {1, i});
        ASSERT_EQ(a.has_value(), b.has_value()) << i;
        if (!a) continue;
        ASSERT_NEAR(a->range, b->range, 1e-6) << i;
        if (a->range > 0.9 * kRange) ++far;
      }
    }
  }
  EXPECT_GT(far, 100);
}

TEST(SpiralDriveTest, DrivesOnStreetsWithoutLeaps) {
  Point3 last = SpiralDrive(0);
  for (double distance = 1; distance < 20000; ++distance) {
    const Point3 p = SpiralDrive(distance);
    ASSERT_LT(std::hypot(p.x - last.x, p.y - last.y), 1.1) << distance;
    const auto from_middle = [](double place, double block) {
      const double offset = place - Campus::kStreetWidth / 2;
      return std::abs(offset - block * std::round(offset / block));
    };
    ASSERT_LT(std::min(from_middle(p.x, Campus::kBlockX),
                       from_middle(p.y, Campus::kBlockY)),
              0.7)
        << distance;
    last = p;
  }
}

TEST(SpiralDriveTest, PassesEveryCrossingOnce) {
  std::map<std::pair<double, double>, int> passes;
  bool at_crossing = false;
  // Turns 0 to 9: the crossings of a square of 11 x 11, less its last side.
  for (double distance = 0; distance < 56 * 10 * 11 - 5; distance += 0.5) {
    const Point3 p = SpiralDrive(distance);
    const double x = std::round((p.x - 4) / Campus::kBlockX);
    const double y = std::round((p.y - 4) / Campus::kBlockY);
    const bool here = std::hypot(p.x - 4 - x * Campus::kBlockX,
                                 p.y - 4 - y * Campus::kBlockY) < 3;
    if (here && !at_crossing) ++passes[{x, y}];
    at_crossing = here;
  }
  EXPECT_EQ(passes.size(), 110);
  for (const auto& [crossing, count] : passes) {
    EXPECT_EQ(count, 1) << crossing.first << ", " << crossing.second;
  }
}

TEST(SpiralDriveTest, GoesOnForATrillionMetres) {
  const Point3 a = SpiralDrive(1e12 - 1);
  const Point3 b = SpiralDrive(1e12);
  EXPECT_LT(std::hypot(a.x - b.x, a.y - b.y), 1.2);
  EXPECT_LT(std::hypot(b.x, b.y), 1e7);
}

TEST(CampusTest, TheDriveIsFree) {
  for (const uint64_t seed : {1, 2, 3}) {
    const Campus campus(seed);
    for (double distance = 0; distance < 1500; distance += 50) {
      const Point3 start = SpiralDrive(distance);
      const SceneDescription scene = campus.Surroundings(
          static_cast<int64_t>(std::floor(start.x / Campus::kBlockX)),
          static_cast<int64_t>(std::floor(start.y / Campus::kBlockY)), 60);
      Solids solids(scene);
      for (double further = 0; further < 50; ++further) {
        Point3 p = SpiralDrive(distance + further);
        solids.SelectAlong(p, {1, 0, 0}, 1);
        for (const double height : {0.3, 1.0, 1.8}) {
          p.z = campus.TerrainHeight(p.x, p.y) + height;
          EXPECT_FALSE(solids.Contain(p)) << seed << " " << distance + further;
        }
      }
    }
  }
}

}  // namespace
}  // namespace mapsieve::client
