#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/time/clock.h"
#include "core/base/bytes.h"
#include "core/cloud/merge_duplicates.h"
#include "core/spdf/cloud_filter.h"
#include "gmock/gmock.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/generic/generic_stub.h"
#include "grpcpp/security/credentials.h"
#include "gtest/gtest.h"
#include "spdlog/sinks/ostream_sink.h"
#include "tests/rpc/service_fixture.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

using Code = absl::StatusCode;

// What the service must answer for `cloud`.
core::LatticeCloud FilteredHere(const core::LatticeCloud& cloud) {
  const core::SpdfOptions options;
  const auto filtered = core::FilterCloud(cloud, options);
  EXPECT_TRUE(filtered.ok()) << filtered.status();
  const core::FilteredCloud kept =
      filtered->WithoutOutliers(options.outlier_share);
  return core::MakeLabeledCloud(cloud, kept.rows, kept.columns);
}

TEST_F(ServiceTest, AnswersWithWhatTheFilterMakesOfTheUpload) {
  const core::LatticeCloud cloud = TestScene(20'000);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto map,
                                client_->CreateMap("campus", 4.0));
  EXPECT_EQ(map.name(), "maps/campus");
  EXPECT_EQ(map.step_nm(), 1'000'000);
  EXPECT_EQ(map.tile_level(), 12);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto report,
                                client_->Upload("campus", "u", cloud));
  EXPECT_EQ(report.added_point_count(), 20'000);
  EXPECT_EQ(report.block_count(), 20);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Process("campus"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto done, client_->Wait(started.name()));
  v1::ProcessMapResponse processed;
  ASSERT_TRUE(done.response().UnpackTo(&processed));

  core::LatticeCloud expected = FilteredHere(cloud);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Answer answer,
                                client_->Query(QueryOf("campus")));
  EXPECT_GT(expected.size(), 500U);
  // The answer comes coarse first.
  answer.cloud = answer.cloud.Select(core::MortonOrder(answer.cloud.positions));
  EXPECT_EQ(answer.cloud.positions, expected.positions);
  answer.cloud.attributes.SortByName();
  expected.attributes.SortByName();
  EXPECT_EQ(answer.cloud.attributes, expected.attributes);
  const auto count = static_cast<int64_t>(expected.size());
  EXPECT_EQ(answer.summary.point_count(), count);
  EXPECT_EQ(answer.header.revision(), processed.revision());
  EXPECT_GE(answer.header.candidate_point_count(), count);
  EXPECT_EQ(processed.point_count(), count);

  v1::GetMapStatsRequest request;
  request.set_name("maps/campus/stats");
  v1::MapStats stats;
  MAPSIEVE_ASSERT_OK(FromGrpc(client_->maps->GetMapStats(
      client_->NewContext().get(), request, &stats)));
  EXPECT_EQ(stats.raw_point_count(), 20'000);
  EXPECT_EQ(stats.point_count(), count);
  EXPECT_EQ(stats.stale_tile_count(), 0);
  EXPECT_GT(stats.tile_count(), 1);
  EXPECT_GT(stats.stored_bytes(), 0);
  EXPECT_EQ(stats.label_counts().junction() + stats.label_counts().curve() +
                stats.label_counts().surface(),
            count);
  EXPECT_EQ(stats.options().neighbor_count(), 50);
}

TEST_F(ServiceTest, AnswersByRegionLabelBudgetAndColumns) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(20'000)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Process("campus"));
  MAPSIEVE_ASSERT_OK(client_->Wait(started.name()));

  v1::QueryRegionRequest request = QueryOf("campus");
  request.mutable_sphere()->mutable_center();
  request.mutable_sphere()->set_radius(3);
  request.add_labels(v1::LABEL_SURFACE);
  request.mutable_columns()->add_filter_columns(v1::FILTER_COLUMN_LABEL);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer all, client_->Query(request));
  ASSERT_GT(all.cloud.size(), 100U);
  EXPECT_THAT(all.cloud.attributes.specs(),
              ElementsAre(core::ColumnSpec{"label", core::ScalarType::kUint8}));
  for (size_t i = 0; i < all.cloud.size(); ++i) {
    const core::LatticePoint& q = all.cloud.positions[i];
    EXPECT_LE(q.x * q.x + q.y * q.y + q.z * q.z, 9'000'000);
    EXPECT_EQ(all.cloud.attributes.columns()[0].Get<uint8_t>(i), 3);
  }
  request.set_max_point_count(50);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer some, client_->Query(request));
  EXPECT_EQ(some.cloud.size(), 50U);

  v1::QueryRegionRequest raw = QueryOf("campus");
  raw.set_raw(true);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer uploaded, client_->Query(raw));
  EXPECT_EQ(uploaded.cloud.size(), 20'000U);
}

