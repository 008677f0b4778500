// The service gives what the filter in memory gives, bit for bit, however the
// map is cut.

#include <string>
#include <vector>

#include "core/cloud/merge_duplicates.h"
#include "core/codec/points_codec.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/levels.h"
#include "gtest/gtest.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/product_chunk.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::DensityRule;
using core::LatticeCloud;
using core::SpdfOptions;

/// So little that a bucket is written again and again.
constexpr IngestLimits kTightLimits = {.block_bytes = 1 << 20,
                                       .bucket_bytes = 400'000,
                                       .chunk_bytes = 20'000,
                                       .chunk_count = 100'000};
constexpr IngestLimits kWideLimits = {.block_bytes = 1 << 26,
                                      .bucket_bytes = 1 << 28,
                                      .chunk_bytes = 1 << 24,
                                      .chunk_count = 100'000};

ProcessLimits UnitsOf(int64_t points) {
  return {.unit_points = points,
          .tile_points = 1 << 26,
          .pending_bytes = 1 << 20,
          .chunk_bytes = 30'000};
}

struct Cut {
  int tile_level;
  int64_t unit_points;
  size_t upload_count;
  bool is_tight;
  int worker_count;
};

class TiledPipelineTest : public ::testing::TestWithParam<Cut> {};

TEST_P(TiledPipelineTest, GivesWhatTheFilterInMemoryGives) {
  const Cut& cut = GetParam();
  const LatticeCloud scene = MakeScene(1);
  Workshop workshop(cut.tile_level, cut.worker_count);
  int64_t added = 0;
  for (const LatticeCloud& part :
       Split(mapsieve::testing::Shuffled(scene, 5), cut.upload_count)) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const UploadReport report,
        workshop.Add(part, cut.is_tight ? kTightLimits : kWideLimits));
    added += report.added_point_count;
  }
  EXPECT_EQ(added, static_cast<int64_t>(scene.size()));
  for (const DensityRule rule : {DensityRule::kPaper, DensityRule::kQuota}) {
    SpdfOptions options = SceneOptions(rule);
    if (rule == DensityRule::kQuota) options.label_neighbor_count = 60;
    const LatticeCloud expected = FilterLocally(scene, options);
    ASSERT_GT(expected.size(), scene.size() / 20);
    ASSERT_LT(expected.size(), scene.size() / 2);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const ProcessReport report,
        workshop.Process(options, UnitsOf(cut.unit_points)));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
    ExpectSameCloud(answer.points, expected);
    EXPECT_EQ(report.point_count, static_cast<int64_t>(expected.size()));
    EXPECT_EQ(report.label_counts, answer.summary.label_counts);
    EXPECT_EQ(report.revision, answer.header.revision);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Cuts, TiledPipelineTest,
    ::testing::Values(
        // Tiles of 1, 4, 8 and 33 m; units of one tile, of some, of all.
        Cut{10, 2'000, 3, true, 3}, Cut{10, 1'000'000, 1, false, 1},
        Cut{12, 1, 2, false, 1}, Cut{12, 3'000, 5, true, 3},
        Cut{13, 4'000, 1, false, 3}, Cut{15, 1, 4, false, 1},
        Cut{15, 1'000'000, 2, true, 3}),
    [](const auto& test) {
      const Cut& cut = test.param;
      return "Level" + std::to_string(cut.tile_level) + "Unit" +
             std::to_string(cut.unit_points) + "Uploads" +
             std::to_string(cut.upload_count) + "Workers" +
             std::to_string(cut.worker_count) + (cut.is_tight ? "Tight" : "");
    });

TEST(PipelineTest, StoresEverythingTheFilterSays) {
  const LatticeCloud scene = MakeScene(2);
  const SpdfOptions options = SceneOptions(DensityRule::kPaper);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::FilteredCloud expected,
                                core::FilterCloud(scene, options));
  Workshop workshop(12);
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, kWideLimits));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ProcessReport report,
                                workshop.Process(options, UnitsOf(3000)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                workshop.store().OpenSnapshot("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto chunks,
      snapshot->ListChunks(storage::ChunkKind::kProduct, std::nullopt,
                           std::nullopt, 10'000));
  LatticeCloud stored;
  core::LabelCounts counts{};
  for (const storage::ChunkRef& chunk : chunks) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud points,
                                  ReadPoints(*snapshot, chunk));
    MAPSIEVE_ASSERT_OK(stored.attributes.AppendAll(
        stored.size(), points.attributes, points.size()));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<uint8_t> own,
                                  DepthsOf(points.attributes));
    EXPECT_EQ(*std::min_element(own.begin(), own.end()), chunk.min_depth);
    EXPECT_EQ(*std::max_element(own.begin(), own.end()), chunk.max_depth);
    for (const core::LatticePoint& q : points.positions) {
      EXPECT_TRUE(chunk.bounds.Contains(q));
      stored.positions.push_back(q);
    }
    for (size_t l = 0; l < core::kLabelCount; ++l) {
      counts[l] += chunk.label_counts[l];
    }
  }
  // Outliers are stored: the test is applied when points are read.
  const LatticeCloud survivors = scene.Select(expected.rows);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const std::vector<uint8_t> depths,
      core::ComputeDepths(survivors.positions, scene.lattice, options));
  LatticeCloud divided;
  for (const LatticeCloud& group : SplitByDepth(
           MakeProductCloud(survivors, expected.columns.All()), depths)) {
    MAPSIEVE_ASSERT_OK(divided.attributes.AppendAll(
        divided.size(), group.attributes, group.size()));
    divided.positions.insert(divided.positions.end(), group.positions.begin(),
                             group.positions.end());
  }
  ExpectSameCloud(InCanonicalOrder(stored), InCanonicalOrder(divided));
  EXPECT_EQ(counts, expected.summary.label_counts);
  const auto& product = snapshot->revision().spec.product;
  ASSERT_TRUE(product.has_value());
  EXPECT_EQ(product->max_confidence, expected.summary.max_confidence);
  EXPECT_EQ(product->distinct_point_count, expected.summary.point_count);
  EXPECT_EQ(report.outlier_count,
            expected.summary.survivor_count - report.point_count);
  EXPECT_GT(report.outlier_count, 0);
  EXPECT_EQ(report.round_count, expected.summary.round_count);
}

