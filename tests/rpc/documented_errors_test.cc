// Every error that the comment of a call names, and how to get it. The rows are
// compared with the comments: an error without a row fails, and so does a row
// without its error.

#include <cstddef>
#include <filesystem>
#include <fstream>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "google/protobuf/descriptor.h"
#include "google/protobuf/message.h"
#include "google/protobuf/text_format.h"
#include "grpcpp/generic/generic_stub.h"
#include "gtest/gtest.h"
#include "tests/api/api_comments.h"
#include "tests/api/api_files.h"
#include "tests/rpc/failing_calls.h"
#include "tests/rpc/service_fixture.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

namespace pb = google::protobuf;

using ::mapsieve::testing::StatusIs;
using ::testing::_;

using Code = absl::StatusCode;

std::string CodeName(Code code) { return absl::StatusCodeToString(code); }

TEST(DocumentedErrors, AreThoseThatTestsProvoke) {
  const auto api = testing::ReadApi(PROJECT_ROOT);
  ASSERT_EQ(api->errors(), "");
  std::set<Place> documented;
  for (const auto* file : api->files()) {
    for (int i = 0; i < file->service_count(); ++i) {
      const pb::ServiceDescriptor& service = *file->service(i);
      for (int k = 0; k < service.method_count(); ++k) {
        const std::string name =
            absl::StrCat(service.name(), ".", service.method(k)->name());
        const auto comment = testing::CommentOfMethod(*service.method(k));
        for (const auto& error : comment.errors) {
          documented.insert({name, false, error.code});
        }
        for (const auto& error : comment.operation_errors) {
          documented.insert({name, true, error.code});
        }
      }
    }
  }
  std::set<Place> provoked;
  for (const FailingCalls* calls :
       {&AtRest(), &OnAFullDisk(), &WhileOperationsGoOn()}) {
    for (const FailingCall& call : *calls) {
      provoked.insert({call.method, false, CodeName(call.code)});
    }
  }
  for (const ElsewherePlace& elsewhere : Elsewhere()) {
    EXPECT_TRUE(provoked.insert(elsewhere.place).second)
        << ::testing::PrintToString(elsewhere.place) << " has two places";
  }
  EXPECT_EQ(documented, provoked);
}

