#include <cmath>
#include <random>

#include "Eigen/Eigenvalues"
#include "core/geometry/octahedral.h"
#include "gtest/gtest.h"
#include "tests/testing/symmetric3.h"

namespace mapsieve::core {
namespace {

using testing::Decompose;
using testing::EigenSystem3;
using testing::SmallestEigenvalue;
using testing::Symmetric3;

Vector3 RandomUnit(std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  const Vector3 v = {normal(random), normal(random), normal(random)};
  const double length = std::sqrt(Dot(v, v));
  return {v[0] / length, v[1] / length, v[2] / length};
}

TEST(Decompose, AgreesWithEigen) {
  std::mt19937_64 random(2);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 5000; ++trial) {
    Symmetric3 m = {normal(random), normal(random), normal(random),
                    normal(random), normal(random), normal(random)};
    if (trial % 4 == 1) m.xy = m.xz = m.yz = 0;
    if (trial % 4 == 2) m.yy = m.xx;
    if (trial % 4 == 3) m = {1, 1e-9, 0, 1, 1e-12, 1};
    Eigen::Matrix3d dense;
    dense << m.xx, m.xy, m.xz, m.xy, m.yy, m.yz, m.xz, m.yz, m.zz;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(dense);
    const EigenSystem3 ours = Decompose(m);
    EXPECT_EQ(SmallestEigenvalue(m), ours.values[2]);
    for (size_t i = 0; i < 3; ++i) {
      ASSERT_NEAR(ours.values[i], solver.eigenvalues()(2 - static_cast<int>(i)),
                  1e-13);
      const Eigen::Vector3d v(ours.vectors[i].data());
      ASSERT_LT((dense * v - ours.values[i] * v).norm(), 1e-13);
      for (size_t j = 0; j < 3; ++j) {
        ASSERT_NEAR(Dot(ours.vectors[i], ours.vectors[j]), i == j ? 1 : 0,
                    1e-14);
      }
    }
  }
}

TEST(WithCanonicalSign, MakesTheLargestComponentPositive) {
  EXPECT_EQ(WithCanonicalSign({0.1, -0.9, 0.2}), (Vector3{-0.1, 0.9, -0.2}));
  EXPECT_EQ(WithCanonicalSign({-0.5, 0.5, 0}), (Vector3{0.5, -0.5, -0}));
  EXPECT_EQ(WithCanonicalSign({0, 0, -1}), (Vector3{-0.0, -0.0, 1}));
}

TEST(Octahedral, KeepsTheDirection) {
  std::mt19937_64 random(4);
  for (int trial = 0; trial < 100000; ++trial) {
    const Vector3 v = RandomUnit(random);
    const auto back = DecodeOctahedral(EncodeOctahedral(v));
    const Vector3 d = {back[0], back[1], back[2]};
    const Vector3 cross = {v[1] * d[2] - v[2] * d[1], v[2] * d[0] - v[0] * d[2],
                           v[0] * d[1] - v[1] * d[0]};
    const double angle = std::atan2(std::sqrt(Dot(cross, cross)), Dot(v, d));
    ASSERT_LT(angle * 180 / M_PI, 0.06);
    ASSERT_NEAR(Dot(d, d), 1, 1e-6);
  }
}

TEST(Octahedral, KeepsTheAxesExactly) {
  for (size_t axis = 0; axis < 3; ++axis) {
    for (const double sign : {1.0, -1.0}) {
      Vector3 v = {0, 0, 0};
      v[axis] = sign;
      const auto back = DecodeOctahedral(EncodeOctahedral(v));
      for (size_t a = 0; a < 3; ++a) {
        EXPECT_EQ(back[a], static_cast<float>(v[a]));
      }
    }
  }
}

}  // namespace
}  // namespace mapsieve::core
