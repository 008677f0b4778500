#include "client/lab/scene.h"

#include <cmath>
#include <numbers>
#include <optional>
#include <utility>
#include <vector>

#include "client/lab/spinning_scanner.h"
#include "gtest/gtest.h"

namespace mapsieve::client {
namespace {

using core::Label;
using core::Point3;
using core::Vector3;
using std::numbers::pi;

constexpr double kTiny = 1e-9;

/// A scene of flat ground, at height 0 unless told.
SceneDescription FlatScene(double ground_z = 0) {
  SceneDescription scene;
  scene.ground = Ground::Flat(120, ground_z);
  return scene;
}

/// A box of 4 x 4 x 3 around (10, 0) with two windows on each face: columns at
/// -0.75 and 0.75, 1 m wide, sill at 1 m, 1 m high, 0.2 m deep.
SceneDescription WindowScene() {
  SceneDescription scene = FlatScene();
  Polyhedron box = UprightBox({10, 0, -1}, 2, 2, 4, 0);
  box.openings = {.center = {10, 0, 1},
                  .column_counts = {2, 2},
                  .row_count = 1,
                  .width = 1,
                  .height = 1,
                  .depth = 0.2,
                  .column_spacing = 1.5};
  scene.polyhedra.push_back(box);
  return scene;
}

/// What lies in the direction of `target` as seen from `eye`.
std::optional<SceneHit> Look(Scene& scene, const Point3& eye,
                             const Point3& target, double max_range = 100,
                             int64_t pulse = 0) {
  const Vector3 d = {target.x - eye.x, target.y - eye.y, target.z - eye.z};
  const double length = std::hypot(d[0], d[1], d[2]);
  return scene.Cast(eye, {d[0] / length, d[1] / length, d[2] / length},
                    max_range, {1, pulse});
}

/// The truth at `target`, which the ray from `eye` must reach.
Label TruthAt(Scene& scene, const Point3& eye, const Point3& target) {
  const auto hit = Look(scene, eye, target);
  if (!hit) {
    ADD_FAILURE() << "nothing met";
    return Label::kNone;
  }
  EXPECT_NEAR(hit->range,
              std::hypot(target.x - eye.x, target.y - eye.y, target.z - eye.z),
              1e-6);
  return hit->truth;
}

/// Slope of the least-squares line through (log x, log y).
double LogSlope(const std::vector<std::pair<double, double>>& points) {
  double sum_x = 0;
  double sum_y = 0;
  double sum_xx = 0;
  double sum_xy = 0;
  for (const auto& [x, y] : points) {
    const double u = std::log(x);
    const double v = std::log(y);
    sum_x += u;
    sum_y += v;
    sum_xx += u * u;
    sum_xy += u * v;
  }
  const auto n = static_cast<double>(points.size());
  return (n * sum_xy - sum_x * sum_y) / (n * sum_xx - sum_x * sum_x);
}

TEST(SceneTest, RayMeetsFlatGroundWhereGeometrySays) {
  Scene scene(FlatScene());
  const auto hit = Look(scene, {0.3, 0.7, 2}, {13.3, -20.3, 0});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->range, std::hypot(13, 21, 2), kTiny);
  EXPECT_NEAR(hit->cos_incidence, 2 / hit->range, kTiny);
  EXPECT_EQ(hit->object, ObjectClass::kGround);
  EXPECT_EQ(hit->truth, Label::kSurface);
}

TEST(SceneTest, RayMeetsBilinearGroundOnItsSurface) {
  SceneDescription description = FlatScene();
  for (size_t i = 0; i < description.ground.corners.size(); ++i) {
    const auto x = static_cast<double>(i % 121);
    const auto y = static_cast<double>(i / 121);
    description.ground.corners[i] =
        static_cast<float>(std::sin(x / 2) * std::cos(y / 3));
  }
  Scene scene(std::move(description));
  int met = 0;
  for (int i = 0; i < 2000; ++i) {
    const double azimuth = 0.01 + 0.7 * i;
    const double elevation = -0.3 + 0.0001 * i;
    const Vector3 d = {std::cos(elevation) * std::cos(azimuth),
                       std::cos(elevation) * std::sin(azimuth),
                       std::sin(elevation)};
    const Point3 eye = {0.3, 0.7, scene.GroundHeight(0.3, 0.7) + 2};
    const auto hit = scene.Cast(eye, d, 60, {1, i});
    // Above the ground all the way, on it at the end.
    const double end = hit ? hit->range : 60;
    for (double t = 0; t < end - 0.01; t += 0.01) {
      ASSERT_GT(eye.z + t * d[2],
                scene.GroundHeight(eye.x + t * d[0], eye.y + t * d[1]) - 1e-6)
          << "ray " << i << " at " << t;
    }
    if (!hit) continue;
    ++met;
    ASSERT_NEAR(eye.z + end * d[2],
                scene.GroundHeight(eye.x + end * d[0], eye.y + end * d[1]),
                1e-6);
  }
  EXPECT_GT(met, 1500);
}

TEST(SceneTest, NothingIsMetBeyondTheRange) {
  Scene scene(WindowScene());
  EXPECT_EQ(Look(scene, {0, 0, 1.5}, {8, 0, 1.5}, 7.99), std::nullopt);
  EXPECT_NE(Look(scene, {0, 0, 1.5}, {8, 0, 1.5}, 8.01), std::nullopt);
}

TEST(SceneTest, RayIntoTheSkyMeetsNothing) {
  Scene scene(WindowScene());
  EXPECT_EQ(Look(scene, {0, 0, 1}, {1, 0.1, 3}), std::nullopt);
  EXPECT_EQ(Look(scene, {0, 0, 1}, {0, 0, 2}), std::nullopt);
}

TEST(SceneTest, RayStraightDownMeetsTheGround) {
  Scene scene(FlatScene());
  const auto hit = Look(scene, {1, 1, 3}, {1, 1, 0});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->range, 3, kTiny);
}

