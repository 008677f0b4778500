// What verification finds, and that it finds nothing where nothing is wrong.

#include <map>
#include <string>
#include <vector>

#include "core/codec/points_codec.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/chunk_writer.h"
#include "server/engine/product_chunk.h"
#include "server/engine/verify_map.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::DensityRule;
using core::LatticeCloud;
using ::mapsieve::testing::StatusIs;
using storage::ChunkKind;
using storage::ChunkRef;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr ProcessLimits kProcess = {.unit_points = 2000,
                                    .tile_points = 1 << 26,
                                    .pending_bytes = 1 << 18,
                                    .chunk_bytes = 30'000};

struct Findings {
  std::vector<DamagedChunk> damaged;
  std::vector<DifferingTile> differing;
  VerifySummary summary;
};

absl::StatusOr<Findings> VerifyAll(Workshop& workshop, int64_t tiles,
                                   int64_t memory_bytes = 1 << 30) {
  MemoryPool memory(memory_bytes);
  MAPSIEVE_ASSIGN_OR_RETURN(
      const auto cursor,
      OpenVerification(workshop.store(), memory,
                       {.map_id = "map", .compared_tile_count = tiles}, {}));
  Findings findings;
  int64_t done = 0;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<VerifyEvent> event,
                              cursor->Next());
    if (!event.has_value()) break;
    if (const auto* damaged = std::get_if<DamagedChunk>(&*event)) {
      findings.damaged.push_back(*damaged);
    } else if (const auto* tile = std::get_if<DifferingTile>(&*event)) {
      findings.differing.push_back(*tile);
    } else {
      const auto& progress = std::get<VerifyProgress>(*event);
      EXPECT_GE(progress.done_count, done);
      EXPECT_LE(progress.done_count, progress.total_count);
      done = progress.done_count;
    }
  }
  findings.summary = cursor->summary();
  EXPECT_EQ(findings.summary.damaged_chunk_count, findings.damaged.size());
  EXPECT_EQ(findings.summary.differing_tile_count, findings.differing.size());
  return findings;
}

class VerifyTest : public ::testing::TestWithParam<DensityRule> {};

TEST_P(VerifyTest, TilesFilteredAloneAreWhatTheMapHolds) {
  // Long enough for most points to have no say in a tile.
  LatticeCloud scene;
  for (int part = 0; part < 4; ++part) {
    const LatticeCloud moved = mapsieve::testing::Shifted(
        MakeScene(20 + static_cast<uint32_t>(part)), {part * 14'000, 0, 0});
    MAPSIEVE_ASSERT_OK(scene.attributes.AppendAll(
        scene.size(), moved.attributes, moved.size()));
    scene.positions.insert(scene.positions.end(), moved.positions.begin(),
                           moved.positions.end());
  }
  Workshop workshop(11);
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, kSmallChunks));
  MAPSIEVE_ASSERT_OK(workshop.Process(SceneOptions(GetParam()), kProcess));
  const int64_t chunks =
      static_cast<int64_t>(workshop.Chunks(ChunkKind::kRaw).size() +
                           workshop.Chunks(ChunkKind::kProduct).size() +
                           workshop.Chunks(ChunkKind::kHistory).size());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Findings found, VerifyAll(workshop, 30));
  EXPECT_THAT(found.damaged, IsEmpty());
  for (const DifferingTile& tile : found.differing) {
    ADD_FAILURE() << tile.tile.ToString() << ": " << tile.difference;
  }
  EXPECT_EQ(found.summary.chunk_count, chunks);
  EXPECT_EQ(found.summary.compared_tile_count, 30);
  EXPECT_GT(found.summary.compared_point_count, 300);
  EXPECT_EQ(found.summary.skipped_tile_count, 0);
}

INSTANTIATE_TEST_SUITE_P(Rules, VerifyTest,
                         ::testing::Values(DensityRule::kPaper,
                                           DensityRule::kQuota));

