// Uploads and operations.

#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/catalogue.h"
#include "tests/storage/catalogue_conformance.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::IsOk;
using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST_P(CatalogueTest, CreatingAnUploadAgainReturnsIt) {
  const MapRecord map = MakeMap("campus");
  const UploadSpec spec{.id = "0123456789abcdef0123456789abcdef",
                        .expected_bytes = 10,
                        .content_hash = std::string(32, 'a')};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadRecord created,
                                catalogue_->CreateUpload(map.uid, spec));
  EXPECT_EQ(created.spec, spec);
  EXPECT_EQ(created.map_uid, map.uid);
  EXPECT_EQ(created.state, UploadState::kActive);
  EXPECT_EQ(created.committed_bytes, 0);
  MAPSIEVE_ASSERT_OK(catalogue_->SetCommittedBytes(created.uid, 7));

  Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadRecord again,
                                catalogue_->CreateUpload(map.uid, spec));
  EXPECT_EQ(again.uid, created.uid);
  EXPECT_EQ(again.committed_bytes, 7);
  EXPECT_EQ(again.spec, spec);
  UploadSpec changed = spec;
  changed.expected_bytes = 11;
  EXPECT_THAT(catalogue_->CreateUpload(map.uid, changed),
              StatusIs(absl::StatusCode::kAlreadyExists, _));
  // The same id in another map is another upload.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const UploadRecord other,
      catalogue_->CreateUpload(MakeMap("other").uid, spec));
  EXPECT_NE(other.uid, created.uid);
}

TEST_P(CatalogueTest, IllFormedUploadsAreRefused) {
  const MapRecord map = MakeMap("campus");
  for (const std::string id : {"", "../x", "a/b", "A", "-"}) {
    EXPECT_THAT(catalogue_->CreateUpload(map.uid, {.id = id}),
                StatusIs(absl::StatusCode::kInvalidArgument, _));
  }
  EXPECT_THAT(
      catalogue_->CreateUpload(map.uid, {.id = "a", .expected_bytes = -1}),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("-1")));
  EXPECT_THAT(
      catalogue_->CreateUpload(map.uid, {.id = "a", .content_hash = "xyz"}),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("xyz")));
  EXPECT_THAT(catalogue_->CreateUpload("nobody", {.id = "a"}),
              StatusIs(absl::StatusCode::kNotFound, _));
}

TEST_P(CatalogueTest, CommittedBytesNeverDecrease) {
  const UploadRecord upload = MakeUpload(MakeMap("campus"), "u");
  MAPSIEVE_ASSERT_OK(catalogue_->SetCommittedBytes(upload.uid, 5));
  MAPSIEVE_ASSERT_OK(catalogue_->SetCommittedBytes(upload.uid, 5));
  EXPECT_THAT(catalogue_->SetCommittedBytes(upload.uid, 4),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  MAPSIEVE_ASSERT_OK(catalogue_->SetUploadState(
      upload.uid, UploadState::kActive, UploadState::kFinalizing, ""));
  EXPECT_THAT(
      catalogue_->SetCommittedBytes(upload.uid, 6),
      StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("upload u")));
  EXPECT_EQ(catalogue_->GetUploadByUid(upload.uid)->committed_bytes, 5);
}

TEST_P(CatalogueTest, AnUploadIsFinalizedWithTheCommitOfItsPoints) {
  const MapRecord map = MakeMap("campus");
  const UploadRecord upload = MakeUpload(map, "u");
  RevisionChange change = Adding({TestChunk(ChunkKind::kRaw, 0, 0, 0, "a", 1)});
  change.finalized_upload_uid = upload.uid;
  change.upload_report = "report";
  // Not yet complete: nothing happens at all.
  EXPECT_THAT(catalogue_->CommitRevision(map.uid, 1, change),
              StatusIs(absl::StatusCode::kFailedPrecondition, _));
  EXPECT_EQ(catalogue_->GetMap("campus")->newest_revision, 1);
  EXPECT_THAT(Chunks(map, 1), IsEmpty());

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const UploadRecord finalizing,
      catalogue_->SetUploadState(upload.uid, UploadState::kActive,
                                 UploadState::kFinalizing, "soon"));
  EXPECT_EQ(finalizing.state, UploadState::kFinalizing);
  EXPECT_EQ(finalizing.report, "soon");
  Commit(map, 1, change);
  Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadRecord finalized,
                                catalogue_->GetUpload(map.uid, "u"));
  EXPECT_EQ(finalized.state, UploadState::kFinalized);
  EXPECT_EQ(finalized.revision, 2);
  EXPECT_EQ(finalized.report, "report");
  // Once only.
  EXPECT_THAT(catalogue_->CommitRevision(map.uid, 2, change),
              StatusIs(absl::StatusCode::kFailedPrecondition, _));
  EXPECT_EQ(catalogue_->GetMap("campus")->newest_revision, 2);
}