TEST_F(ServiceTest, EmptyMessagesGetAnAnswerThatNamesTheField) {
  const auto context = [&] { return client_->NewContext(); };
  const auto expect_invalid = [](const char* method,
                                 const grpc::Status& status) {
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT)
        << method << ": " << status.error_message();
    v1::RpcStatus details;
    ASSERT_TRUE(details.ParseFromString(status.error_details())) << method;
    ASSERT_EQ(details.details_size(), 1) << method;
    v1::ErrorInfo info;
    EXPECT_TRUE(details.details(0).UnpackTo(&info)) << method;
    EXPECT_EQ(info.domain(), "mapsieve");
  };
  v1::Map map;
  v1::Upload upload;
  v1::Operation operation;
  google::protobuf::Empty empty;
  expect_invalid("CreateMap",
                 client_->maps->CreateMap(context().get(), {}, &map));
  expect_invalid("GetMap", client_->maps->GetMap(context().get(), {}, &map));
  v1::ListMapsResponse maps;
  MAPSIEVE_EXPECT_OK(
      FromGrpc(client_->maps->ListMaps(context().get(), {}, &maps)));
  expect_invalid("DeleteMap",
                 client_->maps->DeleteMap(context().get(), {}, &empty));
  v1::MapStats stats;
  expect_invalid("GetMapStats",
                 client_->maps->GetMapStats(context().get(), {}, &stats));
  v1::ListRevisionsResponse revisions;
  expect_invalid("ListRevisions",
                 client_->maps->ListRevisions(context().get(), {}, &revisions));
  v1::CompareRevisionsResponse comparison;
  expect_invalid("CompareRevisions", client_->maps->CompareRevisions(
                                         context().get(), {}, &comparison));
  expect_invalid("DeleteRegion",
                 client_->maps->DeleteRegion(context().get(), {}, &operation));
  v1::Revision revision;
  expect_invalid("RollBackMap",
                 client_->maps->RollBackMap(context().get(), {}, &revision));
  expect_invalid("CreateUpload",
                 client_->uploads->CreateUpload(context().get(), {}, &upload));
  expect_invalid("GetUpload",
                 client_->uploads->GetUpload(context().get(), {}, &upload));
  v1::ListUploadsResponse uploads;
  expect_invalid("ListUploads",
                 client_->uploads->ListUploads(context().get(), {}, &uploads));
  expect_invalid("DeleteUpload",
                 client_->uploads->DeleteUpload(context().get(), {}, &empty));
  expect_invalid("FinalizeUpload", client_->uploads->FinalizeUpload(
                                       context().get(), {}, &operation));
  expect_invalid("ProcessMap", client_->processing->ProcessMap(context().get(),
                                                               {}, &operation));
  expect_invalid("GetOperation", client_->operations->GetOperation(
                                     context().get(), {}, &operation));
  v1::ListOperationsResponse operations;
  MAPSIEVE_EXPECT_OK(FromGrpc(
      client_->operations->ListOperations(context().get(), {}, &operations)));
  expect_invalid("CancelOperation", client_->operations->CancelOperation(
                                        context().get(), {}, &empty));
  expect_invalid("WaitOperation", client_->operations->WaitOperation(
                                      context().get(), {}, &operation));
  {
    const auto kept = context();
    const auto stream = client_->queries->QueryRegion(kept.get(), {});
    v1::QueryRegionResponse response;
    EXPECT_FALSE(stream->Read(&response));
    expect_invalid("QueryRegion", stream->Finish());
  }
  for (const bool with_request : {false, true}) {
    const auto kept = context();
    const auto stream = client_->uploads->WriteUpload(kept.get());
    if (with_request) stream->Write({});
    stream->WritesDone();
    v1::WriteUploadResponse response;
    EXPECT_FALSE(stream->Read(&response));
    expect_invalid("WriteUpload", stream->Finish());
  }
  MAPSIEVE_EXPECT_OK(client_->CreateMap("alive"));
}

