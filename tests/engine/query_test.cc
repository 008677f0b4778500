#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <set>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "core/cloud/merge_duplicates.h"
#include "core/codec/points_codec.h"
#include "core/sampling/spatial_budget.h"
#include "core/spdf/levels.h"
#include "gtest/gtest.h"
#include "server/engine/field_error.h"
#include "server/engine/region.h"
#include "server/engine/region_query.h"
#include "server/engine/sync_region.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::Label;
using core::LatticeCloud;
using core::LatticePoint;
using core::Point3;
using mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

constexpr ProcessLimits kProcessLimits = {.unit_points = 1 << 20,
                                          .tile_points = 1 << 26,
                                          .pending_bytes = 1 << 20,
                                          .chunk_bytes = 30'000};

/// One processed map for all tests of a suite, which only read.
class RegionQueryTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    scene_ = new LatticeCloud(MakeScene(11));
    const core::SpdfOptions options = SceneOptions(core::DensityRule::kPaper);
    expected_ = new LatticeCloud(FilterLocally(*scene_, options));
    workshop_ = new Workshop(12);
    MAPSIEVE_ASSERT_OK(
        workshop_->Add(*scene_, IngestLimits::Of(int64_t{32} << 20)));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ProcessReport report,
                                  workshop_->Process(options, kProcessLimits));
    report_ = new ProcessReport(report);
  }
  static void TearDownTestSuite() {
    delete report_;
    delete workshop_;
    delete expected_;
    delete scene_;
  }

  /// The points of `cloud` that `is_wanted`.
  static LatticeCloud Filter(const LatticeCloud& cloud,
                             const std::function<bool(size_t)>& is_wanted) {
    std::vector<uint32_t> rows;
    for (uint32_t row = 0; row < cloud.size(); ++row) {
      if (is_wanted(row)) rows.push_back(row);
    }
    return cloud.Select(rows);
  }
  static Point3 At(const LatticeCloud& cloud, size_t row) {
    return cloud.lattice.Position(cloud.positions[row]);
  }
  static Label LabelAt(size_t row) {
    return static_cast<Label>(
        expected_->attributes.Find("label")->Get<uint8_t>(row));
  }

  static LatticeCloud* scene_;
  static LatticeCloud* expected_;
  static Workshop* workshop_;
  static ProcessReport* report_;
};
LatticeCloud* RegionQueryTest::scene_ = nullptr;
LatticeCloud* RegionQueryTest::expected_ = nullptr;
Workshop* RegionQueryTest::workshop_ = nullptr;
ProcessReport* RegionQueryTest::report_ = nullptr;

TEST_F(RegionQueryTest, BoxGivesThePointsInside) {
  // The ends are tile faces, lattice coordinates, and between them.
  for (const Box& box :
       {Box{{-4.096, -2, -0.001}, {4.096, 3.5005, 2}},
        Box{{-8.192, -8.192, 0}, {0, 0, 4.096}},
        Box{{-1e6, -1e6, -1e6}, {1e6, 1e6, 1e6}},
        Box{{3.9, 3.9, -1}, {4.2, 4.2, 6}}, Box{{50, 50, 50}, {60, 60, 60}}}) {
    const auto inside = [&](const Point3& p) {
      return p.x >= box.min.x && p.x < box.max.x && p.y >= box.min.y &&
             p.y < box.max.y && p.z >= box.min.z && p.z < box.max.z;
    };
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                  workshop_->Query({.region = box}));
    ExpectSameCloud(answer.points, Filter(*expected_, [&](size_t row) {
                      return inside(At(*expected_, row));
                    }));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const Answer raw, workshop_->Query({.region = box, .raw = true}));
    ExpectSameCloud(InCanonicalOrder(raw.points),
                    InCanonicalOrder(Filter(*scene_, [&](size_t row) {
                      return inside(At(*scene_, row));
                    })));
  }
}

TEST_F(RegionQueryTest, SphereGivesThePointsInside) {
  for (const Sphere& sphere :
       {Sphere{{0, 0, 0}, 3}, Sphere{{4.096, 4.096, 2}, 2.5},
        Sphere{{-4.5, 4.5, 2}, 1}, Sphere{{0, 0, 0}, 1e5},
        Sphere{{0, 0, -5}, 4}}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                  workshop_->Query({.region = sphere}));
    ExpectSameCloud(answer.points, Filter(*expected_, [&](size_t row) {
                      const Point3 p = At(*expected_, row);
                      const double dx = p.x - sphere.center.x;
                      const double dy = p.y - sphere.center.y;
                      const double dz = p.z - sphere.center.z;
                      return dx * dx + dy * dy + dz * dz <=
                             sphere.radius * sphere.radius;
                    }));
  }
}

