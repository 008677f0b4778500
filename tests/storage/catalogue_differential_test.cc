// The SQLite catalogue against the plain one in memory: random calls, the same
// to both, answer the same, and leave the same behind.

#include <algorithm>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/sqlite_catalogue.h"
#include "tests/storage/catalogue_dump.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/memory_catalogue.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::MemoryCatalogue;

// One catalogue, and the uids that it gave to maps and uploads, which the other
// one has not.
struct Side {
  Catalogue* catalogue = nullptr;
  std::vector<std::string> map_uids;
  std::vector<std::string> upload_uids;
};

// What a call answers: its code, or what is told of the result.
std::string Told(const absl::Status& status) {
  return absl::StatusCodeToString(status.code());
}
std::string Told(int64_t count) { return absl::StrCat(count); }
template <typename Record>
std::string Told(const Record& record) requires requires {
  Describe(record, Identities::kLeftOut);
}
{ return Describe(record, Identities::kLeftOut); }
std::string Told(const ChunkRef& chunk) { return Describe(chunk); }
std::string Told(const TileSummary& tile) { return Describe(tile); }
std::string Told(const core::CellKey& tile) { return tile.ToString(); }
template <typename Record>
std::string Told(const std::vector<Record>& records) {
  std::string text;
  for (const Record& record : records)
    absl::StrAppend(&text, Told(record), "|");
  return text;
}
template <typename T>
std::string Told(const absl::StatusOr<T>& result) {
  return result.ok() ? Told(*result) : Told(result.status());
}

