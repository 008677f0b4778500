// What a repair makes again, byte for byte, and what it leaves alone.

#include <algorithm>
#include <filesystem>
#include <functional>
#include <iterator>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/chunk_writer.h"
#include "server/engine/product_chunk.h"
#include "server/engine/repair_map.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::DensityRule;
using core::LatticeCloud;
using ::mapsieve::testing::StatusIs;
using storage::ChunkKind;
using storage::ChunkRef;
using ::testing::HasSubstr;

/// Many units, and several chunks for a tile.
constexpr ProcessLimits kWriting = {.unit_points = 500,
                                    .tile_points = 1 << 26,
                                    .pending_bytes = 1 << 18,
                                    .chunk_bytes = 4'000};
/// One unit, and one chunk for a tile.
constexpr ProcessLimits kRepairing = {.unit_points = 1 << 26,
                                      .tile_points = 1 << 26,
                                      .pending_bytes = 1 << 26,
                                      .chunk_bytes = 1 << 26};

using Files = std::map<std::string, std::string>;

/// A map whose blobs are damaged and repaired.
class RepairTest : public ::testing::Test {
 protected:
  absl::StatusOr<RepairReport> Repair(const ProcessLimits& limits = kRepairing,
                                      const ExecutionContext& context = {}) {
    ExecutionContext own = context;
    own.executor = workers_.get();
    return RepairStoredMap(workshop_.store(), "map", workshop_.map().uid,
                           limits, *workers_, own);
  }

  std::string PathOf(const storage::BlobId& id) const {
    return workshop_.path() + "/data/blobs/" + id.substr(0, 2) + "/" + id;
  }

  /// The blobs of the map's chunks of all revisions, those of raw points or
  /// the others, by path.
  Files Blobs(bool raw) {
    const auto snapshot = workshop_.store().OpenSnapshot("map");
    EXPECT_TRUE(snapshot.ok()) << snapshot.status();
    const auto chunks = (*snapshot)->ListAllChunks(0, 100'000);
    EXPECT_TRUE(chunks.ok()) << chunks.status();
    Files files;
    for (const ChunkRef& chunk : *chunks) {
      if ((chunk.kind == ChunkKind::kRaw) != raw) continue;
      const std::string path = PathOf(chunk.blob_id);
      files[path] = storage::ReadWholeFile(path);
    }
    return files;
  }

  static void ExpectAsBefore(const Files& files) {
    for (const auto& [path, bytes] : files) {
      EXPECT_TRUE(storage::ReadWholeFile(path) == bytes) << path;
    }
  }

  Workshop workshop_{13};
  std::unique_ptr<Executor> workers_ = MakeWorkerPool(3);
};

using Damage = std::function<void(const std::string& path)>;

std::vector<Damage> AllDamages() {
  return {[](const std::string& path) {
            std::string bytes = storage::ReadWholeFile(path);
            bytes[bytes.size() / 3] ^= 1;
            storage::WriteWholeFile(path, bytes);
          },
          [](const std::string& path) {
            const std::string bytes = storage::ReadWholeFile(path);
            storage::WriteWholeFile(path, bytes.substr(0, bytes.size() / 2));
          },
          [](const std::string& path) { std::filesystem::remove(path); }};
}

TEST_F(RepairTest, MakesEveryDamagedChunkOfTheFilterAgain) {
  MAPSIEVE_ASSERT_OK(workshop_.Add(Split(MakeScene(70), 4)[0], kSmallChunks));
  MAPSIEVE_ASSERT_OK(
      workshop_.Process(SceneOptions(DensityRule::kPaper), kWriting));
  const std::vector<ChunkRef> products = workshop_.Chunks(ChunkKind::kProduct);
  ASSERT_NE(std::adjacent_find(products.begin(), products.end(),
                               [](const ChunkRef& a, const ChunkRef& b) {
                                 return a.tile == b.tile &&
                                        a.min_depth == b.min_depth;
                               }),
            products.end())
      << "no tile has several chunks of the same depths";
  const Files made = Blobs(false);
  const Files raw = Blobs(true);
  ASSERT_GT(made.size(), 20U);
  const int64_t revision = workshop_.map().newest_revision;

  // Every blob, each way.
  for (const Damage& damage : AllDamages()) {
    for (const auto& [path, bytes] : made) damage(path);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RepairReport report, Repair());
    EXPECT_GE(report.damaged_chunk_count, static_cast<int64_t>(made.size()));
    EXPECT_EQ(report.repaired_chunk_count, report.damaged_chunk_count);
    EXPECT_EQ(report.raw_chunk_count, 0);
    EXPECT_EQ(report.obstacle, "");
    ExpectAsBefore(made);
  }
  // One blob: no other file is written.
  for (size_t i = 0; i < made.size(); i += 9) {
    const auto victim = std::next(made.begin(), static_cast<ptrdiff_t>(i));
    AllDamages()[i / 9 % 3](victim->first);
    std::map<std::string, std::filesystem::file_time_type> times;
    for (const auto& [path, bytes] : made) {
      if (path == victim->first) continue;
      times[path] = std::filesystem::last_write_time(path);
    }
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RepairReport report, Repair(kWriting));
    EXPECT_GE(report.repaired_chunk_count, 1);
    ExpectAsBefore(made);
    for (const auto& [path, time] : times) {
      EXPECT_EQ(std::filesystem::last_write_time(path), time) << path;
    }
  }
  ExpectAsBefore(raw);
  EXPECT_EQ(workshop_.map().newest_revision, revision);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RepairReport sound, Repair());
  EXPECT_EQ(sound, RepairReport());
}

