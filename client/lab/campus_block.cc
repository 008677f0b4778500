#include "client/lab/campus_block.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/base/hash.h"

namespace mapsieve::client {
namespace {

using core::Point3;
using core::Vector3;

constexpr double kStoreyHeight = 3.2;
constexpr double kPi = std::numbers::pi;
/// The part of a block between the pavements, relative to its corner.
constexpr double kLawnMin = Campus::kStreetWidth + Campus::kPavementWidth;
constexpr double kLawnMaxX = Campus::kBlockX - Campus::kPavementWidth;
constexpr double kLawnMaxY = Campus::kBlockY - Campus::kPavementWidth;

/// Where a building stands: the centre, half edges, and the angle of its first
/// axis.
struct Footprint {
  double x = 0;
  double y = 0;
  double half_length = 0;
  double half_width = 0;
  double yaw = 0;

  /// The place at (along, across) on the footprint's own axes.
  std::array<double, 2> Place(double along, double across) const {
    return {x + std::cos(yaw) * along - std::sin(yaw) * across,
            y + std::sin(yaw) * along + std::cos(yaw) * across};
  }
  bool Contains(double px, double py, double margin) const {
    const double dx = px - x;
    const double dy = py - y;
    return std::abs(std::cos(yaw) * dx + std::sin(yaw) * dy) <
               half_length + margin &&
           std::abs(std::cos(yaw) * dy - std::sin(yaw) * dx) <
               half_width + margin;
  }
};

enum class Roof { kFlat, kGable, kHip };

class BlockBuilder {
 public:
  BlockBuilder(const Campus& campus, uint64_t seed, int64_t block_x,
               int64_t block_y, SceneDescription& scene)
      : campus_(campus),
        seed_(seed),
        block_x_(block_x),
        block_y_(block_y),
        corner_x_(static_cast<double>(block_x) * Campus::kBlockX),
        corner_y_(static_cast<double>(block_y) * Campus::kBlockY),
        scene_(scene) {}

  void Build() {
    const double kind = Uniform(0, 1);
    if (kind < 0.36) {
      BuildHall();
    } else if (kind < 0.60) {
      BuildWings();
    } else if (kind < 0.80) {
      BuildHouses();
    } else if (kind < 0.92) {
      BuildGrove();
    } else {
      BuildCarPark();
    }
    FurnishStreets();
  }

 private:
  uint64_t Draw() {
    return HashIntegers(std::array{static_cast<int64_t>(seed_), block_x_,
                                   block_y_, draw_count_++});
  }
  double Uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(Draw() >> 11) * 0x1p-53;
  }
  bool Chance(double share) { return Uniform(0, 1) < share; }
  int Integer(int low, int high) {
    return low + static_cast<int>(Uniform(0, high - low + 1));
  }
  /// Height of pavements and lawns.
  double LawnHeight(double x, double y) const {
    return campus_.TerrainHeight(x, y) + Campus::kKerbHeight;
  }

  void AddBox(const Point3& base, double half_length, double half_width,
              double height, double yaw, ObjectClass object,
              float reflectance) {
    Polyhedron box = UprightBox(base, half_length, half_width, height, yaw);
    box.object = object;
    box.reflectance = reflectance;
    scene_.polyhedra.push_back(box);
  }

  /// A band around a building, wider than it by `out`.
  void AddBand(const Footprint& f, double out, double bottom, double height,
               float reflectance) {
    AddBox({f.x, f.y, bottom}, f.half_length + out, f.half_width + out, height,
           f.yaw, ObjectClass::kBuilding, reflectance);
  }

  /// The floor's height: above the ground all around.
  double FloorHeight(const Footprint& f) const {
    double height = LawnHeight(f.x, f.y);
    for (const double along : {-f.half_length, f.half_length}) {
      for (const double across : {-f.half_width, f.half_width}) {
        const auto place = f.Place(along, across);
        height = std::max(height, LawnHeight(place[0], place[1]));
      }
    }
    return height + 0.15;
  }

