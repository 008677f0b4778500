#include "core/registration/icp.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "core/base/executor.h"
#include "core/registration/transform_error.h"
#include "tests/testing/registration_scenes.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using testing::CorridorBoards;
using ::testing::HasSubstr;
using testing::Moved;
using testing::Random;
using testing::RandomDirection;
using testing::RandomMotion;
using testing::RegistrationCloud;
using testing::RoomBoards;
using testing::SampleBoards;
using testing::Shuffled;
using testing::StairBoards;
using testing::StatusIs;

constexpr double kPi = std::numbers::pi;
constexpr double kDegree = kPi / 180;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

Vector3 ToVector(const Point3& p) { return {p.x, p.y, p.z}; }

constexpr IcpMethod kMethods[] = {IcpMethod::kPointToPlane,
                                  IcpMethod::kPlaneToPlane};

/// Options that go on to the last bit.
IcpOptions Exact(IcpMethod method = IcpMethod::kPointToPlane) {
  return {.method = method,
          .translation_tolerance_m = 1e-13,
          .rotation_tolerance_rad = 1e-13};
}

void ExpectSameBits(const IcpResult& a, const IcpResult& b) {
  EXPECT_EQ(a.T_reference_reading, b.T_reference_reading);
  EXPECT_EQ(a.stop, b.stop);
  EXPECT_EQ(a.iteration_count, b.iteration_count);
  EXPECT_EQ(a.pair_count, b.pair_count);
  EXPECT_EQ(a.rms_residual_m, b.rms_residual_m);
  EXPECT_EQ(a.information.eigenvalues, b.information.eigenvalues);
}

TEST(Icp, RecoversTheExactPoseOfASceneWithoutNoise) {
  Random random(2);
  const RegistrationCloud reference =
      SampleBoards(RoomBoards(), 400, 0, random);
  for (int trial = 0; trial < 12; ++trial) {
    const RigidTransform truth = RandomMotion(20, 3 * trial, random);
    // Other points of the same surfaces, with the first trials the same ones.
    const RegistrationCloud reading = Moved(
        trial < 4 ? reference : SampleBoards(RoomBoards(), 400, 0, random),
        truth.Inverse());
    const double share = (trial + 1) / 12.0;
    const RigidTransform start =
        RandomMotion(0.5 * share, 20 * kDegree * share, random) * truth;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const IcpResult result,
        RunIcp(reading.view(), reference.view(), start, Exact()));
    EXPECT_TRUE(result.converged());
    EXPECT_EQ(result.information.degenerate_count, 0);
    EXPECT_LT(result.rms_residual_m, 1e-12);
    const TransformError error =
        CompareTransforms(result.T_reference_reading, truth);
    EXPECT_LT(error.translation_m, 1e-9) << trial;
    EXPECT_LT(error.rotation_rad, 1e-9) << trial;
  }
}

TEST(Icp, PlaneToPlaneOfTheSamePointsIsExactToo) {
  Random random(3);
  const RegistrationCloud reference =
      SampleBoards(RoomBoards(), 300, 0, random);
  const RigidTransform truth = RandomMotion(10, 1, random);
  const RegistrationCloud reading = Moved(reference, truth.Inverse());
  const RigidTransform start = truth * RandomMotion(0.2, 5 * kDegree, random);
  IcpOptions options = Exact();
  options.neighbor_count = 1;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const IcpResult to_plane,
      RunIcp(reading.view(), reference.view(), start, options));
  options.method = IcpMethod::kPlaneToPlane;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const IcpResult planes,
      RunIcp(reading.view(), reference.view(), start, options));
  EXPECT_TRUE(planes.converged());
  const TransformError error = CompareTransforms(planes.T_reference_reading,
                                                 to_plane.T_reference_reading);
  EXPECT_LT(error.translation_m, 1e-9);
  EXPECT_LT(error.rotation_rad, 1e-9);
  EXPECT_LT(CompareTransforms(planes.T_reference_reading, truth).translation_m,
            1e-9);
}