TEST(SceneTest, TurnedBoxIsMetOnItsFaces) {
  SceneDescription description = FlatScene();
  // Its nearest edge, not a face, points to the eye.
  description.polyhedra.push_back(UprightBox({10, 0, 0}, 1, 1, 3, pi / 4));
  Scene scene(std::move(description));
  const auto hit = Look(scene, {0, 0, 1}, {10, 0, 1});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->range, 10 - std::sqrt(2), kTiny);
  EXPECT_NEAR(hit->cos_incidence, std::sqrt(0.5), kTiny);
  EXPECT_EQ(hit->object, ObjectClass::kBuilding);
}

TEST(SceneTest, OpeningIsMetAtItsBackAndItsSides) {
  Scene scene(WindowScene());
  // Straight into the right-hand window of the face x = 8.
  auto hit = Look(scene, {0, 0.75, 1.5}, {8, 0.75, 1.5});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->range, 8.2, kTiny);
  // Obliquely at its side y = 1.25, after 0.1 m before the wall.
  hit = Look(scene, {7.9, 1, 1.5}, {8, 1.15, 1.5});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->range, std::hypot(0.25, 0.25 / 1.5), kTiny);
  EXPECT_NEAR(hit->cos_incidence, 0.25 / hit->range, kTiny);
  // Obliquely at its head z = 2.
  hit = Look(scene, {7.9, 0.75, 1.75}, {8, 0.75, 1.9});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->range, std::hypot(0.25, 0.25 / 1.5), kTiny);
  EXPECT_NEAR(hit->cos_incidence, 0.25 / hit->range, kTiny);
  // Between the windows there is wall.
  hit = Look(scene, {0, 0, 1.5}, {8, 0, 1.5});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->range, 8, kTiny);
}

