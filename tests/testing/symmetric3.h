#ifndef MAPSIEVE_TESTS_TESTING_SYMMETRIC3_H_
#define MAPSIEVE_TESTS_TESTING_SYMMETRIC3_H_

#include <array>

#include "core/geometry/vector3.h"

/// Eigenvalues one matrix at a time: the oracle of the kernels' batches.
namespace mapsieve::testing {

/// A symmetric 3 x 3 matrix.
struct Symmetric3 {
  double xx = 0;
  double xy = 0;
  double xz = 0;
  double yy = 0;
  double yz = 0;
  double zz = 0;
};

struct EigenSystem3 {
  /// Descending.
  std::array<double, 3> values;
  /// vectors[i] is the unit eigenvector of values[i].
  std::array<core::Vector3, 3> vectors;
};

/// Eigenvalues and eigenvectors by cyclic Jacobi rotations: a fixed sequence of
/// + - * / and square roots, so every processor gives the same bits.
EigenSystem3 Decompose(const Symmetric3& matrix);

/// The smallest eigenvalue of `matrix`, as Decompose gives it.
double SmallestEigenvalue(const Symmetric3& matrix);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_SYMMETRIC3_H_