  void AddBuilding(const Footprint& f, int storeys, Roof roof, bool ledges) {
    footprints_.push_back(f);
    const double floor = FloorHeight(f);
    const double eaves = storeys * kStoreyHeight + 0.4;
    const auto wall_reflectance = static_cast<float>(Uniform(0.35, 0.8));
    const auto trim_reflectance = static_cast<float>(Uniform(0.5, 0.9));
    constexpr double kFoundation = 4;
    Polyhedron hull = UprightBox({f.x, f.y, floor - kFoundation}, f.half_length,
                                 f.half_width, kFoundation + eaves, f.yaw);
    hull.reflectance = wall_reflectance;
    hull.openings.center = {f.x, f.y, floor + 0.9};
    hull.openings.row_count = storeys;
    hull.openings.width = Uniform(1.0, 1.6);
    hull.openings.depth = Uniform(0.15, 0.3);
    hull.openings.column_spacing = Uniform(2.4, 3.4);
    const auto columns = [&](double half_edge) {
      return static_cast<int>((2 * half_edge - 1.5) /
                              hull.openings.column_spacing);
    };
    hull.openings.column_counts = {columns(f.half_width),
                                   columns(f.half_length)};
    if (roof != Roof::kFlat) {
      // Slopes through the eaves take the place of top and base.
      const double pitch = Uniform(0.5, 0.75);
      hull.face_count = 4;
      for (size_t side = roof == Roof::kHip ? 0 : 1; side < 4;
           side += roof == Roof::kHip ? 1 : 2) {
        const HalfSpace wall = hull.faces[side];
        hull.AddFace(
            {wall.normal[0] * std::sin(pitch), wall.normal[1] * std::sin(pitch),
             std::cos(pitch)},
            wall.offset * std::sin(pitch) + (floor + eaves) * std::cos(pitch));
      }
      hull.max_corner.z = floor + eaves + f.half_width * std::tan(pitch);
    }
    scene_.polyhedra.push_back(hull);

    AddBand(f, 0.12, floor - kFoundation, kFoundation + 0.4, trim_reflectance);
    if (roof == Roof::kFlat) {
      AddBand(f, 0.3, floor + eaves - 0.35, 0.5, trim_reflectance);
    }
    if (ledges) {
      for (int storey = 1; storey < storeys; ++storey) {
        AddBand(f, 0.15, floor + storey * kStoreyHeight - 0.4, 0.22,
                trim_reflectance);
      }
    }
    AddEntrance(f, floor, trim_reflectance);
  }

  /// Steps and a canopy on two posts before the middle of a long side.
  void AddEntrance(const Footprint& f, double floor, float reflectance) {
    const double side = Chance(0.5) ? 1 : -1;
    for (int step = 0; step < 3; ++step) {
      const double depth = 1.5 + 0.35 * (2 - step);
      const auto place = f.Place(0, side * (f.half_width + depth / 2));
      AddBox({place[0], place[1], floor - 2}, 1.4, depth / 2, 1.7 + 0.15 * step,
             f.yaw, ObjectClass::kBuilding, reflectance);
    }
    const auto middle = f.Place(0, side * (f.half_width + 0.9));
    AddBox({middle[0], middle[1], floor + 2.55}, 1.6, 0.9, 0.2, f.yaw,
           ObjectClass::kBuilding, reflectance);
    for (const double along : {-1.3, 1.3}) {
      const auto post = f.Place(along, side * (f.half_width + 1.4));
      scene_.cylinders.push_back({{post[0], post[1], floor - 1},
                                  0.07,
                                  3.6,
                                  ObjectClass::kBuilding,
                                  reflectance});
    }
  }

  void AddTree(double x, double y, double size) {
    const double ground = LawnHeight(x, y);
    const double trunk = size * Uniform(2.3, 3.2);
    const double half_height = size * Uniform(1.7, 2.7);
    const double spread = size * Uniform(1.6, 2.4);
    scene_.cylinders.push_back({{x, y, ground - 0.5},
                                size * Uniform(0.12, 0.22),
                                0.5 + trunk + half_height,
                                ObjectClass::kVegetation,
                                0.35F});
    const double density = Uniform(0.4, 0.9);
    const auto reflectance = static_cast<float>(Uniform(0.35, 0.6));
    const auto add_crown = [&](const Point3& center, const Vector3& radii) {
      scene_.crowns.push_back(
          {center, radii, density, reflectance, static_cast<int64_t>(Draw())});
    };
    const double top = ground + trunk + 0.85 * half_height;
    add_crown({x, y, top}, {spread, spread, half_height});
    for (int i = 0; i < 3; ++i) {
      const double bearing = Uniform(0, 2 * kPi);
      const double out = spread * Uniform(0.5, 0.9);
      const double part = Uniform(0.4, 0.7);
      add_crown({x + out * std::cos(bearing), y + out * std::sin(bearing),
                 top + half_height * Uniform(-0.4, 0.5)},
                {part * spread, part * spread, part * half_height});
    }
  }

  void AddLamp(double x, double y, double arm_yaw) {
    const double ground = LawnHeight(x, y);
    const double height = Uniform(5.5, 7.5);
    scene_.cylinders.push_back({{x, y, ground - 0.2},
                                Uniform(0.06, 0.1),
                                height + 0.2,
                                ObjectClass::kPole,
                                0.4F});
    AddBox({x + 0.6 * std::cos(arm_yaw), y + 0.6 * std::sin(arm_yaw),
            ground + height},
           0.75, 0.12, 0.15, arm_yaw, ObjectClass::kPole, 0.4F);
  }

