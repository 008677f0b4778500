#include "core/sampling/sampler.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "core/cloud/merge_duplicates.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

// What all samplers promise through their one interface; cell_sampling_test.cc
// and normal_sampling_test.cc have the oracles of each.
namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

/// A scene, a grid full of ties and points on top of each other, with
/// attributes.
LatticeCloud MixedCloud(int count) {
  LatticeCloud cloud = testing::Concatenated(
      testing::SceneCloud(count, 2, 1),
      testing::Shifted(testing::GridCloud(7, 40), {-900, 700, 300}));
  std::vector<uint32_t> rows(cloud.size());
  std::iota(rows.begin(), rows.end(), uint32_t{0});
  for (uint32_t row = 0; row < cloud.size(); row += 5) rows.push_back(row);
  return testing::WithAttributes(cloud.Select(rows), 2);
}

/// Every method with its parameter, if it has one.
std::vector<SamplerOptions> WithParameters() {
  return {
      {.method = SampleMethod::kRandom, .keep_probability = 0.3},
      {.method = SampleMethod::kMaxDensity, .max_density = 500},
      {.method = SampleMethod::kSsNormal, .max_cell_points = 7},
      {.method = SampleMethod::kOctree, .max_cell_points = 4},
      {.method = SampleMethod::kOctree,
       .max_cell_points = 9,
       .cell_edge_m = 0.1,
       .representative = Representative::kRandom},
      {.method = SampleMethod::kOctree,
       .cell_edge_m = 0.2,
       .representative = Representative::kNearest},
      {.method = SampleMethod::kVoxel, .cell_edge_m = 0.15},
      {.method = SampleMethod::kSpdf, .spdf = {.density_radius_m = 0.2}},
  };
}

/// Every method with a number of points.
std::vector<SamplerOptions> WithCounts(int64_t count) {
  std::vector<SamplerOptions> all;
  for (const SampleMethod method : kSampleMethods) {
    all.push_back({.method = method, .max_points = count});
  }
  all.push_back({.method = SampleMethod::kSpatialSpdf,
                 .max_points = count,
                 .representative = Representative::kSurest,
                 .cell_split = CellSplit::kMidway});
  return all;
}

std::vector<SamplerOptions> Both(int64_t count) {
  std::vector<SamplerOptions> all = WithParameters();
  for (SamplerOptions& options : WithCounts(count)) all.push_back(options);
  return all;
}

std::string NameOf(const SamplerOptions& options) {
  return std::string(SampleMethodName(options.method)) + " " +
         std::to_string(options.max_points);
}

TEST(Sampler, GivesTheSameBytesInAnyOrderOnAnyNumberOfThreads) {
  const LatticeCloud cloud = MixedCloud(1000);
  const LatticeCloud shuffled = testing::Shuffled(cloud, 3);
  const std::unique_ptr<Executor> pool = MakeWorkerPool(3);
  for (const SamplerOptions& options : Both(300)) {
    SCOPED_TRACE(NameOf(options));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample a, Sample(cloud, options));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const CloudSample b,
        Sample(shuffled, options, {.executor = pool.get()}));
    EXPECT_GT(a.cloud.size(), 0u);
    EXPECT_LT(a.cloud.size(), cloud.size());
    EXPECT_TRUE(a.cloud.positions == b.cloud.positions);
    EXPECT_TRUE(a.cloud.attributes == b.cloud.attributes);
    EXPECT_EQ(a.parameter, b.parameter);
  }
}

TEST(Sampler, KeepsExactlyAsManyPointsAsWanted) {
  const LatticeCloud cloud = MixedCloud(800);
  const auto distinct = static_cast<int64_t>(MergeDuplicates(cloud).size());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const CloudSample inliers,
      Sample(cloud, {.spdf = {.max_round_count = 0}}));
  for (const int64_t wanted :
       {int64_t{1}, int64_t{2}, int64_t{3}, int64_t{17}, int64_t{100},
        int64_t{999}, distinct - 1, distinct, distinct + 1}) {
    for (SamplerOptions options : WithCounts(wanted)) {
      if (options.method == SampleMethod::kVoxel ||
          options.method == SampleMethod::kSpdf) {
        continue;
      }
      SCOPED_TRACE(NameOf(options));
      options.spdf.max_round_count = 0;
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample sample,
                                    Sample(cloud, options));
      EXPECT_EQ(
          static_cast<int64_t>(sample.cloud.size()),
          std::min(wanted, options.method == SampleMethod::kSpatialSpdf
                               ? static_cast<int64_t>(inliers.cloud.size())
                               : distinct));
    }
  }
}