TEST(PipelineTest, RawPointsComeBackAsTheyWere) {
  const LatticeCloud scene = MakeScene(3);
  Workshop workshop(11);
  for (const LatticeCloud& part : Split(scene, 3)) {
    MAPSIEVE_ASSERT_OK(workshop.Add(part, kTightLimits));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                workshop.Query({.raw = true}));
  ExpectSameCloud(InCanonicalOrder(answer.points), InCanonicalOrder(scene));
  EXPECT_EQ(answer.header.candidate_point_count,
            static_cast<int64_t>(scene.size()));
  EXPECT_EQ(answer.summary.label_counts[0], static_cast<int64_t>(scene.size()));
}

TEST(PipelineTest, AttributesThatOneUploadLacksAreMissing) {
  LatticeCloud bare = MakeScene(4);
  LatticeCloud full = bare;
  for (core::LatticePoint& q : full.positions) q.x += 1;
  bare.attributes.columns().clear();
  LatticeCloud all = full;
  MAPSIEVE_ASSERT_OK(
      all.attributes.AppendAll(all.size(), bare.attributes, bare.size()));
  all.positions.insert(all.positions.end(), bare.positions.begin(),
                       bare.positions.end());
  Workshop workshop(12);
  MAPSIEVE_ASSERT_OK(workshop.Add(bare, kWideLimits));
  MAPSIEVE_ASSERT_OK(workshop.Add(full, kWideLimits));
  const SpdfOptions options = SceneOptions(DensityRule::kQuota);
  MAPSIEVE_ASSERT_OK(workshop.Process(options, UnitsOf(1 << 30)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
  ExpectSameCloud(answer.points, FilterLocally(all, options));
}

TEST(PipelineTest, AMillionPointsInOnePlaceAreOnePoint) {
  LatticeCloud cloud;
  cloud.positions.assign(1'000'000, {5, -7, 9});
  core::Column number({"number", core::ScalarType::kInt32}, cloud.size());
  for (size_t i = 0; i < cloud.size(); ++i) {
    number.Set(i, static_cast<int32_t>(cloud.size() - i));
  }
  MAPSIEVE_ASSERT_OK(cloud.attributes.Add(std::move(number)));
  Workshop workshop(15);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadReport added,
                                workshop.Add(cloud, {.block_bytes = 1 << 20,
                                                     .bucket_bytes = 4 << 20,
                                                     .chunk_bytes = 1 << 20,
                                                     .chunk_count = 1000}));
  EXPECT_EQ(added.added_point_count, 1'000'000);
  EXPECT_EQ(added.tile_count, 1);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ProcessReport report,
                                workshop.Process({}, UnitsOf(1 << 26)));
  EXPECT_EQ(report.distinct_point_count, 1);
  // No neighbour, so no label, so an outlier.
  EXPECT_EQ(report.point_count, 0);
  EXPECT_EQ(report.outlier_count, 1);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
  EXPECT_EQ(answer.points.size(), 0U);
  // The one with the smallest attributes, as little-endian bytes: 256.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                workshop.store().OpenSnapshot("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto chunks, snapshot->ListChunks(storage::ChunkKind::kProduct,
                                              std::nullopt, std::nullopt, 10));
  ASSERT_EQ(chunks.size(), 1U);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud stored,
                                ReadPoints(*snapshot, chunks[0]));
  const std::vector<uint32_t> expected = core::MergeDuplicates(cloud);
  EXPECT_EQ(stored.attributes.Find("number")->Get<int32_t>(0),
            cloud.attributes.Find("number")->Get<int32_t>(expected[0]));
}

