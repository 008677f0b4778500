#include "client/lab/filter_report.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "client/lab/ball_counter.h"
#include "core/cloud/merge_duplicates.h"
#include "gtest/gtest.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

using core::DensityRule;
using core::FilteredCloud;
using core::Label;
using core::LatticeCloud;
using core::LatticePoint;
using core::SpdfOptions;
namespace clouds = ::mapsieve::testing;

size_t At(Label label) { return static_cast<size_t>(label); }

// BallCounter -----------------------------------------------------------------

TEST(BallCounter, EqualsBruteForce) {
  const LatticePoint offset = {core::kLatticeLimit - 4000, -5'000'000'000, 7};
  const std::vector<LatticePoint> points = core::DistinctPoints(
      clouds::Concatenated(
          clouds::Concatenated(clouds::SceneCloud(2000, 0.6, 1),
                               clouds::PlaneCloud(1000, 1.5, 2)),
          clouds::Shifted(clouds::SceneCloud(300, 0.6, 3), offset))
          .positions);
  const BallCounter counter(points);
  const auto d2 = [](const LatticePoint& a, const LatticePoint& b) {
    // Far pairs are beyond every radius here and would overflow.
    const auto far = std::max(
        {std::abs(a.x - b.x), std::abs(a.y - b.y), std::abs(a.z - b.z)});
    if (far > 10'000) return int64_t{1'000'000'000};
    return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y) +
           (a.z - b.z) * (a.z - b.z);
  };
  for (size_t i = 0; i < points.size(); i += 17) {
    LatticePoint center = points[i];
    if (i % 2 == 0) center.x += 500;
    for (const int64_t radius : {0, 1, 30, 200, 8191}) {
      const int64_t expected = std::count_if(
          points.begin(), points.end(),
          [&](const auto& q) { return d2(q, center) <= radius * radius; });
      ASSERT_EQ(counter.Count(center, radius * radius), expected);
    }
  }
}

TEST(BallCounter, TakesNoPointsAndOne) {
  EXPECT_EQ(BallCounter({}).Count({}, 100), 0);
  const BallCounter one({{3, 4, 0}});
  EXPECT_EQ(one.Count({}, 25), 1);
  EXPECT_EQ(one.Count({}, 24), 0);
}

// Made by hand ----------------------------------------------------------------

/// A filter's answer that keeps `rows`, all with one label and eigenvalues.
FilteredCloud Answer(std::vector<uint32_t> rows, size_t input_size,
                     Label label = Label::kCurve,
                     const std::array<float, 3>& lambda = {0.5F, 0.4F, 0.1F}) {
  FilteredCloud answer;
  for (size_t i = 0; i < rows.size(); ++i) {
    answer.columns.label.push_back(label);
    answer.columns.confidence.push_back(30000);
    answer.columns.lambda.push_back(lambda);
    answer.columns.normal.emplace_back();
    answer.columns.tangent.emplace_back();
  }
  answer.summary.point_count = static_cast<int64_t>(input_size);
  answer.summary.survivor_count = static_cast<int64_t>(rows.size());
  answer.summary.label_counts[At(label)] = answer.summary.survivor_count;
  answer.summary.max_confidence =
      core::UpdateMaxConfidence(answer.columns.All());
  answer.rows = std::move(rows);
  return answer;
}

/// 101 points on the x axis, 10 steps apart; rows in Morton order are 0 to 100.
LatticeCloud Ruler() {
  LatticeCloud cloud;
  for (int64_t i = 0; i <= 100; ++i) cloud.positions.push_back({10 * i, 0, 0});
  return cloud;
}

std::vector<uint32_t> EveryRow(uint32_t step) {
  std::vector<uint32_t> rows;
  for (uint32_t i = 0; i <= 100; i += step) rows.push_back(i);
  return rows;
}

/// Six others within 50 steps are aimed at.
const SpdfOptions kRulerOptions = {.neighbor_count = 6,
                                   .density_radius_m = 0.05};

