#include <algorithm>
#include <cmath>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/cloud/point_cloud.h"
#include "core/codec/points_codec.h"
#include "gtest/gtest.h"
#include "server/engine/engine.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::Column;
using core::LatticeCloud;
using core::ScalarType;
using mapsieve::testing::StatusIs;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
constexpr auto kFailedPrecondition = absl::StatusCode::kFailedPrecondition;

class UploadsTest : public ::testing::Test {
 protected:
  UploadsTest() {
    MAPSIEVE_EXPECT_OK(service_->CreateMap({.map_id = "map", .tile_edge = 4}));
  }

  /// Finalizes `bytes` as upload `id` and returns the error of the operation.
  absl::Status Refusal(const std::string& id,
                       std::span<const std::byte> bytes) {
    MAPSIEVE_RETURN_IF_ERROR(service_.Stage("map", id, bytes));
    MAPSIEVE_ASSIGN_OR_RETURN(const Operation operation,
                              service_.Finalize("map", id));
    EXPECT_EQ(operation.state, OperationState::kFailed);
    return operation.error;
  }

  UploadState StateOf(const std::string& id) {
    const auto upload = service_->GetUpload("map", id);
    EXPECT_TRUE(upload.ok()) << upload.status();
    return upload->state;
  }

  int64_t Revision() { return service_->GetMap("map")->revision; }

  Service service_;
};

LatticeCloud OnePoint(const core::LatticePoint& q = {1, 2, 3}) {
  LatticeCloud cloud;
  cloud.positions = {q};
  return cloud;
}

LatticeCloud OnePoint(const std::string& attribute, ScalarType type) {
  LatticeCloud cloud = OnePoint();
  EXPECT_TRUE(cloud.attributes.Add(Column({attribute, type}, 1)).ok());
  return cloud;
}

TEST_F(UploadsTest, CreateTellsWhatIsThere) {
  const UploadSpec spec = {.upload_id = "0123abc",
                           .expected_bytes = 1000,
                           .content_hash = std::string(32, 'a'),
                           .refused = {.non_finite = 3, .out_of_lattice = 4},
                           .source = {.crs_wkt = std::string(65'536, 'w'),
                                      .frame_id = "odom",
                                      .unit = "foot",
                                      .coordinate_step = 0.25}};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadInfo created,
                                service_->CreateUpload("map", spec));
  EXPECT_EQ(created.spec, spec);
  EXPECT_EQ(created.state, UploadState::kActive);
  EXPECT_EQ(created.committed_bytes, 0);
  EXPECT_FALSE(created.report.has_value());
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                  service_->OpenUploadWriter("map", "0123abc"));
    MAPSIEVE_ASSERT_OK(writer->Append(0, std::vector<std::byte>(600)));
    EXPECT_THAT(writer->Commit().value(), 600);
  }
  service_.Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadInfo again,
                                service_->CreateUpload("map", spec));
  EXPECT_EQ(again.spec, spec);
  EXPECT_EQ(again.committed_bytes, 600);

  UploadSpec other = spec;
  other.expected_bytes = 1001;
  EXPECT_THAT(service_->CreateUpload("map", other),
              StatusIs(absl::StatusCode::kAlreadyExists, HasSubstr("")));
  other = spec;
  other.content_hash[0] = 'b';
  EXPECT_THAT(service_->CreateUpload("map", other),
              StatusIs(absl::StatusCode::kAlreadyExists, HasSubstr("")));
}

