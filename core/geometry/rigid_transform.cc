#include "core/geometry/rigid_transform.h"

#include <cmath>
#include <cstddef>

#include "core/base/status.h"

namespace mapsieve::core {
namespace {

constexpr double kMaxDistanceFromRotation = 0.01;

Matrix3 Transposed(const Matrix3& m) {
  Matrix3 result;
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 3; ++c) result[r][c] = m[c][r];
  }
  return result;
}

Vector3 Product(const Matrix3& m, const Vector3& v) {
  return {Dot(m[0], v), Dot(m[1], v), Dot(m[2], v)};
}

Matrix3 Product(const Matrix3& a, const Matrix3& b) {
  const Matrix3 columns = Transposed(b);
  return {Product(columns, a[0]), Product(columns, a[1]),
          Product(columns, a[2])};
}

double Distance(const Matrix3& a, const Matrix3& b) {
  double sum = 0;
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 3; ++c) {
      sum += (a[r][c] - b[r][c]) * (a[r][c] - b[r][c]);
    }
  }
  return std::sqrt(sum);
}

/// The mean of `m` and its inverse transposed: Newton's step to the orthogonal
/// factor of the polar decomposition, of quadratic convergence.
Matrix3 PolarStep(const Matrix3& m) {
  const Matrix3 cofactors = {Cross(m[1], m[2]), Cross(m[2], m[0]),
                             Cross(m[0], m[1])};
  const double determinant = Dot(m[0], cofactors[0]);
  Matrix3 result;
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 3; ++c) {
      result[r][c] = 0.5 * (m[r][c] + cofactors[r][c] / determinant);
    }
  }
  return result;
}

}  // namespace

Point3 RigidTransform::operator()(const Point3& p) const {
  const Vector3 v = Rotate({p.x, p.y, p.z});
  return {v[0] + translation[0], v[1] + translation[1], v[2] + translation[2]};
}

Vector3 RigidTransform::Rotate(const Vector3& v) const {
  return Product(rotation, v);
}

RigidTransform RigidTransform::Inverse() const {
  RigidTransform result{.rotation = Transposed(rotation)};
  const Vector3 back = result.Rotate(translation);
  result.translation = {-back[0], -back[1], -back[2]};
  return result;
}

RigidTransform operator*(const RigidTransform& a, const RigidTransform& b) {
  RigidTransform result{.rotation = Product(a.rotation, b.rotation),
                        .translation = a.Rotate(b.translation)};
  for (size_t i = 0; i < 3; ++i) result.translation[i] += a.translation[i];
  return result;
}

Matrix3 RotationFromVector(const Vector3& v) {
  const double angle = std::sqrt(Dot(v, v));
  // sin(a) / a and (1 - cos(a)) / a², the latter without cancellation.
  const double half = 0.5 * angle;
  const double sinc = angle > 0 ? std::sin(angle) / angle : 1;
  const double half_sinc = half > 0 ? std::sin(half) / half : 1;
  const double versine = 0.5 * half_sinc * half_sinc;
  const Matrix3 cross = {Vector3{0, -v[2], v[1]}, Vector3{v[2], 0, -v[0]},
                         Vector3{-v[1], v[0], 0}};
  const Matrix3 square = Product(cross, cross);
  Matrix3 result;
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 3; ++c) {
      result[r][c] =
          (r == c ? 1 : 0) + sinc * cross[r][c] + versine * square[r][c];
    }
  }
  return result;
}

absl::StatusOr<RigidTransform> Orthonormalized(
    const RigidTransform& transform) {
  bool finite = true;
  for (size_t r = 0; r < 3; ++r) {
    finite = finite && std::isfinite(transform.translation[r]);
    for (size_t c = 0; c < 3; ++c) {
      finite = finite && std::isfinite(transform.rotation[r][c]);
    }
  }
  if (!finite) {
    return absl::InvalidArgumentError(
        "the transform has a value that is not finite");
  }
  // From 0.01 three steps reach the last bit; the other is for its rounding.
  RigidTransform result = transform;
  for (int step = 0; step < 4; ++step) {
    result.rotation = PolarStep(result.rotation);
  }
  const double distance = Distance(result.rotation, transform.rotation);
  // False for NaN, which a singular matrix gives, and for a reflection.
  if (!(distance <= kMaxDistanceFromRotation) ||
      Dot(result.rotation[0], Cross(result.rotation[1], result.rotation[2])) <
          0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the transform's matrix is no rotation: it is ", distance,
        " from the nearest one (", kMaxDistanceFromRotation, " at most)"));
  }
  return result;
}

}  // namespace mapsieve::core
