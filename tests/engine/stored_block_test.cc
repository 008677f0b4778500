// Raw chunks that are blocks of an answer as they are stored.

#include <algorithm>
#include <iterator>
#include <set>
#include <string>
#include <vector>

#include "core/base/hash.h"
#include "core/codec/points_codec.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/engine/region_query.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::LatticeCloud;
using ::mapsieve::testing::StatusIs;
using storage::ChunkKind;
using ::testing::AllOf;
using ::testing::HasSubstr;

class StoredBlockTest : public ::testing::Test {
 protected:
  void SetUp() override {
    MAPSIEVE_ASSERT_OK(
        workshop_.Add(scene_, IngestLimits::Of(int64_t{64} << 20)));
    for (const storage::ChunkRef& chunk : workshop_.Chunks(ChunkKind::kRaw)) {
      chunks_.insert(chunk.blob_id);
    }
  }

  absl::StatusOr<Batches> Ask(QuerySpec spec) {
    spec.map_id = "map";
    spec.raw = true;
    return ReadBatches(OpenQuery(workshop_.store(), memory_, spec, {}));
  }

  /// How many blocks of an answer are chunks.
  int64_t StoredCount(const Batches& batches) {
    return std::count_if(batches.blocks.begin(), batches.blocks.end(),
                         [&](const auto& block) {
                           return chunks_.contains(ContentHash(block));
                         });
  }

  static LatticeCloud PointsOf(const Batches& batches) {
    LatticeCloud points;
    for (const auto& block : batches.blocks) {
      const auto part = core::DecodePoints(block);
      EXPECT_TRUE(part.ok()) << part.status();
      EXPECT_TRUE(points.attributes
                      .AppendAll(points.size(), part->attributes, part->size())
                      .ok());
      points.positions.insert(points.positions.end(), part->positions.begin(),
                              part->positions.end());
    }
    return InCanonicalOrder(points);
  }

  /// Cuts some chunks.
  static constexpr Box kHalf = {{-1000, -1000, -1000}, {1, 1000, 1000}};

  const LatticeCloud scene_ = WideScene(21, 30);
  Workshop workshop_{13};
  std::set<std::string> chunks_;
  MemoryPool memory_{1 << 28};
};

TEST_F(StoredBlockTest, WholeChunksComeAsTheyAre) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Batches all, Ask({}));
  EXPECT_GE(StoredCount(all), 3);
  ExpectSameCloud(PointsOf(all), InCanonicalOrder(scene_));
  EXPECT_EQ(all.summary.point_count, static_cast<int64_t>(scene_.size()));
  EXPECT_EQ(all.summary.label_counts[0], all.summary.point_count);

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Batches plain,
                                Ask({.plain_blocks = true}));
  EXPECT_EQ(StoredCount(plain), 0);
  ExpectSameCloud(PointsOf(plain), InCanonicalOrder(scene_));
}

TEST_F(StoredBlockTest, WhatIsAskedForInPartIsNotStored) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Batches columns,
      Ask({.columns = ColumnSelection{.attributes = {"wide-0"}}}));
  EXPECT_EQ(StoredCount(columns), 0);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Batches values, Ask({.attribute_ranges = {{"wide-0", {0, 1e19}}}}));
  EXPECT_EQ(StoredCount(values), 0);
  EXPECT_LT(values.summary.point_count, static_cast<int64_t>(scene_.size()));
  // Chunks within the region, and parts of those at its border.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Batches region, Ask({.region = kHalf}));
  std::vector<uint32_t> rows;
  for (uint32_t row = 0; row < scene_.size(); ++row) {
    if (scene_.lattice.Position(scene_.positions[row]).x <= kHalf.max.x) {
      rows.push_back(row);
    }
  }
  EXPECT_GT(StoredCount(region), 0);
  EXPECT_LT(rows.size(), scene_.size());
  ExpectSameCloud(PointsOf(region), InCanonicalOrder(scene_.Select(rows)));
}

TEST_F(StoredBlockTest, AnAnswerGoesOnBehindAStoredBlock) {
  const QuerySpec spec = {.region = kHalf, .resume_key = 5};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Batches whole, Ask(spec));
  ASSERT_GE(whole.blocks.size(), 3u);
  for (size_t i = 0; i < whole.blocks.size(); ++i) {
    QuerySpec resumed = spec;
    resumed.resume_token = whole.tokens[i];
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Batches rest, Ask(resumed));
    EXPECT_EQ(rest.blocks,
              std::vector(whole.blocks.begin() + static_cast<ptrdiff_t>(i) + 1,
                          whole.blocks.end()));
    EXPECT_EQ(rest.summary.point_count, whole.summary.point_count);
  }
}

TEST_F(StoredBlockTest, DamageIsFound) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Batches all, Ask({}));
  const auto stored = std::find_if(
      all.blocks.begin(), all.blocks.end(),
      [&](const auto& block) { return chunks_.contains(ContentHash(block)); });
  ASSERT_NE(stored, all.blocks.end());
  const int64_t lost = core::ReadBlockHeader(*stored)->point_count;
  workshop_.DamageBlob(ContentHash(*stored));
  EXPECT_THAT(Ask({}),
              StatusIs(absl::StatusCode::kDataLoss,
                       AllOf(HasSubstr("raw chunk"),
                             HasSubstr(ContentHash(*stored).substr(2)))));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Batches rest,
                                Ask({.allow_partial = true}));
  EXPECT_EQ(rest.summary.missing_chunk_count, 1);
  EXPECT_EQ(rest.summary.missing_point_count, lost);
  EXPECT_EQ(rest.summary.point_count,
            static_cast<int64_t>(scene_.size()) - lost);
}

}  // namespace
}  // namespace mapsieve::engine::testing