TEST_F(UploadsTest, CreateRefusesWhatIsNoUpload) {
  const UploadSpec good = {.upload_id = "a",
                           .expected_bytes = 1,
                           .content_hash = std::string(32, '0')};
  UploadSpec spec = good;
  for (const char* id : {"", "../../a", "A", "a/b", "-"}) {
    spec.upload_id = id;
    EXPECT_THAT(service_->CreateUpload("map", spec),
                StatusIs(kInvalid, HasSubstr("")))
        << id;
  }
  spec = good;
  spec.content_hash = "0";
  EXPECT_THAT(service_->CreateUpload("map", spec),
              StatusIs(kInvalid, HasSubstr("content_hash")));
  spec = good;
  spec.expected_bytes = -1;
  EXPECT_THAT(service_->CreateUpload("map", spec),
              StatusIs(kInvalid, HasSubstr("expected_bytes is -1")));
  const auto refusal = [&](const UploadSource& source) {
    spec = good;
    spec.source = source;
    return service_->CreateUpload("map", spec).status();
  };
  EXPECT_THAT(refusal({.crs_wkt = std::string(65'537, 'x')}),
              StatusIs(kInvalid, HasSubstr("source.crs_wkt")));
  EXPECT_THAT(refusal({.frame_id = std::string(256, 'x')}),
              StatusIs(kInvalid, HasSubstr("source.frame_id")));
  EXPECT_THAT(refusal({.unit = "a\tb"}),
              StatusIs(kInvalid, HasSubstr("source.unit")));
  for (const double step : {-1.0, std::nan(""), HUGE_VAL}) {
    EXPECT_THAT(refusal({.coordinate_step = step}),
                StatusIs(kInvalid, HasSubstr("source.coordinate_step")));
  }
  spec = good;
  spec.refused.non_finite = -1;
  EXPECT_THAT(service_->CreateUpload("map", spec),
              StatusIs(kInvalid, HasSubstr("refused.non_finite")));
  EXPECT_THAT(service_->CreateUpload("nomap", good),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("nomap")));
  EXPECT_THAT(service_->GetUpload("map", "nothing"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("nothing")));
  EXPECT_THAT(service_->OpenUploadWriter("map", "../x"),
              StatusIs(kInvalid, HasSubstr("")));
}

TEST_F(UploadsTest, WriterDropsRepeatsAndRefusesGaps) {
  const LatticeCloud scene = MakeScene(31);
  const std::vector<std::byte> bytes = MakeUpload(scene);
  const std::span<const std::byte> all = bytes;
  MAPSIEVE_ASSERT_OK(service_->CreateUpload(
      "map", {.upload_id = "scan",
              .expected_bytes = static_cast<int64_t>(bytes.size()),
              .content_hash = ContentHash(bytes)}));
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                  service_->OpenUploadWriter("map", "scan"));
    EXPECT_THAT(service_->OpenUploadWriter("map", "scan"),
                StatusIs(absl::StatusCode::kAborted, HasSubstr("")));
    MAPSIEVE_ASSERT_OK(writer->Append(0, all.subspan(0, 1000)));
    EXPECT_THAT(writer->Append(1001, all.subspan(1001, 10)),
                StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("1001")));
    MAPSIEVE_ASSERT_OK(writer->Append(500, all.subspan(500, 1000)));
    EXPECT_EQ(writer->Commit().value(), 1500);
  }
  EXPECT_THAT(service_->FinalizeUpload("map", "scan"),
              StatusIs(kFailedPrecondition, HasSubstr("1500 of ")));
  service_.Reopen();
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                  service_->OpenUploadWriter("map", "scan"));
    MAPSIEVE_ASSERT_OK(writer->Append(1500, all.subspan(1500)));
    EXPECT_THAT(
        writer->Append(static_cast<int64_t>(bytes.size()), all.subspan(0, 1)),
        StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("")));
    MAPSIEVE_ASSERT_OK(writer->Commit());
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation operation,
                                service_.Finalize("map", "scan"));
  MAPSIEVE_ASSERT_OK(operation.error);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                service_.Query({.map_id = "map", .raw = true}));
  ExpectSameCloud(InCanonicalOrder(answer.points), InCanonicalOrder(scene));
  EXPECT_THAT(service_->OpenUploadWriter("map", "scan"),
              StatusIs(kFailedPrecondition, HasSubstr("")));
}

