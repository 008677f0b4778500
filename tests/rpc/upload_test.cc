#include <cstddef>
#include <cstdint>
#include <span>
#include <thread>
#include <vector>

#include "absl/time/clock.h"
#include "core/base/hash.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/rpc/service_fixture.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

using Code = absl::StatusCode;

using UploadTest = ServiceTest;

TEST_F(UploadTest, RefusesAGap) {
  const auto bytes = SomeBytes(1000);
  StartUpload(bytes);
  EXPECT_THAT(client_->Write(kUpload, std::span(bytes).subspan(500), 500),
              StatusIs(Code::kOutOfRange, _));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto upload, client_->GetUpload(kUpload));
  EXPECT_EQ(upload.committed_bytes(), 0);
}

TEST_F(UploadTest, DropsRepeatsAndResumes) {
  const auto bytes = UploadBytes(TestScene(2000), 300);
  StartUpload(bytes);
  const std::span<const std::byte> all = bytes;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const int64_t first, client_->Write(kUpload, all.first(700), 0, 100));
  EXPECT_EQ(first, 700);
  // From the start again, in other pieces.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const int64_t second, client_->Write(kUpload, all.first(1000), 0, 330));
  EXPECT_EQ(second, 1000);
  MAPSIEVE_ASSERT_OK(client_->Write(kUpload, all.subspan(900), 900));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Finalize(kUpload));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto done, client_->Wait(started.name()));
  v1::FinalizeUploadResponse response;
  ASSERT_TRUE(done.response().UnpackTo(&response));
  EXPECT_EQ(response.report().added_point_count(), 2000);
  // Again: the same operation, nothing added.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto again, client_->Finalize(kUpload));
  EXPECT_EQ(again.name(), started.name());
}

TEST_F(UploadTest, RefusesMoreThanItsLength) {
  const auto bytes = SomeBytes(1000);
  StartUpload(bytes);
  EXPECT_THAT(client_->Write(kUpload, SomeBytes(1001)),
              StatusIs(Code::kOutOfRange, _));
}

TEST_F(UploadTest, KeepsWhatCameBeforeAnError) {
  const auto bytes = SomeBytes(1000);
  StartUpload(bytes);
  const auto context = client_->NewContext();
  const auto stream = client_->uploads->WriteUpload(context.get());
  ASSERT_TRUE(
      stream->Write(WriteRequest(kUpload, 0, std::span(bytes).first(600))));
  v1::WriteUploadRequest damaged =
      WriteRequest("", 600, std::span(bytes).subspan(600));
  damaged.mutable_data()->mutable_content()->at(17) ^= 1;
  stream->Write(damaged);
  v1::WriteUploadResponse response;
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.committed_bytes(), 600);
  EXPECT_FALSE(stream->Read(&response));
  EXPECT_THAT(FromGrpc(stream->Finish()), StatusIs(Code::kDataLoss, _));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto upload, client_->GetUpload(kUpload));
  EXPECT_EQ(upload.committed_bytes(), 600);
}

TEST_F(UploadTest, AcknowledgesAFlushAndHasOneWriter) {
  const auto bytes = SomeBytes(1000);
  StartUpload(bytes);
  const auto context = client_->NewContext();
  const auto stream = client_->uploads->WriteUpload(context.get());
  v1::WriteUploadRequest request =
      WriteRequest(kUpload, 0, std::span(bytes).first(400));
  request.set_flush(true);
  ASSERT_TRUE(stream->Write(request));
  v1::WriteUploadResponse response;
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.committed_bytes(), 400);
  EXPECT_THAT(client_->Write(kUpload, bytes), StatusIs(Code::kAborted, _));
  // The first one goes on.
  ASSERT_TRUE(
      stream->Write(WriteRequest("", 400, std::span(bytes).subspan(400))));
  stream->WritesDone();
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.committed_bytes(), 1000);
  EXPECT_FALSE(stream->Read(&response));
  MAPSIEVE_EXPECT_OK(FromGrpc(stream->Finish()));
}

TEST_F(UploadTest, KeepsToTheNameOfItsFirstRequest) {
  const auto bytes = SomeBytes(1000);
  StartUpload(bytes);
  const auto context = client_->NewContext();
  const auto stream = client_->uploads->WriteUpload(context.get());
  stream->Write(WriteRequest(kUpload, 0, std::span(bytes).first(100)));
  stream->Write(WriteRequest("maps/campus/uploads/v", 100,
                             std::span(bytes).subspan(100, 100)));
  for (v1::WriteUploadResponse response; stream->Read(&response);) {
    EXPECT_EQ(response.committed_bytes(), 100);
  }
  EXPECT_THAT(FromGrpc(stream->Finish()),
              StatusIs(Code::kInvalidArgument, HasSubstr("name")));
}

TEST_F(UploadTest, LongUploadIsAcknowledgedAsItGrows) {
  const auto bytes = SomeBytes(20 << 20);
  StartUpload(bytes);
  const auto context = client_->NewContext();
  const auto stream = client_->uploads->WriteUpload(context.get());
  std::vector<int64_t> acknowledged;
  std::thread reader([&] {
    for (v1::WriteUploadResponse response; stream->Read(&response);) {
      acknowledged.push_back(response.committed_bytes());
    }
  });
  constexpr size_t kPiece = 1 << 20;
  for (size_t at = 0; at < bytes.size(); at += kPiece) {
    ASSERT_TRUE(
        stream->Write(WriteRequest(kUpload, static_cast<int64_t>(at),
                                   std::span(bytes).subspan(at, kPiece))));
  }
  stream->WritesDone();
  reader.join();
  MAPSIEVE_EXPECT_OK(FromGrpc(stream->Finish()));
  EXPECT_THAT(acknowledged, ElementsAre(8 << 20, 16 << 20, 20 << 20));
}

