// The SQLite catalogue as a file: damaged, foreign, too new, too large.

#include <algorithm>
#include <memory>
#include <random>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/sqlite_catalogue.h"
#include "storage/sqlite_database.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::AllOf;
using ::testing::HasSubstr;

class SqliteDamageTest : public ::testing::Test {
 protected:
  void MakeCatalogue() {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto catalogue,
        OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kCreate));
    for (const char* id : {"one", "two"}) {
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map,
                                    catalogue->CreateMap(TestMap(id)));
      std::vector<ChunkRef> raw;
      std::vector<ChunkRef> product;
      for (int i = 0; i < 30; ++i) {
        const std::string content = id + std::to_string(i);
        raw.push_back(TestChunk(ChunkKind::kRaw, i % 5, i / 5, 0, content, 9));
        product.push_back(
            TestChunk(ChunkKind::kProduct, i % 5, i / 5, 0, content, 3));
      }
      RevisionChange change = Adding(raw);
      change.spec.attributes = {{"intensity", core::ScalarType::kUint16}};
      MAPSIEVE_ASSERT_OK(catalogue->CommitRevision(map.uid, 1, change));
      MAPSIEVE_ASSERT_OK(
          catalogue->CommitRevision(map.uid, 2, Processing(product)));
      MAPSIEVE_ASSERT_OK(catalogue->CreateUpload(map.uid, {.id = "u"}));
      OperationRecord operation;
      operation.id = id;
      MAPSIEVE_ASSERT_OK(catalogue->CreateOperation(operation));
    }
  }

  /// Does everything that a catalogue can do; whatever it answers.
  void Exercise(Catalogue& catalogue) {
    const auto maps = catalogue.ListMaps("", 100);
    if (!maps.ok()) return;
    for (const MapRecord& map : *maps) {
      catalogue.ListRevisions(map.uid, 0, 100).status().IgnoreError();
      for (const ChunkKind kind : {ChunkKind::kRaw, ChunkKind::kProduct}) {
        const auto chunks = catalogue.ListChunks(
            map.uid, map.newest_revision, kind,
            core::LatticeBox{{0, 0, 0}, {4000, 4000, 4}}, std::nullopt, 100);
        if (chunks.ok()) {
          for (const ChunkRef& chunk : *chunks) chunk.tile.box();
        }
        catalogue
            .ListTiles(map.uid, map.newest_revision, kind, std::nullopt,
                       std::nullopt, 100)
            .status()
            .IgnoreError();
      }
      catalogue.ListUploads(map.uid, "", 100).status().IgnoreError();
      RevisionChange change =
          Processing({TestChunk(ChunkKind::kProduct, 0, 0, 0, "x", 1)});
      catalogue.CommitRevision(map.uid, map.newest_revision, change)
          .status()
          .IgnoreError();
      catalogue.MeasureReclaimable(map.uid).status().IgnoreError();
      catalogue.ExpireRevisions(map.uid, 1).status().IgnoreError();
      catalogue.ForgetExpired(map.uid, {}).status().IgnoreError();
      catalogue.RollBack(map.uid, 3).status().IgnoreError();
      catalogue.DeleteMap(map.spec.id).IgnoreError();
      catalogue.PurgeMap(map.uid).IgnoreError();
    }
    catalogue.ListOperations("", false, 0, 100).status().IgnoreError();
    catalogue.DeleteIdleUploads(absl::InfiniteFuture()).status().IgnoreError();
  }

  void RemoveLog() {
    std::filesystem::remove(path_ + "-wal");
    std::filesystem::remove(path_ + "-shm");
  }

  TemporaryDirectory directory_;
  const std::string path_ = directory_ / "catalogue.db";
};

TEST_F(SqliteDamageTest, NoFlippedByteCrashes) {
  MakeCatalogue();
  const std::string intact = ReadWholeFile(path_);
  ASSERT_GT(intact.size(), 20'000u);
  std::mt19937_64 random(5);
  int refused = 0;
  for (int i = 0; i < 400; ++i) {
    std::string damaged = intact;
    // Every second one hits the first bytes of a page, which are structure.
    size_t at = random() % intact.size();
    if (i % 2 == 0) at = at / 4096 * 4096 + random() % 100;
    damaged[at] = static_cast<char>(random());
    RemoveLog();
    WriteWholeFile(path_, damaged);
    const auto catalogue =
        OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail);
    if (catalogue.ok()) {
      Exercise(**catalogue);
    } else {
      ++refused;
    }
  }
  EXPECT_GT(refused, 0);
}

TEST_F(SqliteDamageTest, NoTruncationCrashes) {
  MakeCatalogue();
  const std::string intact = ReadWholeFile(path_);
  for (size_t size = 0; size < intact.size(); size += 509) {
    RemoveLog();
    WriteWholeFile(path_, intact.substr(0, size));
    const auto catalogue =
        OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail);
    if (catalogue.ok()) Exercise(**catalogue);
  }
}

TEST_F(SqliteDamageTest, DamageIsDataLoss) {
  MakeCatalogue();
  const std::string intact = ReadWholeFile(path_);
  const auto data_loss =
      StatusIs(absl::StatusCode::kDataLoss, HasSubstr(path_));
  WriteWholeFile(path_,
                 "this is no database, but long enough for a header "
                 "of one hundred bytes, and some more to be sure of it");
  EXPECT_THAT(OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kCreate),
              data_loss);
  // The header says so many pages; the rest is gone.
  RemoveLog();
  WriteWholeFile(path_, intact.substr(0, intact.size() / 2));
  const auto half =
      OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kCreate);
  EXPECT_THAT(half.ok() ? (*half)->ListMaps("", 10).status() : half.status(),
              data_loss);
  // Garbage over all that follows the first page.
  RemoveLog();
  std::string damaged = intact;
  std::fill(damaged.begin() + 4096, damaged.end(), '\x55');
  WriteWholeFile(path_, damaged);
  const auto garbage =
      OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kCreate);
  EXPECT_THAT(
      garbage.ok() ? (*garbage)->ListMaps("", 10).status() : garbage.status(),
      data_loss);
}

