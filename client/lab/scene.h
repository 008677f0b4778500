#ifndef MAPSIEVE_CLIENT_LAB_SCENE_H_
#define MAPSIEVE_CLIENT_LAB_SCENE_H_

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/cloud/label.h"
#include "core/geometry/lattice.h"
#include "core/geometry/vector3.h"

/// A world of simple bodies and the rays that meet it. Lengths are metres;
/// z is up. A scene has a frame of its own; nothing here knows of maps.
namespace mapsieve::client {

/// What a point belongs to: the LAS classification of the ASPRS, and codes of
/// the range left to users (64 and above) where it has none.
enum class ObjectClass : uint8_t {
  kGround = 2,
  kVegetation = 5,
  kBuilding = 6,
  kNoise = 7,
  kPole = 64,
  kCar = 65,
};

/// The truth that the filter's labels are an estimate of: a point within
/// kTruthRadius of a place where three planes meet is a junction; of a line
/// where two meet, or on a cylinder, a curve; foliage and noise have none.
inline constexpr double kTruthRadius = 0.05;

/// The half space normal · p <= offset; `normal` is a unit vector.
struct HalfSpace {
  core::Vector3 normal = {0, 0, 1};
  double offset = 0;
};

/// Rows and columns of rectangular openings, recessed into the four vertical
/// faces 0 to 3 of a polyhedron. On every face the columns are centred on
/// `center`, as seen along the face's normal; a row's lower edge lies at
/// center.z + row * row_spacing.
struct Openings {
  core::Point3 center;
  /// Columns on the faces 0 and 2, and on 1 and 3. 0: none.
  std::array<int, 2> column_counts = {0, 0};
  int row_count = 0;
  double width = 1.2;
  double height = 1.5;
  double depth = 0.18;
  double column_spacing = 3;
  double row_spacing = 3.2;
};

/// A convex body: the points in all of its half spaces, without the openings.
struct Polyhedron {
  static constexpr int kMaxFaceCount = 8;

  std::array<HalfSpace, kMaxFaceCount> faces;
  int face_count = 0;
  core::Point3 min_corner;
  core::Point3 max_corner;
  ObjectClass object = ObjectClass::kBuilding;
  /// Share of light that comes back at normal incidence, 0 to 1.
  float reflectance = 0.5F;
  Openings openings;

  void AddFace(const core::Vector3& normal, double offset) {
    faces[static_cast<size_t>(face_count++)] = {normal, offset};
  }
};

/// A box that stands upright: centre of its base, half edges along its own
/// axes, height, and the angle from x to its first axis in radians. Faces 0 to
/// 3 are +first, +second, -first, -second axis; 4 is the top, 5 the base.
Polyhedron UprightBox(const core::Point3& base, double half_length,
                      double half_width, double height, double yaw);

/// A vertical cylinder without its ends.
struct Cylinder {
  core::Point3 base;
  double radius = 0.1;
  double height = 1;
  ObjectClass object = ObjectClass::kPole;
  float reflectance = 0.5F;
};

/// An ellipsoid of foliage. Light that crosses it is caught anywhere on its
/// way, with a chance of `density` a metre.
struct Crown {
  core::Point3 center;
  core::Vector3 radii = {1, 1, 1};
  double density = 1;
  float reflectance = 0.4F;
  /// Keys the draws: crowns of one scene have different ones.
  int64_t id = 0;
};

/// The ground: cells of kCellSize, each a bilinear patch between its four
/// corners, raised by the cell's step. Where neighbours have different steps a
/// vertical face (a kerb) joins them.
struct Ground {
  static constexpr double kCellSize = 2;

  /// Cell (0, 0) spans [min_x, min_x + 1] x [min_y, min_y + 1] cell sizes.
  int64_t min_x = 0;
  int64_t min_y = 0;
  int size_x = 0;
  int size_y = 0;
  /// (size_x + 1) * (size_y + 1) heights, row by row (x runs fastest).
  std::vector<float> corners;
  /// size_x * size_y of each, row by row.
  std::vector<float> steps;
  std::vector<float> reflectances;

  /// Flat ground at height z around the origin, `half_edge` rounded up to
  /// cells.
  static Ground Flat(double half_edge, double z);
};

struct SceneDescription {
  Ground ground;
  std::vector<Polyhedron> polyhedra;
  std::vector<Cylinder> cylinders;
  std::vector<Crown> crowns;
};

/// The first thing that a ray meets.
struct SceneHit {
  double range = 0;
  /// Cosine of the angle between ray and surface normal; 1 in foliage.
  double cos_incidence = 1;
  float reflectance = 0;
  ObjectClass object = ObjectClass::kGround;
  core::Label truth = core::Label::kNone;
};

/// The light's identity, which keys the draws in foliage.
struct PulseKey {
  uint64_t seed = 0;
  int64_t pulse = 0;
};

/// A scene made ready for rays: the bodies sorted into the cells of its ground.
/// Not thread-safe (a cast notes which bodies it has tested).
class Scene {
 public:
  /// Bodies, or parts of them, that lie outside the ground's extent are not
  /// seen.
  explicit Scene(SceneDescription description);

  const SceneDescription& description() const { return description_; }

  /// Height of the ground at a place of its extent.
  double GroundHeight(double x, double y) const;

  /// What a ray from `origin` along the unit vector `direction` meets within
  /// `max_range`; nothing beyond the ground's extent. Surfaces are met from
  /// outside. The same call gives the same answer, whatever was cast before.
  std::optional<SceneHit> Cast(const core::Point3& origin,
                               const core::Vector3& direction, double max_range,
                               const PulseKey& key);

 private:
  /// What one cell of the ground holds.
  struct Cell {
    /// Heights at its corners: x and y min, x max, y max, both max.
    std::array<float, 4> corners;
    float ground_top = 0;
    /// No body of the cell is higher.
    float top = 0;
    uint32_t first_body = 0;
    uint32_t body_count = 0;
  };
  enum class Kind : uint8_t {
    kNothing,
    kGround,
    kPolyhedron,
    kCylinder,
    kCrown
  };
  struct Ray;
  struct Nearest;

  size_t CellIndex(int x, int y) const {
    return static_cast<size_t>(y) * static_cast<size_t>(size_x_) +
           static_cast<size_t>(x);
  }
  /// The cell of a place, which may lie outside the extent.
  int CellX(double x) const;
  int CellY(double y) const;
  void SortBodiesIntoCells();

  void MeetGround(const Ray& ray, int x, int y, double enter, double leave,
                  Nearest& nearest) const;
  void MeetPolyhedron(const Ray& ray, uint32_t index, Nearest& nearest) const;
  void MeetCylinder(const Ray& ray, uint32_t index, Nearest& nearest) const;
  void MeetCrown(const Ray& ray, uint32_t index, const PulseKey& key,
                 Nearest& nearest) const;
  void MeetBodies(const Ray& ray, const Cell& cell, const PulseKey& key,
                  Nearest& nearest);
  /// The truth at a point of the ground or of a polyhedron.
  core::Label TruthAt(const core::Point3& p) const;

  SceneDescription description_;
  int size_x_ = 0;
  int size_y_ = 0;
  double min_x_ = 0;
  double min_y_ = 0;
  float top_ = 0;
  std::vector<Cell> cells_;
  /// Bodies of all cells: polyhedra, then cylinders, then crowns count up.
  std::vector<uint32_t> cell_bodies_;
  /// The last cast that tested each body.
  std::vector<uint64_t> last_cast_;
  uint64_t cast_count_ = 0;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_SCENE_H_
