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

// The step and the eigenvalues against sums written down in the plainest way.
class OneStep {
 public:
  OneStep(const RegistrationCloud& reading, const RegistrationCloud& reference,
          const RigidTransform& pose, const IcpOptions& options) {
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

TEST(Icp, OneStepSolvesTheNormalEquationsOfNaiveSums) {
  Random random(5);
  const RegistrationCloud reference =
      SampleBoards(RoomBoards(), 60, 0.05, random);
  const RegistrationCloud reading =
      SampleBoards(RoomBoards(), 50, 0.05, random);
  const RigidTransform start = RandomMotion(0.3, 3 * kDegree, random);
  for (const IcpMethod method :
       {IcpMethod::kPointToPlane, IcpMethod::kPlaneToPlane}) {
    for (const int neighbor_count : {1, 2, 5}) {
      IcpOptions options{.method = method,
                         .neighbor_count = neighbor_count,
                         .trim_ratio = 0.7,
                         .max_iteration_count = 0};
      const OneStep naive(reading, reference, start, options);
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(
          const IcpResult before,
          RunIcp(reading.view(), reference.view(), start, options));
      options.max_iteration_count = 1;
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(
          const IcpResult after,
          RunIcp(reading.view(), reference.view(), start, options));

      EXPECT_EQ(before.stop, IcpStop::kIterationLimit);
      EXPECT_EQ(before.iteration_count, 0);
      EXPECT_EQ(before.pair_count, static_cast<int64_t>(naive.count));
      EXPECT_NEAR(before.pair_ratio, 0.7, 0.01);
      EXPECT_NEAR(before.rms_residual_m, naive.rms, 1e-12);
      const PoseInformation& information = before.information;
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

      // The motion made is exp of the solution, about the centre.
      EXPECT_EQ(after.iteration_count, 1);
      const RigidTransform step = after.T_reference_reading * start.Inverse();
      const Vector3 moved_center =
          ToVector(step({naive.center[0], naive.center[1], naive.center[2]}));
      const Vector3 translation = Sum(moved_center, Scaled(naive.center, -1));
      const double angle = CompareTransforms(step, {}).rotation_rad;
      const double to_vector = 0.5 * angle / std::sin(angle);
      const Matrix3& r = step.rotation;
      const std::array<double, 6> motion = {to_vector * (r[2][1] - r[1][2]),
                                            to_vector * (r[0][2] - r[2][0]),
                                            to_vector * (r[1][0] - r[0][1]),
                                            translation[0],
                                            translation[1],
                                            translation[2]};
      EXPECT_GT(angle, 1e-3);
      for (size_t row = 0; row < 6; ++row) {
        double gradient = naive.right[row];
        for (size_t c = 0; c < 6; ++c) {
          gradient += naive.matrix[row][c] * motion[c];
        }
        EXPECT_NEAR(gradient / naive.weight, 0, 1e-11);
      }
    }
  }
}

}  // namespace
}  // namespace mapsieve::core