TEST_F(UploadsTest, ReportTellsWhatWasAdded) {
  const LatticeCloud scene = MakeScene(32);
  MAPSIEVE_ASSERT_OK(service_.Stage("map", "scan", MakeUpload(scene, 1000),
                                    {.non_finite = 5, .out_of_lattice = 6}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation operation,
                                service_.Finalize("map", "scan"));
  MAPSIEVE_ASSERT_OK(operation.error);
  EXPECT_EQ(operation.state, OperationState::kSucceeded);
  EXPECT_EQ(operation.verb, OperationVerb::kFinalizeUpload);
  EXPECT_EQ(operation.upload_id, "scan");
  EXPECT_EQ(operation.done_work, operation.total_work);
  EXPECT_GT(operation.total_work, 0);
  ASSERT_TRUE(operation.upload_report.has_value());
  const UploadReport& report = *operation.upload_report;
  EXPECT_EQ(report.revision, 2);
  EXPECT_EQ(report.added_point_count, static_cast<int64_t>(scene.size()));
  EXPECT_EQ(report.refused.non_finite, 5);
  EXPECT_EQ(report.refused.out_of_lattice, 6);
  EXPECT_EQ(report.block_count,
            static_cast<int64_t>((scene.size() + 999) / 1000));
  EXPECT_EQ(report.tile_count, service_->GetMapStats("map")->tile_count);
  EXPECT_EQ(report.bounds, service_->GetMapStats("map")->bounds);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadInfo upload,
                                service_->GetUpload("map", "scan"));
  EXPECT_EQ(upload.state, UploadState::kFinalized);
  EXPECT_EQ(upload.report, report);
}

TEST_F(UploadsTest, FinalizeTwiceAddsOnce) {
  const LatticeCloud scene = MakeScene(33);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation first,
                                service_.Upload("map", "scan", scene));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation second,
                                service_->FinalizeUpload("map", "scan"));
  EXPECT_EQ(second.operation_id, first.operation_id);
  // Also when the operation is forgotten, and after a restart.
  service_.options().max_finished_operations = 1;
  service_.Reopen();
  MAPSIEVE_ASSERT_OK(service_.Upload("map", "other", OnePoint()));
  EXPECT_THAT(service_->GetOperation(first.operation_id),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation third,
                                service_->FinalizeUpload("map", "scan"));
  EXPECT_EQ(third.state, OperationState::kSucceeded);
  EXPECT_EQ(third.upload_report, first.upload_report);
  EXPECT_EQ(Revision(), 3);
  EXPECT_EQ(service_->GetMapStats("map")->raw_point_count,
            static_cast<int64_t>(scene.size()) + 1);
}

TEST_F(UploadsTest, SeveralAtATimeAllArrive) {
  const LatticeCloud scene = MakeScene(34);
  const std::vector<LatticeCloud> parts = Split(scene, 6);
  std::vector<std::thread> clients;
  for (size_t i = 0; i < parts.size(); ++i) {
    clients.emplace_back([&, i] {
      MAPSIEVE_EXPECT_OK(
          service_.Upload("map", absl::StrCat("part-", i), parts[i]));
    });
  }
  for (std::thread& client : clients) client.join();
  EXPECT_EQ(Revision(), 7);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                service_.Query({.map_id = "map", .raw = true}));
  ExpectSameCloud(InCanonicalOrder(answer.points), InCanonicalOrder(scene));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Page<UploadInfo> page,
                                service_->ListUploads("map", {.page_size = 4}));
  ASSERT_EQ(page.items.size(), 4U);
  EXPECT_EQ(page.items[0].spec.upload_id, "part-0");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Page<UploadInfo> rest,
      service_->ListUploads(
          "map", {.page_size = 4, .page_token = page.next_page_token}));
  EXPECT_EQ(rest.items.size(), 2U);
  EXPECT_EQ(rest.next_page_token, "");
}

