// Answers without what is damaged.

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/engine/chunk_reader.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::LatticeCloud;
using core::LatticePoint;
using ::mapsieve::testing::StatusIs;
using storage::ChunkKind;
using storage::ChunkRef;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

LatticeCloud Scene() { return Split(MakeScene(80), 3)[0]; }

class PartialAnswerTest : public ::testing::Test {
 protected:
  void SetUp() override {
    MAPSIEVE_ASSERT_OK(workshop_.Add(Scene(), {.block_bytes = 1 << 26,
                                               .bucket_bytes = 1 << 28,
                                               .chunk_bytes = 50'000,
                                               .chunk_count = 100'000}));
    MAPSIEVE_ASSERT_OK(workshop_.Process(
        SceneOptions(core::DensityRule::kQuota), {.unit_points = 1 << 26,
                                                  .tile_points = 1 << 26,
                                                  .pending_bytes = 1 << 26,
                                                  .chunk_bytes = 1 << 26}));
  }

  /// Damages every third chunk of a kind; by blob.
  std::map<std::string, ChunkRef> DamageSome(ChunkKind kind) {
    std::map<std::string, ChunkRef> damaged;
    const std::vector<ChunkRef> chunks = workshop_.Chunks(kind);
    for (size_t i = 0; i < chunks.size(); i += 3) {
      const auto snapshot = workshop_.store().OpenSnapshot("map");
      EXPECT_TRUE(snapshot.ok());
      const auto points = ReadPoints(**snapshot, chunks[i]);
      EXPECT_TRUE(points.ok()) << points.status();
      for (const LatticePoint& q : points->positions) gone_.insert(Key(q));
      damaged[chunks[i].blob_id] = chunks[i];
      workshop_.DamageBlob(chunks[i].blob_id);
    }
    return damaged;
  }

  static std::vector<int64_t> Key(const LatticePoint& q) {
    return {q.x, q.y, q.z};
  }

  /// `answer` without the points of damaged chunks.
  LatticeCloud Rest(const Answer& answer) const {
    std::vector<uint32_t> rows;
    for (uint32_t row = 0; row < answer.points.size(); ++row) {
      if (!gone_.contains(Key(answer.points.positions[row]))) {
        rows.push_back(row);
      }
    }
    return answer.points.Select(rows);
  }

  Workshop workshop_{12};
  std::set<std::vector<int64_t>> gone_;
};

TEST_F(PartialAnswerTest, HoldsAllThatCanBeReadAndNamesTheRest) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer whole, workshop_.Query({}));
  const auto damaged = DamageSome(ChunkKind::kProduct);
  ASSERT_GT(damaged.size(), 10U);
  EXPECT_THAT(workshop_.Query({}),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("map map")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer part,
                                workshop_.Query({.allow_partial = true}));
  ASSERT_GT(part.points.size(), 0U);
  ExpectSameCloud(part.points, Rest(whole));
  int64_t point_count = 0;
  for (const auto& [blob, chunk] : damaged) point_count += chunk.point_count;
  EXPECT_EQ(part.summary.missing_chunk_count, damaged.size());
  EXPECT_EQ(part.summary.missing_point_count, point_count);
  std::set<std::string> named;
  for (const DamagedChunk& chunk : part.summary.missing_chunks) {
    named.insert(chunk.blob_id);
    ASSERT_TRUE(damaged.contains(chunk.blob_id)) << chunk.blob_id;
    EXPECT_EQ(chunk.tile, damaged.at(chunk.blob_id).tile);
    EXPECT_EQ(chunk.content, StoredContent::kProduct);
    EXPECT_THAT(chunk.problem, HasSubstr("expected content of hash"));
    EXPECT_THAT(chunk.problem, HasSubstr("/blobs/"));
  }
  EXPECT_EQ(named.size(), damaged.size());

  // Raw points are sound.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer raw, workshop_.Query({.raw = true, .allow_partial = true}));
  EXPECT_EQ(raw.points.size(), Scene().size());
  EXPECT_EQ(raw.summary.missing_chunk_count, 0);
  EXPECT_THAT(raw.summary.missing_chunks, IsEmpty());
}

TEST_F(PartialAnswerTest, OfAWholeRegionIsWhole) {
  const auto damaged = DamageSome(ChunkKind::kProduct);
  // A chunk that nobody damaged, and the box of its points.
  for (const ChunkRef& chunk : workshop_.Chunks(ChunkKind::kProduct)) {
    const auto near = [&](const auto& entry) {
      return entry.second.bounds.Intersects(chunk.bounds.Grown(1));
    };
    if (std::any_of(damaged.begin(), damaged.end(), near)) continue;
    const core::Lattice lattice(core::kDefaultStepNm);
    const Box box = {lattice.Position(chunk.bounds.min),
                     lattice.Position(chunk.bounds.max)};
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer strict,
                                  workshop_.Query({.region = box}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const Answer part,
        workshop_.Query({.region = box, .allow_partial = true}));
    ExpectSameCloud(part.points, strict.points);
    EXPECT_EQ(part.summary.missing_chunk_count, 0);
    return;
  }
  FAIL() << "every chunk lies among damaged ones";
}

TEST_F(PartialAnswerTest, KeepsTheBudget) {
  DamageSome(ChunkKind::kProduct);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer all,
                                workshop_.Query({.allow_partial = true}));
  const auto available = static_cast<int64_t>(all.points.size());
  std::set<std::vector<int64_t>> there;
  for (const LatticePoint& q : all.points.positions) there.insert(Key(q));
  for (const int64_t budget :
       {int64_t{1}, int64_t{200}, available / 2, available, 2 * available}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const Answer some,
        workshop_.Query({.max_points = budget, .allow_partial = true}));
    const auto count = static_cast<int64_t>(some.points.size());
    EXPECT_LE(count, budget);
    EXPECT_GE(100 * count, 95 * std::min(budget, available));
    EXPECT_EQ(some.summary.missing_chunk_count,
              all.summary.missing_chunk_count);
    for (const LatticePoint& q : some.points.positions) {
      EXPECT_TRUE(there.contains(Key(q)));
    }
  }
  EXPECT_THAT(workshop_.Query({.max_points = 200}),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("map map")));
}

TEST_F(PartialAnswerTest, OfRawPointsLeavesDamagedChunksOut) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer whole,
                                workshop_.Query({.raw = true}));
  const auto damaged = DamageSome(ChunkKind::kRaw);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Answer part, workshop_.Query({.raw = true, .allow_partial = true}));
  ExpectSameCloud(part.points, Rest(whole));
  EXPECT_EQ(part.summary.missing_chunk_count, damaged.size());
  EXPECT_EQ(part.summary.missing_point_count,
            static_cast<int64_t>(whole.points.size() - part.points.size()));
}

}  // namespace
}  // namespace mapsieve::engine::testing
