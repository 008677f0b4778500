// The SQLite catalogue as a file: damaged, foreign, too new, too large.

#include <algorithm>
#include <fstream>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/sqlite_catalogue.h"
#include "storage/sqlite_database.h"
#include "storage/sqlite_format.h"
#include "tests/storage/catalogue_dump.h"
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

  /// Writes `database` and `log` in the place of the catalogue and opens it.
  absl::StatusOr<std::unique_ptr<Catalogue>> OpenWith(
      const std::string& database, const std::string& log = "") {
    RemoveLog();
    WriteWholeFile(path_, database);
    if (!log.empty()) WriteWholeFile(path_ + "-wal", log);
    return OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail);
  }
  absl::StatusOr<std::string> DumpOf(
      const absl::StatusOr<std::unique_ptr<Catalogue>>& catalogue) {
    if (!catalogue.ok()) return catalogue.status();
    return Dump(**catalogue, Identities::kTold);
  }
  /// Everything that the catalogue answers, which is intact.
  std::string DumpIntact() {
    const auto dump =
        DumpOf(OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail));
    EXPECT_THAT(dump, testing::IsOk());
    return dump.value_or("");
  }

  void RemoveLog() {
    std::filesystem::remove(path_ + "-wal");
    std::filesystem::remove(path_ + "-shm");
  }

  TemporaryDirectory directory_;
  const std::string path_ = directory_ / "catalogue.db";
};

TEST_F(SqliteDamageTest, AFlippedByteIsDataLossOrNoMatter) {
  MakeCatalogue();
  const std::string expected = DumpIntact();
  const std::string intact = ReadWholeFile(path_);
  ASSERT_GT(intact.size(), 20'000u);
  std::mt19937_64 random(5);
  std::vector<size_t> places;
  // The header of the file, then of each page its ends and some in between.
  for (size_t at = 0; at < 100; ++at) places.push_back(at);
  for (size_t page = 0; page < intact.size(); page += kPageBytes) {
    for (const size_t at : {0, 7, kPageBytes - 8, kPageBytes - 1}) {
      places.push_back(page + at);
    }
    for (int i = 0; i < 8; ++i) places.push_back(page + random() % kPageBytes);
  }
  int loss_count = 0;
  for (const size_t at : places) {
    std::string damaged = intact;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << random() % 8));
    SCOPED_TRACE(absl::StrCat("byte ", at));
    const auto dump = DumpOf(OpenWith(damaged));
    if (dump.ok()) {
      EXPECT_EQ(*dump, expected);
      continue;
    }
    ++loss_count;
    // The header tells what a page is: there it can be noticed elsewhere.
    const size_t page = at / kPageBytes * kPageBytes;
    EXPECT_THAT(
        dump,
        StatusIs(absl::StatusCode::kDataLoss,
                 AllOf(HasSubstr(path_),
                       HasSubstr(at < 100 ? std::string("damaged")
                                          : absl::StrCat("offset ", page)))));
  }
  EXPECT_GT(loss_count, static_cast<int>(places.size()) / 2);
}

TEST_F(SqliteDamageTest, ATruncationIsDataLossOrNoMatter) {
  MakeCatalogue();
  const std::string expected = DumpIntact();
  const std::string intact = ReadWholeFile(path_);
  for (size_t page = 0; page < intact.size(); page += kPageBytes) {
    for (const size_t size : {page, page + 99, page + kPageBytes - 1}) {
      SCOPED_TRACE(absl::StrCat(size, " bytes"));
      const auto dump = DumpOf(OpenWith(intact.substr(0, size)));
      if (dump.ok()) {
        EXPECT_EQ(*dump, expected);
      } else {
        EXPECT_THAT(dump,
                    StatusIs(absl::StatusCode::kDataLoss, HasSubstr(path_)));
      }
    }
  }
}