TEST_F(ServiceTest, NamesNeverLeaveTheirPlace) {
  for (const char* id : {"..", "../x", "a/../b", "/etc/passwd", "A", "a b",
                         "a\nb", "-a", "a-", "%2e%2e"}) {
    EXPECT_THAT(client_->CreateMap(id), StatusIs(Code::kInvalidArgument, _))
        << id;
    EXPECT_THAT(client_->Query(QueryOf(id)),
                StatusIs(Code::kInvalidArgument, _))
        << id;
  }
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  for (const char* id : {"..", "../../x", "u/v", ""}) {
    EXPECT_THAT(client_->CreateUpload("campus", id, SomeBytes(8)),
                StatusIs(Code::kInvalidArgument, _))
        << id;
    EXPECT_THAT(client_->GetUpload(std::string("maps/campus/uploads/") + id),
                StatusIs(Code::kInvalidArgument, _))
        << id;
  }
}

TEST_F(ServiceTest, UnknownThingsAreNotFound) {
  EXPECT_THAT(client_->Query(QueryOf("nowhere")),
              StatusIs(Code::kNotFound, HasSubstr("nowhere")));
  EXPECT_THAT(client_->Process("nowhere"), StatusIs(Code::kNotFound, _));
  EXPECT_THAT(client_->CreateUpload("nowhere", "u", SomeBytes(8)),
              StatusIs(Code::kNotFound, _));
  EXPECT_THAT(client_->Wait("operations/abc"), StatusIs(Code::kNotFound, _));
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  EXPECT_THAT(client_->Write(kUpload, SomeBytes(8)),
              StatusIs(Code::kNotFound, _));
  EXPECT_THAT(client_->Finalize(kUpload), StatusIs(Code::kNotFound, _));
}

TEST_F(ServiceTest, AMapHasOneNameOnce) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  EXPECT_THAT(client_->CreateMap("campus"), StatusIs(Code::kAlreadyExists, _));
  v1::DeleteMapRequest request;
  request.set_name("maps/campus");
  google::protobuf::Empty empty;
  MAPSIEVE_ASSERT_OK(FromGrpc(
      client_->maps->DeleteMap(client_->NewContext().get(), request, &empty)));
  MAPSIEVE_EXPECT_OK(client_->CreateMap("campus"));
}

TEST_F(ServiceTest, ListsInPages) {
  for (const char* id : {"c", "a", "b"}) {
    MAPSIEVE_ASSERT_OK(client_->CreateMap(id));
  }
  v1::ListMapsRequest request;
  request.set_page_size(2);
  std::vector<std::string> names;
  do {
    v1::ListMapsResponse response;
    MAPSIEVE_ASSERT_OK(FromGrpc(client_->maps->ListMaps(
        client_->NewContext().get(), request, &response)));
    EXPECT_LE(response.maps_size(), 2);
    for (const v1::Map& map : response.maps()) names.push_back(map.name());
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  EXPECT_THAT(names, ElementsAre("maps/a", "maps/b", "maps/c"));
  request.set_page_size(-1);
  v1::ListMapsResponse response;
  EXPECT_THAT(FromGrpc(client_->maps->ListMaps(client_->NewContext().get(),
                                               request, &response)),
              StatusIs(Code::kInvalidArgument, HasSubstr("page_size")));
}

TEST_F(ServiceTest, QueryBeforeProcessIsAFailedPrecondition) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(1000)));
  EXPECT_THAT(client_->Query(QueryOf("campus")),
              StatusIs(Code::kFailedPrecondition, _));
  v1::QueryRegionRequest request = QueryOf("campus");
  request.set_raw(true);
  MAPSIEVE_EXPECT_OK(client_->Query(request));
  request.set_revision(99);
  EXPECT_THAT(client_->Query(request), StatusIs(Code::kOutOfRange, _));
  request.set_revision(0);
  request.mutable_columns()->add_attributes("no such attribute");
  EXPECT_THAT(client_->Query(request), StatusIs(Code::kNotFound, _));
}