TEST_F(UploadsTest, EmptyUploadAddsNothing) {
  MAPSIEVE_ASSERT_OK(service_.Stage("map", "empty", {}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation operation,
                                service_.Finalize("map", "empty"));
  MAPSIEVE_ASSERT_OK(operation.error);
  EXPECT_EQ(operation.upload_report->added_point_count, 0);
  EXPECT_FALSE(operation.upload_report->bounds.has_value());
  EXPECT_EQ(StateOf("empty"), UploadState::kFinalized);
  EXPECT_THAT(service_->ProcessMap("map", std::nullopt),
              StatusIs(kFailedPrecondition, HasSubstr("no points")));
}

TEST_F(UploadsTest, UploadThatNobodyWroteToTellsWhatWasRefused) {
  MAPSIEVE_ASSERT_OK(service_->CreateUpload(
      "map", {.upload_id = "refused",
              .content_hash = ContentHash({}),
              .refused = {.non_finite = 3, .out_of_lattice = 4}}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation operation,
                                service_.Finalize("map", "refused"));
  MAPSIEVE_ASSERT_OK(operation.error);
  const UploadReport& report = *operation.upload_report;
  EXPECT_EQ(report.added_point_count, 0);
  EXPECT_EQ(report.refused.non_finite, 3);
  EXPECT_EQ(report.refused.out_of_lattice, 4);
  EXPECT_EQ(report.census->density_histogram, std::vector<int64_t>());
}

TEST_F(UploadsTest, OnePointAtTheEndOfTheLattice) {
  const int64_t end = core::kLatticeLimit - 1;
  MAPSIEVE_ASSERT_OK(service_.Upload("map", "one", OnePoint({end, -end, end})));
  MAPSIEVE_ASSERT_OK(service_.Process("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                service_.Query({.map_id = "map", .raw = true}));
  ASSERT_EQ(answer.points.size(), 1U);
  EXPECT_EQ(answer.points.positions[0], (core::LatticePoint{end, -end, end}));
}

TEST_F(UploadsTest, WrongBytesFailTheUploadAndLeaveTheMap) {
  MAPSIEVE_ASSERT_OK(service_.Upload("map", "first", MakeScene(35)));
  const std::vector<std::byte> good = MakeUpload(MakeScene(36));

  std::vector<std::byte> truncated = good;
  truncated.resize(truncated.size() - 1);
  EXPECT_THAT(Refusal("truncated", truncated),
              StatusIs(absl::StatusCode::kDataLoss,
                       AllOf(HasSubstr("upload truncated, block 5 at "),
                             HasSubstr("ends inside a block"))));
  truncated.resize(7);
  EXPECT_THAT(Refusal("stub", truncated),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("expected at least 16 bytes, have 7")));
  std::vector<std::byte> damaged = good;
  damaged[damaged.size() / 2] ^= std::byte{1};
  EXPECT_THAT(Refusal("damaged", damaged),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("block 2 at ")));
  EXPECT_THAT(Refusal("text", std::vector<std::byte>(100, std::byte{'x'})),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("block 0 at 0")));

  MAPSIEVE_ASSERT_OK(service_->CreateUpload(
      "map", {.upload_id = "wrong-hash",
              .expected_bytes = static_cast<int64_t>(good.size()),
              .content_hash = std::string(32, 'e')}));
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto writer, service_->OpenUploadWriter("map", "wrong-hash"));
    MAPSIEVE_ASSERT_OK(writer->Append(0, good));
    MAPSIEVE_ASSERT_OK(writer->Commit());
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation operation,
                                service_.Finalize("map", "wrong-hash"));
  EXPECT_THAT(operation.error,
              StatusIs(absl::StatusCode::kDataLoss,
                       AllOf(HasSubstr(ContentHash(good)),
                             HasSubstr(std::string(32, 'e')))));

  for (const char* id :
       {"truncated", "stub", "damaged", "text", "wrong-hash"}) {
    EXPECT_EQ(StateOf(id), UploadState::kFailed) << id;
  }
  EXPECT_EQ(Revision(), 2);
  // The operation of a failed upload is told again; its id is free once it is
  // deleted.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation repeat,
                                service_->FinalizeUpload("map", "wrong-hash"));
  EXPECT_EQ(repeat.operation_id, operation.operation_id);
  MAPSIEVE_ASSERT_OK(service_->DeleteUpload("map", "wrong-hash"));
  MAPSIEVE_ASSERT_OK(service_.Stage("map", "wrong-hash", good));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation fine,
                                service_.Finalize("map", "wrong-hash"));
  MAPSIEVE_EXPECT_OK(fine.error);
  EXPECT_EQ(Revision(), 3);
}