TEST_F(RegionQueryTest, EveryShapeGivesThePointsInside) {
  const core::Lattice& lattice = expected_->lattice;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer all, workshop_->Query({}));
  for (const QueryShape& shape :
       {QueryShape(OrientedBox{{1, 0, 1}, {0, 0, 0.6, 0.8}, {4, 1.5, 2}}),
        QueryShape(VerticalCylinder{
            .center_x = -4, .center_y = 4, .radius = 2.5, .min_z = 0.2}),
        QueryShape(PolygonPrism{
            .vertices = {{-6, -6}, {5, -5}, {0, 0}, {6, 6}, {-5, 5}},
           .max_z = 1}),
        QueryShape(
            Frustum{{0, 0, 1}, {-0.5, 0.5, -0.5, 0.5}, 0.7, 0.4, 0.5, 7}),
        QueryShape(Corridor{{{-7, -7, 0}, {0, 0, 1}, {0, 7, 0}}, 1.3})}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Region region,
                                  Region::Make(shape, lattice));
    const LatticeCloud expected = Filter(*expected_, [&](size_t row) {
      return region.Contains(expected_->positions[row]);
    });
    ASSERT_GT(expected.size(), 20U);
    ASSERT_LT(expected.size(), expected_->size() / 2);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                  workshop_->Query({.region = shape}));
    ExpectSameCloud(answer.points, expected);
    // Chunks outside are not looked into.
    EXPECT_LT(answer.header.candidate_point_count,
              all.header.candidate_point_count);
  }
}

TEST_F(RegionQueryTest, RangesFilterBeforeTheBudgetCounts) {
  const core::Column& confidence = *expected_->attributes.Find("confidence");
  const core::Column& intensity = *expected_->attributes.Find("intensity");
  const core::Column& ring = *expected_->attributes.Find("ring");
  std::vector<double> sorted;
  for (size_t row = 0; row < expected_->size(); ++row) {
    sorted.push_back(confidence.GetAsDouble(row));
  }
  std::sort(sorted.begin(), sorted.end());
  // Ends that points have: they are inside.
  const Range middle = {sorted[sorted.size() / 4], sorted[sorted.size() / 2]};
  const Range low = {-std::numeric_limits<double>::infinity(),
                     intensity.GetAsDouble(0)};
  // Zero too, which missing values must not pass for.
  const Range rings = {0, 7};
  const LatticeCloud expected = Filter(*expected_, [&](size_t row) {
    return confidence.GetAsDouble(row) >= middle.min &&
           confidence.GetAsDouble(row) <= middle.max &&
           intensity.GetAsDouble(row) <= low.max && !ring.IsMissing(row) &&
           ring.GetAsDouble(row) <= 7;
  });
  ASSERT_GT(expected.size(), 20U);
  ASSERT_LT(expected.size(), expected_->size() / 4);
  QuerySpec spec = {.confidence = middle,
                    .attribute_ranges = {{"intensity", low}, {"ring", rings}}};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop_->Query(spec));
  ExpectSameCloud(answer.points, expected);
  // Columns that are not sent filter too.
  spec.columns = ColumnSelection{};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer bare, workshop_->Query(spec));
  EXPECT_EQ(bare.points.positions, expected.positions);
  spec.max_points = 10;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer some, workshop_->Query(spec));
  EXPECT_EQ(some.points.size(), 10U);
  const core::LabelCounts& available = some.summary.available_label_counts;
  EXPECT_EQ(std::accumulate(available.begin(), available.end(), int64_t{0}),
            static_cast<int64_t>(expected.size()));
  for (const LatticePoint& q : some.points.positions) {
    EXPECT_NE(
        std::find(expected.positions.begin(), expected.positions.end(), q),
        expected.positions.end());
  }
  // Raw points have attributes too, and "label" is that of the upload.
  const core::Column& own = *scene_->attributes.Find("label");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer raw,
      workshop_->Query({.attribute_ranges = {{"label", {1, 2}}}, .raw = true}));
  ExpectSameCloud(InCanonicalOrder(raw.points),
                  InCanonicalOrder(Filter(*scene_, [&](size_t row) {
                    return !own.IsMissing(row) && own.GetAsDouble(row) >= 1 &&
                           own.GetAsDouble(row) <= 2;
                  })));
}

/// Few chunks, since those of wide points are mostly heads.
constexpr ProcessLimits kWideLimits = {.unit_points = 1 << 20,
                                       .tile_points = 1 << 26,
                                       .pending_bytes = 1 << 26,
                                       .chunk_bytes = 1 << 22};

