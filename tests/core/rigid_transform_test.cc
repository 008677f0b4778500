#include "core/geometry/rigid_transform.h"

#include <cmath>
#include <limits>
#include <numbers>

#include "core/registration/transform_error.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

constexpr double kPi = std::numbers::pi;

void ExpectNear(const Matrix3& a, const Matrix3& b, double tolerance) {
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 3; ++c) EXPECT_NEAR(a[r][c], b[r][c], tolerance);
  }
}

Matrix3 AboutZ(double angle) {
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  return {Vector3{c, -s, 0}, Vector3{s, c, 0}, Vector3{0, 0, 1}};
}

TEST(RotationFromVector, TurnsByItsLengthAboutItsDirection) {
  for (const double angle : {0.0, 1e-12, 1e-4, 0.3, kPi / 2, 3.0, kPi, 7.0}) {
    ExpectNear(RotationFromVector({0, 0, angle}), AboutZ(angle), 1e-15);
    // Conjugation: about the image of z by the angle.
    const RigidTransform q{.rotation = RotationFromVector({0.4, -1.1, 0.7})};
    const RigidTransform about_z{.rotation = AboutZ(angle)};
    ExpectNear(RotationFromVector(q.Rotate({0, 0, angle})),
               (q * about_z * q.Inverse()).rotation, 1e-14);
  }
}

TEST(RigidTransform, MovesPointsAndItsInverseMovesThemBack) {
  const RigidTransform a{.rotation = AboutZ(kPi / 2), .translation = {1, 2, 3}};
  const Point3 moved = a({10, 0, 5});
  EXPECT_NEAR(moved.x, 1, 1e-14);
  EXPECT_NEAR(moved.y, 12, 1e-14);
  EXPECT_NEAR(moved.z, 8, 1e-14);
  const RigidTransform b{.rotation = RotationFromVector({0.3, 0.2, -2}),
                         .translation = {-5, 0.5, 7}};
  const Point3 p = {0.25, -3, 11};
  const Point3 once = (a * b)(p);
  const Point3 twice = a(b(p));
  EXPECT_NEAR(once.x, twice.x, 1e-13);
  EXPECT_NEAR(once.y, twice.y, 1e-13);
  EXPECT_NEAR(once.z, twice.z, 1e-13);
  const RigidTransform none = (a * b).Inverse() * a * b;
  ExpectNear(none.rotation, RigidTransform{}.rotation, 1e-14);
  for (const double t : none.translation) EXPECT_NEAR(t, 0, 1e-13);
}

TEST(Orthonormalized, FindsTheNearestRotation) {
  // A symmetric stretch leaves the nearest rotation where it is.
  const Matrix3 rotation = RotationFromVector({1, -0.5, 0.3});
  const Matrix3 stretch = {Vector3{1.002, 0.001, 0}, Vector3{0.001, 0.999, 0},
                           Vector3{0, 0, 0.998}};
  const RigidTransform stretched =
      RigidTransform{.rotation = rotation, .translation = {1e6, 2, 3}} *
      RigidTransform{.rotation = stretch};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RigidTransform result,
                                Orthonormalized(stretched));
  ExpectNear(result.rotation, rotation, 1e-14);
  EXPECT_EQ(result.translation, stretched.translation);
}

TEST(Orthonormalized, RefusesWhatIsNoRotation) {
  const auto expect = [](const RigidTransform& bad, const std::string& words) {
    EXPECT_THAT(Orthonormalized(bad),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(words)));
  };
  const RigidTransform mirror{
      .rotation = {Vector3{1, 0, 0}, Vector3{0, 1, 0}, Vector3{0, 0, -1}}};
  expect(mirror, "no rotation");
  expect({.rotation = {Vector3{1, 0, 0}, Vector3{0, 1, 0}, Vector3{0, 0, 0}}},
         "no rotation");
  expect(
      {.rotation = {Vector3{1.02, 0, 0}, Vector3{0, 1, 0}, Vector3{0, 0, 1}}},
      "no rotation");
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  expect(
      {.rotation = {Vector3{1, 0, 0}, Vector3{0, kNan, 0}, Vector3{0, 0, 1}}},
      "not finite");
  expect({.translation = {0, std::numeric_limits<double>::infinity(), 0}},
         "not finite");
}

TEST(CompareTransforms, GivesTheMotionBetweenEstimateAndTruth) {
  const RigidTransform truth{.rotation = RotationFromVector({0.7, -0.2, 1.9}),
                             .translation = {3, -4, 12}};
  for (const double angle : {0.0, 1e-12, 1e-9, 1e-3, 1.0, 3.1, kPi}) {
    const RigidTransform motion{
        .rotation =
            RotationFromVector({angle * 2 / 3, angle * -1 / 3, angle * 2 / 3}),
        .translation = {0.02, 0.03, -0.06}};
    const TransformError error = CompareTransforms(truth * motion, truth);
    EXPECT_NEAR(error.translation_m, 0.07, 1e-14);
    EXPECT_NEAR(error.rotation_rad, angle, 1e-15 + 1e-7 * angle * angle * angle)
        << angle;
    const TransformError back = CompareTransforms(truth, truth * motion);
    EXPECT_NEAR(back.rotation_rad, error.rotation_rad, 1e-15);
  }
}

}  // namespace
}  // namespace mapsieve::core
