#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "core/registration/icp.h"
#include "core/registration/transform_error.h"
#include "tests/testing/registration_scenes.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using testing::Random;
using testing::RandomMotion;
using testing::RegistrationCloud;
using testing::RoomBoards;
using testing::SampleBoards;

constexpr double kDegree = std::numbers::pi / 180;

Vector3 Scaled(const Vector3& v, double factor) {
  return {v[0] * factor, v[1] * factor, v[2] * factor};
}

Vector3 Sum(const Vector3& a, const Vector3& b) {
  return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}

Vector3 ToVector(const Point3& p) { return {p.x, p.y, p.z}; }

/// The sums of one step written down in the plainest way: every point of the
/// reading against every one of the reference.
class NaiveSums {
 public:
  NaiveSums(const RegistrationCloud& reading,
            const RegistrationCloud& reference, const RigidTransform& pose,
            const IcpOptions& options) {
    struct Pair {
      size_t i;
      size_t j;
      double d2;
    };
    std::vector<Pair> pairs;
    for (size_t i = 0; i < reading.positions.size(); ++i) {
      const Vector3 p = ToVector(pose(reading.positions[i]));
      std::vector<Pair> all;
      for (size_t j = 0; j < reference.positions.size(); ++j) {
        const Vector3 d = Sum(p, Scaled(ToVector(reference.positions[j]), -1));
        all.push_back({i, j, Dot(d, d)});
      }
      const auto closer = [](const Pair& a, const Pair& b) {
        return a.d2 < b.d2;
      };
      std::sort(all.begin(), all.end(), closer);
      pairs.insert(pairs.end(), all.begin(),
                   all.begin() + options.neighbor_count);
    }
    std::erase_if(pairs, [&](const Pair& pair) {
      return std::sqrt(pair.d2) > options.max_distance_m;
    });
    std::sort(pairs.begin(), pairs.end(),
              [](const Pair& a, const Pair& b) { return a.d2 < b.d2; });
    pairs.resize(static_cast<size_t>(
        std::ceil(options.trim_ratio * static_cast<double>(pairs.size()))));
    count = pairs.size();
    // First the centre, then all that is about it.
    std::vector<Matrix3> informations;
    for (const Pair& pair : pairs) {
      informations.push_back(
          Information(reading, reference, pose, options, pair.i, pair.j));
      const double trace = Trace(informations.back());
      center =
          Sum(center, Scaled(ToVector(pose(reading.positions[pair.i])), trace));
      weight += trace;
    }
    center = Scaled(center, 1 / weight);
    for (size_t m = 0; m < pairs.size(); ++m) {
      const Pair& pair = pairs[m];
      const Matrix3& information = informations[m];
      const Vector3 p = ToVector(pose(reading.positions[pair.i]));
      const Vector3 arm = Sum(p, Scaled(center, -1));
      const Vector3 difference =
          Sum(p, Scaled(ToVector(reference.positions[pair.j]), -1));
      // Columns: how the difference changes with each coordinate of motion.
      std::array<Vector3, 6> columns;
      for (size_t a = 0; a < 3; ++a) {
        Vector3 axis = {0, 0, 0};
        axis[a] = 1;
        columns[a] = Cross(axis, arm);
        columns[a + 3] = axis;
      }
      const auto product = [&](const Vector3& a, const Vector3& b) {
        return Dot(a, {Dot(information[0], b), Dot(information[1], b),
                       Dot(information[2], b)});
      };
      for (size_t r = 0; r < 6; ++r) {
        for (size_t c = 0; c < 6; ++c) {
          matrix[r][c] += product(columns[r], columns[c]);
        }
        right[r] += product(columns[r], difference);
      }
      cost += product(difference, difference);
      weighted_arms.emplace_back(Trace(information), arm);
    }
    rms = std::sqrt(cost / weight);
  }

  /// Of `a` and `b` by the normal matrix, over the weight.
  double Product(const PoseMotion& a, const PoseMotion& b) const {
    double sum = 0;
    for (size_t r = 0; r < 6; ++r) {
      for (size_t c = 0; c < 6; ++c) {
        sum += Coordinate(a, r) * matrix[r][c] * Coordinate(b, c);
      }
    }
    return sum / weight;
  }

