// A catalogue of version 3 becomes one of this version, whole or not at all.

#include <filesystem>
#include <memory>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/sqlite_catalogue.h"
#include "storage/sqlite_database.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::FaultFileSystem;
using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::ElementsAre;
using ::testing::SizeIs;

class SqliteMigrationTest : public ::testing::Test {
 protected:
  static absl::StatusOr<std::unique_ptr<Catalogue>> Open(
      const std::string& path, FileSystem& files = PosixFileSystem()) {
    return OpenSqliteCatalogue(files, path, IfAbsent::kFail);
  }

  /// A map of three revisions with a product, in tables as version 3 had them.
  void MakeVersion3(const std::string& path) {
    {
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(
          const auto catalogue,
          OpenSqliteCatalogue(PosixFileSystem(), path, IfAbsent::kCreate));
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map,
                                    catalogue->CreateMap(TestMap("campus")));
      MAPSIEVE_ASSERT_OK(catalogue->CommitRevision(map.uid, 1, Adding({raw_})));
      MAPSIEVE_ASSERT_OK(
          catalogue->CommitRevision(map.uid, 2, Processing({product_})));
      MAPSIEVE_ASSERT_OK(
          catalogue->CommitRevision(map.uid, 3, {.removed = {1}}));
      MAPSIEVE_ASSERT_OK(catalogue->CreateUpload(map.uid, {.id = "u"}));
    }
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto database, SqliteDatabase::Open(PosixFileSystem(), path));
    MAPSIEVE_ASSERT_OK(
        database->Execute("DROP TABLE tile_changes;"
                          "DROP INDEX revisions_kept;"
                          "DROP INDEX chunks_removed;"
                          "ALTER TABLE revisions DROP COLUMN expired;"
                          "PRAGMA user_version = 3"));
  }

  /// All that was there is there, and what the version brought works.
  void Check(Catalogue& catalogue) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map,
                                  catalogue.GetMap("campus"));
    EXPECT_EQ(map.newest_revision, 4);
    EXPECT_EQ(map.oldest_revision, 1);
    EXPECT_EQ(catalogue.GetUpload(map.uid, "u")->spec.id, "u");
    const auto chunks = [&](int64_t revision, ChunkKind kind) {
      return WithoutNumbers(*catalogue.ListChunks(
          map.uid, revision, kind, std::nullopt, std::nullopt, 10));
    };
    EXPECT_THAT(chunks(2, ChunkKind::kRaw), ElementsAre(raw_));
    EXPECT_THAT(chunks(4, ChunkKind::kProduct), ElementsAre(product_));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto revisions,
                                  catalogue.ListRevisions(map.uid, 0, 10));
    ASSERT_THAT(revisions, SizeIs(4));
    for (const auto& revision : revisions) EXPECT_FALSE(revision.is_expired);
    EXPECT_EQ(catalogue.ExpireRevisions(map.uid, 1).value_or(-1), 2);
    MAPSIEVE_EXPECT_OK(catalogue.ForgetExpired(map.uid, {}));
    MAPSIEVE_EXPECT_OK(catalogue.RollBack(map.uid, 3));
  }

  TemporaryDirectory directory_;
  const ChunkRef raw_ = TestChunk(ChunkKind::kRaw, 0, 0, 0, "raw", 1);
  const ChunkRef product_ =
      TestChunk(ChunkKind::kProduct, 0, 0, 0, "product", 1);
};

TEST_F(SqliteMigrationTest, Version3BecomesThisOne) {
  MakeVersion3(directory_ / "catalogue.db");
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto catalogue,
                                  Open(directory_ / "catalogue.db"));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto catalogue,
                                Open(directory_ / "catalogue.db"));
  Check(*catalogue);
}

TEST_F(SqliteMigrationTest, EveryOperationMayFail) {
  const std::string old = directory_ / "old.db";
  MakeVersion3(old);
  FaultFileSystem files(PosixFileSystem());
  bool fired = true;
  int64_t operation = 1;
  for (; fired; ++operation) {
    const std::string path = directory_ / std::to_string(operation);
    std::filesystem::copy_file(old, path);
    files.Arm({.operation = operation,
               .status = absl::UnavailableError("injected"),
               .lasts = true});
    Open(path, files).status().IgnoreError();
    fired = files.fired();
    files.Disarm();
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto catalogue, Open(path));
    SCOPED_TRACE(operation);
    Check(*catalogue);
  }
  EXPECT_GT(operation, 10);
}

TEST_F(SqliteMigrationTest, EarlierVersionsAreRefused) {
  const std::string path = directory_ / "catalogue.db";
  MakeVersion3(path);
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto database, SqliteDatabase::Open(PosixFileSystem(), path));
    MAPSIEVE_ASSERT_OK(database->Execute("PRAGMA user_version = 2"));
  }
  EXPECT_THAT(Open(path), StatusIs(absl::StatusCode::kFailedPrecondition, _));
}

}  // namespace
}  // namespace mapsieve::storage