class DocumentedErrorsTest : public ServiceTest {
 protected:
  void SetUp() override {
    server_.reset();
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(server_,
                                  Server::Start(Options(), logger_, &files_));
    client_ = std::make_unique<TestClient>(server_->address().ToString());
    MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
    MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(2000)));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto run, client_->Process("campus"));
    MAPSIEVE_ASSERT_OK(client_->Wait(run.name()));
    MAPSIEVE_ASSERT_OK(client_->CreateMap("empty"));
    MAPSIEVE_ASSERT_OK(client_->CreateUpload("empty", "u", SomeBytes(10)));
  }

  // The server uses the file system of this object.
  void TearDown() override {
    files_.Release();
    server_.reset();
  }

  // An upload `whole` of `point_count` points whose bytes are all there.
  void MakeWholeUpload(const std::string& map_id, int point_count = 1000) {
    const auto bytes = UploadBytes(TestScene(point_count), 1000);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto upload, client_->CreateUpload(map_id, "whole", bytes));
    MAPSIEVE_ASSERT_OK(client_->Write(upload.name(), bytes));
  }

  // Calls any method, reads the whole answer and returns how it ended;
  // `response` gets the last message.
  absl::Status Call(const std::string& method,
                    const std::vector<std::string>& requests,
                    std::string* response = nullptr,
                    absl::Duration timeout = absl::Minutes(1)) {
    const pb::MethodDescriptor* descriptor =
        pb::DescriptorPool::generated_pool()->FindMethodByName(
            absl::StrCat("mapsieve.v1.", method));
    if (descriptor == nullptr) return absl::UnknownError("no such method");
    grpc::ClientContext context;
    context.set_deadline(absl::ToChronoTime(absl::Now() + timeout));
    grpc::CompletionQueue queue;
    const auto next = [&queue] {
      void* tag = nullptr;
      bool ok = false;
      return queue.Next(&tag, &ok) && ok;
    };
    grpc::GenericStub stub(client_->channel);
    const auto call =
        stub.PrepareCall(&context,
                         absl::StrCat("/", descriptor->service()->full_name(),
                                      "/", descriptor->name()),
                         &queue);
    call->StartCall(nullptr);
    next();
    for (const std::string& text : requests) {
      const std::unique_ptr<pb::Message> request(
          pb::MessageFactory::generated_factory()
              ->GetPrototype(descriptor->input_type())
              ->New());
      const auto sum = WriteRequest("", 0, std::as_bytes(std::span("a", 1)))
                           .data()
                           .xxh3_64();
      if (!pb::TextFormat::ParseFromString(
              absl::StrReplaceAll(text, {{"$SUM", absl::StrCat(sum)}}),
              request.get())) {
        return absl::UnknownError(absl::StrCat("cannot parse: ", text));
      }
      const grpc::Slice slice(request->SerializeAsString());
      call->Write(grpc::ByteBuffer(&slice, 1), nullptr);
      next();
    }
    call->WritesDone(nullptr);
    next();
    grpc::ByteBuffer buffer;
    for (call->Read(&buffer, nullptr); next(); call->Read(&buffer, nullptr)) {
      grpc::Slice slice;
      if (response != nullptr && buffer.DumpToSingleSlice(&slice).ok()) {
        response->assign(reinterpret_cast<const char*>(slice.begin()),
                         slice.size());
      }
    }
    grpc::Status status;
    call->Finish(&status, nullptr);
    next();
    return FromGrpc(status);
  }

  void ExpectAllFail(const FailingCalls& calls) {
    for (const FailingCall& call : calls) {
      EXPECT_THAT(Call(call.method, call.requests), StatusIs(call.code, _))
          << call.method << " {" << call.requests.front() << "}";
    }
  }

  // Starts an operation that a call with this request makes.
  v1::Operation Start(const std::string& method, const std::string& request) {
    std::string response;
    MAPSIEVE_EXPECT_OK(Call(method, {request}, &response));
    v1::Operation operation;
    EXPECT_TRUE(operation.ParseFromString(response));
    return operation;
  }

  // Processes maps/campus, and waits at its first chunk until files_.Release():
  // other operations on the map wait for it.
  v1::Operation StartHeldRun() {
    files_.Hold("/blobs/");
    const v1::Operation run =
        Start("ProcessingService.ProcessMap",
              "name: 'maps/campus' options { density_radius_m: 0.9 }");
    files_.AwaitHeld();
    return run;
  }

  absl::Status Cancel(const v1::Operation& operation) {
    return Call("Operations.CancelOperation",
                {absl::StrCat("name: '", operation.name(), "'")});
  }

  static void WriteByte(const std::filesystem::path& path, int64_t offset) {
    std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(offset);
    file.put('\x55');
  }

  // The last byte of every chunk.
  void DamageBlobs() {
    for (const auto& entry : std::filesystem::recursive_directory_iterator(
             folder_.path() + "/data/blobs")) {
      if (!entry.is_regular_file()) continue;
      WriteByte(entry.path(), static_cast<int64_t>(entry.file_size()) - 1);
    }
  }

  mapsieve::testing::FaultFileSystem files_{storage::PosixFileSystem()};
};

TEST_F(DocumentedErrorsTest, AtRest) { ExpectAllFail(AtRest()); }

TEST_F(DocumentedErrorsTest, OnAFullDisk) {
  files_.SetFreeBytes(int64_t{64} << 20);
  ExpectAllFail(OnAFullDisk());
}

TEST_F(DocumentedErrorsTest, WhileOperationsGoOn) {
  MakeWholeUpload("campus");
  const v1::Operation run = StartHeldRun();
  Start("MapService.RepairMap", "name: 'maps/campus'");
  Start("UploadService.FinalizeUpload", "name: 'maps/campus/uploads/whole'");
  ExpectAllFail(WhileOperationsGoOn());
  MAPSIEVE_EXPECT_OK(Cancel(run));
}

