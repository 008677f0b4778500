#ifndef MAPSIEVE_CORE_GEOMETRY_SYMMETRIC3_H_
#define MAPSIEVE_CORE_GEOMETRY_SYMMETRIC3_H_

#include <array>

namespace mapsieve::core {

/// A symmetric 3 x 3 matrix.
struct Symmetric3 {
  double xx = 0;
  double xy = 0;
  double xz = 0;
  double yy = 0;
  double yz = 0;
  double zz = 0;
};

using Vector3 = std::array<double, 3>;

struct EigenSystem3 {
  /// Descending.
  std::array<double, 3> values;
  /// vectors[i] is the unit eigenvector of values[i].
  std::array<Vector3, 3> vectors;
};

/// Eigenvalues and eigenvectors by cyclic Jacobi rotations: a fixed sequence of
/// + - * / and square roots, so every processor gives the same bits.
EigenSystem3 Decompose(const Symmetric3& matrix);

/// The smallest eigenvalue of `matrix`, as Decompose gives it.
double SmallestEigenvalue(const Symmetric3& matrix);

/// `v` or -v: the component of largest magnitude is positive (ties x, y, z).
Vector3 WithCanonicalSign(const Vector3& v);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_SYMMETRIC3_H_