TEST_F(UploadsTest, PointsOfAnotherMapAreRefused) {
  LatticeCloud cloud = OnePoint();
  cloud.lattice = core::Lattice(2'000'000);
  EXPECT_THAT(
      Refusal("step", MakeUpload(cloud)),
      StatusIs(kInvalid, AllOf(HasSubstr("2000000"), HasSubstr("1000000"))));
  MAPSIEVE_ASSERT_OK(
      service_.Upload("map", "a", OnePoint("time", ScalarType::kFloat64)));
  EXPECT_THAT(Refusal("b", MakeUpload(OnePoint("time", ScalarType::kFloat32))),
              StatusIs(kInvalid, AllOf(HasSubstr("\"time\" is float32"),
                                       HasSubstr("float64 in the map"))));
  EXPECT_EQ(StateOf("b"), UploadState::kFailed);
  EXPECT_EQ(Revision(), 2);
  // Blocks of one upload must agree as well.
  std::vector<std::byte> bytes =
      MakeUpload(OnePoint("gain", ScalarType::kInt8));
  for (const std::byte b : MakeUpload(OnePoint("gain", ScalarType::kInt16))) {
    bytes.push_back(b);
  }
  EXPECT_THAT(Refusal("c", bytes),
              StatusIs(kInvalid, AllOf(HasSubstr("int16"), HasSubstr("int8"),
                                       HasSubstr("block 1"))));
  // What was refused left no attribute behind.
  MAPSIEVE_EXPECT_OK(
      service_.Upload("map", "d", OnePoint("gain", ScalarType::kInt16)));
}

TEST_F(UploadsTest, NamesThatNoAnswerCouldCarryAreRefused) {
  EXPECT_THAT(
      Refusal("a", MakeUpload(OnePoint("spdf.label", ScalarType::kUint8))),
      StatusIs(kInvalid, HasSubstr("reserved")));
  EXPECT_THAT(Refusal("b", MakeUpload(OnePoint(std::string(250, 'n'),
                                               ScalarType::kUint8))),
              StatusIs(kInvalid, HasSubstr("250 bytes")));
  LatticeCloud wide = OnePoint();
  for (size_t i = 0; i <= kMaxMapAttributes; ++i) {
    wide.attributes.columns().emplace_back(
        core::ColumnSpec{absl::StrCat("a", i), ScalarType::kUint8}, 1);
  }
  EXPECT_THAT(Refusal("c", MakeUpload(wide)),
              StatusIs(kInvalid, HasSubstr("1000 attributes")));
  wide.attributes.columns().pop_back();
  MAPSIEVE_ASSERT_OK(service_.Upload("map", "d", wide));
  MAPSIEVE_ASSERT_OK(service_.Process("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                service_.Query({.map_id = "map", .raw = true}));
  EXPECT_EQ(answer.header.columns.size(), kMaxMapAttributes);
}

TEST_F(UploadsTest, BlockThatIsTooLargeIsRefused) {
  // Encoded it is small: all points are equal.
  LatticeCloud cloud;
  cloud.positions.assign(400'000, {1, 1, 1});
  EXPECT_THAT(Refusal("large", MakeUpload(cloud, cloud.size())),
              StatusIs(kInvalid, AllOf(HasSubstr("9600000 decoded"),
                                       HasSubstr("smaller blocks"))));
  MAPSIEVE_EXPECT_OK(service_.Upload("map", "small", cloud));
}

TEST_F(UploadsTest, DeleteForgetsTheUploadNotItsPoints) {
  MAPSIEVE_ASSERT_OK(service_.Upload("map", "scan", OnePoint()));
  MAPSIEVE_ASSERT_OK(service_->DeleteUpload("map", "scan"));
  EXPECT_THAT(service_->DeleteUpload("map", "scan"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("scan")));
  EXPECT_EQ(service_->GetMapStats("map")->raw_point_count, 1);
}

TEST(Uploads, FullDiskFailsTheOperationAndTheNextAttemptGoesThrough) {
  mapsieve::testing::FaultFileSystem file_system(storage::PosixFileSystem());
  Service service;
  service.options().file_system = &file_system;
  service.Reopen();
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  const LatticeCloud scene = MakeScene(37);
  MAPSIEVE_ASSERT_OK(service.Stage("map", "scan", MakeUpload(scene)));
  file_system.SetFreeBytes(0);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation failed,
                                service.Finalize("map", "scan"));
  EXPECT_THAT(failed.error,
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("")));
  EXPECT_EQ(service->GetUpload("map", "scan")->state, UploadState::kActive);
  EXPECT_EQ(service->GetMap("map")->revision, 1);

  file_system.SetFreeBytes(int64_t{1} << 40);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation done,
                                service.Finalize("map", "scan"));
  MAPSIEVE_ASSERT_OK(done.error);
  EXPECT_NE(done.operation_id, failed.operation_id);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                service.Query({.map_id = "map", .raw = true}));
  EXPECT_EQ(answer.points.size(), scene.size());
}

}  // namespace
}  // namespace mapsieve::engine::testing