TEST(PipelineTest, ATileThatMemoryCannotHoldIsRefusedWithWhatWouldDo) {
  Workshop workshop(15);
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(8), kWideLimits));
  ProcessLimits limits = UnitsOf(1 << 20);
  limits.tile_points = 1000;
  EXPECT_THAT(
      workshop.Process({}, limits),
      mapsieve::testing::StatusIs(absl::StatusCode::kResourceExhausted,
                                  ::testing::HasSubstr("times the --memory")));
  EXPECT_EQ(workshop.map().newest_revision, 2);
}

TEST(PipelineTest, UploadOfTooManyTilesIsRefused) {
  const LatticeCloud scene = MakeScene(7);
  Workshop workshop(4);
  IngestLimits limits = kWideLimits;
  limits.chunk_count = 100;
  EXPECT_THAT(workshop.Add(scene, limits),
              mapsieve::testing::StatusIs(
                  absl::StatusCode::kInvalidArgument,
                  ::testing::HasSubstr("more than 100 chunks")));
  EXPECT_EQ(workshop.map().newest_revision, 1);
}

TEST(PipelineTest, ChunksKeepTheirLimitAndStayInMortonOrder) {
  const LatticeCloud scene = MakeScene(6);
  Workshop workshop(14);
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, kTightLimits));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                workshop.store().OpenSnapshot("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto chunks,
      snapshot->ListChunks(storage::ChunkKind::kRaw, std::nullopt, std::nullopt,
                           10'000));
  EXPECT_GT(chunks.size(), 10U);
  for (const storage::ChunkRef& chunk : chunks) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud points,
                                  ReadPoints(*snapshot, chunk));
    EXPECT_LE(chunk.point_count * (24 + 2 + 8 + 1 + 1 + 4),
              kTightLimits.chunk_bytes);
    for (size_t i = 1; i < points.size(); ++i) {
      EXPECT_FALSE(
          core::MortonLess(points.positions[i], points.positions[i - 1]));
    }
  }
}

}  // namespace
}  // namespace mapsieve::engine::testing