  void AddSign(double x, double y, double yaw) {
    const double ground = LawnHeight(x, y);
    scene_.cylinders.push_back(
        {{x, y, ground - 0.2}, 0.035, 2.9, ObjectClass::kPole, 0.4F});
    AddBox({x, y, ground + 2.1}, 0.05, 0.3, 0.6, yaw, ObjectClass::kPole, 0.9F);
  }

  void AddCar(double x, double y, double ground, double yaw) {
    const double half_length = Uniform(1.95, 2.35);
    const double half_width = Uniform(0.84, 0.93);
    const double hood = Uniform(0.82, 0.95);
    const auto paint = static_cast<float>(Uniform(0.1, 0.8));
    AddBox({x, y, ground + 0.22}, half_length, half_width, hood - 0.22, yaw,
           ObjectClass::kCar, paint);
    // The cabin: a box whose sides lean inwards.
    const double height = Uniform(0.5, 0.75);
    const double back = Uniform(0.1, 0.4);
    const double cabin_x = x - back * std::cos(yaw);
    const double cabin_y = y - back * std::sin(yaw);
    Polyhedron cabin =
        UprightBox({cabin_x, cabin_y, ground + hood}, 0.62 * half_length,
                   half_width - 0.03, height, yaw);
    for (size_t side = 0; side < 4; ++side) {
      HalfSpace& face = cabin.faces[side];
      const double lean = side % 2 == 0 ? 0.75 : 0.2;
      face.normal = {face.normal[0] * std::cos(lean),
                     face.normal[1] * std::cos(lean), std::sin(lean)};
      face.offset =
          face.offset * std::cos(lean) + (ground + hood) * std::sin(lean);
    }
    cabin.object = ObjectClass::kCar;
    cabin.reflectance = paint;
    scene_.polyhedra.push_back(cabin);
  }

  /// Trees at random places of the lawn, away from buildings and each other.
  void PlantLawn(int count, double min_distance) {
    std::vector<std::array<double, 2>> trees;
    for (int i = 0; i < count; ++i) {
      const double x = corner_x_ + Uniform(kLawnMin + 1, kLawnMaxX - 1);
      const double y = corner_y_ + Uniform(kLawnMin + 1, kLawnMaxY - 1);
      const bool free =
          std::ranges::none_of(
              footprints_,
              [&](const Footprint& f) { return f.Contains(x, y, 3); }) &&
          std::ranges::none_of(trees, [&](const std::array<double, 2>& t) {
            return std::hypot(t[0] - x, t[1] - y) < min_distance;
          });
      if (!free) continue;
      trees.push_back({x, y});
      AddTree(x, y, Uniform(0.7, 1.2));
    }
  }

  void BuildHall() {
    Footprint f;
    f.half_length = Uniform(16, 22);
    f.half_width = Uniform(8, 12);
    f.x = corner_x_ + 36 + Uniform(-2, 2);
    f.y = corner_y_ + 28 + Uniform(-2, 2);
    f.yaw = Uniform(-0.08, 0.08);
    AddBuilding(f, Integer(2, 5), Chance(0.7) ? Roof::kFlat : Roof::kHip,
                Chance(0.7));
    PlantLawn(14, 5);
  }

  void BuildWings() {
    const double yaw = Uniform(-0.05, 0.05);
    const Footprint main = {corner_x_ + 34, corner_y_ + 19, Uniform(16, 20),
                            Uniform(5.5, 7), yaw};
    AddBuilding(main, Integer(3, 4), Chance(0.5) ? Roof::kFlat : Roof::kGable,
                Chance(0.5));
    const double side = Chance(0.5) ? 1 : -1;
    const auto place = main.Place(side * (main.half_length - 6), 12);
    const Footprint wing = {place[0], place[1], Uniform(9, 10.5),
                            Uniform(4.5, 5.5), yaw + kPi / 2};
    AddBuilding(wing, Integer(2, 3), Chance(0.5) ? Roof::kFlat : Roof::kGable,
                Chance(0.5));
    PlantLawn(12, 5);
  }

  void BuildHouses() {
    for (int i = 0; i < 3; ++i) {
      const Footprint f = {corner_x_ + 19 + 17 * i + Uniform(-1, 1),
                           corner_y_ + 28 + Uniform(-7, 7), Uniform(5, 6),
                           Uniform(3.8, 4.8),
                           Uniform(-0.15, 0.15) + (Chance(0.5) ? kPi / 2 : 0)};
      AddBuilding(f, Integer(1, 2), Chance(0.6) ? Roof::kGable : Roof::kHip,
                  false);
    }
    PlantLawn(22, 4);
  }

