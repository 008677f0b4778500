#include "core/registration/normal_equations.h"

#include <cmath>
#include <cstddef>

#include "Eigen/Core"
#include "Eigen/Eigenvalues"
#include "Eigen/LU"

namespace mapsieve::core {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Matrix6d = Eigen::Matrix<double, 6, 6>;
using Vector6d = Eigen::Matrix<double, 6, 1>;

constexpr size_t kPairsPerPart = 1024;
/// Below this share of the largest arm of a rotation, noise would decide on the
/// rotation about a line of points.
constexpr double kSmallestArmShare = 0.01;

Vector3d ToEigen(const Vector3& v) { return {v[0], v[1], v[2]}; }

Vector3 FromEigen(const Vector3d& v) { return {v[0], v[1], v[2]}; }

Matrix3d ToEigen(const Covariance& c) {
  Matrix3d m;
  m << c[0], c[1], c[2], c[1], c[3], c[4], c[2], c[4], c[5];
  return m;
}

Matrix3d ToEigen(const Matrix3& rows) {
  Matrix3d m;
  for (int r = 0; r < 3; ++r) m.row(r) = ToEigen(rows[static_cast<size_t>(r)]);
  return m;
}

/// The matrix of the cross product with `v`.
Matrix3d CrossMatrix(const Vector3d& v) {
  Matrix3d m;
  m << 0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0;
  return m;
}

/// Sums over pairs. The residual of a motion (w, t) about the origin is
/// r + J (w, t) to first order.
struct Sums {
  // JᵀMJ and JᵀMr with the pair's inverse covariance M; nnᵀ for
  // point-to-plane.
  Matrix6d normal_matrix = Matrix6d::Zero();
  Vector6d right_side = Vector6d::Zero();
  double squared_residual = 0;
  // Of the weights, which are the traces of M, and of them times the point and
  // its outer square.
  double weight = 0;
  Vector3d first_moment = Vector3d::Zero();
  Matrix3d second_moment = Matrix3d::Zero();

  void AddPointToPlane(const Vector3d& point, const Vector3d& difference,
                       const Vector3d& normal) {
    Vector6d jacobian;
    jacobian << point.cross(normal), normal;
    const double residual = normal.dot(difference);
    normal_matrix.noalias() += jacobian * jacobian.transpose();
    right_side += jacobian * residual;
    squared_residual += residual * residual;
    AddWeight(1, point);
  }

  void AddPlaneToPlane(const Vector3d& point, const Vector3d& difference,
                       const Matrix3d& covariance) {
    const Matrix3d information = covariance.inverse();
    Eigen::Matrix<double, 3, 6> jacobian;
    jacobian << -CrossMatrix(point), Matrix3d::Identity();
    const Eigen::Matrix<double, 3, 6> weighted = information * jacobian;
    normal_matrix.noalias() += jacobian.transpose() * weighted;
    right_side.noalias() += weighted.transpose() * difference;
    squared_residual += difference.dot(information * difference);
    AddWeight(information.trace(), point);
  }

  void Add(const Sums& other) {
    normal_matrix += other.normal_matrix;
    right_side += other.right_side;
    squared_residual += other.squared_residual;
    weight += other.weight;
    first_moment += other.first_moment;
    second_moment += other.second_moment;
  }

 private:
  void AddWeight(double pair_weight, const Vector3d& point) {
    weight += pair_weight;
    first_moment += pair_weight * point;
    second_moment.noalias() += (pair_weight * point) * point.transpose();
  }
};

/// Turns a rotation measured in metres, as the root mean square way of the
/// points, into radians: the inverse square root of their inertia tensor.
Matrix3d RadiansPerMetre(const Matrix3d& spread) {
  const Matrix3d inertia = spread.trace() * Matrix3d::Identity() - spread;
  const Eigen::SelfAdjointEigenSolver<Matrix3d> solver(inertia);
  Vector3d arms = solver.eigenvalues().cwiseMax(0).cwiseSqrt();
  // Pairs in one point say nothing of a rotation, in any unit.
  const double largest = arms[2] > 0 ? arms[2] : 1;
  arms = arms.cwiseMax(kSmallestArmShare * largest);
  return solver.eigenvectors() * arms.cwiseInverse().asDiagonal() *
         solver.eigenvectors().transpose();
}

PoseMotion ToMotion(const Vector6d& v) {
  return {.rotation = FromEigen(v.head<3>()),
          .translation = FromEigen(v.tail<3>())};
}

IcpSolution Solve(const Sums& sums, double degenerate_eigenvalue) {
  IcpSolution solution;
  PoseInformation& information = solution.information;
  solution.rms_residual_m = std::sqrt(sums.squared_residual / sums.weight);
  const Vector3d center = sums.first_moment / sums.weight;
  information.center = {center[0], center[1], center[2]};
  const Matrix3d spread =
      sums.second_moment / sums.weight - center * center.transpose();
  // A motion about the centre, its rotation in metres, to one about the origin.
  Matrix6d to_origin = Matrix6d::Identity();
  to_origin.bottomLeftCorner<3, 3>() = CrossMatrix(center);
  Matrix6d units = Matrix6d::Identity();
  units.topLeftCorner<3, 3>() = RadiansPerMetre(spread);
  to_origin *= units;
  const Matrix6d in_metres =
      to_origin.transpose() * (sums.normal_matrix / sums.weight) * to_origin;
  const Vector6d right =
      to_origin.transpose() * (sums.right_side / sums.weight);
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(in_metres);
  Vector6d step = Vector6d::Zero();
  for (int i = 0; i < 6; ++i) {
    const auto slot = static_cast<size_t>(i);
    const double eigenvalue = solver.eigenvalues()[i];
    const Vector6d direction = solver.eigenvectors().col(i);
    information.eigenvalues[slot] = eigenvalue;
    information.motions[slot] = ToMotion(units * direction);
    if (eigenvalue < degenerate_eigenvalue) {
      ++information.degenerate_count;
    } else {
      step -= direction * (direction.dot(right) / eigenvalue);
    }
  }
  solution.step = ToMotion(units * step);
  return solution;
}

}  // namespace

IcpSolution SolvePairs(std::span<const Vector3> moved, const Matrix3& rotation,
                       const IcpPoints& reading, const IcpPoints& reference,
                       std::span<const IcpPair> pairs,
                       const IcpOptions& options, Executor& executor) {
  const Matrix3d turn = ToEigen(rotation);

  std::vector<Sums> parts(PartCount(pairs.size(), kPairsPerPart));
  ForEachPart(
      executor, pairs.size(), kPairsPerPart,
      [&](size_t part, size_t begin, size_t end) {
        Sums sums;
        for (const IcpPair& pair : pairs.subspan(begin, end - begin)) {
          const Vector3d point = ToEigen(moved[pair.reading]);
          const Vector3d difference =
              point - ToEigen(reference.positions[pair.reference]);
          if (options.method == IcpMethod::kPointToPlane) {
            sums.AddPointToPlane(point, difference,
                                 ToEigen(reference.normals[pair.reference]));
          } else {
            const Matrix3d turned = turn *
                                    ToEigen(reading.covariances[pair.reading]) *
                                    turn.transpose();
            sums.AddPlaneToPlane(
                point, difference,
                turned + ToEigen(reference.covariances[pair.reference]));
          }
        }
        parts[part] = sums;
      });
  Sums sums;
  for (const Sums& part : parts) sums.Add(part);
  return Solve(sums, options.degenerate_eigenvalue);
}

}  // namespace mapsieve::core