TEST(RegionQuery, ABudgetInBytesIsKeptAndUsed) {
  Workshop workshop(13);
  MAPSIEVE_ASSERT_OK(
      workshop.Add(WideScene(14, 20), IngestLimits::Of(int64_t{64} << 20)));
  MAPSIEVE_ASSERT_OK(
      workshop.Process(SceneOptions(core::DensityRule::kQuota), kWideLimits));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer all, workshop.Query({}));
  ASSERT_GT(all.summary.block_bytes, 2 * kMinBudgetBytes);
  EXPECT_EQ(all.summary.available_label_counts, all.summary.label_counts);
  for (const int64_t budget :
       {kMinBudgetBytes, all.summary.block_bytes * 3 / 4,
        all.summary.block_bytes - 1, 2 * all.summary.block_bytes}) {
    SCOPED_TRACE(budget);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                  workshop.Query({.max_bytes = budget}));
    EXPECT_LE(answer.summary.block_bytes, budget);
    EXPECT_GE(answer.summary.block_bytes,
              std::min(budget, all.summary.block_bytes) * 95 / 100);
    EXPECT_EQ(answer.summary.available_label_counts, all.summary.label_counts);
    EXPECT_EQ(answer.summary.point_count,
              static_cast<int64_t>(answer.points.size()));
    // The points are those of a budget of as many.
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const Answer counted,
        workshop.Query({.max_points = answer.summary.point_count}));
    ExpectSameCloud(answer.points, counted.points);
    EXPECT_EQ(counted.summary.block_bytes, answer.summary.block_bytes);
    // The smaller of both counts.
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const Answer both,
        workshop.Query({.max_points = 100, .max_bytes = budget}));
    EXPECT_EQ(both.summary.point_count,
              std::min(int64_t{100}, answer.summary.point_count));
  }
}

TEST_F(RegionQueryTest, BlocksAreHardlyLargerThanEachByItselfCanBe) {
  // The first one holds the few points of the coarsest level, which tell
  // little of what is to come.
  MemoryPool memory(1 << 28);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Batches answer,
      ReadBatches(OpenQuery(workshop_->store(), memory,
                            {.map_id = "map", .packed_columns = true}, {})));
  size_t least_bytes = 0;
  for (const std::vector<std::byte>& block : answer.blocks) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud points,
                                  core::DecodePoints(block));
    if (least_bytes == 0) {
      ASSERT_LT(points.size(), 100U);
    }
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto alone, core::EncodePoints(points));
    least_bytes += alone.size();
  }
  EXPECT_LE(static_cast<double>(answer.summary.block_bytes),
            1.03 * static_cast<double>(least_bytes));
}

TEST_F(RegionQueryTest, WeightsShareABudgetOut) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer all, workshop_->Query({}));
  const core::LabelCounts& counts = all.summary.label_counts;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer even,
      workshop_->Query(
          {.max_points = 90, .label_weights = core::LabelWeights{0, 1, 1, 1}}));
  EXPECT_EQ(even.summary.label_counts, (core::LabelCounts{0, 30, 30, 30}));
  // What curves cannot fill goes to the others.
  const int64_t budget = counts[2] + 90;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer full,
      workshop_->Query({.max_points = budget,
                        .label_weights = core::LabelWeights{0, 1, 1e6, 2}}));
  EXPECT_EQ(full.summary.label_counts,
            (core::LabelCounts{0, 30, counts[2], 60}));
  // Weights of labels that are not asked for say nothing.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer two,
      workshop_->Query({.labels = {Label::kCurve, Label::kSurface},
                        .max_points = 80,
                        .label_weights = core::LabelWeights{0, 0, 3, 1}}));
  EXPECT_EQ(two.summary.label_counts, (core::LabelCounts{0, 0, 60, 20}));
}

TEST_F(RegionQueryTest, CovariancesAndSaliencesAreThoseOfTheirDefinitions) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer all,
      workshop_->Query({.columns = ColumnSelection{.label = true,
                                                   .normal = true,
                                                   .eigenvalues = true,
                                                   .saliencies = true,
                                                   .covariance = true}}));
  core::LabelCounts seen{};
  for (size_t i = 0; i < all.points.size(); ++i) {
    const auto value = [&](const std::string& name) {
      return all.points.attributes.Find(name)->GetAsDouble(i);
    };
    const auto label = static_cast<Label>(value("label"));
    ++seen[static_cast<size_t>(label)];
    const double saliencies[] = {value("saliency_surface"),
                                 value("saliency_curve"),
                                 value("saliency_junction")};
    EXPECT_NEAR(saliencies[0], value("lambda1") - value("lambda2"), 1e-6);
    EXPECT_NEAR(saliencies[1], value("lambda2") - value("lambda3"), 1e-6);
    EXPECT_EQ(saliencies[2], value("lambda3"));
    const size_t largest = static_cast<size_t>(
        std::max_element(saliencies, saliencies + 3) - saliencies);
    EXPECT_EQ(static_cast<size_t>(label), 3 - largest);

    const double n[] = {value("nx"), value("ny"), value("nz")};
    const char* names[3][3] = {{"cov_xx", "cov_xy", "cov_xz"},
                               {"cov_xy", "cov_yy", "cov_yz"},
                               {"cov_xz", "cov_yz", "cov_zz"}};
    for (size_t r = 0; r < 3; ++r) {
      for (size_t c = 0; c < 3; ++c) {
        const double one = r == c ? 1 : 0;
        const double expected =
            label == Label::kJunction ? one : one - 0.999 * n[r] * n[c];
        EXPECT_NEAR(value(names[r][c]), expected, 1e-6);
      }
    }
    // Sylvester: all leading minors above 0, and the determinant is known.
    const double xx = value("cov_xx");
    const double xy = value("cov_xy");
    const double xz = value("cov_xz");
    const double yy = value("cov_yy");
    const double yz = value("cov_yz");
    const double zz = value("cov_zz");
    EXPECT_GT(xx, 0);
    EXPECT_GT(xx * yy - xy * xy, 0);
    const double determinant = xx * (yy * zz - yz * yz) -
                               xy * (xy * zz - yz * xz) +
                               xz * (xy * yz - yy * xz);
    EXPECT_NEAR(determinant, label == Label::kJunction ? 1 : 1e-3, 1e-6);
  }
  for (const Label label : {Label::kJunction, Label::kCurve, Label::kSurface}) {
    EXPECT_GT(seen[static_cast<size_t>(label)], 0);
  }
}