  void BuildGrove() {
    const Footprint pavilion = {corner_x_ + 36, corner_y_ + 28, 3.5, 3.5,
                                Uniform(0, kPi)};
    footprints_.push_back(pavilion);
    const double floor = FloorHeight(pavilion);
    AddBand(pavilion, 0, floor - 2, 2, 0.6F);
    AddBand(pavilion, 0.4, floor + 2.8, 0.25, 0.6F);
    for (const double along : {-3.2, 3.2}) {
      for (const double across : {-3.2, 3.2}) {
        const auto post = pavilion.Place(along, across);
        scene_.cylinders.push_back({{post[0], post[1], floor},
                                    0.1,
                                    2.8,
                                    ObjectClass::kBuilding,
                                    0.6F});
      }
    }
    PlantLawn(60, 4.5);
  }

  void BuildCarPark() {
    for (const double row : {14.5, 22.0, 34.0, 41.5}) {
      for (double x = 14; x < 60; x += 2.7) {
        if (!Chance(0.65)) continue;
        const double px = corner_x_ + x + Uniform(-0.15, 0.15);
        const double py = corner_y_ + row + Uniform(-0.3, 0.3);
        AddCar(px, py, LawnHeight(px, py),
               (Chance(0.5) ? kPi / 2 : -kPi / 2) + Uniform(-0.04, 0.04));
      }
    }
    for (const double x : {16.0, 36.0, 56.0}) {
      AddLamp(corner_x_ + x, corner_y_ + 28, Chance(0.5) ? kPi / 2 : -kPi / 2);
      AddTree(corner_x_ + x - 4, corner_y_ + 28, Uniform(0.6, 0.9));
    }
  }

  /// Trees, lamps and signs on the pavements, cars along the kerbs.
  void FurnishStreets() {
    constexpr double kTreeLine = Campus::kStreetWidth + 1.4;
    constexpr double kLampLine = Campus::kStreetWidth + 0.5;
    for (double x = 14; x < 60; x += Uniform(8, 12)) {
      if (Chance(0.5)) {
        AddTree(corner_x_ + x, corner_y_ + kTreeLine, Uniform(0.8, 1.15));
      }
      if (Chance(0.5)) {
        AddTree(corner_x_ + x + 2, corner_y_ + Campus::kBlockY - 1.4,
                Uniform(0.8, 1.15));
      }
    }
    for (double y = 14; y < 44; y += Uniform(8, 12)) {
      if (Chance(0.4)) {
        AddTree(corner_x_ + kTreeLine, corner_y_ + y, Uniform(0.8, 1.15));
      }
    }
    for (const double x : {11.0, 29.0, 47.0}) {
      AddLamp(corner_x_ + x, corner_y_ + kLampLine, -kPi / 2);
    }
    for (const double y : {22.0, 40.0}) {
      AddLamp(corner_x_ + kLampLine, corner_y_ + y, kPi);
    }
    AddSign(corner_x_ + kLampLine, corner_y_ + kLampLine + 1.5, 0);
    AddSign(corner_x_ + Campus::kBlockX - 0.5, corner_y_ + kLampLine, kPi / 2);
    // Cars stand clear of the crossings and of the middle of the street.
    constexpr double kParkingLine = Campus::kStreetWidth - 1.15;
    for (double x = 16; x < 57; x += Uniform(5.6, 7)) {
      if (!Chance(0.5)) continue;
      const double px = corner_x_ + x;
      const double py = corner_y_ + kParkingLine + Uniform(-0.1, 0.1);
      AddCar(px, py, campus_.TerrainHeight(px, py), Uniform(-0.03, 0.03));
    }
    for (double y = 16; y < 41; y += Uniform(5.6, 7)) {
      if (!Chance(0.4)) continue;
      const double px = corner_x_ + 1.15 + Uniform(-0.1, 0.1);
      const double py = corner_y_ + y;
      AddCar(px, py, campus_.TerrainHeight(px, py),
             kPi / 2 + Uniform(-0.03, 0.03));
    }
  }

  const Campus& campus_;
  uint64_t seed_;
  int64_t block_x_;
  int64_t block_y_;
  double corner_x_;
  double corner_y_;
  SceneDescription& scene_;
  int64_t draw_count_ = 0;
  std::vector<Footprint> footprints_;
};

}  // namespace

void AddBlock(const Campus& campus, uint64_t seed, int64_t block_x,
              int64_t block_y, SceneDescription& scene) {
  BlockBuilder(campus, seed, block_x, block_y, scene).Build();
}

}  // namespace mapsieve::client
