// SQLite over a file system that fails and loses power.

#include "storage/sqlite_vfs.h"

#include <sqlite3.h>

#include <filesystem>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/sqlite_database.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::FaultFileSystem;
using ::mapsieve::testing::IsOk;
using ::mapsieve::testing::StatusIs;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using Loss = FaultFileSystem::Loss;

class SqliteVfsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    Open();
    MAPSIEVE_ASSERT_OK(database_->Execute("CREATE TABLE t (x INTEGER)"));
  }
  void Open() {
    database_.reset();
    MAPSIEVE_ASSERT_OK(SqliteDatabase::SecureLog(files_, path_));
    auto database = SqliteDatabase::Open(files_, path_);
    ASSERT_THAT(database, IsOk());
    database_ = *std::move(database);
  }
  /// The process dies: nothing that closing does is done.
  void Die() {
    files_.Arm({.status = absl::UnavailableError("dead"), .lasts = true});
    database_.reset();
    files_.Disarm();
  }
  absl::Status Add(int value) {
    return database_->Execute(
        absl::StrCat("INSERT INTO t VALUES (", value, ")"));
  }
  int64_t Sum() {
    const auto sum =
        database_->QueryInteger("SELECT coalesce(sum(x), 0) FROM t");
    EXPECT_THAT(sum, IsOk());
    return sum.value_or(-1);
  }
  /// Adds `value` with the n-th operation failing that is of kind `kind`.
  absl::Status AddWithFault(int value, const std::string& kind,
                            absl::StatusCode code) {
    for (int64_t n = 1; n < 100; ++n) {
      files_.Arm({.operation = n, .status = absl::Status(code, "injected")});
      const absl::Status status = Add(value);
      const bool is_it = files_.fault_kind() == kind;
      files_.Disarm();
      if (is_it) return status;
      if (status.ok()) {
        EXPECT_THAT(
            database_->Execute(absl::StrCat("DELETE FROM t WHERE x = ", value)),
            IsOk());
      }
    }
    return absl::InternalError("no such operation");
  }

  TemporaryDirectory directory_;
  FaultFileSystem files_{PosixFileSystem()};
  const std::string path_ = directory_ / "db";
  std::unique_ptr<SqliteDatabase> database_;
};

TEST_F(SqliteVfsTest, ACommitIsOneSyncOfTheLog) {
  MAPSIEVE_ASSERT_OK(Add(1));
  const int64_t syncs = files_.call_count("sync");
  const int64_t directories = files_.call_count("sync directory");
  const int64_t writes = files_.call_count("write");
  for (int i = 0; i < 10; ++i) MAPSIEVE_ASSERT_OK(Add(1));
  EXPECT_EQ(files_.call_count("sync"), syncs + 10);
  EXPECT_EQ(files_.call_count("sync directory"), directories);
  EXPECT_GE(files_.call_count("write"), writes + 20);
  EXPECT_GT(files_.call_count("open"), 1);
}

TEST_F(SqliteVfsTest, WhatIsCommittedSurvivesAnyLossOfPower) {
  for (const Loss loss :
       {Loss::kEverything, Loss::kContent, Loss::kSomeContent}) {
    const int64_t before = Sum();
    MAPSIEVE_ASSERT_OK(Add(1));
    MAPSIEVE_ASSERT_OK(Add(2));
    Die();
    files_.LosePower(loss);
    Open();
    EXPECT_EQ(Sum(), before + 3);
  }
}

TEST_F(SqliteVfsTest, WhatIsReadFromALogIsDurable) {
  MAPSIEVE_ASSERT_OK(Add(1));
  // The process dies before it has synced its commit, but all is written.
  EXPECT_THAT(AddWithFault(2, "sync", absl::StatusCode::kUnavailable),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("injected")));
  Die();
  Open();
  const int64_t seen = Sum();
  EXPECT_EQ(seen, 3);
  Die();
  files_.LosePower(Loss::kEverything);
  Open();
  EXPECT_EQ(Sum(), seen);
}

TEST_F(SqliteVfsTest, AFailedSyncOfTheLogIsMendedByTheNextCommit) {
  MAPSIEVE_ASSERT_OK(Add(1));
  EXPECT_THAT(AddWithFault(2, "sync", absl::StatusCode::kUnavailable),
              StatusIs(absl::StatusCode::kUnavailable,
                       AllOf(HasSubstr(path_), HasSubstr("injected"))));
  EXPECT_EQ(Sum(), 1);
  MAPSIEVE_ASSERT_OK(Add(4));
  EXPECT_EQ(Sum(), 5);
  Die();
  files_.LosePower(Loss::kEverything);
  Open();
  EXPECT_EQ(Sum(), 5);
}