TEST_F(ServiceTest, CancelledOperationLeavesTheMapAsItWas) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(100'000)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Process("campus"));
  EXPECT_THAT(client_->Process("campus"), StatusIs(Code::kAborted, _));
  v1::CancelOperationRequest request;
  request.set_name(started.name());
  google::protobuf::Empty empty;
  MAPSIEVE_ASSERT_OK(FromGrpc(client_->operations->CancelOperation(
      client_->NewContext().get(), request, &empty)));
  EXPECT_THAT(client_->Wait(started.name()), StatusIs(Code::kCancelled, _));
  EXPECT_THAT(client_->Query(QueryOf("campus")),
              StatusIs(Code::kFailedPrecondition, _));
}

TEST_F(ServiceTest, WaitReturnsAfterItsTimeout) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(100'000)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Process("campus"));
  v1::WaitOperationRequest request;
  request.set_name(started.name());
  request.mutable_timeout()->set_nanos(1);
  v1::Operation operation;
  MAPSIEVE_ASSERT_OK(FromGrpc(client_->operations->WaitOperation(
      client_->NewContext().get(), request, &operation)));
  EXPECT_FALSE(operation.done());
  request.mutable_timeout()->set_seconds(-1);
  EXPECT_THAT(FromGrpc(client_->operations->WaitOperation(
                  client_->NewContext().get(), request, &operation)),
              StatusIs(Code::kInvalidArgument, HasSubstr("timeout")));
  EXPECT_TRUE(client_->Wait(started.name()).ok());
}

TEST_F(ServiceTest, AClientThatLeavesOrIsLateDisturbsNobody) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(20'000)));
  v1::QueryRegionRequest request = QueryOf("campus");
  request.set_raw(true);
  for (int i = 0; i < 50; ++i) {
    grpc::ClientContext context;
    if (i % 2 == 0) {
      context.set_deadline(std::chrono::system_clock::now() +
                           std::chrono::microseconds(100 * i));
    }
    const auto stream = client_->queries->QueryRegion(&context, request);
    v1::QueryRegionResponse response;
    if (i % 3 != 0) stream->Read(&response);
    if (i % 2 != 0) context.TryCancel();
    while (stream->Read(&response)) {
    }
    EXPECT_THAT(FromGrpc(stream->Finish()).code(),
                AnyOf(Code::kCancelled, Code::kDeadlineExceeded, Code::kOk));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, client_->Query(request));
  EXPECT_EQ(answer.cloud.size(), 20'000U);
}

TEST_F(ServiceTest, MapsSurviveARestart) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(3000)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Process("campus"));
  MAPSIEVE_ASSERT_OK(client_->Wait(started.name()));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer before,
                                client_->Query(QueryOf("campus")));
  server_.reset();
  StartServer();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer after,
                                client_->Query(QueryOf("campus")));
  EXPECT_EQ(after.cloud.positions, before.cloud.positions);
  EXPECT_EQ(after.cloud.attributes, before.cloud.attributes);
  MAPSIEVE_EXPECT_OK(client_->Wait(started.name()));
}

TEST_F(ServiceTest, OneServerHasADirectoryAndAPort) {
  ServerOptions options = Options();
  EXPECT_THAT(Server::Start(options, logger_), StatusIs(Code::kAborted, _));
  options.data_dir = folder_.path() + "/other";
  options.listen = server_->address();
  EXPECT_THAT(
      Server::Start(options, logger_),
      StatusIs(Code::kUnavailable, HasSubstr(server_->address().ToString())));
}

// A raw call, as the messages of these services are not packaged.
grpc::Status CallRaw(const std::shared_ptr<grpc::Channel>& channel,
                     const std::string& method, const std::string& request,
                     std::string& response) {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::seconds(20));
  grpc::CompletionQueue queue;
  const auto call = stub.PrepareCall(&context, method, &queue);
  const auto next = [&queue] {
    void* tag = nullptr;
    bool ok = false;
    return queue.Next(&tag, &ok) && ok;
  };
  call->StartCall(nullptr);
  next();
  const grpc::Slice slice(request);
  call->WriteLast(grpc::ByteBuffer(&slice, 1), grpc::WriteOptions(), nullptr);
  next();
  grpc::ByteBuffer buffer;
  call->Read(&buffer, nullptr);
  if (next()) {
    std::vector<grpc::Slice> slices;
    buffer.Dump(&slices);
    for (const grpc::Slice& piece : slices) {
      response.append(reinterpret_cast<const char*>(piece.begin()),
                      piece.size());
    }
  }
  grpc::Status status;
  call->Finish(&status, nullptr);
  next();
  return status;
}