TEST_P(CatalogueTest, AnUploadOfAnotherMapCannotBeFinalized) {
  const MapRecord map = MakeMap("campus");
  const UploadRecord upload = MakeUpload(MakeMap("other"), "u");
  MAPSIEVE_ASSERT_OK(catalogue_->SetUploadState(
      upload.uid, UploadState::kActive, UploadState::kFinalizing, ""));
  RevisionChange change;
  change.finalized_upload_uid = upload.uid;
  EXPECT_THAT(catalogue_->CommitRevision(map.uid, 1, change),
              StatusIs(absl::StatusCode::kNotFound, _));
}

TEST_P(CatalogueTest, UploadStatesChangeFromTheNamedStateOnly) {
  const UploadRecord upload = MakeUpload(MakeMap("campus"), "u");
  EXPECT_THAT(
      catalogue_->SetUploadState(upload.uid, UploadState::kFinalizing,
                                 UploadState::kActive, ""),
      StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("upload u")));
  EXPECT_THAT(catalogue_->SetUploadState(upload.uid, UploadState::kActive,
                                         UploadState::kFinalized, ""),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  EXPECT_THAT(catalogue_->SetUploadState("nobody", UploadState::kActive,
                                         UploadState::kFailed, ""),
              StatusIs(absl::StatusCode::kNotFound, _));
  MAPSIEVE_ASSERT_OK(catalogue_->SetUploadState(
      upload.uid, UploadState::kActive, UploadState::kFailed, "bad"));
  MAPSIEVE_ASSERT_OK(catalogue_->SetUploadState(
      upload.uid, UploadState::kFailed, UploadState::kActive, ""));
}

TEST_P(CatalogueTest, UploadsAreListedAndDeleted) {
  const MapRecord map = MakeMap("campus");
  for (const char* id : {"b", "c", "a"}) MakeUpload(map, id);
  MakeUpload(MakeMap("other"), "z");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto page,
                                catalogue_->ListUploads(map.uid, "a", 10));
  ASSERT_EQ(page.size(), 2u);
  EXPECT_EQ(page[0].spec.id, "b");
  EXPECT_EQ(page[1].spec.id, "c");
  MAPSIEVE_ASSERT_OK(catalogue_->DeleteUpload(page[0].uid));
  EXPECT_THAT(catalogue_->DeleteUpload(page[0].uid),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(catalogue_->GetUpload(map.uid, "b"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("\"b\"")));
}