TEST_F(SqliteVfsTest, ADatabaseThatCannotBeSyncedKeepsItsLog) {
  MAPSIEVE_ASSERT_OK(Add(1));
  const auto checkpoint = [&] {
    return database_->QueryInteger("PRAGMA wal_checkpoint(TRUNCATE)").status();
  };
  for (int64_t n = 1;; ++n) {
    ASSERT_LT(n, 100);
    MAPSIEVE_ASSERT_OK(Add(1));
    // The second sync of a checkpoint is that of the database.
    files_.Arm({.operation = n, .status = absl::UnavailableError("injected")});
    const absl::Status status = checkpoint();
    const bool fired = files_.fired();
    files_.Disarm();
    if (!fired) break;
  }
  const int64_t sum = Sum();
  MAPSIEVE_ASSERT_OK(Add(1));
  EXPECT_THAT(checkpoint(), Not(IsOk()));
  Die();
  files_.LosePower(Loss::kEverything);
  Open();
  EXPECT_EQ(Sum(), sum + 1);
  MAPSIEVE_EXPECT_OK(checkpoint());
}

TEST_F(SqliteVfsTest, FramesThatAreWrittenTwiceAreReplayed) {
  // A transaction that its pages do not let stay in memory writes those that
  // it changes again over their frames in the log.
  MAPSIEVE_ASSERT_OK(database_->Execute("PRAGMA cache_size = 10"));
  MAPSIEVE_ASSERT_OK(Add(1));
  {
    SqliteTransaction transaction(*database_);
    MAPSIEVE_ASSERT_OK(transaction.Begin(SqliteTransaction::Kind::kWrite));
    MAPSIEVE_ASSERT_OK(database_->Execute(
        "INSERT INTO t WITH RECURSIVE n (x) AS (SELECT 1 UNION ALL SELECT "
        "x + 1 FROM n WHERE x < 20000) SELECT x FROM n"));
    for (int i = 0; i < 3; ++i) {
      MAPSIEVE_ASSERT_OK(database_->Execute("UPDATE t SET x = x + 1"));
    }
    MAPSIEVE_ASSERT_OK(transaction.Commit());
  }
  const int64_t sum = Sum();
  EXPECT_EQ(sum, 20000 * 20001 / 2 + 3 * 20001 + 1);
  MAPSIEVE_ASSERT_OK(Add(7));
  Die();
  files_.LosePower(Loss::kEverything);
  Open();
  EXPECT_EQ(Sum(), sum + 7);
}

TEST_F(SqliteVfsTest, AnotherProgramCanReplayTheLog) {
  MAPSIEVE_ASSERT_OK(Add(5));
  Die();
  {
    sqlite3* other = nullptr;
    ASSERT_EQ(sqlite3_open(path_.c_str(), &other), SQLITE_OK);
    EXPECT_EQ(
        sqlite3_exec(other, "SELECT sum(x) FROM t", nullptr, nullptr, nullptr),
        SQLITE_OK);
    // Writes the log into the database.
    ASSERT_EQ(sqlite3_close(other), SQLITE_OK);
  }
  EXPECT_FALSE(std::filesystem::exists(path_ + "-wal"));
  Open();
  EXPECT_EQ(Sum(), 5);
}

TEST_F(SqliteVfsTest, AFullDiskIsResourceExhausted) {
  for (const char* kind : {"write", "sync"}) {
    EXPECT_THAT(
        AddWithFault(1, kind, absl::StatusCode::kResourceExhausted),
        StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("injected")));
  }
}

TEST_F(SqliteVfsTest, TheLogGoesWhenTheLastConnectionCloses) {
  MAPSIEVE_ASSERT_OK(Add(1));
  EXPECT_TRUE(std::filesystem::exists(path_ + "-wal"));
  database_.reset();
  EXPECT_FALSE(std::filesystem::exists(path_ + "-wal"));
  files_.LosePower(Loss::kEverything);
  Open();
  EXPECT_EQ(Sum(), 1);
}

}  // namespace
}  // namespace mapsieve::storage
