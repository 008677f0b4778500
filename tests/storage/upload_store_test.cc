#include "storage/upload_store.h"

#include <memory>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/sqlite_catalogue.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::FaultFileSystem;
using ::mapsieve::testing::IsOk;
using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::UnorderedElementsAre;

class UploadStoreTest : public ::testing::Test {
 protected:
  void SetUp() override { Open(); }

  void Open() {
    uploads_.reset();
    catalogue_.reset();
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        catalogue_, OpenSqliteCatalogue(files_, directory_ / "catalogue.db",
                                        IfAbsent::kCreate));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        uploads_, UploadStore::Open(files_, directory_ / "uploads", *catalogue_,
                                    reserve_));
  }
  /// What a power failure leaves.
  void Crash(FaultFileSystem::Loss loss) {
    uploads_.reset();
    catalogue_.reset();
    files_.Disarm();
    files_.LosePower(loss);
    Open();
  }
  std::string MakeUpload(std::optional<int64_t> expected_bytes = {}) {
    auto map = catalogue_->GetMap("campus");
    if (!map.ok()) map = catalogue_->CreateMap(TestMap("campus"));
    EXPECT_THAT(map, IsOk());
    const auto upload = catalogue_->CreateUpload(
        map->uid, {.id = std::to_string(++upload_count_),
                   .expected_bytes = expected_bytes});
    EXPECT_THAT(upload, IsOk());
    return upload->uid;
  }
  std::unique_ptr<UploadWriter> Writer(const std::string& uid) {
    auto writer = uploads_->OpenWriter(uid);
    EXPECT_THAT(writer, IsOk());
    return writer.ok() ? *std::move(writer) : nullptr;
  }
  std::string Content(const std::string& uid) {
    const auto reader = uploads_->OpenReader(uid);
    EXPECT_THAT(reader, IsOk());
    if (!reader.ok()) return "?";
    const auto bytes = (*reader)->Read(0, (*reader)->size());
    EXPECT_THAT(bytes, IsOk());
    return bytes.ok() ? Text(*bytes) : "?";
  }

  TemporaryDirectory directory_;
  FaultFileSystem files_{PosixFileSystem()};
  SpaceReserve reserve_{files_, directory_.path(), 0};
  std::unique_ptr<Catalogue> catalogue_;
  std::unique_ptr<UploadStore> uploads_;
  int upload_count_ = 0;
};

TEST_F(UploadStoreTest, OnlyCommittedBytesAreReadable) {
  const std::string uid = MakeUpload();
  const auto writer = Writer(uid);
  MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("hello ")));
  MAPSIEVE_ASSERT_OK(writer->Append(6, Bytes("world")));
  EXPECT_EQ(writer->written_bytes(), 11);
  EXPECT_EQ(writer->committed_bytes(), 0);
  EXPECT_EQ(Content(uid), "");
  EXPECT_EQ(*writer->Commit(), 11);
  EXPECT_EQ(writer->committed_bytes(), 11);
  EXPECT_EQ(catalogue_->GetUploadByUid(uid)->committed_bytes, 11);
  EXPECT_EQ(Content(uid), "hello world");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, uploads_->OpenReader(uid));
  EXPECT_EQ(Text(*reader->Read(4, 3)), "o w");
  for (const auto& [offset, size] : std::vector<std::pair<int64_t, int64_t>>{
           {0, 12}, {12, 0}, {-1, 1}, {0, -1}, {INT64_MAX, INT64_MAX}}) {
    EXPECT_THAT(reader->Read(offset, size),
                StatusIs(absl::StatusCode::kOutOfRange, _));
  }
}

TEST_F(UploadStoreTest, RepeatsAreDroppedAndGapsRefused) {
  const std::string uid = MakeUpload();
  const auto writer = Writer(uid);
  MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abcd")));
  MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("XY")));
  MAPSIEVE_ASSERT_OK(writer->Append(4, {}));
  MAPSIEVE_ASSERT_OK(writer->Append(2, Bytes("XYef")));
  EXPECT_EQ(writer->written_bytes(), 6);
  EXPECT_THAT(writer->Append(7, Bytes("h")),
              StatusIs(absl::StatusCode::kOutOfRange,
                       AllOf(HasSubstr("offset 6"), HasSubstr("got 7"))));
  EXPECT_THAT(writer->Append(-1, Bytes("h")),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  MAPSIEVE_ASSERT_OK(writer->Commit());
  EXPECT_EQ(Content(uid), "abcdef");
}

