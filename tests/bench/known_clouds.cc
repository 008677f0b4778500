#include "tests/bench/known_clouds.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <optional>
#include <random>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "client/lab/ball_counter.h"
#include "client/lab/campus.h"
#include "client/lab/scene.h"
#include "client/lab/simulate.h"
#include "client/lab/spinning_scanner.h"
#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"

namespace mapsieve::bench {
namespace {

using client::Cylinder;
using client::ObjectClass;
using core::Label;
using core::LatticePoint;
using core::Point3;

/// Points of one body do not keep each other from being clear; points of kAir
/// keep none.
enum class Body : uint8_t {
  kAir,
  kGround,
  kWall,
  kPost,
  kTree,
  kCar,
  kEdge,
  kCount,
};

/// What is known of one point.
struct Subject {
  Body body = Body::kAir;
  /// Its kind if it is clear, and if not.
  uint8_t clear_kind = 0;
  uint8_t other_kind = 0;
};

/// Gives kinds their numbers.
class KindTable {
 public:
  uint8_t Number(const Kind& kind) {
    const auto [at, is_new] =
        numbers_.try_emplace(kind.name, static_cast<uint8_t>(kinds_.size()));
    if (is_new) kinds_.push_back(kind);
    return at->second;
  }
  Subject Of(Body body, const Kind& kind) {
    const uint8_t number = Number(kind);
    return {body, number, number};
  }
  Subject OfClear(Body body, const Kind& clear, const Kind& other) {
    return {body, Number(clear), Number(other)};
  }
  std::vector<Kind> Take() { return std::move(kinds_); }

 private:
  std::map<std::string, uint8_t> numbers_;
  std::vector<Kind> kinds_;
};

/// Tells of each of `points` whether it is clear.
std::vector<bool> FindClear(const std::vector<LatticePoint>& points,
                            const std::vector<Subject>& subjects, double step) {
  const double radius = kClearance / step;
  const auto radius_d2 = static_cast<int64_t>(radius * radius);
  std::vector<bool> clear(points.size());
  for (int number = 1; number < static_cast<int>(Body::kCount); ++number) {
    const auto body = static_cast<Body>(number);
    std::vector<LatticePoint> others;
    for (size_t i = 0; i < points.size(); ++i) {
      if (subjects[i].body != body && subjects[i].body != Body::kAir) {
        others.push_back(points[i]);
      }
    }
    const client::BallCounter counter(std::move(others));
    for (size_t i = 0; i < points.size(); ++i) {
      if (subjects[i].body != body) continue;
      clear[i] = counter.Count(points[i], radius_d2) == 0;
    }
  }
  return clear;
}

KnownCloud MakeKnownCloud(std::string name, core::LatticeCloud cloud,
                          const std::vector<Subject>& subject_of_row,
                          KindTable kinds) {
  const std::vector<uint32_t> rows = core::MergeDuplicates(cloud);
  std::vector<Subject> subjects;
  subjects.reserve(rows.size());
  for (const uint32_t row : rows) subjects.push_back(subject_of_row[row]);
  KnownCloud known{.name = std::move(name),
                   .cloud = cloud.Select(rows),
                   .kinds = kinds.Take()};
  const std::vector<bool> clear =
      FindClear(known.cloud.positions, subjects, cloud.lattice.step());
  for (size_t i = 0; i < subjects.size(); ++i) {
    known.kind_of.push_back(clear[i] ? subjects[i].clear_kind
                                     : subjects[i].other_kind);
  }
  return known;
}

Kind PostKind(const std::string& radius_cm, double radius_m) {
  return {"post, r " + radius_cm + " cm", Label::kCurve, radius_m};
}

/// The post that a place is on, up to range noise.
const Cylinder* FindPost(const std::vector<Cylinder>& posts, double x,
                         double y) {
  constexpr double kNoise = 0.06;
  for (const Cylinder& post : posts) {
    if (std::hypot(x - post.base.x, y - post.base.y) < post.radius + kNoise) {
      return &post;
    }
  }
  return nullptr;
}

/// `post`: the kind of the post that a point of a pole lies on, if it does.
Subject SimulatedSubject(ObjectClass object, Label truth,
                         const std::optional<Kind>& post, KindTable& kinds) {
  switch (object) {
    case ObjectClass::kNoise:
      return kinds.Of(Body::kAir, {"stray"});
    case ObjectClass::kCar:
      return kinds.Of(Body::kCar, {"car"});
    case ObjectClass::kVegetation:
      return kinds.Of(Body::kTree, {truth == Label::kNone ? "crown" : "trunk"});
    case ObjectClass::kPole:
      // The rest are arms of lamps and plates of signs.
      return post && truth == Label::kCurve
                 ? kinds.OfClear(Body::kPost, *post, {"post, other"})
                 : kinds.Of(Body::kEdge, {"post, other"});
    case ObjectClass::kGround:
    case ObjectClass::kBuilding:
      break;
  }
  const bool is_ground = object == ObjectClass::kGround;
  if (truth == Label::kJunction) return kinds.Of(Body::kEdge, {"corner"});
  if (truth == Label::kCurve) {
    return kinds.Of(Body::kEdge, {is_ground ? "edge, ground" : "edge, wall"});
  }
  const std::string name = is_ground ? "ground" : "wall";
  return kinds.OfClear(is_ground ? Body::kGround : Body::kWall,
                       {name, Label::kSurface}, {name + ", other"});
}

/// The campus' posts in the frame of the survey that `scanner` takes with
/// `options`, which the drive through both tells.
std::vector<Cylinder> CampusPosts(const client::CampusScanner& scanner,
                                  const client::SimulateOptions& options) {
  constexpr int64_t kFarRotation = 15;
  const Point3 from = client::SpiralDrive(0);
  const Point3 to =
      client::SpiralDrive(kFarRotation * options.rotation_spacing_m);
  const Point3 map_from = scanner.Rotation(0).start;
  const Point3 map_to = scanner.Rotation(kFarRotation).start;
  const double yaw = std::atan2(map_to.y - map_from.y, map_to.x - map_from.x) -
                     std::atan2(to.y - from.y, to.x - from.x);
  std::vector<Cylinder> cylinders =
      client::Campus(options.seed)
          .Surroundings(0, 0, 3 * options.max_range_m)
          .cylinders;
  for (Cylinder& cylinder : cylinders) {
    const double x = cylinder.base.x - from.x;
    const double y = cylinder.base.y - from.y;
    cylinder.base.x = map_from.x + std::cos(yaw) * x - std::sin(yaw) * y;
    cylinder.base.y = map_from.y + std::sin(yaw) * x + std::cos(yaw) * y;
  }
  std::erase_if(cylinders, [](const Cylinder& cylinder) {
    return cylinder.object != ObjectClass::kPole;
  });
  return cylinders;
}

absl::StatusOr<std::string> ReadFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) {
    return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  }
  return std::string(std::istreambuf_iterator<char>(file), {});
}

}  // namespace