TEST(RegionQuery, CovariancesOfAPlaneAndALineAreTheirClosedForms) {
  // Far apart: ground on z = 0, and a wire along y.
  LatticeCloud cloud;
  for (int64_t x = -1500; x <= 1500; x += 100) {
    for (int64_t y = -1500; y <= 1500; y += 100) {
      cloud.positions.push_back({x, y, 0});
    }
  }
  for (int64_t y = -4000; y <= 4000; y += 20) {
    cloud.positions.push_back({20'000, y, 5000});
  }
  Workshop workshop(15);
  MAPSIEVE_ASSERT_OK(workshop.Add(cloud, IngestLimits::Of(1 << 25)));
  MAPSIEVE_ASSERT_OK(workshop.Process(core::SpdfOptions(), kProcessLimits));
  const auto query = [&](const Box& box, Label label) {
    const auto answer = workshop.Query(
        {.region = box,
         .labels = {label},
         .columns = ColumnSelection{.tangent = true, .covariance = true}});
    EXPECT_THAT(answer, mapsieve::testing::IsOk());
    EXPECT_GT(answer->points.size(), 20U);
    return std::move(answer)->points;
  };
  const auto expect = [](const LatticeCloud& points, const std::string& name,
                         double expected) {
    for (size_t i = 0; i < points.size(); ++i) {
      EXPECT_NEAR(points.attributes.Find(name)->GetAsDouble(i), expected, 2e-3);
    }
  };
  const LatticeCloud ground =
      query({{-0.8, -0.8, -1}, {0.8, 0.8, 1}}, Label::kSurface);
  expect(ground, "cov_xx", 1);
  expect(ground, "cov_xy", 0);
  expect(ground, "cov_xz", 0);
  expect(ground, "cov_yy", 1);
  expect(ground, "cov_yz", 0);
  expect(ground, "cov_zz", 0.001);
  // The normal is any direction across the wire.
  const LatticeCloud wire = query({{19, -2, 4}, {21, 2, 6}}, Label::kCurve);
  expect(wire, "ty", 1);
  expect(wire, "cov_yy", 1);
  expect(wire, "cov_xy", 0);
  expect(wire, "cov_yz", 0);
}

/// The batches of a cursor, with the token after each.
TEST_F(RegionQueryTest, PlainBlocksHoldTheSamePoints) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer coded, workshop_->Query({}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer plain,
                                workshop_->Query({.plain_blocks = true}));
  ExpectSameCloud(plain.points, coded.points);
  // Position, label, confidence, normal and at least the attributes' time.
  EXPECT_GT(plain.summary.block_bytes,
            plain.summary.point_count * (3 * 4 + 1 + 4 + 3 * 4 + 8));
  EXPECT_LT(coded.summary.block_bytes, plain.summary.block_bytes);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer budget,
      workshop_->Query({.max_bytes = kMinBudgetBytes, .plain_blocks = true}));
  EXPECT_LE(budget.summary.block_bytes, kMinBudgetBytes);
}

