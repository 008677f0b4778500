#include <array>
#include <cmath>
#include <random>
#include <vector>

#include "core/spdf/kernels.h"
#include "core/spdf/labels.h"
#include "core/spdf/spdf_options.h"
#include "core/spdf/strength_tests.h"
#include "tests/testing/status_matchers.h"
#include "tests/testing/symmetric3.h"

namespace mapsieve::core {
namespace {

using testing::Decompose;

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

/// The paper's general formula, E[exp(-r²/sigma)] over a D-ball of radius rho,
/// as an integral: D / rho^D * ∫ r^(D-1) exp(-r²/sigma) dr, by Simpson's rule.
double StrengthByIntegration(int dimension, double sigma, double rho) {
  const auto f = [&](double r) {
    return dimension * std::pow(r, dimension - 1) / std::pow(rho, dimension) *
           std::exp(-r * r / sigma);
  };
  constexpr int kSteps = 20000;
  const double h = rho / kSteps;
  double sum = f(0) + f(rho);
  for (int i = 1; i < kSteps; ++i) sum += (i % 2 == 1 ? 4 : 2) * f(i * h);
  return sum * h / 3;
}

TEST(ExpectedStrength, EqualsTheGeneralFormulaIntegrated) {
  for (const double sigma : {0.05, 0.2, 1.0}) {
    for (const double rho : {0.1, 0.2, 0.4, 1.35}) {
      for (int dimension = 1; dimension <= 3; ++dimension) {
        EXPECT_NEAR(ExpectedStrength(dimension, sigma, rho),
                    StrengthByIntegration(dimension, sigma, rho), 1e-9)
            << dimension << " " << sigma << " " << rho;
      }
    }
  }
}

TEST(ExpectedStrength, HasItsKnownValues) {
  EXPECT_NEAR(ExpectedStrength(1, 0.2, 0.2), 0.937150, 1e-6);
  EXPECT_NEAR(ExpectedStrength(2, 0.2, 0.2), 0.906346, 1e-6);
  EXPECT_NEAR(ExpectedStrength(3, 0.2, 0.2), 0.888145, 1e-6);
}

/// Sums of ball votes over many draws of `k` neighbours uniform in the
/// D-ball of radius rho, in the kernel's units but in wide integers.
std::array<double, 3> MeanEigenvalues(int dimension, int k, int draws,
                                      double sigma, double rho, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> uniform(-1, 1);
  const double step = 0.0001;
  const auto scale = static_cast<float>(step * step / sigma);
  int64_t c0 = 0;
  std::array<int64_t, 5> a{};
  // The kernel takes 127 neighbours at most; larger k are summed in parts.
  constexpr int kPart = 100;
  constexpr size_t kRoom = kPart + 1 + 2 * kKernelPadding;
  std::vector<int32_t> d2(kRoom);
  std::vector<int32_t> near_xy(kRoom);
  std::vector<int32_t> near_z(kRoom);
  for (int draw = 0; draw < draws; ++draw) {
    for (int done = 0; done < k; done += kPart) {
      const int count = std::min(kPart, k - done);
      std::vector<int32_t> xy = {0};
      std::vector<int32_t> z = {0};
      while (static_cast<int>(xy.size()) <= count) {
        const double p[3] = {uniform(random),
                             dimension > 1 ? uniform(random) : 0,
                             dimension > 2 ? uniform(random) : 0};
        if (p[0] * p[0] + p[1] * p[1] + p[2] * p[2] > 1) continue;
        const auto steps = [&](double u) {
          return static_cast<int32_t>(std::lround(u * rho / step));
        };
        xy.push_back(PackXy(steps(p[0]), steps(p[1])));
        z.push_back(PackZ(steps(p[2])));
      }
      xy.resize(xy.size() + kKernelPadding);
      z.resize(xy.size(), PackZ(kFarAway));
      BallSums sums;
      ActiveKernels().ball_vote(
          {xy.data(), z.data(), count + 1}, {0, 0, 0, count, 1 << 28, scale},
          {d2.data(), near_xy.data(), near_z.data()}, &sums);
      c0 += sums.c0;
      const int32_t parts[5] = {sums.xx, sums.xy, sums.xz, sums.yy, sums.yz};
      for (size_t e = 0; e < 5; ++e) a[e] += parts[e];
    }
  }
  const double n = static_cast<double>(k) * draws * 0x1p24;
  const auto entry = [&](int64_t sum) { return static_cast<double>(sum) / n; };
  const double c = entry(c0);
  return Decompose({c - entry(a[0]) / 2, -entry(a[1]) / 2, -entry(a[2]) / 2,
                    c - entry(a[3]) / 2, -entry(a[4]) / 2,
                    c - entry(c0 - a[0] - a[3]) / 2})
      .values;
}

TEST(ExpectedEigenvalues, OfTheMeanTensorMatchThePapersTable) {
  // Rows: curve, surface, volume; in units of the expected strength.
  const double table[3][3] = {
      {1, 1, 0.5}, {1, 0.75, 0.75}, {5.0 / 6, 5.0 / 6, 5.0 / 6}};
  const double sigma = 0.2;
  const double rho = 0.2;
  for (const auto& [k, draws] : {std::pair(50, 4000), std::pair(5000, 40)}) {
    for (int dimension = 1; dimension <= 3; ++dimension) {
      const double strength = ExpectedStrength(dimension, sigma, rho);
      const auto mean = MeanEigenvalues(dimension, k, draws, sigma, rho, 17);
      for (size_t d = 0; d < 3; ++d) {
        EXPECT_NEAR(mean[d] / strength,
                    table[static_cast<size_t>(dimension - 1)][d], 0.004)
            << "k " << k << " dimension " << dimension << " lambda " << d + 1;
      }
    }
  }
}

TEST(CountEigenvaluesAbove, AgreesWithTheDecomposition) {
  std::mt19937_64 random(23);
  const auto entry = [&] {
    return static_cast<int32_t>(random() % 2000001) - 1000000;
  };
  for (int trial = 0; trial < 20000; ++trial) {
    const BallSums s = {.c0 = entry(),
                        .xx = entry(),
                        .xy = entry(),
                        .xz = entry(),
                        .yy = entry(),
                        .yz = entry()};
    const int64_t threshold = entry();
    const auto values =
        Decompose({static_cast<double>(s.xx), static_cast<double>(s.xy),
                   static_cast<double>(s.xz), static_cast<double>(s.yy),
                   static_cast<double>(s.yz),
                   static_cast<double>(s.c0) - s.xx - s.yy})
            .values;
    int expected = 0;
    bool clear = true;
    for (const double v : values) {
      if (v > static_cast<double>(threshold)) ++expected;
      if (std::abs(v - static_cast<double>(threshold)) < 1e-3) clear = false;
    }
    if (clear) {
      ASSERT_EQ(CountEigenvaluesAbove(s, threshold), expected);
    }
  }
}

TEST(CountEigenvaluesAbove, CountsMultipleAndZeroEigenvaluesExactly) {
  // A = diag(4, 4, 2), trace 10.
  const BallSums s = {.c0 = 10, .xx = 4, .yy = 4};
  EXPECT_EQ(CountEigenvaluesAbove(s, 4), 0);
  EXPECT_EQ(CountEigenvaluesAbove(s, 3), 2);
  EXPECT_EQ(CountEigenvaluesAbove(s, 2), 2);
  EXPECT_EQ(CountEigenvaluesAbove(s, 1), 3);
}

TEST(SpdfOptions, NameTheFieldAndTheLimit) {
  const Lattice lattice;
  SpdfOptions options;
  MAPSIEVE_EXPECT_OK(options.Validate(lattice));
  const auto expect = [&](const SpdfOptions& bad, const char* field) {
    EXPECT_THAT(bad.Validate(lattice),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(field)));
  };
  expect({.neighbor_count = 5}, "neighbor_count is 5; it must be 6 to 127");
  expect({.neighbor_count = 128}, "neighbor_count");
  expect({.label_neighbor_count = 5},
         "label_neighbor_count is 5; it must be 6 to 127, or 0");
  expect({.label_neighbor_count = 128}, "label_neighbor_count");
  expect({.label_neighbor_count = -1}, "label_neighbor_count");
  expect({.vote_scale_m2 = 0}, "vote_scale_m2");
  expect({.vote_scale_m2 = std::nan("")}, "vote_scale_m2");
  expect({.vote_scale_m2 = 100}, "reach_m is");
  expect({.density_radius_m = -1}, "density_radius_m");
  expect({.density_radius_m = 9}, "density_radius_m");
  expect({.reach_m = -1}, "reach_m");
  expect({.reach_m = 9}, "9000 lattice steps");
  expect({.max_round_count = 16}, "max_round_count");
  expect({.rule = static_cast<DensityRule>(9)}, "rule");
  expect({.outlier_share = 1.5}, "outlier_share");
}

}  // namespace
}  // namespace mapsieve::core