TEST_F(SqliteDamageTest, ValuesOutOfRangeAreDataLoss) {
  MakeCatalogue();
  const auto spoil = [&](const std::string& sql) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto database, SqliteDatabase::Open(PosixFileSystem(), path_));
    MAPSIEVE_ASSERT_OK(database->Execute(sql));
  };
  spoil(
      "UPDATE chunks SET tile_key = CAST(tile_key || x'00' AS BLOB) "
      "WHERE number = 1");
  spoil("UPDATE revisions SET attributes = x'ff' WHERE number = 2");
  spoil("UPDATE revisions SET kind = 99 WHERE number = 3");
  spoil("UPDATE maps SET tile_level = 64 WHERE id = 'two'");
  spoil("UPDATE uploads SET state = 0");
  spoil("UPDATE chunks SET stored_bytes = -5 WHERE number = 60");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto catalogue,
      OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail));
  const auto data_loss = [](const char* what) {
    return StatusIs(absl::StatusCode::kDataLoss, HasSubstr(what));
  };
  EXPECT_THAT(catalogue->GetMap("two"),
              data_loss("(tile_level) is no level of tiles"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map, catalogue->GetMap("one"));
  EXPECT_THAT(catalogue->ListChunks(map.uid, 3, ChunkKind::kRaw, std::nullopt,
                                    std::nullopt, 100),
              data_loss("18 bytes, got 19"));
  EXPECT_THAT(
      catalogue->ListChunks(map.uid, 3, ChunkKind::kProduct, std::nullopt,
                            std::nullopt, 100),
      data_loss("chunk 60: stored_bytes: expected 1 to 2147483648, got -5"));
  EXPECT_THAT(catalogue->GetRevision(map.uid, 2), data_loss("attribute name"));
  EXPECT_THAT(catalogue->GetRevision(map.uid, 3),
              data_loss("(kind) is no enumerator"));
  EXPECT_THAT(catalogue->GetUpload(map.uid, "u"), data_loss("(state)"));
}

TEST_F(SqliteDamageTest, ForeignAndNewerDatabasesAreRefused) {
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto database, SqliteDatabase::Open(PosixFileSystem(), path_));
    MAPSIEVE_ASSERT_OK(database->Execute("CREATE TABLE photos (id INTEGER)"));
  }
  EXPECT_THAT(OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kCreate),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("another program")));
  std::filesystem::remove(path_);
  MakeCatalogue();
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto database, SqliteDatabase::Open(PosixFileSystem(), path_));
    MAPSIEVE_ASSERT_OK(database->Execute("PRAGMA user_version = 5"));
  }
  EXPECT_THAT(OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kCreate),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("version 5"), HasSubstr("version 4"))));
}

TEST_F(SqliteDamageTest, AnAbsentCatalogueIsMadeOnlyWhereAskedFor) {
  EXPECT_THAT(OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("gone")));
  EXPECT_THAT(
      OpenSqliteCatalogue(PosixFileSystem(), directory_ / "no/such/dir.db",
                          IfAbsent::kCreate),
      StatusIs(absl::StatusCode::kUnavailable, _));
}

TEST(SqliteDatabase, AFullDiskIsResourceExhausted) {
  TemporaryDirectory directory;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto database,
      SqliteDatabase::Open(PosixFileSystem(), directory / "db"));
  MAPSIEVE_ASSERT_OK(database->Execute("CREATE TABLE t (x BLOB)"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      auto limit, database->QueryInteger("PRAGMA max_page_count = 3"));
  EXPECT_EQ(limit, 3);
  SqliteTransaction transaction(*database);
  MAPSIEVE_ASSERT_OK(transaction.Begin(SqliteTransaction::Kind::kWrite));
  EXPECT_THAT(database->Execute("INSERT INTO t VALUES (zeroblob(100000))"),
              StatusIs(absl::StatusCode::kResourceExhausted, _));
}

TEST(SqliteDatabase, SyncsFullyAndMapsNothing) {
  TemporaryDirectory directory;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto database,
      SqliteDatabase::Open(PosixFileSystem(), directory / "db"));
  EXPECT_EQ(*database->QueryInteger("PRAGMA synchronous"), 2);
  EXPECT_EQ(*database->QueryInteger("PRAGMA foreign_keys"), 1);
  EXPECT_THAT(database->QueryInteger("PRAGMA mmap_size"),
              StatusIs(absl::StatusCode::kInternal, HasSubstr("no row")));
  MAPSIEVE_ASSERT_OK(database->Execute("CREATE TABLE t (x)"));
  EXPECT_TRUE(std::filesystem::exists(directory / "db-wal"));
}

TEST(SqliteStatement, ValuesThatAreTooLargeAreRefused) {
  TemporaryDirectory directory;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto catalogue,
      OpenSqliteCatalogue(PosixFileSystem(), directory / "db",
                          IfAbsent::kCreate));
  OperationRecord operation;
  operation.id = "a";
  operation.request.assign(size_t{65} << 20, 'x');
  EXPECT_THAT(catalogue->CreateOperation(operation),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  EXPECT_THAT(catalogue->GetOperation("a"),
              StatusIs(absl::StatusCode::kNotFound, _));
}

}  // namespace
}  // namespace mapsieve::storage