class CatalogueDifferentialTest : public ::testing::Test {
 protected:
  void SetUp() override {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        sqlite_, OpenSqliteCatalogue(PosixFileSystem(), directory_ / "db",
                                     IfAbsent::kCreate));
    sides_[0].catalogue = sqlite_.get();
    sides_[1].catalogue = &memory_;
  }

  /// `call` of both sides answers the same.
  template <typename Call>
  void Both(const char* what, const Call& call) {
    const std::string first = call(sides_[0]);
    EXPECT_EQ(first, call(sides_[1])) << what;
    ++(first == "OK" || first.find(' ') != std::string::npos ? ok_count_
                                                             : other_count_);
  }

  int64_t Draw(int64_t low, int64_t high) {
    if (high < low) return low;
    return low + static_cast<int64_t>(random_() %
                                      static_cast<uint64_t>(high - low + 1));
  }
  bool Chance(int percent) { return Draw(1, 100) <= percent; }
  /// One of so many, a late one in most cases, or one that is not there.
  size_t DrawIndex(const std::vector<std::string>& names) {
    const int64_t count = std::ssize(names);
    const int64_t first = Chance(90) ? std::max<int64_t>(0, count - 5) : 0;
    return static_cast<size_t>(Draw(first, count - (Chance(90) ? 1 : 0)));
  }
  static std::string At(const std::vector<std::string>& names, size_t index) {
    return index < names.size() ? names[index] : std::string(32, 'f');
  }
  std::string DrawId() { return absl::StrCat("id", Draw(1, 4)); }
  core::CellKey DrawTile() { return {10, Draw(-2, 1), Draw(0, 2), 0}; }
  ChunkKind DrawKind() { return static_cast<ChunkKind>(Draw(1, 3)); }

  RevisionChange DrawChange(int64_t newest) {
    RevisionChange change;
    change.spec.kind = static_cast<RevisionKind>(Draw(2, 5));
    change.spec.description = absl::StrCat("change ", Draw(0, 99));
    if (Chance(50)) {
      change.spec.attributes = {{"intensity", core::ScalarType::kUint16}};
    }
    change.removes_product = Chance(20);
    if (Chance(25)) {
      change.spec.product.emplace().options = absl::StrCat("o", Draw(0, 9));
    }
    for (int64_t i = Draw(0, 4); i > 0; --i) {
      const core::CellKey tile = DrawTile();
      ChunkRef chunk =
          TestChunk(DrawKind(), tile.x, tile.y, tile.z,
                    std::string(static_cast<size_t>(Draw(1, 9)), 'c'),
                    Chance(3) ? 0 : Draw(1, 50));
      chunk.bounds.max.x += Draw(0, 1000);
      change.added.push_back(chunk);
    }
    // Of the newest revision in most cases.
    if (Chance(40)) {
      for (int64_t i = Draw(1, 3); i > 0; --i) {
        change.removed.push_back(DrawNumber(newest));
      }
    }
    return change;
  }
  /// The number of a chunk, one of the map at hand if it has any.
  int64_t DrawNumber(int64_t newest) {
    const auto chunks = memory_.ListChunks(map_uid_, newest, DrawKind(),
                                           std::nullopt, std::nullopt, 1000);
    if (!chunks.ok() || chunks->empty() || Chance(5)) return Draw(1, 500);
    return (*chunks)[static_cast<size_t>(Draw(0, std::ssize(*chunks) - 1))]
        .number;
  }

  void ChangeMaps() {
    const std::string id = DrawId();
    if (Chance(70)) {
      Both("CreateMap", [&](Side& side) {
        const auto map = side.catalogue->CreateMap(TestMap(id));
        if (map.ok()) side.map_uids.push_back(map->uid);
        return Told(map);
      });
    } else if (Chance(60)) {
      Both("DeleteMap",
           [&](Side& side) { return Told(side.catalogue->DeleteMap(id)); });
    } else {
      const size_t map = DrawIndex(sides_[0].map_uids);
      Both("PurgeMap", [&](Side& side) {
        return Told(side.catalogue->PurgeMap(At(side.map_uids, map)));
      });
    }
  }

  void Commit() {
    const size_t map = DrawIndex(sides_[0].map_uids);
    map_uid_ = At(sides_[1].map_uids, map);
    int64_t newest = 1;
    if (const auto revisions = memory_.ListRevisions(map_uid_, 0, 1);
        revisions.ok()) {
      newest = revisions->front().number;
    }
    if (Chance(15)) {
      const int64_t target = Draw(0, newest + 1);
      Both("RollBack", [&](Side& side) {
        return Told(side.catalogue->RollBack(At(side.map_uids, map), target));
      });
      return;
    }
    RevisionChange change = DrawChange(newest);
    const int64_t parent = Chance(95) ? newest : Draw(0, newest + 1);
    const bool has_upload = Chance(20);
    const size_t upload = DrawIndex(sides_[0].upload_uids);
    const std::string crs_wkt = Chance(5) ? DrawId() : "";
    const std::string frame_id = Chance(5) ? DrawId() : "";
    Both("CommitRevision", [&](Side& side) {
      if (has_upload)
        change.finalized_upload_uid = At(side.upload_uids, upload);
      change.upload_report = "report";
      change.crs_wkt = crs_wkt;
      change.frame_id = frame_id;
      return Told(side.catalogue->CommitRevision(At(side.map_uids, map), parent,
                                                 change));
    });
  }

  void ChangeUploads() {
    const size_t map = DrawIndex(sides_[0].map_uids);
    const size_t upload = DrawIndex(sides_[0].upload_uids);
    const int64_t bytes = Draw(0, 100);
    switch (Draw(0, 6)) {
      case 0:
      case 1: {
        UploadSpec spec = {.id = DrawId()};
        if (Chance(10)) spec.expected_bytes = 7;
        Both("CreateUpload", [&](Side& side) {
          const auto made =
              side.catalogue->CreateUpload(At(side.map_uids, map), spec);
          if (made.ok()) side.upload_uids.push_back(made->uid);
          return Told(made);
        });
        break;
      }
      case 2:
        Both("SetCommittedBytes", [&](Side& side) {
          return Told(side.catalogue->SetCommittedBytes(
              At(side.upload_uids, upload), bytes));
        });
        break;
      case 3:
      case 4: {
        const auto from = Chance(80) ? UploadState::kActive : DrawState();
        const auto to = Chance(80) ? UploadState::kFinalizing : DrawState();
        Both("SetUploadState", [&](Side& side) {
          return Told(side.catalogue->SetUploadState(
              At(side.upload_uids, upload), from, to, "why"));
        });
        break;
      }
      case 5:
        if (!Chance(20)) break;
        Both("DeleteIdleUploads", [&](Side& side) {
          return Told(
              side.catalogue->DeleteIdleUploads(absl::InfiniteFuture()));
        });
        break;
      default:
        Both("DeleteUpload", [&](Side& side) {
          return Told(
              side.catalogue->DeleteUpload(At(side.upload_uids, upload)));
        });
    }
  }
  UploadState DrawState() { return static_cast<UploadState>(Draw(1, 4)); }

  void ChangeOperations() {
    OperationRecord operation;
    operation.id = DrawId();
    operation.target = DrawId();
    operation.verb = "process";
    operation.request = std::string("\0r", 2);
    operation.state = static_cast<OperationState>(Draw(1, 5));
    operation.cancel_requested = Chance(30);
    operation.total_count = Draw(0, 5);
    operation.done_count = Draw(0, 5);
    operation.error_code = static_cast<int>(Draw(0, 16));
    operation.response = "response";
    switch (Draw(0, 2)) {
      case 0:
        Both("CreateOperation", [&](Side& side) {
          return Told(side.catalogue->CreateOperation(operation));
        });
        break;
      case 1:
        Both("UpdateOperation", [&](Side& side) {
          return Told(side.catalogue->UpdateOperation(operation));
        });
        break;
      default:
        Both("DeleteOperation", [&](Side& side) {
          return Told(side.catalogue->DeleteOperation(operation.id));
        });
    }
  }

  void Read() {
    const size_t map = DrawIndex(sides_[0].map_uids);
    const std::string id = DrawId();
    const int64_t revision = Draw(0, 12);
    const int64_t other = Draw(1, 8);
    const int64_t count = Draw(0, 6);
    const ChunkKind kind = DrawKind();
    const core::CellKey tile = DrawTile();
    std::optional<core::LatticeBox> region;
    if (Chance(50)) {
      const core::LatticePoint corner{Draw(-3000, 3000), Draw(-500, 3000), 0};
      region = {corner,
                {corner.x + Draw(-9, 2000), corner.y + Draw(0, 2000), 1}};
    }
    std::optional<ChunkPosition> after;
    if (Chance(50)) after = {.tile = DrawTile(), .number = Draw(0, 300)};
    const auto after_tile =
        after.has_value() ? std::optional(after->tile) : std::nullopt;
    const auto each = [&](const char* what, const auto& call) {
      Both(what, [&](Side& side) {
        return Told(call(*side.catalogue, At(side.map_uids, map)));
      });
    };
    switch (Draw(0, 7)) {
      case 0:
        each("ListChunks", [&](auto& catalogue, const std::string& uid) {
          return catalogue.ListChunks(uid, revision, kind, region, after,
                                      count);
        });
        break;
      case 1:
        each("ListTiles", [&](auto& catalogue, const std::string& uid) {
          return catalogue.ListTiles(uid, revision, kind, region, after_tile,
                                     count);
        });
        break;
      case 2:
        each("ListTileChunks", [&](auto& catalogue, const std::string& uid) {
          return catalogue.ListTileChunks(uid, revision, kind, tile);
        });
        break;
      case 3:
        each("ListChangedTiles", [&](auto& catalogue, const std::string& uid) {
          return catalogue.ListChangedTiles(uid, revision, other, kind,
                                            after_tile, count);
        });
        break;
      case 4:
        each("ListRevisions", [&](auto& catalogue, const std::string& uid) {
          return catalogue.ListRevisions(uid, revision, count);
        });
        break;
      case 5:
        each("ListUploads", [&](auto& catalogue, const std::string& uid) {
          return catalogue.ListUploads(uid, id, count);
        });
        break;
      case 6:
        each("ListAllChunks", [&](auto& catalogue, const std::string& uid) {
          return catalogue.ListAllChunks(uid, revision, count);
        });
        break;
      default:
        each("ListOperations", [&](auto& catalogue, const std::string&) {
          return catalogue.ListOperations(count % 2 == 0 ? id : "", other > 4,
                                          revision, count);
        });
    }
  }

  TemporaryDirectory directory_;
  std::unique_ptr<Catalogue> sqlite_;
  MemoryCatalogue memory_;
  Side sides_[2];
  std::mt19937_64 random_{2026};
  /// Of the map at hand, in memory.
  std::string map_uid_;
  int64_t ok_count_ = 0;
  int64_t other_count_ = 0;
};

TEST_F(CatalogueDifferentialTest, RandomCallsAnswerTheSame) {
  constexpr int kCallCount = 3000;
  for (int i = 0; i < kCallCount && !HasFailure(); ++i) {
    SCOPED_TRACE(absl::StrCat("call ", i));
    const int64_t dice = Draw(1, 100);
    if (dice <= 4) {
      ChangeMaps();
    } else if (dice <= 40) {
      Commit();
    } else if (dice <= 58) {
      ChangeUploads();
    } else if (dice <= 66) {
      ChangeOperations();
    } else {
      Read();
    }
    if (i % 1000 == 999) {
      const auto dump = Dump(*sqlite_, Identities::kLeftOut);
      MAPSIEVE_ASSERT_OK(dump);
      EXPECT_EQ(*dump, *Dump(memory_, Identities::kLeftOut));
    }
  }
  // Not only errors and empty answers.
  EXPECT_GT(ok_count_, kCallCount / 4);
  EXPECT_GT(other_count_, kCallCount / 10);
}

}  // namespace
}  // namespace mapsieve::storage