  /// Of `a` and `b` by the points' ways.
  double Ways(const PoseMotion& a, const PoseMotion& b) const {
    double sum = 0;
    for (const auto& [trace, arm] : weighted_arms) {
      sum += trace * Dot(Cross(a.rotation, arm), Cross(b.rotation, arm));
    }
    return sum / weight + Dot(a.translation, b.translation);
  }

  /// Of half the mean squared residual after `motion`, along `along`.
  double Gradient(const PoseMotion& along, const PoseMotion& motion) const {
    double sum = 0;
    for (size_t r = 0; r < 6; ++r) sum += Coordinate(along, r) * right[r];
    return sum / weight + Product(along, motion);
  }

  static double Coordinate(const PoseMotion& motion, size_t i) {
    return i < 3 ? motion.rotation[i] : motion.translation[i - 3];
  }

  size_t count = 0;
  Vector3 center = {0, 0, 0};
  std::array<std::array<double, 6>, 6> matrix{};
  std::array<double, 6> right{};
  double cost = 0;
  double rms = 0;
  double weight = 0;
  std::vector<std::pair<double, Vector3>> weighted_arms;

 private:
  static Matrix3 Information(const RegistrationCloud& reading,
                             const RegistrationCloud& reference,
                             const RigidTransform& pose,
                             const IcpOptions& options, size_t i, size_t j) {
    if (options.method == IcpMethod::kPointToPlane) {
      const Vector3& n = reference.normals[j];
      return {Scaled(n, n[0]), Scaled(n, n[1]), Scaled(n, n[2])};
    }
    return Inverse(Added(Turned(pose.rotation, Full(reading.covariances[i])),
                         Full(reference.covariances[j])));
  }
  static double Trace(const Matrix3& m) { return m[0][0] + m[1][1] + m[2][2]; }
  static Matrix3 Full(const Covariance& c) {
    return {Vector3{c[0], c[1], c[2]}, Vector3{c[1], c[3], c[4]},
            Vector3{c[2], c[4], c[5]}};
  }
  static Matrix3 Turned(const Matrix3& rotation, const Matrix3& m) {
    const RigidTransform r{.rotation = rotation};
    return (r * RigidTransform{.rotation = m} * r.Inverse()).rotation;
  }
  static Matrix3 Added(const Matrix3& a, const Matrix3& b) {
    return {Sum(a[0], b[0]), Sum(a[1], b[1]), Sum(a[2], b[2])};
  }
  static Matrix3 Inverse(const Matrix3& m) {
    const double determinant = Dot(m[0], Cross(m[1], m[2]));
    // Of a symmetric matrix: rows and columns of the cofactors are the same.
    return {Scaled(Cross(m[1], m[2]), 1 / determinant),
            Scaled(Cross(m[2], m[0]), 1 / determinant),
            Scaled(Cross(m[0], m[1]), 1 / determinant)};
  }
};

/// The motion about `center` whose exponential is `step`.
PoseMotion MotionOf(const RigidTransform& step, const Vector3& center) {
  const Point3 moved = step({center[0], center[1], center[2]});
  const double angle = CompareTransforms(step, {}).rotation_rad;
  const double scale = 0.5 * angle / std::sin(angle);
  const Matrix3& r = step.rotation;
  return {.rotation = {scale * (r[2][1] - r[1][2]), scale * (r[0][2] - r[2][0]),
                       scale * (r[1][0] - r[0][1])},
          .translation = Sum(ToVector(moved), Scaled(center, -1))};
}

class IcpStep : public ::testing::Test {
 protected:
  IcpResult Run(const IcpOptions& options) const {
    const auto result =
        RunIcp(reading_.view(), reference_.view(), start_, options);
    EXPECT_THAT(result, testing::IsOk());
    return result.value_or(IcpResult{});
  }
  NaiveSums Naive(const IcpOptions& options) const {
    return NaiveSums(reading_, reference_, start_, options);
  }

