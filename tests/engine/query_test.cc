#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <set>
#include <stop_token>
#include <string>
#include <vector>

#include "core/cloud/merge_duplicates.h"
#include "core/sampling/spatial_budget.h"
#include "core/spdf/levels.h"
#include "gtest/gtest.h"
#include "server/engine/region_query.h"
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
        const core::BudgetSample sample,
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
  const auto invalid = absl::StatusCode::kInvalidArgument;
  EXPECT_THAT(workshop_->Query({.revision = -1}),
              StatusIs(invalid, HasSubstr("revision is -1")));
  EXPECT_THAT(workshop_->Query({.max_points = -1}),
              StatusIs(invalid, HasSubstr("max_points is -1")));
  EXPECT_THAT(workshop_->Query({.depth = core::kMaxDepth + 1}),
              StatusIs(invalid, HasSubstr("depth is 11")));
  EXPECT_THAT(
      workshop_->Query({.spacing_m = std::numeric_limits<double>::quiet_NaN()}),
      StatusIs(invalid, HasSubstr("spacing_m is nan")));
  EXPECT_THAT(workshop_->Query({.depth = 1, .spacing_m = 1}),
              StatusIs(invalid, HasSubstr("leave one out")));
  EXPECT_THAT(workshop_->Query({.depth = 1, .raw = true}),
              StatusIs(invalid, HasSubstr("no levels")));
  EXPECT_THAT(workshop_->Query({.labels = {Label::kNone}}),
              StatusIs(invalid, HasSubstr("labels holds 0")));
  EXPECT_THAT(workshop_->Query({.labels = {static_cast<Label>(200)}}),
              StatusIs(invalid, HasSubstr("labels holds 200")));
  EXPECT_THAT(workshop_->Query({.labels = {Label::kCurve}, .raw = true}),
              StatusIs(invalid, HasSubstr("labels")));
  EXPECT_THAT(workshop_->Query({.max_points = 5, .raw = true}),
              StatusIs(invalid, HasSubstr("max_points")));
  EXPECT_THAT(workshop_->Query(
                  {.columns = ColumnSelection{.normal = true}, .raw = true}),
              StatusIs(invalid, HasSubstr("columns")));
  EXPECT_THAT(workshop_->Query({.region = Sphere{{0, 0, 0}, -1}}),
              StatusIs(invalid, HasSubstr("sphere.radius")));
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
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto cursor,
                                OpenQuery(workshop_->store(), tight, spec, {}));
  EXPECT_THAT(cursor->NextBatch(),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("choosing max_points among")));
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
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                workshop.Query({.raw = true}));
  EXPECT_GE(answer.batch_count, 4);
  EXPECT_LE(answer.batch_count, 8);
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