TEST_F(RepairTest, MakesChunksOfAllRevisionsAgain) {
  const auto parts = Split(MakeScene(71), 8);
  const core::SpdfOptions paper = SceneOptions(DensityRule::kPaper);
  MAPSIEVE_ASSERT_OK(workshop_.Add(parts[0], kSmallChunks));
  MAPSIEVE_ASSERT_OK(workshop_.Process(paper, kWriting));
  const int64_t first = workshop_.map().newest_revision;
  // An update of few tiles: half of the chunks stay.
  LatticeCloud few = parts[1].Select(std::vector<uint32_t>{1, 2, 3});
  few.positions = {
      {20'000, 20'000, 5}, {20'010, 20'000, 5}, {20'000, 20'020, 5}};
  MAPSIEVE_ASSERT_OK(workshop_.Add(few, kSmallChunks));
  MAPSIEVE_ASSERT_OK(workshop_.Process(paper, kRepairing));
  MAPSIEVE_ASSERT_OK(
      workshop_.Process(SceneOptions(DensityRule::kQuota), kRepairing));
  MAPSIEVE_ASSERT_OK(
      workshop_.store().catalogue().RollBack(workshop_.map().uid, first));
  const Files made = Blobs(false);
  const int64_t revision = workshop_.map().newest_revision;
  for (const auto& [path, bytes] : made) AllDamages()[0](path);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RepairReport report, Repair());
  EXPECT_EQ(report.obstacle, "");
  EXPECT_EQ(report.repaired_chunk_count, report.damaged_chunk_count);
  ExpectAsBefore(made);
  EXPECT_EQ(workshop_.map().newest_revision, revision);
}

TEST_F(RepairTest, DamagedRawPointsAreToldAndNothingIsMadeUp) {
  MAPSIEVE_ASSERT_OK(workshop_.Add(Split(MakeScene(72), 8)[0], kSmallChunks));
  MAPSIEVE_ASSERT_OK(
      workshop_.Process(SceneOptions(DensityRule::kPaper), kWriting));
  const Files made = Blobs(false);
  const Files raw = Blobs(true);
  const auto& [raw_path, raw_bytes] = *raw.begin();
  AllDamages()[0](raw_path);
  std::filesystem::remove(made.begin()->first);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RepairReport report, Repair());
  EXPECT_EQ(report.raw_chunk_count, 1);
  EXPECT_GE(report.damaged_chunk_count, 2);
  EXPECT_EQ(report.repaired_chunk_count, 0);
  EXPECT_THAT(report.obstacle, HasSubstr("revision 3 cannot be made again"));
  EXPECT_THAT(report.obstacle, HasSubstr(raw_path));
  EXPECT_FALSE(std::filesystem::exists(made.begin()->first));

  storage::WriteWholeFile(raw_path, raw_bytes);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RepairReport again, Repair());
  EXPECT_GE(again.repaired_chunk_count, 1);
  EXPECT_EQ(again.obstacle, "");
  ExpectAsBefore(made);
}

