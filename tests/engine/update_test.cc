// A product that is kept up to date is, byte for byte, that of a map built from
// the same points.

#include <algorithm>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "core/cloud/merge_duplicates.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/engine/product_chunk.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/clouds.h"
#include "tests/testing/memory_blob_store.h"
#include "tests/testing/memory_catalogue.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::DensityRule;
using core::LatticeCloud;
using core::SpdfOptions;
using storage::ChunkKind;
using storage::ChunkRef;

constexpr IngestLimits kIngest = {.block_bytes = 1 << 26,
                                  .bucket_bytes = 1 << 28,
                                  .chunk_bytes = 1 << 24,
                                  .chunk_count = 100'000};
constexpr ProcessLimits kProcess = {.unit_points = 3000,
                                    .tile_points = 1 << 26,
                                    .pending_bytes = 1 << 18,
                                    .update_bytes = 1 << 18,
                                    .chunk_bytes = 30'000};

/// Content of the chunks of each tile, in order.
using Contents = std::map<std::string, std::vector<storage::BlobId>>;
Contents ContentsOf(Workshop& workshop, ChunkKind kind) {
  Contents contents;
  for (const ChunkRef& chunk : workshop.Chunks(kind)) {
    contents[chunk.tile.ToString()].push_back(chunk.blob_id);
  }
  return contents;
}

storage::RevisionRecord NewestRevision(Workshop& workshop) {
  const auto snapshot = workshop.store().OpenSnapshot("map");
  EXPECT_TRUE(snapshot.ok()) << snapshot.status();
  return (*snapshot)->revision();
}

/// Part of `scene` around one of its points, moved a little.
LatticeCloud Clump(const LatticeCloud& scene, std::mt19937_64& random) {
  const core::LatticePoint center = scene.positions[random() % scene.size()];
  const int64_t radius = 100 + static_cast<int64_t>(random() % 500);
  std::vector<uint32_t> rows;
  for (uint32_t row = 0; row < scene.size(); ++row) {
    const core::LatticePoint& q = scene.positions[row];
    if (std::abs(q.x - center.x) < radius &&
        std::abs(q.y - center.y) < radius &&
        std::abs(q.z - center.z) < radius) {
      rows.push_back(row);
    }
  }
  LatticeCloud clump = scene.Select(rows);
  for (core::LatticePoint& q : clump.positions) {
    q.x += static_cast<int64_t>(random() % 9) - 4;
    q.z += static_cast<int64_t>(random() % 9) - 4;
  }
  return clump;
}

void Append(const LatticeCloud& part, LatticeCloud& all) {
  MAPSIEVE_ASSERT_OK(
      all.attributes.AppendAll(all.size(), part.attributes, part.size()));
  all.positions.insert(all.positions.end(), part.positions.begin(),
                       part.positions.end());
}

void AddAndProcess(const LatticeCloud& points, const SpdfOptions& options,
                   Workshop& workshop) {
  MAPSIEVE_ASSERT_OK(workshop.Add(points, kIngest));
  MAPSIEVE_ASSERT_OK(workshop.Process(options, kProcess));
}

class UpdateTest : public ::testing::TestWithParam<DensityRule> {};

TEST_P(UpdateTest, GivesTheBytesOfAMapBuiltFromTheSamePoints) {
  const SpdfOptions options = SceneOptions(GetParam());
  constexpr int kTileLevel = 11;
  std::mt19937_64 random(7);
  LatticeCloud all = MakeScene(11);
  Workshop edited(kTileLevel, 2);
  AddAndProcess(all, options, edited);
  for (int edit = 0; edit < 2; ++edit) {
    SCOPED_TRACE(edit);
    const LatticeCloud clump = Clump(all, random);
    Append(clump, all);
    MAPSIEVE_ASSERT_OK(edited.Add(clump, kIngest));
    // New tiles and levels in scratch files, then all of them in memory.
    ProcessLimits limits = kProcess;
    limits.update_bytes = edit == 0 ? 0 : 1 << 26;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ProcessReport report,
                                  edited.Process(options, limits));
    Workshop scratch(kTileLevel);
    MAPSIEVE_ASSERT_OK(scratch.Add(all, kIngest));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ProcessReport expected,
                                  scratch.Process(options, kProcess));
    EXPECT_LT(report.updated_tile_count, expected.updated_tile_count);
    EXPECT_GT(report.updated_tile_count, 0);
    EXPECT_EQ(report.distinct_point_count, expected.distinct_point_count);
    EXPECT_EQ(report.label_counts, expected.label_counts);
    EXPECT_EQ(report.level_counts, expected.level_counts);
    EXPECT_EQ(report.outlier_count, expected.outlier_count);
    for (const ChunkKind kind : {ChunkKind::kProduct, ChunkKind::kHistory}) {
      EXPECT_EQ(ContentsOf(edited, kind), ContentsOf(scratch, kind));
    }
    const storage::RevisionRecord a = NewestRevision(edited);
    const storage::RevisionRecord b = NewestRevision(scratch);
    EXPECT_EQ(a.spec.product, b.spec.product);
    EXPECT_EQ(a.totals.product_point_count, b.totals.product_point_count);
    EXPECT_EQ(a.totals.label_counts, b.totals.label_counts);
    EXPECT_EQ(a.totals.stale_tile_count, 0);
    const LatticeCloud local = FilterLocally(all, options);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, edited.Query({}));
    ExpectSameCloud(answer.points, local);
  }
}