TEST_P(CatalogueTest, IdleUploadsThatAreNotAtWorkAreDeleted) {
  const MapRecord map = MakeMap("campus");
  const UploadRecord active = MakeUpload(map, "active");
  const UploadRecord finalizing = MakeUpload(map, "finalizing");
  MAPSIEVE_ASSERT_OK(catalogue_->SetUploadState(
      finalizing.uid, UploadState::kActive, UploadState::kFinalizing, ""));
  const absl::Time now = absl::Now();
  EXPECT_EQ(*catalogue_->DeleteIdleUploads(active.update_time), 0);
  EXPECT_EQ(*catalogue_->DeleteIdleUploads(now + absl::Seconds(1)), 1);
  EXPECT_THAT(catalogue_->GetUploadByUid(active.uid),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(catalogue_->GetUploadByUid(finalizing.uid), IsOk());
}

TEST_P(CatalogueTest, OperationsSurviveAndEndOnce) {
  OperationRecord operation;
  operation.id = "op-1";
  operation.target = "maps/campus";
  operation.verb = "process";
  operation.request = std::string("\0r", 2);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const OperationRecord created,
                                catalogue_->CreateOperation(operation));
  EXPECT_GT(created.number, 0);
  EXPECT_THAT(catalogue_->CreateOperation(operation),
              StatusIs(absl::StatusCode::kAlreadyExists, HasSubstr("op-1")));
  operation.state = OperationState::kRunning;
  operation.done_count = 3;
  operation.total_count = 9;
  operation.cancel_requested = true;
  MAPSIEVE_ASSERT_OK(catalogue_->UpdateOperation(operation));
  Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const OperationRecord running,
                                catalogue_->GetOperation("op-1"));
  EXPECT_EQ(running.number, created.number);
  EXPECT_EQ(running.target, "maps/campus");
  EXPECT_EQ(running.verb, "process");
  EXPECT_EQ(running.request, operation.request);
  EXPECT_EQ(running.state, OperationState::kRunning);
  EXPECT_EQ(running.done_count, 3);
  EXPECT_EQ(running.total_count, 9);
  EXPECT_TRUE(running.cancel_requested);
  EXPECT_EQ(running.create_time, created.create_time);
  EXPECT_THAT(catalogue_->DeleteOperation("op-1"),
              StatusIs(absl::StatusCode::kFailedPrecondition, _));

  operation.state = OperationState::kFailed;
  operation.error_code = 8;
  operation.error_message = "disk full";
  operation.response = "rest";
  MAPSIEVE_ASSERT_OK(catalogue_->UpdateOperation(operation));
  operation.state = OperationState::kSucceeded;
  EXPECT_THAT(catalogue_->UpdateOperation(operation),
              StatusIs(absl::StatusCode::kFailedPrecondition, _));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const OperationRecord failed,
                                catalogue_->GetOperation("op-1"));
  EXPECT_EQ(failed.state, OperationState::kFailed);
  EXPECT_EQ(failed.error_code, 8);
  EXPECT_EQ(failed.error_message, "disk full");
  EXPECT_EQ(failed.response, "rest");
  MAPSIEVE_ASSERT_OK(catalogue_->DeleteOperation("op-1"));
  EXPECT_THAT(catalogue_->GetOperation("op-1"),
              StatusIs(absl::StatusCode::kNotFound, _));
}

TEST_P(CatalogueTest, OperationsAreListedInOrderOfCreation) {
  const auto add = [&](const char* id, const char* target,
                       OperationState state) {
    OperationRecord operation;
    operation.id = id;
    operation.target = target;
    operation.state = state;
    EXPECT_THAT(catalogue_->CreateOperation(operation), IsOk());
  };
  add("z", "maps/a", OperationState::kQueued);
  add("y", "maps/b", OperationState::kSucceeded);
  add("x", "maps/a", OperationState::kCancelled);
  add("w", "maps/a", OperationState::kRunning);
  const auto ids = [&](const char* target, bool unfinished_only, int64_t after,
                       int64_t max_count) {
    const auto operations =
        catalogue_->ListOperations(target, unfinished_only, after, max_count);
    EXPECT_THAT(operations, IsOk());
    std::string text;
    for (const auto& operation : *operations) text += operation.id;
    return text;
  };
  EXPECT_EQ(ids("", false, 0, 10), "zyxw");
  EXPECT_EQ(ids("", false, 0, 2), "zy");
  EXPECT_EQ(ids("", false, catalogue_->GetOperation("y")->number, 10), "xw");
  EXPECT_EQ(ids("maps/a", false, 0, 10), "zxw");
  EXPECT_EQ(ids("", true, 0, 10), "zw");
  EXPECT_EQ(ids("maps/b", true, 0, 10), "");
}

TEST_P(CatalogueTest, IllFormedOperationsAreRefused) {
  OperationRecord operation;
  operation.id = "../x";
  EXPECT_THAT(catalogue_->CreateOperation(operation),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  operation.id = "x";
  operation.done_count = 5;
  operation.total_count = 4;
  EXPECT_THAT(catalogue_->CreateOperation(operation),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  operation.done_count = 4;
  operation.state = static_cast<OperationState>(77);
  EXPECT_THAT(catalogue_->CreateOperation(operation),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("77")));
  operation.state = OperationState::kQueued;
  EXPECT_THAT(catalogue_->UpdateOperation(operation),
              StatusIs(absl::StatusCode::kNotFound, _));
}

}  // namespace
}  // namespace mapsieve::storage