TEST(Icp, FarFromTheOriginsIsAsGood) {
  Random random(4);
  const RegistrationCloud reference =
      SampleBoards(RoomBoards(), 300, 0, random);
  const RegistrationCloud reading = SampleBoards(RoomBoards(), 300, 0, random);
  const RigidTransform near_start = RandomMotion(0.3, 3 * kDegree, random);
  const RigidTransform campus{.translation = {331050, 5183020, 92}};
  const RigidTransform region{.translation = {4e5, -6e6, 1e3}};
  for (const IcpMethod method : kMethods) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const IcpResult near_result,
                                  RunIcp(reading.view(), reference.view(),
                                         near_start, {.method = method}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const IcpResult far_result,
        RunIcp(Moved(reading, region).view(), Moved(reference, campus).view(),
               campus * near_start * region.Inverse(), {.method = method}));
    const RigidTransform back =
        campus.Inverse() * far_result.T_reference_reading * region;
    const TransformError error =
        CompareTransforms(back, near_result.T_reference_reading);
    // Coordinates of 6e6 m are rounded to 1e-9 m, and so is the translation.
    EXPECT_LT(error.translation_m, 1e-7);
    EXPECT_LT(error.rotation_rad, 1e-8);
  }
}

/// The degenerate directions of `cloud` registered to itself.
PoseInformation InformationOf(const RegistrationCloud& cloud,
                              IcpMethod method) {
  const auto result =
      RunIcp(cloud.view(), cloud.view(), {}, {.method = method});
  EXPECT_THAT(result, testing::IsOk());
  return result.ok() ? result->information : PoseInformation{};
}

TEST(Icp, ReportsTheDegenerateDirectionsOfAPlane) {
  Random random(6);
  const RegistrationCloud plane =
      SampleBoards({{{1, 2, 3}, {5, 0, 0}, {0, 5, 0}}}, 1000, 0, random);
  for (const IcpMethod method : kMethods) {
    const PoseInformation information = InformationOf(plane, method);
    EXPECT_EQ(information.degenerate_count, 3);
    // Turning about z, sliding along x and y.
    for (size_t e = 0; e < 3; ++e) {
      const PoseMotion& motion = information.motions[e];
      EXPECT_NEAR(motion.rotation[0], 0, 1e-3);
      EXPECT_NEAR(motion.rotation[1], 0, 1e-3);
      EXPECT_NEAR(motion.translation[2], 0, 1e-3);
    }
    EXPECT_GT(information.eigenvalues[3], 0.3);
  }
}

TEST(Icp, ReportsTheDegenerateDirectionOfACorridor) {
  Random random(7);
  const RegistrationCloud corridor =
      SampleBoards(CorridorBoards(), 600, 0, random);
  for (const IcpMethod method : kMethods) {
    const PoseInformation information = InformationOf(corridor, method);
    EXPECT_EQ(information.degenerate_count, 1);
    EXPECT_NEAR(std::abs(information.motions[0].translation[0]), 1, 1e-3);
    EXPECT_GT(information.eigenvalues[1], 0.1);
  }
}

TEST(Icp, ReportsTheDegenerateDirectionsOfASphereAndACylinder) {
  Random random(8);
  RegistrationCloud sphere;
  RegistrationCloud cylinder;
  for (int i = 0; i < 2000; ++i) {
    const Vector3 n = RandomDirection(random);
    sphere.Add({7 + 2 * n[0], 2 * n[1], 2 * n[2]}, n);
    const double angle = random.Uniform(-kPi, kPi);
    const Vector3 across = {std::cos(angle), std::sin(angle), 0};
    cylinder.Add({across[0], across[1], random.Uniform(-3, 3)}, across);
  }
  EXPECT_EQ(InformationOf(sphere, IcpMethod::kPointToPlane).degenerate_count,
            3);
  EXPECT_EQ(InformationOf(cylinder, IcpMethod::kPointToPlane).degenerate_count,
            2);
  EXPECT_EQ(InformationOf(SampleBoards(RoomBoards(), 500, 0, random),
                          IcpMethod::kPointToPlane)
                .degenerate_count,
            0);
}

TEST(Icp, KeepsThePoseAlongADegenerateDirection) {
  Random random(9);
  const RegistrationCloud reference =
      SampleBoards(CorridorBoards(), 600, 0, random);
  const RegistrationCloud reading =
      SampleBoards(CorridorBoards(), 600, 0, random);
  const RigidTransform start{
      .rotation = RotationFromVector({0.01, -0.01, 0.02}),
      .translation = {0.3, -0.1, 0.15}};
  // With all pairs the centre is that of all points, whatever the pose.
  IcpOptions options = Exact();
  options.neighbor_count = 1;
  options.trim_ratio = 1;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const IcpResult result,
      RunIcp(reading.view(), reference.view(), start, options));
  EXPECT_TRUE(result.converged());
  EXPECT_EQ(result.information.degenerate_count, 1);
  double start_x = 0;
  for (const Point3& p : reading.positions) start_x += start(p).x;
  EXPECT_NEAR(result.information.center.x,
              start_x / static_cast<double>(reading.positions.size()), 1e-9);
  // The other five are recovered.
  EXPECT_LT(CompareTransforms(result.T_reference_reading, {}).rotation_rad,
            1e-9);
  EXPECT_NEAR(result.T_reference_reading.translation[1], 0, 1e-9);
  EXPECT_NEAR(result.T_reference_reading.translation[2], 0, 1e-9);
}