TEST_F(RepairTest, WhatTheFilterDoesNotMakeIsNotPutBack) {
  MAPSIEVE_ASSERT_OK(workshop_.Add(Split(MakeScene(73), 8)[0], kSmallChunks));
  MAPSIEVE_ASSERT_OK(
      workshop_.Process(SceneOptions(DensityRule::kPaper), kWriting));
  // Another version's chunk: the same points, one with another confidence.
  const ChunkRef victim = workshop_.Chunks(ChunkKind::kProduct).front();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                workshop_.store().OpenSnapshot("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(LatticeCloud points,
                                ReadPoints(*snapshot, victim));
  core::Column* const confidence = points.attributes.Find(kConfidenceColumn);
  ASSERT_NE(confidence, nullptr);
  confidence->Set<uint16_t>(
      0, static_cast<uint16_t>(confidence->Get<uint16_t>(0) ^ 1));
  ChunkWriter writer(workshop_.store(), ChunkKind::kProduct, 1 << 20,
                     InlineExecutor());
  std::vector<TileCloud> tile;
  tile.push_back({victim.tile, points});
  MAPSIEVE_ASSERT_OK(writer.Write(std::move(tile), {}));
  MAPSIEVE_ASSERT_OK(workshop_.store().catalogue().CommitRevision(
      snapshot->map().uid, snapshot->revision().number,
      {.spec = snapshot->revision().spec,
       .added = writer.chunks(),
       .removed = {victim.number}}));
  const storage::BlobId id = writer.chunks().front().blob_id;
  workshop_.DamageBlob(id);
  const std::string damaged = storage::ReadWholeFile(PathOf(id));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RepairReport report, Repair());
  EXPECT_EQ(report.damaged_chunk_count, 1);
  EXPECT_EQ(report.repaired_chunk_count, 0);
  EXPECT_THAT(report.obstacle, HasSubstr("makes other bytes"));
  EXPECT_EQ(storage::ReadWholeFile(PathOf(id)), damaged);
}

TEST_F(RepairTest, StopsWhenAsked) {
  MAPSIEVE_ASSERT_OK(workshop_.Add(Split(MakeScene(74), 8)[0], kSmallChunks));
  MAPSIEVE_ASSERT_OK(
      workshop_.Process(SceneOptions(DensityRule::kPaper), kWriting));
  const Files made = Blobs(false);
  std::filesystem::remove(made.begin()->first);
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THAT(Repair(kRepairing, {.stop = stop.get_token()}),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("")));
  // While the filter runs.
  const auto chunks = static_cast<int64_t>(made.size() + Blobs(true).size());
  StopAfter later(chunks + chunks / 2);
  EXPECT_THAT(Repair(kWriting, later.Context()),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("")));
  EXPECT_TRUE(later.is_asked());
  MAPSIEVE_EXPECT_OK(Repair());
  ExpectAsBefore(made);
}

TEST(RepairOperation, RepairsBesideQueriesAndMakesNoRevision) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 4}));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "one", Split(MakeScene(75), 4)[0]));
  MAPSIEVE_ASSERT_OK(service.Process("map", SceneOptions(DensityRule::kQuota)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer whole,
                                service.Query({.map_id = "map"}));
  // All products and histories: what remains is raw.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer raw,
                                service.Query({.map_id = "map", .raw = true}));
  for (const auto& entry : std::filesystem::recursive_directory_iterator(
           service.path() + "/data/blobs")) {
    if (!entry.is_regular_file()) continue;
    const std::string bytes = storage::ReadWholeFile(entry.path());
    storage::WriteWholeFile(entry.path(), "damaged");
    if (service.Query({.map_id = "map", .raw = true}).ok()) continue;
    storage::WriteWholeFile(entry.path(), bytes);
  }
  EXPECT_THAT(service.Query({.map_id = "map"}),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("map map")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation started,
                                service->RepairMap("map"));
  EXPECT_EQ(started.verb, OperationVerb::kRepairMap);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer beside,
                                service.Query({.map_id = "map", .raw = true}));
  ExpectSameCloud(beside.points, raw.points);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Operation done,
      service->WaitOperation(started.operation_id, absl::Minutes(2)));
  MAPSIEVE_ASSERT_OK(done.error);
  ASSERT_TRUE(done.repair_report.has_value());
  EXPECT_GT(done.repair_report->repaired_chunk_count, 10);
  EXPECT_EQ(done.repair_report->repaired_chunk_count,
            done.repair_report->damaged_chunk_count);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer repaired,
                                service.Query({.map_id = "map"}));
  ExpectSameCloud(repaired.points, whole.points);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapInfo info, service->GetMap("map"));
  EXPECT_EQ(info.revision, 3);
  // It is remembered.
  service.Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation remembered,
                                service->GetOperation(started.operation_id));
  EXPECT_EQ(remembered.verb, OperationVerb::kRepairMap);
  EXPECT_EQ(remembered.repair_report, done.repair_report);
  EXPECT_THAT(service->RepairMap("nosuch"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("nosuch")));
}

}  // namespace
}  // namespace mapsieve::engine::testing