TEST(SceneTest, CylinderIsMetBetweenItsEnds) {
  SceneDescription description = FlatScene();
  description.cylinders.push_back({{10, 0, 0}, 0.25, 2, ObjectClass::kPole});
  Scene scene(std::move(description));
  auto hit = Look(scene, {0, 0, 1}, {10, 0, 1});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->range, 9.75, kTiny);
  EXPECT_EQ(hit->object, ObjectClass::kPole);
  EXPECT_EQ(hit->truth, Label::kCurve);
  EXPECT_EQ(Look(scene, {0, 0, 2.1}, {10, 0, 2.1}), std::nullopt);
  EXPECT_EQ(Look(scene, {0, 0.26, 1}, {10, 0.26, 1}), std::nullopt);
}

TEST(SceneTest, FoliageThinsLightOutExponentially) {
  SceneDescription description = FlatScene(-50);
  description.crowns.push_back({{10, 0, 0}, {2, 3, 4}, 0.5, 0.4F, 77});
  Scene scene(std::move(description));
  constexpr int kPulses = 20000;
  int caught = 0;
  double depth_sum = 0;
  for (int i = 0; i < kPulses; ++i) {
    const auto hit = Look(scene, {0, 0, 0}, {10, 0, 0}, 100, i);
    if (!hit) continue;
    ++caught;
    EXPECT_EQ(hit->object, ObjectClass::kVegetation);
    EXPECT_EQ(hit->truth, Label::kNone);
    ASSERT_GE(hit->range, 8);
    ASSERT_LE(hit->range, 12);
    depth_sum += hit->range - 8;
  }
  // 4 m at 0.5 / m; the mean depth is that of a cut exponential law.
  const double through = std::exp(-2);
  EXPECT_NEAR(caught / double{kPulses}, 1 - through, 0.01);
  EXPECT_NEAR(depth_sum / caught, 2 - 4 * through / (1 - through), 0.04);
}

TEST(SceneTest, KerbIsMetFromTheStreetOnly) {
  SceneDescription description = FlatScene();
  Ground& ground = description.ground;
  for (size_t i = 0; i < ground.steps.size(); ++i) {
    if (i % static_cast<size_t>(ground.size_x) >= 60) ground.steps[i] = 0.12F;
  }
  Scene scene(std::move(description));
  const auto hit = Look(scene, {-5, 0.5, 1}, {0, 0.5, 0.06});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->range, std::hypot(5, 0.94), 1e-6);
  EXPECT_NEAR(hit->cos_incidence, 5 / hit->range, 1e-6);
  EXPECT_EQ(hit->truth, Label::kSurface);
  const Point3 street = {-5, 0.5, 1};
  const Point3 pavement = {5, 0.5, 1};
  const double top = 0.12F;
  EXPECT_EQ(TruthAt(scene, street, {0, 0.5, 0.02}), Label::kCurve);
  EXPECT_EQ(TruthAt(scene, street, {-0.03, 0.5, 0}), Label::kCurve);
  EXPECT_EQ(TruthAt(scene, street, {-0.3, 0.5, 0}), Label::kSurface);
  EXPECT_EQ(TruthAt(scene, pavement, {0.03, 0.5, top}), Label::kCurve);
  EXPECT_EQ(TruthAt(scene, pavement, {0.3, 0.5, top}), Label::kSurface);
  EXPECT_EQ(TruthAt(scene, pavement, {-2, 0.5, 0}), Label::kSurface);
}

