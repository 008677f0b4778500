#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/rpc/service_fixture.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::HasSubstr;

using Code = absl::StatusCode;

class EditsTest : public ServiceTest {
 protected:
  static v1::Sphere Ball(double radius) {
    v1::Sphere sphere;
    sphere.mutable_center();
    sphere.set_radius(radius);
    return sphere;
  }
  absl::StatusOr<v1::Operation> Delete(const v1::DeleteRegionRequest& request) {
    v1::Operation operation;
    MAPSIEVE_RETURN_IF_ERROR(FromGrpc(client_->maps->DeleteRegion(
        client_->NewContext().get(), request, &operation)));
    return operation;
  }
  absl::StatusOr<v1::Revision> RollBack(const std::string& name,
                                        int64_t number) {
    v1::RollBackMapRequest request;
    request.set_name(name);
    request.set_revision(number);
    v1::Revision revision;
    MAPSIEVE_RETURN_IF_ERROR(FromGrpc(client_->maps->RollBackMap(
        client_->NewContext().get(), request, &revision)));
    return revision;
  }
  absl::StatusOr<v1::CompareRevisionsResponse> Compare(
      const std::string& name, int64_t base, int64_t target, int page_size = 0,
      const std::string& token = "") {
    v1::CompareRevisionsRequest request;
    request.set_name(name);
    request.set_base_revision(base);
    request.set_target_revision(target);
    request.set_page_size(page_size);
    request.set_page_token(token);
    v1::CompareRevisionsResponse response;
    MAPSIEVE_RETURN_IF_ERROR(FromGrpc(client_->maps->CompareRevisions(
        client_->NewContext().get(), request, &response)));
    return response;
  }
  v1::ListRevisionsResponse Revisions() {
    v1::ListRevisionsRequest request;
    request.set_parent("maps/campus");
    v1::ListRevisionsResponse response;
    EXPECT_TRUE(
        client_->maps
            ->ListRevisions(client_->NewContext().get(), request, &response)
            .ok());
    return response;
  }
  int64_t RawCount() {
    v1::QueryRegionRequest raw = QueryOf("campus");
    raw.set_raw(true);
    const auto answer = client_->Query(raw);
    EXPECT_TRUE(answer.ok()) << answer.status();
    return answer->summary.point_count();
  }
};

TEST_F(EditsTest, RegionsGoAndComeBack) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus", 1.0));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(5000)));
  v1::QueryRegionRequest inside = QueryOf("campus");
  inside.set_raw(true);
  *inside.mutable_sphere() = Ball(2);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer there, client_->Query(inside));
  const int64_t count = there.summary.point_count();
  ASSERT_GT(count, 0);
  ASSERT_LT(count, 5000);

  v1::DeleteRegionRequest request;
  request.set_name("maps/campus");
  *request.mutable_sphere() = Ball(2);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, Delete(request));
  v1::OperationMetadata metadata;
  ASSERT_TRUE(started.metadata().UnpackTo(&metadata));
  EXPECT_EQ(metadata.verb(), "DeleteRegion");
  EXPECT_EQ(metadata.target(), "maps/campus");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto done, client_->Wait(started.name()));
  v1::DeleteRegionResponse deleted;
  ASSERT_TRUE(done.response().UnpackTo(&deleted));
  EXPECT_EQ(deleted.revision(), 3);
  EXPECT_EQ(deleted.removed_point_count(), count);
  EXPECT_GT(deleted.tile_count(), 0);
  EXPECT_EQ(RawCount(), 5000 - count);

  const std::vector<std::byte> bytes = UploadBytes(TestScene(100), 100);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto upload,
                                client_->CreateUpload("campus", "v", bytes));
  MAPSIEVE_ASSERT_OK(client_->Write(upload.name(), bytes));
  v1::FinalizeUploadRequest replace;
  replace.set_name(upload.name());
  *replace.mutable_sphere() = Ball(1000);
  v1::Operation operation;
  MAPSIEVE_ASSERT_OK(FromGrpc(client_->uploads->FinalizeUpload(
      client_->NewContext().get(), replace, &operation)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto replaced,
                                client_->Wait(operation.name()));
  v1::FinalizeUploadResponse response;
  ASSERT_TRUE(replaced.response().UnpackTo(&response));
  EXPECT_EQ(response.report().removed_point_count(), 5000 - count);
  EXPECT_EQ(RawCount(), 100);

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto back, RollBack("maps/campus", 2));
  EXPECT_EQ(back.number(), 5);
  EXPECT_EQ(back.kind(), v1::Revision::KIND_ROLLBACK);
  EXPECT_EQ(back.restored_revision(), 2);
  EXPECT_EQ(RawCount(), 5000);

  const v1::ListRevisionsResponse list = Revisions();
  ASSERT_EQ(list.revisions_size(), 5);
  EXPECT_EQ(list.revisions(0).DebugString(), back.DebugString());
  EXPECT_EQ(list.revisions(1).kind(), v1::Revision::KIND_REPLACE_REGION);
  EXPECT_EQ(list.revisions(1).upload(), "maps/campus/uploads/v");
  EXPECT_EQ(list.revisions(1).sphere().radius(), 1000);
  EXPECT_EQ(list.revisions(2).kind(), v1::Revision::KIND_DELETE_REGION);
  EXPECT_EQ(list.revisions(2).removed_point_count(), count);
  EXPECT_EQ(list.revisions(3).kind(), v1::Revision::KIND_UPLOAD);
  EXPECT_EQ(list.revisions(3).added_point_count(), 5000);

  std::string token;
  int tile_count = 0;
  do {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto page,
                                  Compare("maps/campus", 2, 3, 2, token));
    EXPECT_EQ(page.base().number(), 2);
    EXPECT_EQ(page.target().number(), 3);
    for (const v1::TileChange& tile : page.tiles()) {
      EXPECT_TRUE(tile.raw() == v1::TileChange::CHANGE_CHANGED ||
                  tile.raw() == v1::TileChange::CHANGE_REMOVED);
      EXPECT_EQ(tile.product(), v1::TileChange::CHANGE_NONE);
      EXPECT_LT(tile.target_raw_point_count(), tile.base_raw_point_count());
    }
    tile_count += page.tiles_size();
    token = page.next_page_token();
  } while (!token.empty());
  EXPECT_EQ(tile_count, deleted.tile_count());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto same, Compare("maps/campus", 2, 5));
  EXPECT_EQ(same.tiles_size(), 0);
}