absl::StatusOr<KnownCloud> CampusCloud(Scenes scenes, double range_noise_m) {
  client::SimulateOptions options = {.range_noise_m = range_noise_m};
  if (scenes == Scenes::kHeldOut) options.seed = 20261125;
  MAPSIEVE_ASSIGN_OR_RETURN(client::CampusScanner scanner,
                            client::CampusScanner::Create(options));
  const std::vector<Cylinder> posts = CampusPosts(scanner, options);
  MAPSIEVE_ASSIGN_OR_RETURN(
      const core::PointCloud survey,
      scanner.NextBatch(static_cast<size_t>(options.point_count)));
  const core::Column& classes = *survey.attributes.Find("classification");
  const core::Column& truths = *survey.attributes.Find("truth");
  KindTable kinds;
  std::vector<Subject> subjects;
  for (size_t i = 0; i < survey.size(); ++i) {
    const auto object = static_cast<ObjectClass>(classes.Get<uint8_t>(i));
    const Point3& p = survey.positions[i];
    std::optional<Kind> post;
    if (object == ObjectClass::kPole) {
      if (const Cylinder* at = FindPost(posts, p.x, p.y)) {
        // Posts of signs, and of lamps.
        post = at->radius < 0.05 ? PostKind("3.5", at->radius)
                                 : PostKind("6 to 10", 0.1);
      }
    }
    subjects.push_back(SimulatedSubject(
        object, static_cast<Label>(truths.Get<uint8_t>(i)), post, kinds));
  }
  core::RefusedCounts refused;
  core::LatticeCloud cloud = core::Quantize(survey, core::Lattice(), refused);
  if (refused.total() != 0) {
    return absl::InternalError("the survey does not fit the lattice");
  }
  cloud.attributes = {};
  return MakeKnownCloud("campus", std::move(cloud), subjects, std::move(kinds));
}