TEST(SceneTest, TruthFollowsThePlanesNearThePoint) {
  Scene scene(WindowScene());
  const Point3 eye = {0, 0, 1.6};
  // On the wall x = 8, which ends at y = +-2 and z = 3.
  EXPECT_EQ(TruthAt(scene, eye, {8, 0, 2.5}), Label::kSurface);
  EXPECT_EQ(TruthAt(scene, eye, {8, 1.97, 1}), Label::kCurve);
  EXPECT_EQ(TruthAt(scene, eye, {8, 1.94, 1}), Label::kSurface);
  EXPECT_EQ(TruthAt(scene, eye, {8, 0, 2.97}), Label::kCurve);
  EXPECT_EQ(TruthAt(scene, eye, {8, 1.97, 2.97}), Label::kJunction);
  // Where wall and ground meet, seen from both.
  EXPECT_EQ(TruthAt(scene, eye, {8, 0, 0.03}), Label::kCurve);
  EXPECT_EQ(TruthAt(scene, eye, {7.97, 0, 0}), Label::kCurve);
  EXPECT_EQ(TruthAt(scene, eye, {8, 1.98, 0.02}), Label::kJunction);
  // The window from y = 0.25 to 1.25 and z = 1 to 2, 0.2 deep.
  EXPECT_EQ(TruthAt(scene, eye, {8, 0.22, 1.5}), Label::kCurve);
  EXPECT_EQ(TruthAt(scene, eye, {8, 0.22, 0.98}), Label::kJunction);
  EXPECT_EQ(TruthAt(scene, {0, 0.75, 1.6}, {8.2, 0.75, 1.5}), Label::kSurface);
  EXPECT_EQ(TruthAt(scene, {0, 0.75, 1.6}, {8.2, 0.27, 1.5}), Label::kCurve);
  EXPECT_EQ(TruthAt(scene, {0, 0.75, 1.6}, {8.2, 0.27, 1.03}),
            Label::kJunction);
  EXPECT_EQ(TruthAt(scene, {7, 0.75, 1.6}, {8.1, 1.25, 1.5}), Label::kSurface);
}

TEST(SceneTest, CastsDoNotDisturbEachOther) {
  Scene fresh(WindowScene());
  Scene used(WindowScene());
  for (int i = 0; i < 100; ++i) Look(used, {0, 0, 1}, {8, i * 0.1 - 5, 1});
  const auto a = Look(fresh, {0, 0, 1}, {8, 0.4, 1.2});
  const auto b = Look(used, {0, 0, 1}, {8, 0.4, 1.2});
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->range, b->range);
}

/// Counts what `want` accepts of full rotations at `count` heights from `low`
/// to `high`, so that the beams sweep over everything evenly.
template <typename Want>
void ForReturnsAtHeights(Scene& scene, double low, double high, int count,
                         const Want& want) {
  const SpinningScanner scanner({.range_noise_m = 0, .spurious_share = 0});
  for (int i = 0; i < count; ++i) {
    ScannerRotation rotation;
    rotation.index = i;
    rotation.start.z = low + (high - low) * (i + 0.5) / count;
    for (int pulse = 0; pulse < SpinningScanner::kPulseCount; ++pulse) {
      if (const auto echo = scanner.Fire(scene, rotation, pulse)) {
        want(*echo, rotation);
      }
    }
  }
}

/// Returns per steradian of a rotation, near the horizon.
constexpr double kHorizonDensity =
    SpinningScanner::kColumnCount / (2 * pi) * (180 / pi);

TEST(SpinningScannerTest, DensityOnAFacingWallFallsWithTheSquareOfRange) {
  std::vector<std::pair<double, double>> densities;
  for (const double range : {12.0, 16.0, 22.0, 32.0, 45.0, 64.0}) {
    SceneDescription description = FlatScene(-50);
    description.polyhedra.push_back(UprightBox({range + 1, 0, -1}, 1, 2, 2, 0));
    Scene scene(std::move(description));
    // The beams are spaced range degrees: the heights cover whole spacings.
    constexpr int kHeights = 24;
    const double spacing = range * pi / 180;
    int met = 0;
    ForReturnsAtHeights(scene, -spacing / 2, spacing / 2, kHeights,
                        [&](const ScannerReturn& echo, const ScannerRotation&) {
                          if (std::abs(echo.position.x - range) < 1e-6) ++met;
                        });
    const double density = met / (4.0 * 2.0 * kHeights);
    EXPECT_NEAR(density * range * range / kHorizonDensity, 1, 0.04) << range;
    densities.emplace_back(range, density);
  }
  EXPECT_NEAR(LogSlope(densities), -2, 0.03);
}