TEST(RegionQuery, ResumesBehindAnyBatchByteForByteFromItsRevision) {
  Workshop workshop(13);
  MAPSIEVE_ASSERT_OK(
      workshop.Add(WideScene(15, 50), IngestLimits::Of(int64_t{64} << 20)));
  MAPSIEVE_ASSERT_OK(
      workshop.Process(SceneOptions(core::DensityRule::kQuota), kWideLimits));
  MemoryPool memory(1 << 28);
  const auto ask = [&](const QuerySpec& spec) {
    return ReadBatches(OpenQuery(workshop.store(), memory, spec, {}));
  };
  std::vector<std::pair<QuerySpec, Batches>> answers;
  for (const QuerySpec& spec :
       {QuerySpec{.map_id = "map", .resume_key = 7},
        QuerySpec{.map_id = "map", .max_points = 2000, .resume_key = 8},
        QuerySpec{.map_id = "map", .raw = true, .resume_key = 9}}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(Batches batches, ask(spec));
    ASSERT_GE(batches.blocks.size(), 2U);
    answers.emplace_back(spec, std::move(batches));
  }
  // Whatever happens to the map after.
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(16), IngestLimits::Of(1 << 25)));
  MAPSIEVE_ASSERT_OK(
      workshop.Process(SceneOptions(core::DensityRule::kQuota), kWideLimits));
  for (const auto& [asked, whole] : answers) {
    const size_t step = 1 + whole.blocks.size() / 4;
    for (size_t i = 0; i < whole.blocks.size(); i += step) {
      SCOPED_TRACE(i);
      QuerySpec spec = asked;
      spec.resume_token = whole.tokens[i];
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Batches rest, ask(spec));
      EXPECT_EQ(rest.blocks, std::vector(whole.blocks.begin() +
                                             static_cast<ptrdiff_t>(i) + 1,
                                         whole.blocks.end()));
      EXPECT_EQ(rest.tokens, std::vector(whole.tokens.begin() +
                                             static_cast<ptrdiff_t>(i) + 1,
                                         whole.tokens.end()));
      EXPECT_EQ(rest.summary.point_count, whole.summary.point_count);
      EXPECT_EQ(rest.summary.label_counts, whole.summary.label_counts);
      EXPECT_EQ(rest.summary.block_bytes, whole.summary.block_bytes);
    }
  }
  const auto refuses = [&](const std::string& token, uint64_t key) {
    const absl::Status status =
        ask({.map_id = "map", .resume_token = token, .resume_key = key})
            .status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
    EXPECT_EQ(FieldOf(status), "resume_token");
  };
  const std::string token = answers[0].second.tokens[0];
  refuses(token, 8);
  refuses("token", 7);
  refuses(token + "x", 7);
  for (size_t i = 0; i < token.size(); ++i) {
    std::string damaged = token;
    damaged[i] = static_cast<char>(damaged[i] ^ 4);
    refuses(damaged, 7);
  }
}

TEST_F(RegionQueryTest, LabelsFilter) {
  for (const std::vector<Label>& labels :
       {std::vector<Label>{Label::kCurve},
        std::vector<Label>{Label::kJunction, Label::kCurve},
        std::vector<Label>{Label::kSurface, Label::kSurface}}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                  workshop_->Query({.labels = labels}));
    ASSERT_GT(answer.points.size(), 0U);
    ExpectSameCloud(answer.points, Filter(*expected_, [&](size_t row) {
                      return std::find(labels.begin(), labels.end(),
                                       LabelAt(row)) != labels.end();
                    }));
  }
}

TEST_F(RegionQueryTest, SummaryAndHeaderTellTheAnswer) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop_->Query({}));
  core::LabelCounts counts{};
  for (size_t row = 0; row < expected_->size(); ++row) {
    ++counts[static_cast<size_t>(LabelAt(row))];
  }
  EXPECT_EQ(answer.summary.label_counts, counts);
  EXPECT_EQ(answer.header.revision, 3);
  EXPECT_EQ(answer.header.step_nm, core::kDefaultStepNm);
  // Outliers and points outside the region may be counted, no others.
  EXPECT_GE(answer.header.candidate_point_count, answer.summary.point_count);
  EXPECT_LT(answer.header.candidate_point_count,
            2 * answer.summary.point_count);
}

TEST_F(RegionQueryTest, BudgetIsWhatTheSamplerChooses) {
  const LatticeCloud sorted =
      expected_->Select(core::MortonOrder(expected_->positions));
  const core::Column& label_column = *sorted.attributes.Find("label");
  std::vector<Label> labels;
  for (size_t row = 0; row < sorted.size(); ++row) {
    labels.push_back(static_cast<Label>(label_column.Get<uint8_t>(row)));
  }
  const auto available = static_cast<int64_t>(expected_->size());
  for (const int64_t budget : {int64_t{1}, int64_t{7}, int64_t{300},
                               available - 1, available, available + 5000}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                  workshop_->Query({.max_points = budget}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const core::CellSample sample,
        core::SampleUnderBudget(sorted.positions, labels, budget));
    EXPECT_EQ(answer.summary.point_count, std::min(budget, available));
    EXPECT_LE(answer.header.candidate_point_count, budget);
    ExpectSameCloud(InCanonicalOrder(answer.points),
                    InCanonicalOrder(sorted.Select(sample.rows)));

    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const Answer centroids,
        workshop_->Query({.max_points = budget,
                          .representative = Representative::kCentroid}));
    LatticeCloud moved = sorted.Select(sample.rows);
    for (size_t i = 0; i < moved.size(); ++i) {
      const Point3& c = sample.centroids[i];
      moved.positions[i] = {std::llrint(c.x), std::llrint(c.y),
                            std::llrint(c.z)};
    }
    ExpectSameCloud(InCanonicalOrder(centroids.points),
                    InCanonicalOrder(moved));
  }
}

