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
constexpr double kPostLength = 30 * kRadius;

/// The vote scale that docs/evaluation.md recommends for a rule.
double VoteScale(DensityRule rule) {
  return (rule == DensityRule::kPaper ? 1 : 5) * kRadius * kRadius;
}

/// The side of a post along z that a scanner far away on the x axis sees, six
/// times as dense as aimed at, with noise along the beams.
LatticeCloud PostCloud(double post_radius_m) {
  std::mt19937_64 random(3);
  const auto uniform = [&] {
    return (static_cast<double>(random() >> 11) + 0.5) * 0x1p-53;
  };
  LatticeCloud cloud{.lattice = Lattice(shapes::kIdealShapeStepNm)};
  for (int i = 0; i < 6 * 50 / (2 * kRadius) * kPostLength; ++i) {
    const double across = 2 * uniform() - 1;
    const double noise = kNoise * std::sqrt(-2 * std::log(uniform())) *
                         std::cos(2 * std::numbers::pi * uniform());
    const Point3 p = {post_radius_m * std::sqrt(1 - across * across) + noise,
                      post_radius_m * across, kPostLength * uniform()};
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
void AddLabels(const LatticeCloud& cloud, DensityRule rule, Label right,
               const Counts& counts, Tally& tally) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const FilteredCloud filtered,
      FilterCloud(cloud, {.vote_scale_m2 = VoteScale(rule),
                          .density_radius_m = kRadius,
                          .rule = rule}));
  for (size_t i = 0; i < filtered.rows.size(); ++i) {
    if (!counts(cloud.positions[filtered.rows[i]])) continue;
    ++tally.all;
    tally.right += filtered.columns.label[i] == right;
  }
  ASSERT_GT(tally.all, 0);
}

double PostShare(double post_radius_m, DensityRule rule, Label label) {
  const LatticeCloud post = PostCloud(post_radius_m);
  Tally tally;
  AddLabels(
      post, rule, label,
      [&](const LatticePoint& q) {
        const double z = post.lattice.Position(q).z;
        return z > 3 * kRadius && z < kPostLength - 3 * kRadius;
      },
      tally);
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
  const shapes::IdealShape plane = shapes::MakeIdealShape(
      {.dimension = 2, .radius_m = kRadius, .start = 6, .noise_m = kNoise});
  Tally tally;
  AddLabels(
      plane.cloud, GetParam(), Label::kSurface,
      [&](const LatticePoint& q) { return plane.IsInterior(q); }, tally);
  EXPECT_GE(tally.share(), 0.97);
}

TEST_P(LabelTruth, SlenderPostsAreCurves) {
  EXPECT_GE(PostShare(kRadius / 10, GetParam(), Label::kCurve), 0.9);
}

// A body as thick as the neighbourhood is a wall to it.
TEST_P(LabelTruth, StoutPostsAreSurfaces) {
  EXPECT_GE(PostShare(0.6 * kRadius, GetParam(), Label::kSurface), 0.9);
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
    AddLabels(edge, DensityRule::kQuota, Label::kCurve, lies_between(0, 0.05),
              close);
    AddLabels(edge, DensityRule::kQuota, Label::kSurface, lies_between(0.25, 5),
              far);
  }
  EXPECT_GE(close.share(), 0.9);
  EXPECT_GE(far.share(), 0.97);
}

}  // namespace
}  // namespace mapsieve::core