TEST(Icp, TrimsPointsThatTheReferenceDoesNotHave) {
  Random random(10);
  const RegistrationCloud reference =
      SampleBoards(RoomBoards(), 400, 0, random);
  RegistrationCloud reading = SampleBoards(RoomBoards(), 400, 0, random);
  // A fifth of all, off the surfaces.
  for (int i = 0; i < 400; ++i) {
    reading.Add(
        {random.Uniform(-3, 3), random.Uniform(-3, 3), random.Uniform(2, 4)},
        {0, 0, 1});
  }
  const RigidTransform start = RandomMotion(0.2, 2 * kDegree, random);
  const auto error = [&](const IcpOptions& options) {
    const auto result =
        RunIcp(reading.view(), reference.view(), start, options);
    EXPECT_THAT(result, testing::IsOk());
    return CompareTransforms(result->T_reference_reading, {}).translation_m;
  };
  IcpOptions options = Exact();
  EXPECT_LT(error(options), 1e-9);
  options.trim_ratio = 1;
  EXPECT_GT(error(options), 1e-3);
  options.max_distance_m = 1;
  EXPECT_LT(error(options), 1e-9);
}

TEST(Icp, LeavesOutPairsWhoseNormalsDisagree) {
  Random random(11);
  const RegistrationCloud reference =
      SampleBoards(RoomBoards(), 400, 0, random);
  RegistrationCloud reading = SampleBoards(RoomBoards(), 400, 0, random);
  // Steps on the floor: near the reference, their surfaces at right angles.
  for (int i = 0; i < 300; ++i) {
    reading.Add({random.Uniform(-4, 4), random.Uniform(-4, 4), 0.05},
                {1, 0, 0});
  }
  const RigidTransform start = RandomMotion(0.02, 0.2 * kDegree, random);
  IcpOptions options = Exact();
  const auto error = [&] {
    const auto result =
        RunIcp(reading.view(), reference.view(), start, options);
    EXPECT_THAT(result, testing::IsOk());
    return CompareTransforms(result->T_reference_reading, {}).translation_m;
  };
  EXPECT_GT(error(), 1e-3);
  options.min_normal_cosine = 0.8;
  EXPECT_LT(error(), 1e-9);
  // Of either sign.
  for (Vector3& n : reading.normals) n = {-n[0], -n[1], -n[2]};
  EXPECT_LT(error(), 1e-9);
}

TEST(Icp, GivesTheSameBitsForAnyNumberOfThreadsAndAnyOrder) {
  Random random(12);
  RegistrationCloud reference = SampleBoards(RoomBoards(), 700, 0.02, random);
  RegistrationCloud reading = SampleBoards(RoomBoards(), 700, 0.02, random);
  // Duplicates with another normal, and ties of distances.
  for (size_t i = 0; i < 50; ++i) {
    reference.Add(ToVector(reference.positions[i]), RandomDirection(random));
    reading.Add(ToVector(reference.positions[i]), RandomDirection(random));
  }
  const RigidTransform start = RandomMotion(0.3, 5 * kDegree, random);
  const auto threads = MakeWorkerPool(3);
  for (const IcpMethod method : kMethods) {
    const IcpOptions options{.method = method};
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const IcpResult one,
        RunIcp(reading.view(), reference.view(), start, options));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const IcpResult three, RunIcp(reading.view(), reference.view(), start,
                                      options, {.executor = threads.get()}));
    ExpectSameBits(one, three);
    const RegistrationCloud other_reading = Shuffled(reading, random);
    const RegistrationCloud other_reference = Shuffled(reference, random);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const IcpResult shuffled,
        RunIcp(other_reading.view(), other_reference.view(), start, options));
    ExpectSameBits(one, shuffled);
  }
}