TEST_F(DocumentedErrorsTest, OperationsAreCancelled) {
  MakeWholeUpload("campus");
  const v1::Operation run = StartHeldRun();
  const std::vector<v1::Operation> waiting = {
      Start("UploadService.FinalizeUpload",
            "name: 'maps/campus/uploads/whole'"),
      Start("MapService.DeleteRegion",
            "name: 'maps/campus' sphere { center {} radius: 1 }"),
      Start("MapService.RepairMap", "name: 'maps/campus'")};
  for (const v1::Operation& operation : waiting) {
    MAPSIEVE_EXPECT_OK(Cancel(operation));
    EXPECT_THAT(client_->Wait(operation.name()), StatusIs(Code::kCancelled, _));
  }
  MAPSIEVE_EXPECT_OK(Cancel(run));
  files_.Release();
  EXPECT_THAT(client_->Wait(run.name()), StatusIs(Code::kCancelled, _));
}

TEST_F(DocumentedErrorsTest, OperationsFailOnAFullDisk) {
  MakeWholeUpload("campus");
  files_.SetFreeBytes(int64_t{64} << 20);
  for (const v1::Operation& operation :
       {Start("UploadService.FinalizeUpload",
              "name: 'maps/campus/uploads/whole'"),
        Start("MapService.DeleteRegion",
              "name: 'maps/campus' sphere { center {} radius: 1 }"),
        Start("ProcessingService.ProcessMap",
              "name: 'maps/campus' options { density_radius_m: 0.5 }")}) {
    EXPECT_THAT(client_->Wait(operation.name()),
                StatusIs(Code::kResourceExhausted, _))
        << operation.name();
  }
}

TEST_F(DocumentedErrorsTest, ABlockOnAnotherLatticeIsInvalid) {
  core::LatticeCloud cloud = TestScene(10);
  cloud.lattice = core::Lattice(2'000'000);
  EXPECT_THAT(client_->Upload("campus", "coarse", cloud),
              StatusIs(Code::kInvalidArgument, _));
}

TEST_F(DocumentedErrorsTest, DamagedChunksAreDataLoss) {
  v1::QueryRegionRequest resumed = QueryOf("campus");
  resumed.set_allow_partial(true);
  {
    const auto context = client_->NewContext();
    const auto stream = client_->queries->QueryRegion(context.get(), resumed);
    v1::QueryRegionResponse response;
    while (resumed.resume_token().empty() && stream->Read(&response)) {
      resumed.set_resume_token(response.batch().resume_token());
    }
    context->TryCancel();
  }
  DamageBlobs();
  EXPECT_THAT(client_->Query(QueryOf("campus")), StatusIs(Code::kDataLoss, _));
  EXPECT_THAT(client_->Query(resumed), StatusIs(Code::kAborted, _));
  EXPECT_THAT(
      Call("QueryService.SyncRegion", {"query { name: 'maps/campus' }"}),
      StatusIs(Code::kDataLoss, _));
  for (const v1::Operation& operation :
       {Start("MapService.DeleteRegion",
              "name: 'maps/campus' sphere { center {} radius: 1 }"),
        Start("ProcessingService.ProcessMap",
              "name: 'maps/campus' options { density_radius_m: 0.5 }")}) {
    EXPECT_THAT(client_->Wait(operation.name()), StatusIs(Code::kDataLoss, _));
  }
}

