#include "storage/sqlite_migration.h"

#include <sqlite3.h>

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/sqlite_catalogue.h"
#include "storage/sqlite_database.h"
#include "tests/storage/catalogue_dump.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::FaultFileSystem;
using ::mapsieve::testing::IsOk;
using ::mapsieve::testing::StatusIs;
using Loss = FaultFileSystem::Loss;

/// A database as SQLite makes it by itself: its pages have no checksums.
class PlainDatabase {
 public:
  explicit PlainDatabase(const std::string& path) {
    EXPECT_EQ(sqlite3_open(path.c_str(), &handle_), SQLITE_OK);
  }
  ~PlainDatabase() { sqlite3_close(handle_); }
  PlainDatabase(const PlainDatabase&) = delete;
  PlainDatabase& operator=(const PlainDatabase&) = delete;

  void Execute(const std::string& sql) {
    EXPECT_EQ(sqlite3_exec(handle_, sql.c_str(), nullptr, nullptr, nullptr),
              SQLITE_OK)
        << sqlite3_errmsg(handle_) << " in " << sql;
  }
  /// The texts that a query of one column gives.
  std::vector<std::string> Query(const std::string& sql) {
    std::vector<std::string> texts;
    const auto take = [](void* out, int, char** values, char**) {
      static_cast<std::vector<std::string>*>(out)->push_back(values[0]);
      return 0;
    };
    EXPECT_EQ(sqlite3_exec(handle_, sql.c_str(), take, &texts, nullptr),
              SQLITE_OK)
        << sqlite3_errmsg(handle_) << " in " << sql;
    return texts;
  }

 private:
  sqlite3* handle_ = nullptr;
};

class SqliteMigrationTest : public ::testing::Test {
 protected:
  /// A catalogue of version 3 with a map of three revisions; its last
  /// transaction is in the log.
  void SetUp() override {
    {
      const auto catalogue =
          OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kCreate);
      MAPSIEVE_ASSERT_OK(catalogue);
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map,
                                    (*catalogue)->CreateMap(TestMap("one")));
      std::vector<ChunkRef> raw;
      for (int i = 0; i < 40; ++i) {
        raw.push_back(
            TestChunk(ChunkKind::kRaw, i, 0, 0, std::to_string(i), 1));
      }
      MAPSIEVE_ASSERT_OK((*catalogue)->CommitRevision(map.uid, 1, Adding(raw)));
      MAPSIEVE_ASSERT_OK(
          (*catalogue)
              ->CommitRevision(map.uid, 2,
                               Processing({TestChunk(ChunkKind::kProduct, 0, 0,
                                                     0, "p", 1)})));
      MAPSIEVE_ASSERT_OK((*catalogue)->CreateUpload(map.uid, {.id = "u"}));
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(expected_,
                                    Dump(**catalogue, Identities::kTold));
    }
    const std::string plain = directory_ / "plain.db";
    {
      PlainDatabase database(plain);
      database.Execute("PRAGMA journal_mode = WAL");
      database.Execute(absl::StrCat("ATTACH '", path_, "' AS source"));
      for (const std::string& sql : database.Query(
               "SELECT sql FROM source.sqlite_schema WHERE sql IS NOT NULL AND "
               "name NOT LIKE 'sqlite_%' ORDER BY rowid")) {
        database.Execute(sql);
      }
      for (const std::string& table : database.Query(
               "SELECT name FROM source.sqlite_schema WHERE type = 'table' AND "
               "name <> 'sqlite_sequence'")) {
        database.Execute(absl::StrCat("INSERT INTO main.", table,
                                      " SELECT * FROM source.", table));
      }
      database.Execute("DELETE FROM main.sqlite_sequence");
      database.Execute(
          "INSERT INTO main.sqlite_sequence SELECT * FROM "
          "source.sqlite_sequence");
      database.Execute("DETACH source");
      // What versions 4 and 5 brought.
      database.Execute("ALTER TABLE maps DROP COLUMN frame_id");
      database.Execute("DROP TABLE tile_changes");
      database.Execute("DROP INDEX revisions_kept");
      database.Execute("DROP INDEX chunks_removed");
      database.Execute("ALTER TABLE revisions DROP COLUMN expired");
      database.Execute("ALTER TABLE upload_revisions DROP COLUMN report");
      database.Execute("PRAGMA application_id = 0x6d737665");
      database.Execute("PRAGMA wal_checkpoint(TRUNCATE)");
      database.Execute("PRAGMA user_version = 3");
      database_ = ReadWholeFile(plain);
      log_ = ReadWholeFile(plain + "-wal");
    }
    Restore();
  }

  /// Makes the catalogue one of version 3 again.
  void Restore() {
    for (const auto& entry :
         std::filesystem::directory_iterator(directory_.path())) {
      std::filesystem::remove(entry.path());
    }
    WriteWholeFile(path_, database_);
    WriteWholeFile(path_ + "-wal", log_);
  }
  int64_t Version(const std::string& path) {
    // In the header of the database, big-endian.
    return static_cast<unsigned char>(ReadWholeFile(path).at(63));
  }

  TemporaryDirectory directory_;
  const std::string path_ = directory_ / "catalogue.db";
  std::string database_;
  std::string log_;
  std::string expected_;
};