TEST(FilterReport, CountsOthersInTheClosedBall) {
  const LatticeCloud cloud = Ruler();
  const std::vector<RuleRun> runs = {
      {DensityRule::kQuota, Answer(EveryRow(2), 101), 1.5}};
  const FilterReport report =
      MakeFilterReport(cloud, Answer(EveryRow(1), 101), runs, kRulerOptions);
  EXPECT_EQ(report.point_count, 101);
  EXPECT_DOUBLE_EQ(report.target_density[At(Label::kCurve)], 60);
  ASSERT_EQ(report.rules.size(), 1U);
  EXPECT_EQ(report.rules[0].rule, DensityRule::kQuota);
  EXPECT_EQ(report.rules[0].filter_s, 1.5);
  EXPECT_EQ(report.rules[0].survivor_count, 51);

  const LabelDensity& density = report.rules[0].density[At(Label::kCurve)];
  EXPECT_EQ(density.survivor_count, 51);
  // The first and the last point had 5 others in the input.
  EXPECT_EQ(density.sparse_count, 2);
  EXPECT_EQ(density.reached.count, 49);
  // 20 and 40 steps to both sides; but for those 20 steps from an end.
  EXPECT_NEAR(density.reached.mean, (47 * 4 + 2 * 3) / (49 * 6.0), 1e-12);
  EXPECT_NEAR(density.reached.median, 4 / 6.0, 1e-12);
  EXPECT_NEAR(density.reached.p10, 4 / 6.0, 1e-12);
  // 7, 9, then 10 from the sixth point on.
  EXPECT_NEAR(density.input.mean, (2 * 7 + 2 * 9 + 45 * 10) / (49 * 6.0),
              1e-12);
  EXPECT_NEAR(density.input.p90, 10 / 6.0, 1e-12);
  for (size_t bin = 0; bin < RatioBins::kCount; ++bin) {
    const auto holds = [&](double ratio) {
      return RatioBins::LowerEdge(bin) <= ratio &&
             ratio < RatioBins::LowerEdge(bin + 1);
    };
    EXPECT_EQ(density.reached_histogram[bin], holds(4 / 6.0) ? 47
                                              : holds(0.5)   ? 2
                                                             : 0);
  }
  EXPECT_EQ(report.rules[0].density[At(Label::kSurface)].survivor_count, 0);
  EXPECT_EQ(report.rules[0].density[At(Label::kSurface)].reached.count, 0);
}

TEST(FilterReport, KnowsTheTargetInEveryDimension) {
  const FilterReport report =
      MakeFilterReport(Ruler(), Answer({}, 0), {},
                       {.neighbor_count = 30, .density_radius_m = 0.5});
  EXPECT_NEAR(report.target_density[At(Label::kCurve)], 30, 1e-9);
  EXPECT_NEAR(report.target_density[At(Label::kSurface)], 120 / M_PI, 1e-9);
  EXPECT_NEAR(report.target_density[At(Label::kJunction)], 180 / M_PI, 1e-9);
}

TEST(FilterReport, HasEachSaliencyInItsBin) {
  const LatticeCloud cloud = Ruler();
  FilteredCloud survivors = Answer({0, 1, 2}, 101);
  survivors.columns.lambda = {{0.3F, 0.1F, 0.0F},     // surface 0.2
                              {0.25F, 0.249F, 0.0F},  // curve 0.249
                              {0.9F, 0.9F, 0.9F}};    // beyond the last bin
  survivors.columns.label = {Label::kSurface, Label::kCurve, Label::kJunction};
  const std::vector<RuleRun> runs = {{DensityRule::kPaper, survivors, 0}};
  const FilterReport report =
      MakeFilterReport(cloud, Answer(EveryRow(1), 101), runs, kRulerOptions);
  const auto& saliency = report.rules[0].saliency;
  for (const Label label : kGeometricLabels) {
    const SaliencyHistogram& histogram = saliency[At(label)];
    EXPECT_EQ(std::accumulate(histogram.all.begin(), histogram.all.end(), 0),
              3);
    EXPECT_EQ(
        std::accumulate(histogram.labeled.begin(), histogram.labeled.end(), 0),
        1);
  }
  EXPECT_EQ(saliency[At(Label::kSurface)].labeled[40], 1);
  EXPECT_EQ(saliency[At(Label::kCurve)].labeled[49], 1);
  EXPECT_EQ(saliency[At(Label::kJunction)].labeled.back(), 1);
  EXPECT_EQ(saliency[At(Label::kSurface)].all[0], 2);
  // The input's own: curve 0.3.
  EXPECT_EQ(report.input_saliency[At(Label::kCurve)].labeled[60] +
                report.input_saliency[At(Label::kCurve)].labeled[59],
            101);
}

TEST(FilterReport, FollowsEveryPointOfAKnownClass) {
  LatticeCloud cloud = Ruler();
  core::Column classes({"classification", core::ScalarType::kUint8});
  core::Column other({"truth", core::ScalarType::kUint16});
  // Rows 0 to 49 ground, 50 to 99 poles, the last has none.
  for (int i = 0; i < 100; ++i) {
    classes.Append(static_cast<uint8_t>(i < 50 ? 2 : 64));
  }
  classes.AppendMissing(1);
  other.Resize(101);
  MAPSIEVE_ASSERT_OK(cloud.attributes.Add(std::move(classes)));
  MAPSIEVE_ASSERT_OK(cloud.attributes.Add(std::move(other)));
  // Even rows survive; ground among them is a surface, all the rest a curve;
  // rows 0, 2 and 60 are outliers.
  FilteredCloud survivors = Answer(EveryRow(2), 101);
  for (size_t i = 0; i < survivors.rows.size(); ++i) {
    const uint32_t row = survivors.rows[i];
    if (row < 50) survivors.columns.label[i] = Label::kSurface;
    if (row == 0 || row == 2 || row == 60) {
      survivors.columns.confidence[i] = 2999;
    }
  }
  survivors.summary.max_confidence =
      core::UpdateMaxConfidence(survivors.columns.All());
  const std::vector<RuleRun> runs = {{DensityRule::kPaper, survivors, 0}};
  const FilterReport report =
      MakeFilterReport(cloud, Answer(EveryRow(1), 101), runs, kRulerOptions);
  const RuleReport& rule = report.rules[0];
  EXPECT_EQ(rule.kept_count, 48);
  EXPECT_EQ(rule.kept_label_counts, (core::LabelCounts{0, 0, 25, 23}));
  // The other attribute is of a type that is no class.
  ASSERT_EQ(rule.confusions.size(), 1U);
  EXPECT_EQ(rule.confusions[0].attribute, "classification");
  ASSERT_EQ(rule.confusions[0].classes.size(), 2U);
  const ClassOutcome& ground = rule.confusions[0].classes[0];
  EXPECT_EQ(ground.value, 2);
  EXPECT_EQ(ground.name, "ground");
  EXPECT_EQ(ground.kept, (core::LabelCounts{0, 0, 0, 23}));
  EXPECT_EQ(ground.outlier_count, 2);
  EXPECT_EQ(ground.thinned_count, 25);
  const ClassOutcome& pole = rule.confusions[0].classes[1];
  EXPECT_EQ(pole.name, "pole");
  EXPECT_EQ(pole.kept, (core::LabelCounts{0, 0, 24, 0}));
  EXPECT_EQ(pole.outlier_count, 1);
  EXPECT_EQ(pole.thinned_count, 25);
}