INSTANTIATE_TEST_SUITE_P(Rules, UpdateTest,
                         ::testing::Values(DensityRule::kPaper,
                                           DensityRule::kQuota));

TEST(Update, IsTheSameWhateverTheStoreKeepsItsMapsIn) {
  const SpdfOptions options = SceneOptions(DensityRule::kPaper);
  const LatticeCloud scene = MakeScene(11);
  const RegionShape hole = Box{{0.5, 0.5, -4}, {2.5, 2.5, 4}};
  Workshop on_disk(11);
  Workshop in_memory(
      11, 1,
      {.catalogue = std::make_unique<mapsieve::testing::MemoryCatalogue>(),
       .blobs = std::make_unique<mapsieve::testing::MemoryBlobStore>()});
  const auto expect_same = [&] {
    for (const ChunkKind kind :
         {ChunkKind::kRaw, ChunkKind::kProduct, ChunkKind::kHistory}) {
      EXPECT_EQ(ContentsOf(in_memory, kind), ContentsOf(on_disk, kind));
    }
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer actual, in_memory.Query({}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer expected, on_disk.Query({}));
    EXPECT_EQ(actual.header.revision, expected.header.revision);
    ExpectSameCloud(actual.points, expected.points);
  };
  for (Workshop* workshop : {&on_disk, &in_memory}) {
    AddAndProcess(scene, options, *workshop);
  }
  expect_same();
  const int64_t whole = NewestRevision(on_disk).number;
  for (Workshop* workshop : {&on_disk, &in_memory}) {
    MAPSIEVE_ASSERT_OK(workshop->Delete(hole, kIngest));
    MAPSIEVE_ASSERT_OK(workshop->Process(options, kProcess));
  }
  expect_same();
  for (Workshop* workshop : {&on_disk, &in_memory}) {
    MAPSIEVE_ASSERT_OK(
        workshop->store().catalogue().RollBack(workshop->map().uid, whole));
    MAPSIEVE_ASSERT_OK(workshop->store().CollectGarbage());
  }
  expect_same();
}