TEST_F(UploadStoreTest, BytesBeyondTheDeclaredSizeAreRefused) {
  const std::string uid = MakeUpload(5);
  const auto writer = Writer(uid);
  EXPECT_THAT(writer->Append(0, Bytes("abcdef")),
              StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("5 bytes")));
  MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abc")));
  MAPSIEVE_ASSERT_OK(writer->Append(3, Bytes("de")));
  EXPECT_THAT(writer->Append(5, Bytes("f")),
              StatusIs(absl::StatusCode::kOutOfRange, _));
  EXPECT_EQ(*writer->Commit(), 5);
}

TEST_F(UploadStoreTest, OneWriterAtATime) {
  const std::string uid = MakeUpload();
  const std::string other = MakeUpload();
  auto writer = Writer(uid);
  EXPECT_THAT(uploads_->OpenWriter(uid),
              StatusIs(absl::StatusCode::kAborted, HasSubstr(uid)));
  EXPECT_THAT(uploads_->OpenWriter(other), IsOk());
  writer.reset();
  EXPECT_THAT(uploads_->OpenWriter(uid), IsOk());
}

TEST_F(UploadStoreTest, AWriterGoesOnFromTheCommittedBytes) {
  const std::string uid = MakeUpload();
  {
    const auto writer = Writer(uid);
    MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abc")));
    MAPSIEVE_ASSERT_OK(writer->Commit());
    MAPSIEVE_ASSERT_OK(writer->Append(3, Bytes("lost")));
  }
  Open();
  const auto writer = Writer(uid);
  EXPECT_EQ(writer->written_bytes(), 3);
  EXPECT_EQ(*files_.FileSize(directory_ / ("uploads/" + uid)), 3);
  MAPSIEVE_ASSERT_OK(writer->Append(3, Bytes("def")));
  MAPSIEVE_ASSERT_OK(writer->Commit());
  EXPECT_EQ(Content(uid), "abcdef");
}