TEST(Icp, MovesWithItsClouds) {
  Random random(13);
  const RegistrationCloud reference =
      SampleBoards(RoomBoards(), 500, 0.02, random);
  const RegistrationCloud reading =
      SampleBoards(RoomBoards(), 500, 0.02, random);
  const RigidTransform start = RandomMotion(0.3, 5 * kDegree, random);
  const RigidTransform a = RandomMotion(30, 2, random);
  const RigidTransform b = RandomMotion(30, 1, random);
  for (const IcpMethod method : kMethods) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const IcpResult here,
        RunIcp(reading.view(), reference.view(), start, Exact(method)));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const IcpResult there,
        RunIcp(Moved(reading, b).view(), Moved(reference, a).view(),
               a * start * b.Inverse(), Exact(method)));
    const TransformError error = CompareTransforms(
        a.Inverse() * there.T_reference_reading * b, here.T_reference_reading);
    // Covariances are float32, so a turn rounds them.
    const double tolerance = method == IcpMethod::kPointToPlane ? 1e-9 : 1e-6;
    EXPECT_LT(error.translation_m, tolerance);
    EXPECT_LT(error.rotation_rad, tolerance);
    EXPECT_EQ(here.pair_count, there.pair_count);
    for (size_t e = 0; e < 6; ++e) {
      EXPECT_NEAR(here.information.eigenvalues[e],
                  there.information.eigenvalues[e], 100 * tolerance);
    }
  }
}

TEST(Icp, TellsWhyItStopped) {
  Random random(14);
  const RegistrationCloud reference =
      SampleBoards(RoomBoards(), 200, 0, random);
  const RegistrationCloud reading = SampleBoards(RoomBoards(), 200, 0, random);
  const RigidTransform start = RandomMotion(0.3, 5 * kDegree, random);
  const auto run = [&](const RigidTransform& pose, const IcpOptions& options) {
    auto result = RunIcp(reading.view(), reference.view(), pose, options);
    EXPECT_THAT(result, testing::IsOk());
    return std::move(result).value();
  };
  const IcpResult converged = run(start, {});
  EXPECT_EQ(converged.stop, IcpStop::kConverged);
  EXPECT_GT(converged.iteration_count, 3);
  // At the solution only the steps are made that show that it is one.
  EXPECT_EQ(run({}, {.settled_step_count = 5}).iteration_count, 5);
  const IcpResult limited = run(start, {.max_iteration_count = 2});
  EXPECT_EQ(limited.stop, IcpStop::kIterationLimit);
  EXPECT_EQ(limited.iteration_count, 2);
  const RigidTransform far{.translation = {100, 0, 0}};
  const IcpResult apart = run(far, {.max_distance_m = 5});
  EXPECT_EQ(apart.stop, IcpStop::kTooFewPairs);
  EXPECT_EQ(apart.T_reference_reading, far);
  EXPECT_EQ(apart.pair_count, 0);
  EXPECT_EQ(apart.information.eigenvalues[5], 0);
}

TEST(Icp, PlaneToPlaneHalvesTheErrorOfThinNoisyClouds) {
  // Samples are farther apart than the surfaces of the stairs, so that many
  // pairs join two of them.
  std::vector<double> errors[2];
  for (uint64_t seed = 1; seed <= 40; ++seed) {
    Random random(seed);
    const RegistrationCloud reference =
        SampleBoards(StairBoards(), 20, 0.01, random);
    const RegistrationCloud reading =
        SampleBoards(StairBoards(), 20, 0.01, random);
    const RigidTransform start = RandomMotion(0.1, 2 * kDegree, random);
    for (size_t m = 0; m < 2; ++m) {
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const IcpResult result,
                                    RunIcp(reading.view(), reference.view(),
                                           start, {.method = kMethods[m]}));
      errors[m].push_back(
          CompareTransforms(result.T_reference_reading, {}).translation_m);
    }
  }
  for (std::vector<double>& e : errors) std::sort(e.begin(), e.end());
  EXPECT_LT(errors[1][20], 0.5 * errors[0][20]);
  EXPECT_LT(errors[1][20], 0.02);
}