TEST(Verify, FindsEveryDamagedChunkOfEveryRevision) {
  Workshop workshop(11);
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(30), kSmallChunks));
  MAPSIEVE_ASSERT_OK(
      workshop.Process(SceneOptions(DensityRule::kPaper), kProcess));
  std::map<std::string, StoredContent> damaged;
  for (const auto& [kind, content] :
       {std::pair(ChunkKind::kRaw, StoredContent::kRaw),
        std::pair(ChunkKind::kProduct, StoredContent::kProduct),
        std::pair(ChunkKind::kHistory, StoredContent::kHistory)}) {
    const std::vector<ChunkRef> chunks = workshop.Chunks(kind);
    for (size_t i = 0; i < chunks.size(); i += 1 + chunks.size() / 3) {
      damaged[chunks[i].blob_id] = content;
    }
  }
  // The newest revision has neither product nor history of the first one.
  MAPSIEVE_ASSERT_OK(
      workshop.Process(SceneOptions(DensityRule::kQuota), kProcess));
  for (const auto& [blob, content] : damaged) workshop.DamageBlob(blob);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Findings found, VerifyAll(workshop, 0));
  std::map<std::string, StoredContent> reported;
  for (const DamagedChunk& chunk : found.damaged) {
    reported[chunk.blob_id] = chunk.content;
    EXPECT_THAT(chunk.problem, HasSubstr(chunk.blob_id));
    EXPECT_THAT(chunk.problem, HasSubstr(chunk.tile.ToString()));
  }
  EXPECT_EQ(reported, damaged);

  // Tiles that cannot be filtered again are no error.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Findings tiles,
                                VerifyAll(workshop, 1000));
  EXPECT_GT(tiles.summary.skipped_tile_count, 0);
  EXPECT_THAT(tiles.differing, IsEmpty());
}

TEST(Verify, FindsATileThatIsNotWhatItsPointsGive) {
  Workshop workshop(12);
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(31), kSmallChunks));
  MAPSIEVE_ASSERT_OK(
      workshop.Process(SceneOptions(DensityRule::kPaper), kProcess));
  // A wrong confidence, stored as carefully as a right one.
  const std::vector<ChunkRef> chunks = workshop.Chunks(ChunkKind::kProduct);
  const ChunkRef victim = chunks[chunks.size() / 2];
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                workshop.store().OpenSnapshot("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(LatticeCloud points,
                                ReadPoints(*snapshot, victim));
  core::Column* const confidence = points.attributes.Find(kConfidenceColumn);
  ASSERT_NE(confidence, nullptr);
  confidence->Set<uint16_t>(
      0, static_cast<uint16_t>(confidence->Get<uint16_t>(0) ^ 1));
  ChunkWriter writer(workshop.store(), ChunkKind::kProduct, 1 << 20,
                     InlineExecutor());
  std::vector<TileCloud> tile;
  tile.push_back({victim.tile, points});
  MAPSIEVE_ASSERT_OK(writer.Write(std::move(tile), {}));
  storage::RevisionChange change = {.spec = snapshot->revision().spec,
                                    .added = writer.chunks(),
                                    .removed = {victim.number}};
  MAPSIEVE_ASSERT_OK(workshop.store()
                         .catalogue()
                         .CommitRevision(snapshot->map().uid,
                                         snapshot->revision().number, change)
                         .status());

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Findings found,
                                VerifyAll(workshop, 1000));
  EXPECT_THAT(found.damaged, IsEmpty());
  ASSERT_EQ(found.differing.size(), 1u);
  EXPECT_EQ(found.differing[0].tile, victim.tile);
  EXPECT_THAT(found.differing[0].difference, HasSubstr("spdf.confidence"));

  // Without the memory for any tile all are skipped.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Findings none,
                                VerifyAll(workshop, 1000, 100));
  EXPECT_EQ(none.summary.compared_tile_count, 0);
  EXPECT_GT(none.summary.skipped_tile_count, 1);
}

TEST(Verify, RefusesWhatItCannotDo) {
  Workshop workshop(12);
  MemoryPool memory(1 << 20);
  const auto open = [&](const VerifySpec& spec) {
    return OpenVerification(workshop.store(), memory, spec, {}).status();
  };
  EXPECT_THAT(open({.map_id = "nosuch"}),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("nosuch")));
  EXPECT_THAT(open({.map_id = "map", .compared_tile_count = -1}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("compared_tile_count")));
  EXPECT_THAT(open({.map_id = "map", .compared_tile_count = 1}),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("never processed")));
  std::stop_source stop;
  stop.request_stop();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto cursor, OpenVerification(workshop.store(), memory,
                                          {.map_id = "map"}, stop.get_token()));
  EXPECT_THAT(cursor->Next(),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("")));
}

}  // namespace
}  // namespace mapsieve::engine::testing
