// Labels on bodies as a lidar sees them. Whole scenes and all settings are
// tests/bench/label_table.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>
#include <string>

#include "core/cloud/label.h"
#include "core/cloud/merge_duplicates.h"
#include "core/spdf/cloud_filter.h"
#include "gtest/gtest.h"
#include "tests/testing/clouds.h"
#include "tests/testing/ideal_shape.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

namespace shapes = ::mapsieve::testing;

constexpr double kRadius = 0.2;
constexpr double kNoise = 0.012;

/// With the vote scale that docs/evaluation.md recommends for the rule.
SpdfOptions OptionsOf(DensityRule rule) {
  const double scale = rule == DensityRule::kPaper ? 1 : 5;
  return {.vote_scale_m2 = scale * kRadius * kRadius,
          .density_radius_m = kRadius,
          .rule = rule};
}

/// 30 times the density radius.
double PostLength(const SpdfOptions& options) {
  return 30 * options.density_radius_m;
}

/// The side of a post along z that a scanner far away on the x axis sees, six
/// times as dense as aimed at, with noise along the beams.
LatticeCloud PostCloud(double post_radius_m, double noise_m,
                       const SpdfOptions& options) {
  std::mt19937_64 random(3);
  const auto uniform = [&] {
    return (static_cast<double>(random() >> 11) + 0.5) * 0x1p-53;
  };
  LatticeCloud cloud{.lattice = Lattice(shapes::kIdealShapeStepNm)};
  const double length = PostLength(options);
  const double density =
      6 * options.neighbor_count / (2 * options.density_radius_m);
  for (int i = 0; i < density * length; ++i) {
    const double across = 2 * uniform() - 1;
    const double noise = noise_m * std::sqrt(-2 * std::log(uniform())) *
                         std::cos(2 * std::numbers::pi * uniform());
    const Point3 p = {post_radius_m * std::sqrt(1 - across * across) + noise,
                      post_radius_m * across, length * uniform()};
    cloud.positions.push_back(cloud.lattice.Quantize(p).value());
  }
  cloud.positions = DistinctPoints(cloud.positions);
  return cloud;
}

/// Survivors that count, and those of them with the right label.
struct Tally {
  int64_t all = 0;
  int64_t right = 0;

  double share() const {
    return static_cast<double>(right) / static_cast<double>(all);
  }
};

/// Adds the survivors for which `counts` holds to `tally`.
template <typename Counts>
void AddLabels(const LatticeCloud& cloud, const SpdfOptions& options,
               Label right, const Counts& counts, Tally& tally) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const FilteredCloud filtered,
                                FilterCloud(cloud, options));
  for (size_t i = 0; i < filtered.rows.size(); ++i) {
    if (!counts(cloud.positions[filtered.rows[i]])) continue;
    ++tally.all;
    tally.right += filtered.columns.label[i] == right;
  }
  ASSERT_GT(tally.all, 0);
}

double PostShare(double post_radius_m, double noise_m,
                 const SpdfOptions& options, Label label) {
  const LatticeCloud post = PostCloud(post_radius_m, noise_m, options);
  Tally tally;
  AddLabels(
      post, options, label,
      [&](const LatticePoint& q) {
        const double z = post.lattice.Position(q).z;
        const double end = 3 * options.density_radius_m;
        return z > end && z < PostLength(options) - end;
      },
      tally);
  return tally.share();
}

double PlaneShare(double noise_m, const SpdfOptions& options) {
  const shapes::IdealShape plane =
      shapes::MakeIdealShape({.dimension = 2,
                              .radius_m = options.density_radius_m,
                              .start = 6,
                              .noise_m = noise_m});
  Tally tally;
  AddLabels(
      plane.cloud, options, Label::kSurface,
      [&](const LatticePoint& q) { return plane.IsInterior(q); }, tally);
  return tally.share();
}

class LabelTruth : public ::testing::TestWithParam<DensityRule> {};

INSTANTIATE_TEST_SUITE_P(BothRules, LabelTruth,
                         ::testing::Values(DensityRule::kPaper,
                                           DensityRule::kQuota),
                         [](const auto& param) {
                           return std::string(DensityRuleName(param.param));
                         });

TEST_P(LabelTruth, PlanesAreSurfaces) {
  EXPECT_GE(PlaneShare(kNoise, OptionsOf(GetParam())), 0.97);
}

TEST_P(LabelTruth, SlenderPostsAreCurves) {
  const SpdfOptions options = OptionsOf(GetParam());
  EXPECT_GE(PostShare(kRadius / 10, kNoise, options, Label::kCurve), 0.9);
}

// A body as thick as the neighbourhood is a wall to it.
TEST_P(LabelTruth, StoutPostsAreSurfaces) {
  const SpdfOptions options = OptionsOf(GetParam());
  EXPECT_GE(PostShare(0.6 * kRadius, kNoise, options, Label::kSurface), 0.9);
}

// Thicker than the post: as many neighbours as the density asks for do not
// reach beyond the noise.
TEST(LabelTruthOfQuota, ManyNeighboursSeeThroughNoise) {
  constexpr double kStrongNoise = 0.015;
  SpdfOptions options = {.density_radius_m = 0.1, .rule = DensityRule::kQuota};
  EXPECT_LT(PostShare(0.01, kStrongNoise, options, Label::kCurve), 0.6);
  EXPECT_LT(PlaneShare(kStrongNoise, options), 0.97);
  options.label_neighbor_count = kMaxNeighborCount;
  EXPECT_GE(PostShare(0.01, kStrongNoise, options, Label::kCurve), 0.9);
  EXPECT_GE(PlaneShare(kStrongNoise, options), 0.97);
}

// To walls that meet, an edge is as thin as a fraction of the radius.
TEST(LabelTruthOfQuota, EdgesAreCurvesCloseByAndSurfacesFartherAway) {
  Tally close;
  Tally far;
  for (uint64_t seed = 1; seed <= 8; ++seed) {
    const LatticeCloud edge = shapes::EdgeCloud(20000, 1.5, seed);
    const auto lies_between = [&edge](double from, double to) {
      return [&edge, from, to](const LatticePoint& q) {
        const Point3 p = edge.lattice.Position(q);
        const double distance = std::max(p.y, p.z) / kRadius;
        return std::abs(p.x) < 1 && distance >= from && distance < to;
      };
    };
    const SpdfOptions options = OptionsOf(DensityRule::kQuota);
    AddLabels(edge, options, Label::kCurve, lies_between(0, 0.05), close);
    AddLabels(edge, options, Label::kSurface, lies_between(0.25, 5), far);
  }
  EXPECT_GE(close.share(), 0.9);
  EXPECT_GE(far.share(), 0.97);
}

}  // namespace
}  // namespace mapsieve::core