TEST_F(RegionQueryTest, ALevelIsWhatTheDepthsInMemorySay) {
  const core::SpdfOptions options = SceneOptions(core::DensityRule::kPaper);
  int64_t finer_count = std::numeric_limits<int64_t>::max();
  int64_t finer_candidates = finer_count;
  for (const int depth : {0, 1, 2, 3, 5, core::kMaxDepth}) {
    SCOPED_TRACE(depth);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                  workshop_->Query({.depth = depth}));
    ExpectSameCloud(answer.points, FilterLocally(*scene_, options, depth));
    EXPECT_GT(answer.summary.point_count, 0);
    EXPECT_LE(answer.summary.point_count, finer_count);
    // Chunks of finer groups are not looked into.
    if (depth <= 3) {
      EXPECT_LT(answer.header.candidate_point_count, finer_candidates);
    }
    EXPECT_EQ(report_->level_counts[static_cast<size_t>(depth)],
              answer.summary.label_counts);
    finer_count = answer.summary.point_count;
    finer_candidates = answer.header.candidate_point_count;
    // The level with this spacing, and not the next.
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const Answer spaced,
        workshop_->Query(
            {.spacing_m = 1.01 * core::LevelSpacing(options, depth)}));
    ExpectSameCloud(spaced.points, answer.points);
  }
}

TEST_F(RegionQueryTest, ALevelGoesWithRegionLabelsAndBudget) {
  const Sphere sphere = {{-4.5, 4.5, 2}, 6};
  const std::vector<Label> labels = {Label::kCurve, Label::kSurface};
  const core::SpdfOptions options = SceneOptions(core::DensityRule::kPaper);
  const LatticeCloud level = FilterLocally(*scene_, options, 1);
  const core::Column& label_column = *level.attributes.Find("label");
  const LatticeCloud expected = Filter(level, [&](size_t row) {
    const Point3 p = At(level, row);
    return label_column.Get<uint8_t>(row) !=
               static_cast<uint8_t>(Label::kJunction) &&
           std::hypot(p.x + 4.5, p.y - 4.5, p.z - 2) <= 6;
  });
  ASSERT_GT(expected.size(), 40U);
  ASSERT_LT(expected.size(), level.size());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer all,
      workshop_->Query({.region = sphere, .labels = labels, .depth = 1}));
  ExpectSameCloud(all.points, expected);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer some,
      workshop_->Query(
          {.region = sphere, .labels = labels, .depth = 1, .max_points = 30}));
  EXPECT_EQ(some.points.size(), 30U);
  for (const LatticePoint& q : some.points.positions) {
    EXPECT_NE(
        std::find(expected.positions.begin(), expected.positions.end(), q),
        expected.positions.end());
  }
}

TEST_F(RegionQueryTest, BudgetCountsWhatRegionAndLabelsLeave) {
  const Sphere sphere = {{-4.5, 4.5, 2}, 2};
  const std::vector<Label> labels = {Label::kJunction, Label::kSurface};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer all, workshop_->Query({.region = sphere, .labels = labels}));
  ASSERT_GT(all.points.size(), 60U);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer some,
      workshop_->Query({.region = sphere, .labels = labels, .max_points = 50}));
  EXPECT_EQ(some.points.size(), 50U);
  for (const LatticePoint& q : some.points.positions) {
    EXPECT_NE(
        std::find(all.points.positions.begin(), all.points.positions.end(), q),
        all.points.positions.end());
  }
}

TEST_F(RegionQueryTest, ColumnsAreThoseAskedForInTheirOrder) {
  using core::ColumnSpec;
  using core::ScalarType;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer all,
      workshop_->Query({.columns = ColumnSelection{.label = true,
                                                   .confidence = true,
                                                   .normal = true,
                                                   .tangent = true,
                                                   .eigenvalues = true,
                                                   .all_attributes = true}}));
  std::vector<std::string> names;
  for (const ColumnSpec& spec : all.header.columns) names.push_back(spec.name);
  EXPECT_EQ(names, (std::vector<std::string>{"label", "confidence", "nx", "ny",
                                             "nz", "tx", "ty", "tz", "lambda1",
                                             "lambda2", "lambda3", "intensity",
                                             "input_label", "ring", "time"}));
  // The eigenvalues tell label and confidence.
  for (size_t i = 0; i < all.points.size(); ++i) {
    const auto value = [&](const char* name) {
      return all.points.attributes.Find(name)->GetAsDouble(i);
    };
    const double strength[] = {0, value("lambda3"),
                               value("lambda2") - value("lambda3"),
                               value("lambda1") - value("lambda2")};
    const auto label = static_cast<size_t>(value("label"));
    EXPECT_NEAR(value("confidence"), strength[label], 2e-5);
    EXPECT_NEAR(std::hypot(value("tx"), value("ty"), value("tz")), 1, 1e-6);
  }

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer some,
      workshop_->Query({.columns = ColumnSelection{
                            .attributes = {"time", "label", "time"}}}));
  EXPECT_EQ(some.header.columns,
            (std::vector<ColumnSpec>{{"input_label", ScalarType::kInt32},
                                     {"time", ScalarType::kFloat64}}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer none, workshop_->Query({.columns = ColumnSelection{}}));
  EXPECT_TRUE(none.header.columns.empty());
  EXPECT_TRUE(none.points.positions == expected_->positions);
  // Raw points have no columns of the filter that a name could collide with.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer raw,
      workshop_->Query(
          {.columns = ColumnSelection{.attributes = {"label"}}, .raw = true}));
  EXPECT_EQ(raw.header.columns,
            (std::vector<ColumnSpec>{{"label", ScalarType::kInt32}}));
}