TEST_F(SqliteDamageTest, APageInThePlaceOfAnotherIsDataLoss) {
  MakeCatalogue();
  const std::string expected = DumpIntact();
  const std::string intact = ReadWholeFile(path_);
  int loss_count = 0;
  for (size_t page = kPageBytes; page + kPageBytes < intact.size();
       page += kPageBytes) {
    std::string damaged = intact;
    damaged.replace(page, kPageBytes, intact, page + kPageBytes, kPageBytes);
    const auto dump = DumpOf(OpenWith(damaged));
    if (dump.ok()) {
      EXPECT_EQ(*dump, expected);
      continue;
    }
    ++loss_count;
    EXPECT_THAT(dump, StatusIs(absl::StatusCode::kDataLoss,
                               HasSubstr(absl::StrCat("offset ", page,
                                                      ": damaged "
                                                      "page"))));
  }
  EXPECT_GT(loss_count, 5);
}

TEST_F(SqliteDamageTest, AFlippedByteOfTheLogIsDataLossOrLosesItsEnd) {
  std::string database;
  std::string log;
  std::string all;
  std::string all_but_last;
  size_t last_begin = 0;
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto catalogue,
        OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kCreate));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map,
                                  catalogue->CreateMap(TestMap("one")));
    MAPSIEVE_ASSERT_OK(catalogue->CommitRevision(
        map.uid, 1, Adding({TestChunk(ChunkKind::kRaw, 0, 0, 0, "a", 1)})));
    last_begin = ReadWholeFile(path_ + "-wal").size();
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(all_but_last,
                                  Dump(*catalogue, Identities::kTold));
    MAPSIEVE_ASSERT_OK(catalogue->CreateUpload(map.uid, {.id = "u"}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(all, Dump(*catalogue, Identities::kTold));
    // As they are when the process dies now.
    database = ReadWholeFile(path_);
    log = ReadWholeFile(path_ + "-wal");
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::string replayed,
                                DumpOf(OpenWith(database, log)));
  ASSERT_EQ(replayed, all);
  ASSERT_LT(last_begin, log.size());
  std::vector<size_t> places;
  for (size_t at = 0; at < kLogHeaderBytes; ++at) places.push_back(at);
  for (size_t frame = kLogHeaderBytes; frame < log.size();
       frame += kFrameBytes) {
    for (size_t at = 0; at < kFrameHeaderBytes; ++at) {
      places.push_back(frame + at);
    }
    for (const int at : {24, 1000, kFrameBytes - 8, kFrameBytes - 1}) {
      places.push_back(frame + static_cast<size_t>(at));
    }
  }
  for (const size_t at : places) {
    std::string damaged = log;
    damaged[at] = static_cast<char>(damaged[at] ^ 0x10);
    SCOPED_TRACE(absl::StrCat("byte ", at));
    const auto dump = DumpOf(OpenWith(database, damaged));
    if (dump.ok()) {
      // As if the last transaction had never come to its end.
      EXPECT_GE(at, last_begin);
      EXPECT_EQ(*dump, all_but_last);
    } else {
      EXPECT_THAT(dump, StatusIs(absl::StatusCode::kDataLoss,
                                 AllOf(HasSubstr(path_ + "-wal, offset"),
                                       HasSubstr("expected checksum"))));
    }
  }
}

TEST_F(SqliteDamageTest, DamageIsNoticedInALogInUse) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto database,
                                SqliteDatabase::Open(PosixFileSystem(), path_));
  MAPSIEVE_ASSERT_OK(database->Execute("CREATE TABLE t (x TEXT)"));
  MAPSIEVE_ASSERT_OK(database->Execute("INSERT INTO t VALUES ('kilroy')"));
  // Of the last frame, which holds the row.
  std::string log = ReadWholeFile(path_ + "-wal");
  const size_t at = log.rfind("kilroy");
  ASSERT_NE(at, std::string::npos);
  std::fstream(path_ + "-wal", std::ios::in | std::ios::out | std::ios::binary)
      .seekp(static_cast<std::streamoff>(at))
      .put('K');
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto other,
                                SqliteDatabase::Open(PosixFileSystem(), path_));
  EXPECT_THAT(other->QueryInteger("SELECT count(*) FROM t WHERE x > 'a'"),
              StatusIs(absl::StatusCode::kDataLoss,
                       AllOf(HasSubstr(path_ + "-wal, offset"),
                             HasSubstr("damaged page"))));
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
    MAPSIEVE_ASSERT_OK(database->Execute("PRAGMA user_version = 6"));
  }
  EXPECT_THAT(OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kCreate),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("version 6"), HasSubstr("3 to 5"))));
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