TEST(Icp, RefusesCloudsThatCannotBeRegistered) {
  Random random(15);
  const RegistrationCloud good = SampleBoards(RoomBoards(), 10, 0, random);
  const auto refuses = [&](const IcpCloud& reading, const IcpCloud& reference,
                           const std::string& words,
                           const IcpOptions& options = {}) {
    EXPECT_THAT(RunIcp(reading, reference, {}, options),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(words)));
  };
  const IcpOptions planes{.method = IcpMethod::kPlaneToPlane};
  refuses({}, good.view(), "the reading has 0 points");
  refuses(good.view(), {}, "the reference has 0 points");
  RegistrationCloud one;
  one.Add({0, 0, 0}, {0, 0, 1});
  refuses(one.view(), good.view(), "the reading has 1 points");
  refuses(good.view(), one.view(), "the reference has 1 points");
  RegistrationCloud seven = SampleBoards({RoomBoards()[0]}, 7, 0, random);
  refuses(good.view(), seven.view(), "registration needs 8",
          {.neighbor_count = 8});

  refuses(good.view(), {.positions = good.positions}, "has 0 normals for 40");
  refuses({.positions = good.positions}, good.view(), "reading has 0 normals",
          {.min_normal_cosine = 0.5});
  refuses({.positions = good.positions}, good.view(),
          "reading has 0 covariances", planes);
  refuses({.positions = good.positions, .normals = one.normals}, good.view(),
          "has 1 normals for 40");

  for (const double bad : {kNan, kInfinity, -2e13}) {
    RegistrationCloud cloud = good;
    cloud.positions[3].y = bad;
    refuses(cloud.view(), good.view(), "reading's positions: number 3");
    refuses(good.view(), cloud.view(), "reference's positions: number 3");
  }
  for (const Vector3& bad : {Vector3{0, 0, 0}, {0, kNan, 1}, {1, 1, 0}}) {
    RegistrationCloud cloud = good;
    cloud.normals[4] = bad;
    refuses(good.view(), cloud.view(), "reference's normals: number 4");
  }
  constexpr auto kFloatNan = std::numeric_limits<float>::quiet_NaN();
  for (const Covariance& bad : {Covariance{0, 0, 0, 0, 0, 0},
                                {1, 0, 0, 1, 0, -1},
                                {1, 2, 0, 1, 0, 1},
                                {1, 0, 0, 1, kFloatNan, 1},
                                {-1, 0, 0, -1, 0, 1}}) {
    RegistrationCloud cloud = good;
    cloud.covariances[5] = bad;
    refuses(cloud.view(), good.view(), "reading's covariances: number 5",
            planes);
  }
  EXPECT_THAT(
      RunIcp(good.view(), good.view(), {.translation = {kNan, 0, 0}},
             IcpOptions{}),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("not finite")));
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THAT(
      RunIcp(good.view(), good.view(), {}, {}, {.stop = stop.get_token()}),
      StatusIs(absl::StatusCode::kCancelled, HasSubstr("cancelled")));
}

TEST(IcpOptions, AreCheckedFieldByField) {
  MAPSIEVE_EXPECT_OK(IcpOptions{}.Validate());
  const auto refuses = [](const IcpOptions& options, const std::string& field) {
    EXPECT_THAT(options.Validate(), StatusIs(absl::StatusCode::kInvalidArgument,
                                             HasSubstr(field + " is ")));
  };
  refuses({.method = static_cast<IcpMethod>(0)}, "method");
  refuses({.neighbor_count = 0}, "neighbor_count");
  refuses({.neighbor_count = 17}, "neighbor_count");
  for (const double bad : {0.0, -1.0, 1.01, kNan}) {
    refuses({.trim_ratio = bad}, "trim_ratio");
  }
  for (const double bad : {0.0, -1.0, kNan}) {
    refuses({.max_distance_m = bad}, "max_distance_m");
  }
  for (const double bad : {-0.1, 1.1, kNan}) {
    refuses({.min_normal_cosine = bad}, "min_normal_cosine");
  }
  refuses({.max_iteration_count = -1}, "max_iteration_count");
  refuses({.max_iteration_count = 10001}, "max_iteration_count");
  refuses({.settled_step_count = 0}, "settled_step_count");
  for (const double bad : {-1.0, kNan}) {
    refuses({.translation_tolerance_m = bad}, "translation_tolerance_m");
    refuses({.rotation_tolerance_rad = bad}, "rotation_tolerance_rad");
  }
  for (const double bad : {0.0, 1.5, kNan}) {
    refuses({.degenerate_eigenvalue = bad}, "degenerate_eigenvalue");
  }
}

}  // namespace
}  // namespace mapsieve::core