TEST(Sampler, VoxelsComeNearTheCountFromBelow) {
  const LatticeCloud cloud = testing::SceneCloud(4000, 2, 4);
  for (const int64_t wanted : {8, 20, 50, 100, 300, 1000, 2500}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const CloudSample sample,
        Sample(cloud, {.method = SampleMethod::kVoxel, .max_points = wanted}));
    EXPECT_LE(static_cast<int64_t>(sample.cloud.size()), wanted);
    EXPECT_GE(static_cast<double>(sample.cloud.size()),
              0.9 * static_cast<double>(wanted));
  }
}

TEST(Sampler, SpdfComesNearTheCountFromBelow) {
  const LatticeCloud cloud = testing::SceneCloud(3000, 2, 5);
  for (const DensityRule rule : {DensityRule::kPaper, DensityRule::kQuota}) {
    for (const int64_t wanted : {500, 1500}) {
      SamplerOptions options = {.max_points = wanted, .spdf = {.rule = rule}};
      options.spdf.outlier_share = 0;
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample sample,
                                    Sample(cloud, options));
      EXPECT_LE(static_cast<int64_t>(sample.cloud.size()), wanted);
      EXPECT_GE(static_cast<double>(sample.cloud.size()),
                0.95 * static_cast<double>(wanted));
    }
  }
}

TEST(Sampler, TheParameterFoundGivesTheSampleAgain) {
  const LatticeCloud cloud = MixedCloud(900);
  for (SamplerOptions options : WithCounts(333)) {
    SCOPED_TRACE(NameOf(options));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample found,
                                  Sample(cloud, options));
    options.max_points = 0;
    switch (options.method) {
      case SampleMethod::kRandom:
        options.keep_probability = found.parameter;
        break;
      case SampleMethod::kMaxDensity:
        options.max_density = found.parameter;
        break;
      case SampleMethod::kVoxel:
        options.cell_edge_m = found.parameter;
        break;
      case SampleMethod::kSpdf:
        options.spdf.density_radius_m = found.parameter;
        break;
      default:
        continue;
    }
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample again,
                                  Sample(cloud, options));
    EXPECT_EQ(again.rows, found.rows);
    EXPECT_EQ(again.parameter, found.parameter);
  }
}

TEST(Sampler, TakesNoneOfNoPointsAndOneOfOne) {
  const LatticeCloud empty;
  LatticeCloud one;
  one.positions = {{-12, 34, 56}};
  for (SamplerOptions options : Both(5)) {
    options.spdf.max_round_count = 0;
    SCOPED_TRACE(NameOf(options));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample none,
                                  Sample(empty, options));
    EXPECT_EQ(none.cloud.size(), 0u);
    // A point by itself is an outlier of the filter.
    const bool is_filter = options.method == SampleMethod::kSpdf ||
                           options.method == SampleMethod::kSpatialSpdf;
    if (options.keep_probability > 0) options.keep_probability = 1;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample sample,
                                  Sample(one, options));
    EXPECT_EQ(sample.cloud.positions,
              is_filter ? empty.positions : one.positions);
  }
}

TEST(Sampler, KeepsTheAttributesOfTheChosenPoints) {
  const LatticeCloud cloud = MixedCloud(700);
  for (SamplerOptions options : Both(300)) {
    SCOPED_TRACE(NameOf(options));
    if (options.method == SampleMethod::kVoxel) {
      options.representative = Representative::kNearest;
    }
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample sample,
                                  Sample(cloud, options));
    ASSERT_EQ(sample.rows.size(), sample.cloud.size());
    EXPECT_EQ(sample.cloud.positions, cloud.Select(sample.rows).positions);
    for (const Column& column : cloud.attributes.columns()) {
      EXPECT_EQ(*sample.cloud.attributes.Find(column.name()),
                column.Select(sample.rows));
    }
  }
}

TEST(Sampler, CentroidsCarryTheAttributesOfTheNearestPoint) {
  const LatticeCloud cloud = MixedCloud(700);
  for (const SampleMethod method :
       {SampleMethod::kOctree, SampleMethod::kVoxel, SampleMethod::kSsNormal,
        SampleMethod::kSpatialSpdf}) {
    SamplerOptions options = {.method = method, .max_points = 200};
    SCOPED_TRACE(NameOf(options));
    options.representative = Representative::kNearest;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample nearest,
                                  Sample(cloud, options));
    options.representative = Representative::kCentroid;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample centroids,
                                  Sample(cloud, options));
    EXPECT_EQ(centroids.rows, nearest.rows);
    EXPECT_TRUE(centroids.cloud.attributes == nearest.cloud.attributes);
    EXPECT_NE(centroids.cloud.positions, nearest.cloud.positions);
  }
}