TEST_F(RegionQueryTest, RefusesWhatMakesNoSense) {
  const auto refuses = [&](const QuerySpec& spec, const char* field,
                           const char* message) {
    const absl::Status status = workshop_->Query(spec).status();
    EXPECT_THAT(status, StatusIs(absl::StatusCode::kInvalidArgument,
                                 HasSubstr(message)));
    EXPECT_EQ(FieldOf(status), field) << status;
  };
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  refuses({.revision = -1}, "revision", "it is -1");
  refuses({.max_points = -1}, "max_point_count", "it is -1");
  refuses({.max_bytes = -1}, "max_bytes", "it is -1");
  refuses({.max_bytes = 65535}, "max_bytes", "at least 65536");
  refuses({.depth = core::kMaxDepth + 1}, "depth", "it is 11");
  refuses({.spacing_m = kNan}, "spacing_m", "it is nan");
  refuses({.depth = 1, .spacing_m = 1}, "spacing_m", "leave one out");
  refuses({.labels = {Label::kNone}}, "labels[0]", "it is 0");
  refuses({.labels = {Label::kCurve, static_cast<Label>(200)}}, "labels[1]",
          "it is 200");
  refuses({.label_weights = core::LabelWeights{0, 1, 1, 1}}, "label_weights",
          "no budget");
  refuses({.max_points = 5, .label_weights = core::LabelWeights{0, 1, 0, 1}},
          "label_weights.curve", "it is 0");
  refuses({.max_points = 5, .label_weights = core::LabelWeights{0, 1, 1, kNan}},
          "label_weights.surface", "it is nan");
  refuses({.max_points = 5, .label_weights = core::LabelWeights{0, 2e6, 1, 1}},
          "label_weights.junction", "at most 1e+06");
  refuses({.confidence = Range{.min = kNan}}, "confidence", "min is nan");
  refuses({.attribute_ranges = {{"time", {}}, {"ring", {2, 1}}}},
          "attribute_ranges[1].range", "min is 2 and max is 1");
  refuses({.attribute_ranges = {{"time", {}}, {"gps", {}}}},
          "attribute_ranges[1].name",
          "\"gps\"; it has intensity, label, ring, time");
  refuses({.attribute_ranges = std::vector<AttributeRange>(17)},
          "attribute_ranges", "at most 16");
  refuses({.labels = {Label::kCurve}, .raw = true}, "labels", "none");
  refuses({.depth = 1, .raw = true}, "depth", "no levels");
  refuses({.spacing_m = 1, .raw = true}, "spacing_m", "no levels");
  refuses({.max_points = 5, .raw = true}, "max_point_count", "by label");
  refuses({.max_bytes = 1 << 20, .raw = true}, "max_bytes", "by label");
  refuses({.confidence = Range(), .raw = true}, "confidence", "none");
  refuses({.columns = ColumnSelection{.normal = true}, .raw = true},
          "columns.filter_columns", "raw points");
  refuses({.columns = ColumnSelection{.covariance = true}, .raw = true},
          "columns.filter_columns", "raw points");
  refuses({.region = Sphere{{0, 0, 0}, -1}}, "sphere.radius", "above 0");
  EXPECT_THAT(
      workshop_->Query({.columns = ColumnSelection{.attributes = {"gps"}}}),
      StatusIs(absl::StatusCode::kNotFound,
               HasSubstr("\"gps\"; it has intensity, label, ring, time")));
  EXPECT_THAT(workshop_->Query({.revision = 99}),
              StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("99")));
  EXPECT_THAT(workshop_->Query({.revision = 2}),
              StatusIs(absl::StatusCode::kOutOfRange,
                       HasSubstr("not processed up to revision 2")));
}

TEST_F(RegionQueryTest, StopsWhenAsked) {
  MemoryPool memory(1 << 28);
  std::stop_source stop;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto cursor,
                                OpenQuery(workshop_->store(), memory,
                                          {.map_id = "map"}, stop.get_token()));
  stop.request_stop();
  EXPECT_THAT(cursor->NextBatch(),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("cancelled")));
}