// The serving status of a service by number (1 serving, 2 not), 0 if unknown.
int HealthOf(const std::shared_ptr<grpc::Channel>& channel,
             const std::string& service) {
  std::string request = "\x0a";
  request += static_cast<char>(service.size());
  request += service;
  std::string response;
  const grpc::Status status =
      CallRaw(channel, "/grpc.health.v1.Health/Check", request, response);
  return status.ok() && response.size() == 2 && response[0] == 8 ? response[1]
                                                                 : 0;
}

TEST_F(ServiceTest, HealthAnswersForEachService) {
  for (const char* service :
       {"", "mapsieve.v1.MapService", "mapsieve.v1.UploadService",
        "mapsieve.v1.ProcessingService", "mapsieve.v1.QueryService",
        "mapsieve.v1.Operations"}) {
    EXPECT_EQ(HealthOf(client_->channel, service), 1) << service;
  }
  EXPECT_EQ(HealthOf(client_->channel, "mapsieve.v1.NoService"), 0);
}

// Whether `service` has that status within a while.
bool BecomesHealth(const std::shared_ptr<grpc::Channel>& channel,
                   const std::string& service, int health) {
  const absl::Time end = absl::Now() + absl::Seconds(20);
  while (HealthOf(channel, service) != health) {
    if (absl::Now() > end) return false;
    absl::SleepFor(absl::Milliseconds(20));
  }
  return true;
}

TEST_F(ServiceTest, LogTellsOfOperationsThatFail) {
  std::ostringstream log;
  logger_.sinks().push_back(
      std::make_shared<spdlog::sinks::ostream_sink_mt>(log));
  const auto bytes = SomeBytes(1000);
  StartUpload(bytes);
  MAPSIEVE_ASSERT_OK(client_->Write(kUpload, bytes));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto run, client_->Finalize(kUpload));
  EXPECT_THAT(client_->Wait(run.name()), StatusIs(Code::kDataLoss, _));
  server_.reset();
  EXPECT_THAT(log.str(), HasSubstr(absl::StrCat(
                             "FinalizeUpload of ", kUpload, ", operation ",
                             run.name().substr(sizeof("operations")),
                             ": DATA_LOSS: upload u, block 0 at 0")));
}

TEST_F(ServiceTest, HealthTellsOfAFullDiskWhileQueriesGoOn) {
  std::ostringstream log;
  logger_.sinks().push_back(
      std::make_shared<spdlog::sinks::ostream_sink_mt>(log));
  mapsieve::testing::FaultFileSystem files(storage::PosixFileSystem());
  const auto start = [&] {
    server_.reset();
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(server_,
                                  Server::Start(Options(), logger_, &files));
    client_ = std::make_unique<TestClient>(server_->address().ToString());
  };
  start();
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "first", TestScene(2000)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto run, client_->Process("campus"));
  MAPSIEVE_ASSERT_OK(client_->Wait(run.name()));
  MAPSIEVE_ASSERT_OK(client_->CreateMap("other"));
  const auto bytes = UploadBytes(TestScene(3000), 1000);
  MAPSIEVE_ASSERT_OK(client_->CreateUpload("campus", "u", bytes));

  // As much as the reserve.
  files.SetFreeBytes(int64_t{64} << 20);
  for (const char* stopped :
       {"mapsieve.v1.UploadService", "mapsieve.v1.ProcessingService"}) {
    EXPECT_TRUE(BecomesHealth(client_->channel, stopped, 2)) << stopped;
  }
  const auto others_serve = [&] {
    for (const char* service :
         {"", "mapsieve.v1.MapService", "mapsieve.v1.QueryService",
          "mapsieve.v1.Operations"}) {
      EXPECT_EQ(HealthOf(client_->channel, service), 1) << service;
    }
  };
  others_serve();
  EXPECT_THAT(client_->Write(kUpload, bytes),
              StatusIs(Code::kResourceExhausted, HasSubstr("reserve")));
  EXPECT_THAT(client_->CreateUpload("campus", "v", bytes),
              StatusIs(Code::kResourceExhausted, HasSubstr("reserve")));
  MAPSIEVE_EXPECT_OK(client_->Query(QueryOf("campus")));
  v1::DeleteMapRequest deletion;
  deletion.set_name("maps/other");
  google::protobuf::Empty nothing;
  MAPSIEVE_EXPECT_OK(FromGrpc(client_->maps->DeleteMap(
      client_->NewContext().get(), deletion, &nothing)));

  // A server that begins on a full disk says so from the beginning.
  start();
  EXPECT_EQ(HealthOf(client_->channel, "mapsieve.v1.UploadService"), 2);
  others_serve();

  files.SetFreeBytes(int64_t{1} << 40);
  for (const char* stopped :
       {"mapsieve.v1.UploadService", "mapsieve.v1.ProcessingService"}) {
    EXPECT_TRUE(BecomesHealth(client_->channel, stopped, 1)) << stopped;
  }
  MAPSIEVE_EXPECT_OK(client_->Write(kUpload, bytes));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto finalize,
                                client_->Finalize(kUpload));
  MAPSIEVE_EXPECT_OK(client_->Wait(finalize.name()));
  server_.reset();
  EXPECT_THAT(log.str(), AllOf(HasSubstr("are refused: RESOURCE_EXHAUSTED"),
                               HasSubstr("has space again")));
}