TEST_F(UploadStoreTest, OnlyActiveUploadsTakeBytes) {
  const std::string uid = MakeUpload();
  auto writer = Writer(uid);
  MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abc")));
  MAPSIEVE_ASSERT_OK(writer->Commit());
  MAPSIEVE_ASSERT_OK(writer->Append(3, Bytes("d")));
  MAPSIEVE_ASSERT_OK(catalogue_->SetUploadState(uid, UploadState::kActive,
                                                UploadState::kFinalizing, ""));
  EXPECT_THAT(writer->Commit(),
              StatusIs(absl::StatusCode::kFailedPrecondition, _));
  EXPECT_EQ(writer->committed_bytes(), 3);
  EXPECT_EQ(Content(uid), "abc");
  writer.reset();
  EXPECT_THAT(uploads_->OpenWriter(uid),
              StatusIs(absl::StatusCode::kFailedPrecondition, _));
  EXPECT_THAT(uploads_->OpenWriter("../../etc/passwd"),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  EXPECT_THAT(uploads_->OpenReader(std::string(32, 'a')),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(uploads_->Remove("a/b"),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
}

TEST_F(UploadStoreTest, AnUploadDeletedUnderItsWriterTakesNoMore) {
  const std::string uid = MakeUpload();
  const auto writer = Writer(uid);
  MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abc")));
  MAPSIEVE_ASSERT_OK(catalogue_->DeleteUpload(uid));
  MAPSIEVE_ASSERT_OK(uploads_->Remove(uid));
  EXPECT_THAT(writer->Commit(), StatusIs(absl::StatusCode::kNotFound, _));
}

TEST_F(UploadStoreTest, LostBytesAreDataLoss) {
  const std::string uid = MakeUpload();
  {
    const auto writer = Writer(uid);
    MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abcdef")));
    MAPSIEVE_ASSERT_OK(writer->Commit());
  }
  const std::string path = directory_ / ("uploads/" + uid);
  WriteWholeFile(path, "abc");
  const auto lost = StatusIs(
      absl::StatusCode::kDataLoss,
      AllOf(HasSubstr(path), HasSubstr("expected 6"), HasSubstr("holds 3")));
  EXPECT_THAT(uploads_->OpenReader(uid), lost);
  EXPECT_THAT(uploads_->OpenWriter(uid), lost);
  // The failed writer is not in the way of the next one.
  WriteWholeFile(path, "abcdef");
  EXPECT_THAT(uploads_->OpenWriter(uid), IsOk());
  MAPSIEVE_ASSERT_OK(uploads_->Remove(uid));
  EXPECT_THAT(uploads_->OpenReader(uid),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("holds 0")));
}

TEST_F(UploadStoreTest, OrphansAreRemoved) {
  const std::string active = MakeUpload();
  const std::string finalized = MakeUpload();
  const std::string deleted = MakeUpload();
  for (const std::string& uid : {active, finalized, deleted}) {
    const auto writer = Writer(uid);
    MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abc")));
    MAPSIEVE_ASSERT_OK(writer->Commit());
  }
  MAPSIEVE_ASSERT_OK(catalogue_->SetUploadState(finalized, UploadState::kActive,
                                                UploadState::kFinalizing, ""));
  RevisionChange change;
  change.finalized_upload_uid = finalized;
  MAPSIEVE_ASSERT_OK(
      catalogue_->CommitRevision(catalogue_->GetMap("campus")->uid, 1, change));
  MAPSIEVE_ASSERT_OK(catalogue_->DeleteUpload(deleted));
  WriteWholeFile(directory_ / "uploads/README", "not ours");
  EXPECT_EQ(*uploads_->RemoveOrphans(), 2);
  EXPECT_THAT(*files_.List(directory_ / "uploads"),
              UnorderedElementsAre("README", active));
  EXPECT_EQ(Content(active), "abc");
}

TEST_F(UploadStoreTest, AFullDiskIsToldAndTheCallCanBeRepeated) {
  const std::string uid = MakeUpload();
  const auto writer = Writer(uid);
  MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abc")));
  files_.Arm(
      {.operation = 1, .status = absl::ResourceExhaustedError("no space")});
  EXPECT_THAT(writer->Append(3, Bytes("defg")),
              StatusIs(absl::StatusCode::kResourceExhausted, _));
  EXPECT_EQ(writer->written_bytes(), 3);
  files_.SetFreeBytes(2);
  EXPECT_THAT(writer->Append(3, Bytes("defg")),
              StatusIs(absl::StatusCode::kResourceExhausted, _));
  files_.SetFreeBytes(100);
  MAPSIEVE_ASSERT_OK(writer->Append(3, Bytes("defg")));
  MAPSIEVE_ASSERT_OK(writer->Commit());
  EXPECT_EQ(Content(uid), "abcdefg");
}

TEST_F(UploadStoreTest, AFailedSyncIsNeverTakenBack) {
  const std::string uid = MakeUpload();
  {
    const auto writer = Writer(uid);
    MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abc")));
    files_.Arm({.operation = 1, .status = absl::UnavailableError("device")});
    EXPECT_THAT(writer->Commit(), StatusIs(absl::StatusCode::kUnavailable, _));
    EXPECT_THAT(writer->Commit(), StatusIs(absl::StatusCode::kUnavailable, _));
    EXPECT_EQ(writer->committed_bytes(), 0);
  }
  EXPECT_EQ(Content(uid), "");
  EXPECT_EQ(Writer(uid)->written_bytes(), 0);
}

TEST_F(UploadStoreTest, AcknowledgedBytesSurviveAnyFailureAndPowerLoss) {
  const std::string all = "0123456789abcdefghij";
  for (const auto loss :
       {FaultFileSystem::Loss::kEverything, FaultFileSystem::Loss::kContent}) {
    for (const bool takes_effect : {false, true}) {
      for (int64_t n = 1;; ++n) {
        const std::string uid = MakeUpload();
        files_.Arm({.operation = n,
                    .status = absl::UnavailableError("device"),
                    .takes_effect = takes_effect});
        int64_t acknowledged = 0;
        // Two sessions of two commits.
        for (int session = 0; session < 2; ++session) {
          const auto writer = uploads_->OpenWriter(uid);
          if (!writer.ok()) continue;
          for (int commit = 0; commit < 2; ++commit) {
            const int64_t at = (*writer)->written_bytes();
            (*writer)
                ->Append(at, Bytes(all.substr(static_cast<size_t>(at), 5)))
                .IgnoreError();
            const auto committed = (*writer)->Commit();
            if (committed.ok()) acknowledged = *committed;
          }
        }
        const bool fired = files_.fired();
        Crash(loss);

        MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadRecord record,
                                      catalogue_->GetUploadByUid(uid));
        // A commit that failed may have happened.
        const int64_t have = record.committed_bytes;
        EXPECT_GE(have, acknowledged) << "operation " << n;
        EXPECT_LE(have, acknowledged + 5) << "operation " << n;
        if (have > 0) {
          EXPECT_EQ(Content(uid), all.substr(0, static_cast<size_t>(have)));
        }
        {
          const auto writer = Writer(uid);
          ASSERT_NE(writer, nullptr);
          MAPSIEVE_ASSERT_OK(writer->Append(
              have, Bytes(all.substr(static_cast<size_t>(have)))));
          MAPSIEVE_ASSERT_OK(writer->Commit());
        }
        EXPECT_EQ(Content(uid), all);
        if (!fired) {
          EXPECT_EQ(acknowledged, 20);
          EXPECT_GT(n, 10);
          break;
        }
      }
    }
  }
}

}  // namespace
}  // namespace mapsieve::storage