  Random random_{5};
  RegistrationCloud reference_ = SampleBoards(RoomBoards(), 60, 0.05, random_);
  RegistrationCloud reading_ = SampleBoards(RoomBoards(), 50, 0.05, random_);
  RigidTransform start_ = RandomMotion(0.3, 3 * kDegree, random_);
  std::vector<IcpOptions> options_ = {
      {.neighbor_count = 1, .trim_ratio = 0.7},
      {.neighbor_count = 2, .trim_ratio = 1, .max_distance_m = 0.7},
      {.neighbor_count = 5, .trim_ratio = 0.9, .max_distance_m = 1.5},
      {.method = IcpMethod::kPlaneToPlane, .trim_ratio = 0.7},
      {.method = IcpMethod::kPlaneToPlane, .neighbor_count = 5}};
};

TEST_F(IcpStep, InformationIsThatOfNaiveSums) {
  for (IcpOptions options : options_) {
    options.max_iteration_count = 0;
    const NaiveSums naive = Naive(options);
    const IcpResult result = Run(options);
    EXPECT_EQ(result.stop, IcpStop::kIterationLimit);
    EXPECT_EQ(result.iteration_count, 0);
    EXPECT_EQ(result.pair_count, static_cast<int64_t>(naive.count));
    EXPECT_EQ(result.pair_ratio, static_cast<double>(naive.count) /
                                     (200 * options.neighbor_count));
    EXPECT_NEAR(result.rms_residual_m, naive.rms, 1e-12);
    const PoseInformation& information = result.information;
    EXPECT_NEAR(information.center.x, naive.center[0], 1e-12);
    EXPECT_NEAR(information.center.y, naive.center[1], 1e-12);
    EXPECT_NEAR(information.center.z, naive.center[2], 1e-12);
    // Orthonormal by the points' ways, and they make the matrix diagonal.
    for (size_t a = 0; a < 6; ++a) {
      for (size_t b = 0; b < 6; ++b) {
        const PoseMotion& v = information.motions[a];
        const PoseMotion& w = information.motions[b];
        EXPECT_NEAR(naive.Ways(v, w), a == b ? 1 : 0, 1e-12);
        EXPECT_NEAR(naive.Product(v, w),
                    a == b ? information.eigenvalues[a] : 0, 1e-12);
      }
    }
  }
}

TEST_F(IcpStep, SolvesTheNormalEquationsOfNaiveSums) {
  for (IcpOptions options : options_) {
    options.max_iteration_count = 1;
    const NaiveSums naive = Naive(options);
    const IcpResult result = Run(options);
    EXPECT_EQ(result.iteration_count, 1);
    const PoseMotion motion =
        MotionOf(result.T_reference_reading * start_.Inverse(), naive.center);
    EXPECT_GT(naive.Ways(motion, motion), 1e-3);
    for (size_t i = 0; i < 6; ++i) {
      PoseMotion axis;
      (i < 3 ? axis.rotation : axis.translation)[i % 3] = 1;
      EXPECT_NEAR(naive.Gradient(axis, motion), 0, 1e-11);
    }
  }
}

TEST_F(IcpStep, LeavesOutDegenerateDirections) {
  for (IcpOptions options : options_) {
    options.max_iteration_count = 0;
    const PoseInformation information = Run(options).information;
    const NaiveSums naive = Naive(options);
    options.max_iteration_count = 1;
    options.degenerate_eigenvalue =
        0.5 * (information.eigenvalues[1] + information.eigenvalues[2]);
    const PoseMotion motion = MotionOf(
        Run(options).T_reference_reading * start_.Inverse(), naive.center);
    for (size_t e = 0; e < 6; ++e) {
      const PoseMotion& along = information.motions[e];
      if (e < 2) {
        EXPECT_NEAR(naive.Ways(along, motion), 0, 1e-11);
      } else {
        EXPECT_NEAR(naive.Gradient(along, motion), 0, 1e-11);
      }
    }
  }
}

}  // namespace
}  // namespace mapsieve::core