TEST_F(ServiceTest, ReflectionListsTheServices) {
  std::string response;
  CallRaw(client_->channel,
          "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
          std::string("\x3a\x00", 2), response);
  EXPECT_THAT(response, HasSubstr("mapsieve.v1.QueryService"));
  EXPECT_THAT(response, HasSubstr("grpc.health.v1.Health"));
}

TEST_F(ServiceTest, DrainingEndsWaitsAndRefusesCalls) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  const auto bytes = SomeBytes(1000);
  MAPSIEVE_ASSERT_OK(client_->CreateUpload("campus", "u", bytes));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "v", TestScene(60'000)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client_->Process("campus"));
  absl::Status waited;
  std::thread waiter([&] { waited = client_->Wait(started.name()).status(); });
  // This upload keeps the server in its grace.
  const auto context = client_->NewContext();
  const auto stream = client_->uploads->WriteUpload(context.get());
  v1::WriteUploadRequest request =
      WriteRequest(kUpload, 0, std::span(bytes).first(100));
  request.set_flush(true);
  ASSERT_TRUE(stream->Write(request));
  v1::WriteUploadResponse response;
  ASSERT_TRUE(stream->Read(&response));

  const absl::Time begin = absl::Now();
  std::thread shutdown([&] { server_->Shutdown(absl::Seconds(30)); });
  waiter.join();
  EXPECT_THAT(waited, StatusIs(Code::kUnavailable, _));
  EXPECT_THAT(client_->CreateMap("late"), StatusIs(Code::kUnavailable, _));
  // What it sends is kept and acknowledged, and then it has to go elsewhere.
  ASSERT_TRUE(
      stream->Write(WriteRequest("", 100, std::span(bytes).subspan(100, 50))));
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.committed_bytes(), 150);
  EXPECT_FALSE(stream->Read(&response));
  EXPECT_THAT(FromGrpc(stream->Finish()), StatusIs(Code::kUnavailable, _));
  shutdown.join();
  EXPECT_LT(absl::Now() - begin, absl::Seconds(25));

  server_.reset();
  StartServer();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto upload, client_->GetUpload(kUpload));
  EXPECT_EQ(upload.committed_bytes(), 150);
  // The operation went on.
  MAPSIEVE_EXPECT_OK(client_->Wait(started.name()));
}

TEST_F(ServiceTest, GraceEndsCallsThatDoNot) {
  const auto bytes = SomeBytes(1000);
  StartUpload(bytes);
  const auto context = client_->NewContext();
  const auto stream = client_->uploads->WriteUpload(context.get());
  v1::WriteUploadRequest request =
      WriteRequest(kUpload, 0, std::span(bytes).first(100));
  request.set_flush(true);
  ASSERT_TRUE(stream->Write(request));
  v1::WriteUploadResponse response;
  ASSERT_TRUE(stream->Read(&response));
  server_->Shutdown(absl::Milliseconds(100));
  EXPECT_FALSE(stream->Read(&response));
  EXPECT_FALSE(stream->Finish().ok());
}

}  // namespace
}  // namespace mapsieve::rpc