absl::StatusOr<KnownCloud> YardCloud(Scenes scenes, double range_noise_m) {
  const bool held_out = scenes == Scenes::kHeldOut;
  client::SceneDescription description;
  description.ground = client::Ground::Flat(12, 0);
  // Two walls that meet at (5, 5), and a kiosk.
  description.polyhedra = {client::UprightBox({6, 0, -1}, 1, 9, 5, 0),
                           client::UprightBox({-2, 6, -1}, 7, 1, 5, 0),
                           client::UprightBox({-4, -4, -1}, 1, 0.75, 3.5, 0.3)};
  std::array radii = {0.01, 0.02, 0.04, 0.08};
  if (held_out) {
    // A passage between walls that are not parallel, and a booth.
    description.polyhedra = {
        client::UprightBox({5, 0, -1}, 0.5, 8, 4, 0.15),
        client::UprightBox({-6.5, 1, -1}, 0.5, 8, 6, -0.1),
        client::UprightBox({1, -4.5, -1}, 1.2, 0.6, 3.5, -0.7)};
    radii = {0.008, 0.015, 0.03, 0.06};
  }
  double x = -3.5;
  for (const double radius : radii) {
    description.cylinders.push_back(
        {{x, 2, -0.5}, radius, 4, ObjectClass::kPole, 0.5F});
    x += 2;
  }
  const std::vector<Cylinder> posts = description.cylinders;
  client::Scene scene(std::move(description));
  const client::SpinningScanner scanner(
      {.range_noise_m = range_noise_m, .spurious_share = 0});
  std::mt19937_64 random(held_out ? 2 : 1);
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * static_cast<double>(random() >> 11) * 0x1p-53;
  };
  constexpr int kRotationCount = 80;
  KindTable kinds;
  core::LatticeCloud cloud;
  std::vector<Subject> subjects;
  for (int rotation = 0; rotation < kRotationCount; ++rotation) {
    const client::ScannerRotation turn = {
        .index = rotation,
        .start = {uniform(-4, 4), uniform(-2.5, 1), uniform(1.2, 2.2)}};
    for (int pulse = 0; pulse < client::SpinningScanner::kPulseCount; ++pulse) {
      const auto echo = scanner.Fire(scene, turn, pulse);
      if (!echo) continue;
      const auto q = cloud.lattice.Quantize(echo->position);
      if (!q) return absl::InternalError("the yard does not fit the lattice");
      cloud.positions.push_back(*q);
      std::optional<Kind> post;
      if (const Cylinder* at =
              FindPost(posts, echo->position.x, echo->position.y)) {
        post = PostKind(absl::StrCat(at->radius * 100), at->radius);
      }
      subjects.push_back(
          SimulatedSubject(echo->object, echo->truth, post, kinds));
    }
  }
  return MakeKnownCloud("yard", std::move(cloud), subjects, std::move(kinds));
}

absl::StatusOr<KnownCloud> ReferenceCloud(const std::string& path,
                                          double split_range_m) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::string points, ReadFile(path));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::string truth, ReadFile(path + ".truth"));
  constexpr size_t kPointSize = 3 * sizeof(float);
  if (points.size() != truth.size() * kPointSize) {
    return absl::DataLossError(absl::StrCat(
        path, ": ", points.size(), " bytes; expected ", kPointSize,
        " for each of the ", truth.size(), " points of its .truth"));
  }
  KindTable kinds;
  core::LatticeCloud cloud;
  std::vector<Subject> subjects;
  for (size_t i = 0; i < truth.size(); ++i) {
    const auto coordinate = [&](size_t axis) {
      return double{LoadLittleEndian<float>(
          TextBytes(points).data() + i * kPointSize + axis * sizeof(float))};
    };
    const Point3 p = {coordinate(0), coordinate(1), coordinate(2)};
    const auto q = cloud.lattice.Quantize(p);
    const auto label = static_cast<uint8_t>(truth[i]);
    if (!q || label >= core::kLabelCount) {
      return absl::DataLossError(absl::StrCat(
          path, ": point ", i, " is not a place with a truth of 0 to 3"));
    }
    cloud.positions.push_back(*q);
    const bool is_far =
        split_range_m > 0 && std::hypot(p.x, p.y) > split_range_m;
    switch (static_cast<Label>(label)) {
      case Label::kNone:
        subjects.push_back(kinds.Of(Body::kAir, {"foliage, noise"}));
        break;
      case Label::kJunction:
        subjects.push_back(kinds.Of(Body::kEdge, {"junction"}));
        break;
      case Label::kCurve:
        subjects.push_back(kinds.Of(Body::kEdge, {"curve"}));
        break;
      case Label::kSurface:
        subjects.push_back(kinds.OfClear(
            Body::kWall,
            is_far ? Kind{absl::StrCat("surface, beyond ", split_range_m, " m")}
                   : Kind{"surface", Label::kSurface},
            {"surface, other"}));
        break;
    }
  }
  return MakeKnownCloud(std::filesystem::path(path).stem().string(),
                        std::move(cloud), subjects, std::move(kinds));
}

}  // namespace mapsieve::bench