// With the filter -------------------------------------------------------------

FilterReport ReportOf(const LatticeCloud& cloud, const SpdfOptions& options,
                      Executor& executor = InlineExecutor()) {
  const auto run = [&](DensityRule rule, int rounds) {
    SpdfOptions with = options;
    with.rule = rule;
    with.max_round_count = rounds;
    auto filtered = core::FilterCloud(cloud, with);
    EXPECT_THAT(filtered, clouds::IsOk());
    return *std::move(filtered);
  };
  const std::vector<RuleRun> runs = {
      {DensityRule::kPaper, run(DensityRule::kPaper, 10), 0},
      {DensityRule::kQuota, run(DensityRule::kQuota, 10), 0}};
  return MakeFilterReport(cloud, run(DensityRule::kPaper, 0), runs, options,
                          {.executor = &executor});
}

double MeanSaliency(const SaliencyHistogram& histogram) {
  double sum = 0;
  double count = 0;
  for (size_t bin = 0; bin < SaliencyBins::kCount; ++bin) {
    const auto n = static_cast<double>(histogram.labeled[bin]);
    sum += n * (static_cast<double>(bin) + 0.5) * SaliencyBins::kWidth;
    count += n;
  }
  return sum / count;
}

TEST(FilterReport, FindsIdealShapesAtTargetAsExpected) {
  // Eight times the target: 100 points a metre, 318 a square metre.
  SpdfOptions options = {.neighbor_count = 40, .density_radius_m = 0.2};
  const std::pair<Label, LatticeCloud> shapes[] = {
      {Label::kCurve, clouds::LineCloud(12800, 8, 51)},
      {Label::kSurface, clouds::PlaneCloud(40744, 2, 52)}};
  for (const int label_neighbor_count : {0, 90}) {
    options.label_neighbor_count = label_neighbor_count;
    for (const auto& [label, cloud] : shapes) {
      SCOPED_TRACE(std::string(core::LabelName(label)) + " by " +
                   std::to_string(options.LabelNeighborCount()));
      const FilterReport report = ReportOf(cloud, options);
      const RuleReport& quota = report.rules[1];
      const LabelDensity& density = quota.density[At(label)];
      EXPECT_EQ(density.survivor_count, quota.survivor_count);
      EXPECT_EQ(density.sparse_count, 0);
      EXPECT_NEAR(density.reached.mean, 1, 0.05);
      EXPECT_GT(density.input.median, 4);
      EXPECT_NEAR(MeanSaliency(quota.saliency[At(label)]) /
                      report.expected_saliency[At(label)],
                  1, 0.05);
      EXPECT_GT(MeanSaliency(report.input_saliency[At(label)]),
                report.expected_saliency[At(label)] * 1.05);
    }
  }
}

TEST(FilterReport, DoesNotDependOnTheWorkers) {
  const LatticeCloud cloud = clouds::SceneCloud(20000, 1, 53);
  const auto pool = MakeWorkerPool(3);
  const SpdfOptions options = {.density_radius_m = 0.1};
  const FilterReport a = ReportOf(cloud, options);
  const FilterReport b = ReportOf(cloud, options, *pool);
  for (size_t rule = 0; rule < 2; ++rule) {
    for (const Label label : kGeometricLabels) {
      const LabelDensity& x = a.rules[rule].density[At(label)];
      const LabelDensity& y = b.rules[rule].density[At(label)];
      EXPECT_GT(x.survivor_count, 0);
      EXPECT_EQ(x.sparse_count, y.sparse_count);
      EXPECT_EQ(x.reached_histogram, y.reached_histogram);
      EXPECT_EQ(x.reached.mean, y.reached.mean);
    }
  }
}

}  // namespace
}  // namespace mapsieve::client