TEST_F(UploadTest, GoesOnAfterABrokenStream) {
  const auto bytes = UploadBytes(TestScene(5000), 500);
  StartUpload(bytes);
  {
    const auto context = client_->NewContext();
    const auto stream = client_->uploads->WriteUpload(context.get());
    v1::WriteUploadRequest request =
        WriteRequest(kUpload, 0, std::span(bytes).first(1000));
    request.set_flush(true);
    stream->Write(request);
    v1::WriteUploadResponse response;
    ASSERT_TRUE(stream->Read(&response));
    stream->Write(WriteRequest("", 1000, std::span(bytes).subspan(1000, 500)));
    context->TryCancel();
    EXPECT_THAT(FromGrpc(stream->Finish()), StatusIs(Code::kCancelled, _));
  }
  // The server hears of it a moment later.
  absl::StatusOr<int64_t> written = absl::AbortedError("");
  for (int i = 0; i < 200 && absl::IsAborted(written.status()); ++i) {
    absl::SleepFor(absl::Milliseconds(10));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto upload,
                                  client_->GetUpload(kUpload));
    EXPECT_GE(upload.committed_bytes(), 1000);
    const auto offset = static_cast<size_t>(upload.committed_bytes());
    written = client_->Write(kUpload, std::span(bytes).subspan(offset),
                             upload.committed_bytes());
  }
  MAPSIEVE_ASSERT_OK(written);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Finalize(kUpload));
  MAPSIEVE_EXPECT_OK(client_->Wait(started.name()));
}

TEST_F(UploadTest, TheSourceGivesTheMapItsPlace) {
  const auto bytes = UploadBytes(TestScene(500), 300);
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  v1::CreateUploadRequest request;
  request.set_parent("maps/campus");
  request.set_upload_id("u");
  v1::Upload& told = *request.mutable_upload();
  told.set_expected_bytes(static_cast<int64_t>(bytes.size()));
  told.set_content_hash(ContentHash(bytes));
  told.mutable_source()->set_crs_wkt("EPSG:2056");
  told.mutable_source()->set_frame_id("map");
  told.mutable_source()->set_unit("foot");
  told.mutable_source()->set_coordinate_step(0.25);
  v1::Upload upload;
  MAPSIEVE_ASSERT_OK(FromGrpc(client_->uploads->CreateUpload(
      client_->NewContext().get(), request, &upload)));
  EXPECT_EQ(upload.source().SerializeAsString(),
            told.source().SerializeAsString());
  MAPSIEVE_ASSERT_OK(client_->Write(kUpload, bytes));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Finalize(kUpload));
  MAPSIEVE_ASSERT_OK(client_->Wait(started.name()));

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(upload, client_->GetUpload(kUpload));
  EXPECT_EQ(upload.source().SerializeAsString(),
            told.source().SerializeAsString());
  ASSERT_EQ(upload.report().warnings_size(), 1);
  EXPECT_EQ(upload.report().warnings(0).code(), "unit_not_metre");
  EXPECT_EQ(upload.report().census().overlapping_point_count(), 0);
  v1::GetMapRequest get;
  get.set_name("maps/campus");
  v1::Map map;
  MAPSIEVE_ASSERT_OK(
      FromGrpc(client_->maps->GetMap(client_->NewContext().get(), get, &map)));
  EXPECT_EQ(map.crs_wkt(), "EPSG:2056");
  EXPECT_EQ(map.frame_id(), "map");
  // A page of long texts could exceed what a client receives.
  v1::ListUploadsRequest list;
  list.set_parent("maps/campus");
  v1::ListUploadsResponse page;
  MAPSIEVE_ASSERT_OK(FromGrpc(
      client_->uploads->ListUploads(client_->NewContext().get(), list, &page)));
  ASSERT_EQ(page.uploads_size(), 1);
  EXPECT_EQ(page.uploads(0).source().crs_wkt(), "");
  EXPECT_EQ(page.uploads(0).source().frame_id(), "map");
}

TEST_F(UploadTest, IncompleteUploadIsNotFinalized) {
  const auto bytes = UploadBytes(TestScene(500), 500);
  StartUpload(bytes);
  EXPECT_THAT(client_->Finalize(kUpload),
              StatusIs(Code::kFailedPrecondition, _));
}

TEST_F(UploadTest, DamagedUploadLeavesTheMapAsItWas) {
  const auto bytes = SomeBytes(5000);
  StartUpload(bytes);
  MAPSIEVE_ASSERT_OK(client_->Write(kUpload, bytes));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Finalize(kUpload));
  EXPECT_THAT(client_->Wait(started.name()), StatusIs(Code::kDataLoss, _));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto upload, client_->GetUpload(kUpload));
  EXPECT_EQ(upload.state(), v1::Upload::STATE_FAILED);
  v1::QueryRegionRequest request = QueryOf("campus");
  request.set_raw(true);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, client_->Query(request));
  EXPECT_EQ(answer.cloud.size(), 0U);
}

}  // namespace
}  // namespace mapsieve::rpc
