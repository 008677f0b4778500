#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "google/protobuf/descriptor.h"
#include "google/protobuf/message.h"
#include "gtest/gtest.h"
#include "tests/rpc/service_fixture.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

using google::protobuf::FieldDescriptor;
using google::protobuf::Message;

// Fills messages with values that are legal on the wire and seldom meant.
class Filler {
 public:
  explicit Filler(uint64_t seed) : random_(seed) {}

  void Fill(Message& message) {
    const auto& descriptor = *message.GetDescriptor();
    for (int i = 0; i < descriptor.field_count(); ++i) {
      const FieldDescriptor& field = *descriptor.field(i);
      const uint64_t repeats = field.is_repeated() ? random_() % 4 : 1;
      if (random_() % 4 == 0) continue;
      for (uint64_t k = 0; k < repeats; ++k) FillField(message, field);
    }
  }

 private:
  template <typename T>
  T Pick(const std::vector<T>& values) {
    return values[random_() % values.size()];
  }

  void FillField(Message& message, const FieldDescriptor& field) {
    const auto& reflection = *message.GetReflection();
    const bool repeated = field.is_repeated();
    switch (field.cpp_type()) {
      case FieldDescriptor::CPPTYPE_MESSAGE:
        Fill(repeated ? *reflection.AddMessage(&message, &field)
                      : *reflection.MutableMessage(&message, &field));
        break;
      case FieldDescriptor::CPPTYPE_STRING: {
        const std::string text = Pick<std::string>(
            {"", "maps/campus", "maps/campus/stats", "maps/campus/uploads/u",
             "campus", "operations/1", "maps/../..", "..", "u", "x y",
             std::string(70'000, 'a'), std::string("a\0b", 3), "ß", "label",
             "00000000000000000000000000000000"});
        repeated ? reflection.AddString(&message, &field, text)
                 : reflection.SetString(&message, &field, text);
        break;
      }
      case FieldDescriptor::CPPTYPE_ENUM: {
        const int value = Pick<int>({0, 1, 2, 3, 4, 5, 77, -1});
        repeated ? reflection.AddEnumValue(&message, &field, value)
                 : reflection.SetEnumValue(&message, &field, value);
        break;
      }
      case FieldDescriptor::CPPTYPE_DOUBLE:
        reflection.SetDouble(
            &message, &field,
            Pick<double>({0.0, -0.0, 1.0, -1.0, 0.25, 40.0, 1e-300, 1e300,
                          5e-324, std::nan(""),
                          std::numeric_limits<double>::infinity(),
                          -std::numeric_limits<double>::infinity()}));
        break;
      case FieldDescriptor::CPPTYPE_INT32:
        reflection.SetInt32(
            &message, &field,
            Pick<int32_t>({0, 1, -1, 15, 50, 127, 1 << 20,
                           std::numeric_limits<int32_t>::max(),
                           std::numeric_limits<int32_t>::min()}));
        break;
      case FieldDescriptor::CPPTYPE_INT64: {
        const auto value = Pick<int64_t>({0, 1, -1, 2, 1000, int64_t{1} << 42,
                                          std::numeric_limits<int64_t>::max(),
                                          std::numeric_limits<int64_t>::min()});
        repeated ? reflection.AddInt64(&message, &field, value)
                 : reflection.SetInt64(&message, &field, value);
        break;
      }
      case FieldDescriptor::CPPTYPE_UINT64:
        reflection.SetUInt64(&message, &field, random_());
        break;
      case FieldDescriptor::CPPTYPE_BOOL:
        reflection.SetBool(&message, &field, random_() % 2 == 0);
        break;
      default:
        ADD_FAILURE() << "no values for " << field.full_name();
    }
  }

  std::mt19937_64 random_;
};

// Every answer is a code that the API knows, and the server goes on.
void ExpectAnswered(const char* method, const grpc::Status& status) {
  switch (status.error_code()) {
    case grpc::StatusCode::UNKNOWN:
    case grpc::StatusCode::INTERNAL:
    case grpc::StatusCode::UNAVAILABLE:
    case grpc::StatusCode::UNIMPLEMENTED:
      ADD_FAILURE() << method << ": " << status.error_code() << " "
                    << status.error_message();
      break;
    default:
      break;
  }
}

using RandomRequestsTest = ServiceTest;

TEST_F(RandomRequestsTest, AreAnsweredAndNeverEndTheServer) {
  Filler filler(1);
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "first", TestScene(500)));
  const auto call = [&](const char* method, auto request, auto response,
                        const auto& stub, auto member) {
    filler.Fill(request);
    ExpectAnswered(method, (*stub.*member)(client_->NewContext().get(), request,
                                           &response));
  };
  using MapStub = v1::MapService::Stub;
  using UploadStub = v1::UploadService::Stub;
  using OperationStub = v1::Operations::Stub;
  using google::protobuf::Empty;
  for (int round = 0; round < 60; ++round) {
    TestClient& c = *client_;
    call("CreateMap", v1::CreateMapRequest(), v1::Map(), c.maps,
         &MapStub::CreateMap);
    call("GetMap", v1::GetMapRequest(), v1::Map(), c.maps, &MapStub::GetMap);
    call("ListMaps", v1::ListMapsRequest(), v1::ListMapsResponse(), c.maps,
         &MapStub::ListMaps);
    call("GetMapStats", v1::GetMapStatsRequest(), v1::MapStats(), c.maps,
         &MapStub::GetMapStats);
    call("ListRevisions", v1::ListRevisionsRequest(),
         v1::ListRevisionsResponse(), c.maps, &MapStub::ListRevisions);
    call("CompareRevisions", v1::CompareRevisionsRequest(),
         v1::CompareRevisionsResponse(), c.maps, &MapStub::CompareRevisions);
    call("CreateUpload", v1::CreateUploadRequest(), v1::Upload(), c.uploads,
         &UploadStub::CreateUpload);
    call("GetUpload", v1::GetUploadRequest(), v1::Upload(), c.uploads,
         &UploadStub::GetUpload);
    call("ListUploads", v1::ListUploadsRequest(), v1::ListUploadsResponse(),
         c.uploads, &UploadStub::ListUploads);
    call("FinalizeUpload", v1::FinalizeUploadRequest(), v1::Operation(),
         c.uploads, &UploadStub::FinalizeUpload);
    call("DeleteUpload", v1::DeleteUploadRequest(), Empty(), c.uploads,
         &UploadStub::DeleteUpload);
    call("ProcessMap", v1::ProcessMapRequest(), v1::Operation(), c.processing,
         &v1::ProcessingService::Stub::ProcessMap);
    call("RepairMap", v1::RepairMapRequest(), v1::Operation(), c.maps,
         &MapStub::RepairMap);
    call("GetOperation", v1::GetOperationRequest(), v1::Operation(),
         c.operations, &OperationStub::GetOperation);
    call("ListOperations", v1::ListOperationsRequest(),
         v1::ListOperationsResponse(), c.operations,
         &OperationStub::ListOperations);
    call("CancelOperation", v1::CancelOperationRequest(), Empty(), c.operations,
         &OperationStub::CancelOperation);
    call("WaitOperation", v1::WaitOperationRequest(), v1::Operation(),
         c.operations, &OperationStub::WaitOperation);
    {
      v1::QueryRegionRequest request;
      filler.Fill(request);
      const auto context = c.NewContext();
      const auto stream = c.queries->QueryRegion(context.get(), request);
      for (v1::QueryRegionResponse response; stream->Read(&response);) {
      }
      ExpectAnswered("QueryRegion", stream->Finish());
    }
    {
      v1::VerifyMapRequest request;
      filler.Fill(request);
      const auto context = c.NewContext();
      const auto stream = c.maps->VerifyMap(context.get(), request);
      for (v1::VerifyMapResponse response; stream->Read(&response);) {
      }
      ExpectAnswered("VerifyMap", stream->Finish());
    }
    {
      const auto context = c.NewContext();
      const auto stream = c.uploads->WriteUpload(context.get());
      for (int i = 0; i < 3; ++i) {
        v1::WriteUploadRequest request;
        filler.Fill(request);
        if (!stream->Write(request)) break;
      }
      stream->WritesDone();
      for (v1::WriteUploadResponse response; stream->Read(&response);) {
      }
      ExpectAnswered("WriteUpload", stream->Finish());
    }
  }
  // Nothing of all this touched the points.
  v1::QueryRegionRequest raw = QueryOf("campus");
  raw.set_raw(true);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, client_->Query(raw));
  EXPECT_EQ(answer.cloud.size(), 500U);
  for (int round = 0; round < 60; ++round) {
    call("DeleteRegion", v1::DeleteRegionRequest(), v1::Operation(),
         client_->maps, &MapStub::DeleteRegion);
    call("RollBackMap", v1::RollBackMapRequest(), v1::Revision(), client_->maps,
         &MapStub::RollBackMap);
  }
  MAPSIEVE_EXPECT_OK(client_->CreateMap("alive"));
}

}  // namespace
}  // namespace mapsieve::rpc