TEST(Sampler, RenamesInputsThatHaveTheNamesOfItsColumns) {
  LatticeCloud cloud = testing::SceneCloud(500, 1, 6);
  for (const char* name : {"nx", "label", "input_nx"}) {
    Column column({name, ScalarType::kUint8}, cloud.size());
    MAPSIEVE_ASSERT_OK(cloud.attributes.Add(std::move(column)));
  }
  const auto names = [&](SampleMethod method) {
    std::vector<std::string> result;
    for (const ColumnSpec& spec :
         Sample(cloud, {.method = method, .max_points = 50})
             ->cloud.attributes.specs()) {
      result.push_back(spec.name);
    }
    return result;
  };
  EXPECT_THAT(names(SampleMethod::kSsNormal),
              ::testing::ElementsAre("nx", "ny", "nz", "input_nx", "label",
                                     "input_input_nx"));
  EXPECT_THAT(names(SampleMethod::kOctree),
              ::testing::ElementsAre("nx", "label", "input_nx"));
  EXPECT_THAT(
      names(SampleMethod::kNss),
      ::testing::ElementsAre("label", "confidence", "nx", "ny", "nz",
                             "input_nx", "input_label", "input_input_nx"));
}

TEST(Sampler, TheSeedChangesWhatIsDrawn) {
  const LatticeCloud cloud = testing::SceneCloud(3000, 2, 7);
  for (const SamplerOptions& options : std::vector<SamplerOptions>{
           {.method = SampleMethod::kRandom, .keep_probability = 0.5},
           {.method = SampleMethod::kMaxDensity, .max_density = 300},
           {.method = SampleMethod::kOctree,
           .max_points = 200,
           .representative = Representative::kRandom},
           {.method = SampleMethod::kNss, .max_points = 200}}) {
    SCOPED_TRACE(NameOf(options));
    SamplerOptions other = options;
    other.spdf.seed = 1;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample a, Sample(cloud, options));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CloudSample b, Sample(cloud, other));
    EXPECT_NE(a.rows, b.rows);
    // Counts do not depend on it.
    EXPECT_NEAR(static_cast<double>(a.rows.size()),
                static_cast<double>(b.rows.size()), 150);
  }
}

TEST(Sampler, OutliersByIdealShapesAreTheSameWhateverElseThereIs) {
  // Ground with a few points to each ball, and far away ground with many.
  const LatticeCloud ground = testing::PlaneCloud(2000, 5, 8);
  const LatticeCloud both = testing::Concatenated(
      ground, testing::Shifted(testing::PlaneCloud(4000, 1, 9), {50000, 0, 0}));
  const auto kept_ground = [](const LatticeCloud& cloud,
                              const SamplerOptions& options) {
    std::vector<LatticePoint> kept = Sample(cloud, options)->cloud.positions;
    std::erase_if(kept, [](const LatticePoint& q) { return q.x > 40000; });
    return kept;
  };
  SamplerOptions options = {.method = SampleMethod::kSpatialSpdf,
                            .max_points = 100000,
                            .spdf = {.density_radius_m = 0.2,
                                     .rule = DensityRule::kQuota,
                                     .outlier_share = 0.3}};
  // A share of the largest confidence, that of the dense ground.
  EXPECT_NE(kept_ground(both, options), kept_ground(ground, options));
  options.ideal_share = 0.02;
  const std::vector<LatticePoint> kept = kept_ground(ground, options);
  EXPECT_EQ(kept_ground(both, options), kept);
  EXPECT_GT(kept.size(), 0u);
  EXPECT_LT(kept.size(), ground.size());
  // It takes the place of the other share.
  options.spdf.outlier_share = 1;
  EXPECT_EQ(kept_ground(both, options), kept);
}

TEST(Sampler, TheSurestPointsAreThoseOfTheFiltersConfidences) {
  const LatticeCloud cloud = testing::SceneCloud(6000, 3, 4);
  SamplerOptions options = {.method = SampleMethod::kSpatialSpdf,
                            .max_points = 200,
                            .spdf = {.rule = DensityRule::kQuota}};
  const auto confidence_sum = [&] {
    const BulkVector<uint16_t> confidences =
        Sample(cloud, options)->columns.confidence;
    EXPECT_EQ(confidences.size(), 200u);
    return std::accumulate(confidences.begin(), confidences.end(), int64_t{0});
  };
  const int64_t nearest = confidence_sum();
  options.representative = Representative::kSurest;
  EXPECT_GT(confidence_sum(), nearest * 11 / 10);
}

TEST(Sampler, IdealSharesAreThoseOfTheLabelsSaliency) {
  // 0.5 xi_1^2 and 0.25 xi_2^2 at sigma = rho = 0.2, times 65535 / 2.
  const OutlierTest test =
      OutlierTest::OfIdealShapes({.density_radius_m = 0.2}, 0.5);
  const auto lowest_kept = [&](Label label) {
    uint16_t confidence = 0;
    while (confidence < 65535 && !test.Keeps(label, confidence)) ++confidence;
    return confidence;
  };
  EXPECT_NEAR(lowest_kept(Label::kCurve), 14389, 1);
  EXPECT_NEAR(lowest_kept(Label::kSurface), 6730, 1);
  EXPECT_NEAR(lowest_kept(Label::kJunction), 6730, 1);
  EXPECT_FALSE(test.Keeps(Label::kNone, 65535));
}

