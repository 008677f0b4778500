#include "tests/testing/symmetric3.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace mapsieve::testing {
namespace {

using Matrix3 = std::array<std::array<double, 3>, 3>;

/// Zeroes a[p][q] by a rotation of rows and columns p and q; r is the third.
template <bool kVectors>
void Rotate(Matrix3& a, Matrix3& v, size_t p, size_t q, size_t r) {
  if (a[p][q] == 0.0) return;
  const double theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
  const double magnitude =
      1.0 / (std::abs(theta) + std::sqrt(theta * theta + 1.0));
  const double t = theta < 0.0 ? -magnitude : magnitude;
  const double c = 1.0 / std::sqrt(t * t + 1.0);
  const double s = t * c;
  a[p][p] -= t * a[p][q];
  a[q][q] += t * a[p][q];
  a[p][q] = a[q][p] = 0.0;
  const double rp = a[r][p];
  const double rq = a[r][q];
  a[r][p] = a[p][r] = c * rp - s * rq;
  a[r][q] = a[q][r] = s * rp + c * rq;
  if constexpr (kVectors) {
    for (size_t i = 0; i < 3; ++i) {
      const double ip = v[i][p];
      const double iq = v[i][q];
      v[i][p] = c * ip - s * iq;
      v[i][q] = s * ip + c * iq;
    }
  }
}

/// Diagonalises `a`; the columns of `v` become the eigenvectors.
template <bool kVectors>
void Diagonalize(Matrix3& a, Matrix3& v) {
  // Convergence is quadratic: five sweeps reach the last bit of any matrix,
  // and most stop earlier.
  constexpr int kMaxSweeps = 10;
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    const double off =
        std::abs(a[0][1]) + std::abs(a[0][2]) + std::abs(a[1][2]);
    const double scale =
        std::abs(a[0][0]) + std::abs(a[1][1]) + std::abs(a[2][2]);
    if (off <= 1e-17 * scale) return;
    Rotate<kVectors>(a, v, 0, 1, 2);
    Rotate<kVectors>(a, v, 0, 2, 1);
    Rotate<kVectors>(a, v, 1, 2, 0);
  }
}

Matrix3 Dense(const Symmetric3& m) {
  return {{{m.xx, m.xy, m.xz}, {m.xy, m.yy, m.yz}, {m.xz, m.yz, m.zz}}};
}

}  // namespace

EigenSystem3 Decompose(const Symmetric3& matrix) {
  Matrix3 a = Dense(matrix);
  Matrix3 v = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  Diagonalize<true>(a, v);
  std::array<size_t, 3> order = {0, 1, 2};
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t i, size_t j) { return a[i][i] > a[j][j]; });
  EigenSystem3 result;
  for (size_t i = 0; i < 3; ++i) {
    const size_t from = order[i];
    result.values[i] = a[from][from];
    result.vectors[i] = {v[0][from], v[1][from], v[2][from]};
  }
  return result;
}

double SmallestEigenvalue(const Symmetric3& matrix) {
  Matrix3 a = Dense(matrix);
  Matrix3 unused{};
  Diagonalize<false>(a, unused);
  return std::min({a[0][0], a[1][1], a[2][2]});
}

}  // namespace mapsieve::testing