TEST_F(EditsTest, ErrorsNameWhatIsWrong) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  v1::DeleteRegionRequest request;
  EXPECT_THAT(Delete(request),
              StatusIs(Code::kInvalidArgument, HasSubstr("name")));
  request.set_name("maps/campus");
  EXPECT_THAT(Delete(request),
              StatusIs(Code::kInvalidArgument, HasSubstr("region")));
  request.mutable_box()->mutable_min();
  EXPECT_THAT(Delete(request),
              StatusIs(Code::kInvalidArgument, HasSubstr("box.max")));
  *request.mutable_sphere() = Ball(-1);
  EXPECT_THAT(Delete(request),
              StatusIs(Code::kInvalidArgument, HasSubstr("sphere.radius")));
  *request.mutable_sphere() = Ball(1);
  request.set_name("maps/other");
  EXPECT_THAT(Delete(request), StatusIs(Code::kNotFound, HasSubstr("other")));

  v1::FinalizeUploadRequest finalize;
  finalize.set_name("maps/campus/uploads/u");
  finalize.mutable_sphere();
  v1::Operation operation;
  EXPECT_THAT(FromGrpc(client_->uploads->FinalizeUpload(
                  client_->NewContext().get(), finalize, &operation)),
              StatusIs(Code::kInvalidArgument, HasSubstr("sphere.center")));

  EXPECT_THAT(RollBack("campus", 1),
              StatusIs(Code::kInvalidArgument, HasSubstr("name")));
  EXPECT_THAT(RollBack("maps/other", 1),
              StatusIs(Code::kNotFound, HasSubstr("other")));
  EXPECT_THAT(RollBack("maps/campus", 0), StatusIs(Code::kOutOfRange, _));
  EXPECT_THAT(RollBack("maps/campus", 2),
              StatusIs(Code::kOutOfRange, HasSubstr("1 to 1")));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(20'000)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto run, client_->Process("campus"));
  EXPECT_THAT(RollBack("maps/campus", 1), StatusIs(Code::kAborted, _));
  MAPSIEVE_ASSERT_OK(client_->Wait(run.name()));

  EXPECT_THAT(Compare("campus", 1, 1),
              StatusIs(Code::kInvalidArgument, HasSubstr("name")));
  EXPECT_THAT(Compare("maps/other", 1, 1), StatusIs(Code::kNotFound, _));
  EXPECT_THAT(Compare("maps/campus", 0, 1),
              StatusIs(Code::kOutOfRange, HasSubstr("base_revision")));
  EXPECT_THAT(Compare("maps/campus", 1, 9),
              StatusIs(Code::kOutOfRange, HasSubstr("9")));
  EXPECT_THAT(Compare("maps/campus", 1, 2, -1),
              StatusIs(Code::kInvalidArgument, HasSubstr("page_size")));
  EXPECT_THAT(Compare("maps/campus", 1, 2, 0, "nowhere"),
              StatusIs(Code::kInvalidArgument, HasSubstr("page_token")));
}

}  // namespace
}  // namespace mapsieve::rpc