TEST(Sampler, SaysWhatIsWrongWithItsOptions) {
  const Lattice lattice;
  using Method = SampleMethod;
  const std::vector<std::pair<SamplerOptions, const char*>> cases = {
      {{.method = Method::kVoxel},
       "method voxel needs max_points or cell_edge"},
      {{.method = Method::kRandom}, "needs max_points or keep_probability"},
      {{.method = Method::kNss}, "method nss needs max_points"},
      {{.method = Method::kSpatialSpdf}, "needs max_points"},
      {{.method = Method::kVoxel, .max_points = 9, .cell_edge_m = 1},
       "not both"},
      {{.method = Method::kVoxel, .max_points = -1}, "max_points is -1"},
      {{.method = Method::kVoxel, .cell_edge_m = 0.0005}, "0.001 or above"},
      {{.method = Method::kVoxel, .cell_edge_m = std::nan("")},
       "cell_edge_m is nan"},
      {{.method = Method::kRandom, .keep_probability = 1.5}, "at most 1"},
      {{.method = Method::kMaxDensity, .max_density = -2}, "above 0"},
      {{.method = Method::kOctree, .max_cell_points = -2}, "max_cell_points"},
      {{.method = Method::kOctree, .max_density = 1}, "takes no max_density"},
      {{.method = Method::kNss,
        .max_points = 9,
        .representative = Representative::kFirst},
       "takes no representative"},
      {{.method = Method::kSpatialSpdf,
        .max_points = 9,
        .representative = Representative::kFirst},
       "nearest, centroid and surest"},
      {{.method = Method::kVoxel,
        .cell_edge_m = 1,
        .representative = Representative::kSurest},
       "takes no representative surest"},
      {{.method = Method::kOctree,
        .max_points = 9,
        .cell_split = CellSplit::kWidest},
       "takes no cell_split"},
      {{.method = Method::kSpdf, .ideal_share = 0.1}, "takes no ideal_share"},
      {{.method = Method::kSpatialSpdf, .max_points = 9, .ideal_share = 1.5},
       "ideal_share is 1.5; it must be 0 to 1"},
      {{.method = Method::kCovs, .max_points = 9, .spdf = {.vote_scale_m2 = 0}},
       "vote_scale_m2"},
      {{.method = Method::kMaxDensity,
        .max_points = 9,
        .spdf = {.neighbor_count = 0}},
       "neighbor_count is 0"},
  };
  for (const auto& [options, message] : cases) {
    EXPECT_THAT(
        options.Validate(lattice),
        StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(message)));
    EXPECT_FALSE(Sample(LatticeCloud(), options).ok());
  }
  for (const SamplerOptions& options : Both(5)) {
    MAPSIEVE_EXPECT_OK(options.Validate(lattice));
  }
}

TEST(Sampler, FailsWhereNoParameterKeepsSoFew) {
  // Eight voxels meet at the origin, however large they are.
  LatticeCloud corners;
  for (const int64_t x : {-5, 5}) {
    for (const int64_t y : {-5, 5}) {
      for (const int64_t z : {-5, 5}) corners.positions.push_back({x, y, z});
    }
  }
  EXPECT_THAT(
      Sample(corners, {.method = SampleMethod::kVoxel, .max_points = 7}),
      StatusIs(absl::StatusCode::kFailedPrecondition,
               HasSubstr("no voxel edge leaves as few as 7 points")));
  // Two rounds halve no cloud to a single point.
  EXPECT_THAT(
      Sample(testing::PlaneCloud(3000, 2, 8),
             {.max_points = 1, .spdf = {.max_round_count = 2}}),
      StatusIs(absl::StatusCode::kFailedPrecondition,
               HasSubstr("8.191 (8191 lattice steps) leaves as few as 1")));
}

TEST(Sampler, StopsWhenAsked) {
  std::stop_source stop;
  stop.request_stop();
  const LatticeCloud cloud = testing::SceneCloud(9000, 2, 9);
  for (const SamplerOptions& options : Both(5000)) {
    if (options.method == SampleMethod::kRandom) continue;
    SCOPED_TRACE(NameOf(options));
    EXPECT_THAT(Sample(cloud, options, {.stop = stop.get_token()}),
                StatusIs(absl::StatusCode::kCancelled, HasSubstr("cancelled")));
  }
}

}  // namespace
}  // namespace mapsieve::core