TEST_F(SqliteMigrationTest, ACatalogueOfVersion3AnswersAsBefore) {
  ASSERT_FALSE(log_.empty());
  ASSERT_EQ(database_[20], 0);
  for (int i = 0; i < 2; ++i) {
    const auto catalogue =
        OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail);
    MAPSIEVE_ASSERT_OK(catalogue);
    EXPECT_EQ(*Dump(**catalogue, Identities::kTold), expected_);
    // Numbers go on where they were.
    MAPSIEVE_ASSERT_OK(
        (*catalogue)->CreateMap(TestMap(absl::StrCat("new", i))));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(expected_,
                                  Dump(**catalogue, Identities::kTold));
  }
  {
    const auto catalogue =
        OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail);
    MAPSIEVE_ASSERT_OK(catalogue);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map,
                                  (*catalogue)->GetMap("one"));
    EXPECT_EQ(map.oldest_revision, 1);
    EXPECT_EQ((*catalogue)->ExpireRevisions(map.uid, 1).value_or(-1), 2);
    MAPSIEVE_EXPECT_OK((*catalogue)->ForgetExpired(map.uid, {}));
  }
  EXPECT_EQ(Version(path_), 5);
  EXPECT_EQ(ReadWholeFile(path_)[20], 8);
  EXPECT_THAT(std::filesystem::exists(path_ + ".new"), false);
}

TEST_F(SqliteMigrationTest, ACatalogueOfVersion4AnswersAsBefore) {
  MAPSIEVE_ASSERT_OK(
      OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail));
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto database, SqliteDatabase::Open(PosixFileSystem(), path_));
    MAPSIEVE_ASSERT_OK(
        database->Execute("ALTER TABLE maps DROP COLUMN frame_id"));
    MAPSIEVE_ASSERT_OK(database->Execute("PRAGMA user_version = 4"));
  }
  const auto catalogue =
      OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail);
  MAPSIEVE_ASSERT_OK(catalogue);
  EXPECT_EQ(*Dump(**catalogue, Identities::kTold), expected_);
  MapSpec spec = TestMap("new");
  spec.frame_id = "odom";
  MAPSIEVE_ASSERT_OK((*catalogue)->CreateMap(spec));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map,
                                (*catalogue)->GetMap("new"));
  EXPECT_EQ(map.spec.frame_id, "odom");
}

TEST_F(SqliteMigrationTest, EarlierVersionsAreRefused) {
  {
    PlainDatabase database(path_);
    database.Execute("PRAGMA user_version = 2");
  }
  EXPECT_THAT(OpenSqliteCatalogue(PosixFileSystem(), path_, IfAbsent::kFail),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       ::testing::HasSubstr("version 2")));
}

TEST_F(SqliteMigrationTest, AnyFailureOrCrashLeavesTheOldOneOrTheNewOne) {
  int64_t old_count = 0;
  int64_t new_count = 0;
  // A sample: another operation each time, odd and even by turns.
  for (int64_t n = 1;; n += 3) {
    // By turns one operation fails, and all from there on.
    const bool dies = n % 2 == 0;
    SCOPED_TRACE(absl::StrCat("operation ", n, dies ? " and later" : ""));
    Restore();
    FaultFileSystem files(PosixFileSystem());
    files.Arm({.operation = n,
               .status = absl::UnavailableError("injected"),
               .lasts = dies});
    const bool opened = OpenSqliteCatalogue(files, path_, IfAbsent::kFail).ok();
    const bool fired = files.fired();
    files.Disarm();
    files.LosePower(n % 4 < 2 ? Loss::kEverything : Loss::kSomeContent);
    ++(Version(path_) == 5 ? new_count : old_count);
    const auto catalogue = OpenSqliteCatalogue(files, path_, IfAbsent::kFail);
    MAPSIEVE_ASSERT_OK(catalogue);
    EXPECT_EQ(*Dump(**catalogue, Identities::kTold), expected_);
    if (!fired) {
      EXPECT_TRUE(opened);
      break;
    }
  }
  EXPECT_GT(old_count, 15);
  EXPECT_GE(new_count, 1);
}

}  // namespace
}  // namespace mapsieve::storage