TEST_F(DocumentedErrorsTest, ADamagedCatalogueIsDataLoss) {
  client_.reset();
  server_.reset();
  const std::string path = folder_.path() + "/data/catalogue.db";
  const std::string backup = folder_.path() + "/catalogue.db";
  std::filesystem::copy_file(path, backup);
  constexpr int64_t kPageBytes = 4096;
  const auto size = static_cast<int64_t>(std::filesystem::file_size(path));
  bool verify_fails = false;
  bool repair_fails = false;
  for (int64_t page = 0; page < size / kPageBytes; ++page) {
    std::filesystem::copy_file(
        backup, path, std::filesystem::copy_options::overwrite_existing);
    WriteByte(path, page * kPageBytes + kPageBytes / 2);
    auto server = Server::Start(Options(), logger_, &files_);
    if (!server.ok()) {
      EXPECT_THAT(server.status(), StatusIs(Code::kDataLoss, _));
      continue;
    }
    server_ = *std::move(server);
    client_ = std::make_unique<TestClient>(server_->address().ToString());
    const absl::Status verified =
        Call("MapService.VerifyMap", {"name: 'maps/campus'"});
    verify_fails |= absl::IsDataLoss(verified);
    std::string response;
    v1::Operation repair;
    if (Call("MapService.RepairMap", {"name: 'maps/campus'"}, &response).ok() &&
        repair.ParseFromString(response)) {
      repair_fails |= absl::IsDataLoss(client_->Wait(repair.name()).status());
    }
    client_.reset();
    server_.reset();
  }
  EXPECT_TRUE(verify_fails);
  EXPECT_TRUE(repair_fails);
}

TEST_F(DocumentedErrorsTest, ARepairNeedsStorage) {
  bool fails = false;
  for (int operation = 1; !fails && operation < 200; ++operation) {
    DamageBlobs();
    files_.Arm({.operation = operation,
                .status = absl::UnavailableError("cable"),
                .lasts = false});
    std::string response;
    v1::Operation repair;
    if (Call("MapService.RepairMap", {"name: 'maps/campus'"}, &response).ok() &&
        repair.ParseFromString(response)) {
      fails = absl::IsUnavailable(client_->Wait(repair.name()).status());
    }
    files_.Disarm();
  }
  EXPECT_TRUE(fails);
}

template <typename Request>
Request OfCampus(Request request) {
  request.set_name("maps/campus");
  return request;
}

TEST_F(DocumentedErrorsTest, CallersEndStreams) {
  EXPECT_THAT(Call("MapService.WatchMap", {"name: 'maps/campus'"}, nullptr,
                   absl::Milliseconds(300)),
              StatusIs(Code::kDeadlineExceeded, _));
  for (const char* method :
       {"MapService.VerifyMap", "QueryService.QueryRegion"}) {
    EXPECT_THAT(
        Call(method, {"name: 'maps/campus'"}, nullptr, absl::Nanoseconds(1)),
        StatusIs(Code::kDeadlineExceeded, _));
  }
  EXPECT_THAT(Call("QueryService.SyncRegion", {"query { name: 'maps/campus' }"},
                   nullptr, absl::Nanoseconds(1)),
              StatusIs(Code::kDeadlineExceeded, _));
  const auto expect_cancelled = [&](const auto& start, auto request,
                                    auto response) {
    const auto context = client_->NewContext();
    const auto stream = start(context.get(), request);
    context->TryCancel();
    while (stream->Read(&response)) {
    }
    EXPECT_THAT(FromGrpc(stream->Finish()), StatusIs(Code::kCancelled, _));
  };
  expect_cancelled(
      [&](auto* context, const auto& request) {
        return client_->maps->WatchMap(context, request);
      },
      OfCampus(v1::WatchMapRequest()), v1::WatchMapResponse());
  expect_cancelled(
      [&](auto* context, const auto& request) {
        return client_->maps->VerifyMap(context, request);
      },
      OfCampus(v1::VerifyMapRequest()), v1::VerifyMapResponse());
  expect_cancelled(
      [&](auto* context, const auto& request) {
        return client_->queries->QueryRegion(context, request);
      },
      OfCampus(v1::QueryRegionRequest()), v1::QueryRegionResponse());
  v1::SyncRegionRequest sync;
  *sync.mutable_query() = OfCampus(v1::QueryRegionRequest());
  expect_cancelled(
      [&](auto* context, const auto& request) {
        return client_->queries->SyncRegion(context, request);
      },
      sync, v1::SyncRegionResponse());
}

}  // namespace
}  // namespace mapsieve::rpc