TEST(SpinningScannerTest, DensityAcrossTheBeamOnGroundFallsWithSquareOfRange) {
  Scene scene(FlatScene());
  constexpr int kHeights = 60;
  constexpr double kLow = 1.4;
  constexpr double kHigh = 2.2;
  constexpr double kMean = (kLow + kHigh) / 2;
  const double first = 5;
  const double ratio = 1.25;
  std::vector<double> counts(9);
  // Every return stands for the area across its beam; per area of ground that
  // is the cosine of incidence, height / range, and beams of equal elevation
  // steps crowd towards the zenith as 1 / cos(elevation).
  ForReturnsAtHeights(
      scene, kLow, kHigh, kHeights,
      [&](const ScannerReturn& echo, const ScannerRotation& rotation) {
        const double across = std::hypot(echo.position.x, echo.position.y);
        const double range = std::hypot(across, rotation.start.z);
        const auto bin = std::floor(std::log(across / first) / std::log(ratio));
        if (bin < 0 || bin >= static_cast<double>(counts.size())) return;
        counts[static_cast<size_t>(bin)] +=
            (range / rotation.start.z) * (across / range);
      });
  std::vector<std::pair<double, double>> densities;
  for (size_t bin = 0; bin < counts.size(); ++bin) {
    const double inner = first * std::pow(ratio, bin);
    const double outer = inner * ratio;
    const double area = pi * (outer * outer - inner * inner);
    densities.emplace_back(std::hypot(std::sqrt(inner * outer), kMean),
                           counts[bin] / area);
  }
  EXPECT_NEAR(LogSlope(densities), -2, 0.06);
}

TEST(SpinningScannerTest, BeamTableIsTheDocumentedOne) {
  EXPECT_EQ(SpinningScanner::kBeamCount, 64);
  EXPECT_EQ(SpinningScanner::BeamElevationDeg(0), -25);
  EXPECT_EQ(SpinningScanner::BeamElevationDeg(25), 0);
  EXPECT_EQ(SpinningScanner::BeamElevationDeg(63), 38);
}

TEST(SpinningScannerTest, NothingNearerThanTheLeastRangeComesBack) {
  // The lower half of the beams that meet the ground do so too near.
  Scene scene(FlatScene(-0.1));
  int met = 0;
  ForReturnsAtHeights(
      scene, 0, 0, 1, [&](const ScannerReturn& echo, const ScannerRotation&) {
        ++met;
        EXPECT_GE(std::hypot(echo.position.x, echo.position.y, echo.position.z),
                  SpinningScanner::kMinRange);
      });
  EXPECT_GT(met, 1000);
}

TEST(SpinningScannerTest, NoiseOfRotationsIsIndependent) {
  Scene scene(FlatScene());
  const SpinningScanner scanner({.range_noise_m = 0.1, .spurious_share = 0});
  const auto ranges = [&](int64_t index) {
    ScannerRotation rotation;
    rotation.index = index;
    rotation.start.z = 2;
    std::vector<double> result;
    for (int column = 0; column < SpinningScanner::kColumnCount; ++column) {
      const auto echo =
          scanner.Fire(scene, rotation, column * SpinningScanner::kBeamCount);
      const Point3 p = echo.value().position;
      result.push_back(std::hypot(p.x, p.y, p.z - 2));
    }
    return result;
  };
  const std::vector<double> first = ranges(0);
  const std::vector<double> second = ranges(1);
  EXPECT_EQ(first, ranges(0));
  const double exact = 2 / std::sin(25 * pi / 180);
  double product = 0;
  for (size_t i = 0; i < first.size(); ++i) {
    product += (first[i] - exact) * (second[i] - exact);
  }
  EXPECT_NEAR(product / (0.1 * 0.1 * static_cast<double>(first.size())), 0,
              0.15);
}

}  // namespace
}  // namespace mapsieve::client