TEST(Update, SharesTheChunksOfTilesOutOfReach) {
  const SpdfOptions options = SceneOptions(DensityRule::kPaper);
  std::mt19937_64 random(3);
  const LatticeCloud scene = MakeScene(12);
  Workshop workshop(10);
  AddAndProcess(scene, options, workshop);
  std::map<int64_t, core::CellKey> before;
  std::set<std::string> tiles;
  for (const ChunkRef& chunk : workshop.Chunks(ChunkKind::kProduct)) {
    before[chunk.number] = chunk.tile;
    tiles.insert(chunk.tile.ToString());
  }
  MAPSIEVE_ASSERT_OK(workshop.Add(Clump(scene, random), kIngest));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ProcessReport report,
                                workshop.Process(options, kProcess));
  std::set<std::string> shared;
  for (const ChunkRef& chunk : workshop.Chunks(ChunkKind::kProduct)) {
    if (before.contains(chunk.number)) shared.insert(chunk.tile.ToString());
  }
  EXPECT_LT(static_cast<size_t>(report.updated_tile_count), tiles.size());
  EXPECT_GT(shared.size(), tiles.size() / 4);
}

TEST(Update, OfATileInWhichOnlyDepthsChangedWritesTheGroupsThatHoldThem) {
  const SpdfOptions options = SceneOptions(DensityRule::kPaper);
  std::mt19937_64 random(6);
  LatticeCloud all = MakeScene(12);
  Workshop edited(11);
  AddAndProcess(all, options, edited);
  std::set<int64_t> before;
  for (const ChunkRef& chunk : edited.Chunks(ChunkKind::kProduct)) {
    before.insert(chunk.number);
  }
  const LatticeCloud clump = Clump(all, random);
  Append(clump, all);
  AddAndProcess(clump, options, edited);
  std::map<std::string, std::set<size_t>> shared;
  std::map<std::string, std::set<size_t>> written;
  for (const ChunkRef& chunk : edited.Chunks(ChunkKind::kProduct)) {
    (before.contains(chunk.number) ? shared : written)[chunk.tile.ToString()]
        .insert(DepthGroupOf(chunk.min_depth));
  }
  size_t written_in_part = 0;
  for (const auto& [tile, groups] : written) {
    const auto kept = shared.find(tile);
    if (kept == shared.end()) continue;
    ++written_in_part;
    // Coarse groups come first.
    EXPECT_GT(*kept->second.begin(), *groups.rbegin());
  }
  EXPECT_GT(written_in_part, 0u);
  Workshop scratch(11);
  AddAndProcess(all, options, scratch);
  // Chunks that were written later come last.
  const auto sorted_contents = [](Workshop& workshop) {
    Contents contents = ContentsOf(workshop, ChunkKind::kProduct);
    for (auto& [tile, blobs] : contents) std::sort(blobs.begin(), blobs.end());
    return contents;
  };
  EXPECT_EQ(sorted_contents(edited), sorted_contents(scratch));
}

TEST(Update, OtherOptionsFilterEverything) {
  std::mt19937_64 random(4);
  const LatticeCloud scene = MakeScene(13);
  Workshop workshop(11);
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, kIngest));
  SpdfOptions options = SceneOptions(DensityRule::kQuota);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ProcessReport first,
                                workshop.Process(options, kProcess));
  options.neighbor_count -= 1;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ProcessReport second,
                                workshop.Process(options, kProcess));
  EXPECT_EQ(second.updated_tile_count, first.updated_tile_count);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
  ExpectSameCloud(answer.points, FilterLocally(scene, options));
}

TEST(Update, ACancelledOneLeavesTheProductAsItWas) {
  const SpdfOptions options = SceneOptions(DensityRule::kPaper);
  std::mt19937_64 random(5);
  const LatticeCloud scene = MakeScene(14);
  Workshop workshop(10);
  AddAndProcess(scene, options, workshop);
  const Contents before = ContentsOf(workshop, ChunkKind::kProduct);
  MAPSIEVE_ASSERT_OK(workshop.Add(Clump(scene, random), kIngest));
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THAT(
      workshop.Process(options, kProcess, {.stop = stop.get_token()}),
      mapsieve::testing::StatusIs(absl::StatusCode::kCancelled, ::testing::_));
  EXPECT_EQ(ContentsOf(workshop, ChunkKind::kProduct), before);
}

}  // namespace
}  // namespace mapsieve::engine::testing