TEST_F(RegionQueryTest, KeepsToTheMemoryOfQueries) {
  MemoryPool small(1 << 20);
  EXPECT_THAT(OpenQuery(workshop_->store(), small, {.map_id = "map"}, {}),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("of 1048576 bytes")));
  EXPECT_THAT(
      OpenSync(workshop_->store(), small, {.query = {.map_id = "map"}}, {}),
      StatusIs(absl::StatusCode::kResourceExhausted,
               HasSubstr("the largest chunk needs")));
  // Just enough for a walk through the chunks, not for a choice among all
  // points.
  QuerySpec spec = {.map_id = "map"};
  int64_t bytes = 1 << 20;
  while (true) {
    MemoryPool pool(bytes);
    if (OpenQuery(workshop_->store(), pool, spec, {}).ok()) break;
    bytes += 10'000;
    ASSERT_LT(bytes, 1 << 24);
  }
  MemoryPool tight(bytes);
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto cursor, OpenQuery(workshop_->store(), tight, spec, {}));
    MAPSIEVE_EXPECT_OK(ReadAll(*cursor));
    // While it lives nobody else gets its share.
    EXPECT_THAT(OpenQuery(workshop_->store(), tight, spec, {}),
                StatusIs(absl::StatusCode::kResourceExhausted,
                         HasSubstr("try again later")));
  }
  spec.max_points = 100'000;
  EXPECT_THAT(OpenQuery(workshop_->store(), tight, spec, {}),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("choosing under a budget among")));
  // What was for the choice is there for others once it is made.
  MemoryPool roomy(2 * bytes + 40'000'000);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto cursor,
                                OpenQuery(workshop_->store(), roomy, spec, {}));
}

TEST(RegionQuery, BatchesKeepTheirLimitHoweverWideThePoints) {
  LatticeCloud cloud;
  std::vector<core::Column> columns;
  for (int c = 0; c < 300; ++c) {
    // Random bits: nothing compresses.
    core::Column column(
        {"attribute-" + std::to_string(c),
         c % 2 == 0 ? core::ScalarType::kUint64 : core::ScalarType::kUint8});
    columns.push_back(column);
  }
  uint64_t state = 1;
  for (int64_t i = 0; i < 3000; ++i) {
    cloud.positions.push_back({i * 977, i * 31, (i * i) % 1013});
    for (core::Column& column : columns) {
      state = state * 6364136223846793005 + 1442695040888963407;
      if (column.type() == core::ScalarType::kUint64) {
        column.Append(state ^ state >> 31);
      } else {
        column.Append(static_cast<uint8_t>(state >> 40));
      }
      if ((state >> 50) % 5 == 0) column.SetMissing(column.size() - 1);
    }
  }
  cloud.attributes.columns() = columns;
  Workshop workshop(15);
  MAPSIEVE_ASSERT_OK(workshop.Add(cloud, IngestLimits::Of(int64_t{64} << 20)));
  // Not the chunks as they are stored.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer answer, workshop.Query({.raw = true, .plain_blocks = true}));
  EXPECT_GE(answer.batch_count, 8);
  EXPECT_LE(answer.batch_count, 16);
  ExpectSameCloud(InCanonicalOrder(answer.points), InCanonicalOrder(cloud));
}

TEST(RegionQuery, ReadsItsRevisionWhateverHappensToTheMap) {
  const LatticeCloud scene = MakeScene(12);
  const core::SpdfOptions options = SceneOptions(core::DensityRule::kQuota);
  Workshop workshop(12);
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, IngestLimits::Of(1 << 25)));
  EXPECT_THAT(workshop.Query({}),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("never processed")));
  MAPSIEVE_ASSERT_OK(workshop.Process(options, kProcessLimits));
  const LatticeCloud expected = FilterLocally(scene, options);

  MemoryPool memory(1 << 28);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto cursor,
      OpenQuery(workshop.store(), memory, {.map_id = "map"}, {}));
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(13), IngestLimits::Of(1 << 25)));
  // An upload leaves the newest processed revision as it is.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer newest, workshop.Query({}));
  EXPECT_EQ(newest.header.revision, 3);
  ExpectSameCloud(newest.points, expected);
  MAPSIEVE_ASSERT_OK(workshop.Process(options, kProcessLimits));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer later, workshop.Query({}));
  EXPECT_EQ(later.header.revision, 5);
  EXPECT_NE(later.points.size(), expected.size());
  // Older revisions answer still: 4 from what revision 3 computed.
  for (const int64_t revision : {3, 4}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer old,
                                  workshop.Query({.revision = revision}));
    EXPECT_EQ(old.header.revision, 3);
    ExpectSameCloud(old.points, expected);
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer raw,
                                workshop.Query({.revision = 3, .raw = true}));
  EXPECT_EQ(raw.points.size(), scene.size());

  MAPSIEVE_ASSERT_OK(workshop.store().catalogue().DeleteMap("map"));
  MAPSIEVE_ASSERT_OK(workshop.store().CollectGarbage());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer pinned, ReadAll(*cursor));
  ExpectSameCloud(pinned.points, expected);
}

TEST(RegionQuery, DamagedChunkIsDataLossThatNamesIt) {
  Workshop workshop(15);
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(14), IngestLimits::Of(1 << 25)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                workshop.store().OpenSnapshot("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto chunks, snapshot->ListChunks(storage::ChunkKind::kRaw,
                                              std::nullopt, std::nullopt, 1));
  ASSERT_EQ(chunks.size(), 1U);
  workshop.DamageBlob(chunks[0].blob_id);
  EXPECT_THAT(
      workshop.Query({.raw = true}),
      StatusIs(absl::StatusCode::kDataLoss, HasSubstr(chunks[0].blob_id)));
}

}  // namespace
}  // namespace mapsieve::engine::testing
