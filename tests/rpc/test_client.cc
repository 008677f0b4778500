#include "tests/rpc/test_client.h"

#include <algorithm>
#include <chrono>
#include <numeric>

#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/codec/points_codec.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/credentials.h"
#include "gtest/gtest.h"
#include "tests/testing/clouds.h"

namespace mapsieve::rpc {

absl::Status FromGrpc(const grpc::Status& status) {
  return absl::Status(static_cast<absl::StatusCode>(status.error_code()),
                      status.error_message());
}

core::LatticeCloud TestScene(int count) {
  return testing::WithAttributes(testing::SceneCloud(count, 6.0, 7), 8);
}

std::vector<std::byte> UploadBytes(const core::LatticeCloud& cloud,
                                   size_t block_points) {
  std::vector<std::byte> bytes;
  for (size_t begin = 0; begin < cloud.size(); begin += block_points) {
    std::vector<uint32_t> rows(std::min(block_points, cloud.size() - begin));
    std::iota(rows.begin(), rows.end(), static_cast<uint32_t>(begin));
    const auto block = core::EncodePoints(cloud.Select(rows));
    EXPECT_TRUE(block.ok()) << block.status();
    bytes.insert(bytes.end(), block->begin(), block->end());
  }
  return bytes;
}

v1::WriteUploadRequest WriteRequest(const std::string& name, int64_t offset,
                                    std::span<const std::byte> bytes) {
  v1::WriteUploadRequest request;
  request.set_name(name);
  request.set_write_offset(offset);
  request.mutable_data()->set_content(bytes.data(), bytes.size());
  request.mutable_data()->set_xxh3_64(Hash64(bytes));
  return request;
}

TestClient::TestClient(const std::string& address)
    : channel(grpc::CreateChannel(address, grpc::InsecureChannelCredentials())),
      maps(v1::MapService::NewStub(channel)),
      uploads(v1::UploadService::NewStub(channel)),
      processing(v1::ProcessingService::NewStub(channel)),
      queries(v1::QueryService::NewStub(channel)),
      operations(v1::Operations::NewStub(channel)) {}

std::unique_ptr<grpc::ClientContext> TestClient::NewContext() const {
  auto context = std::make_unique<grpc::ClientContext>();
  context->set_deadline(std::chrono::system_clock::now() +
                        std::chrono::minutes(1));
  return context;
}

absl::StatusOr<v1::Map> TestClient::CreateMap(const std::string& map_id,
                                              double tile_edge) {
  v1::CreateMapRequest request;
  request.set_map_id(map_id);
  request.set_tile_edge(tile_edge);
  v1::Map map;
  MAPSIEVE_RETURN_IF_ERROR(
      FromGrpc(maps->CreateMap(NewContext().get(), request, &map)));
  return map;
}

absl::StatusOr<v1::Upload> TestClient::CreateUpload(
    const std::string& map_id, const std::string& upload_id,
    std::span<const std::byte> bytes) {
  v1::CreateUploadRequest request;
  request.set_parent("maps/" + map_id);
  request.set_upload_id(upload_id);
  request.mutable_upload()->set_expected_bytes(
      static_cast<int64_t>(bytes.size()));
  request.mutable_upload()->set_content_hash(ContentHash(bytes));
  v1::Upload upload;
  MAPSIEVE_RETURN_IF_ERROR(
      FromGrpc(uploads->CreateUpload(NewContext().get(), request, &upload)));
  return upload;
}

absl::StatusOr<v1::Upload> TestClient::GetUpload(const std::string& name) {
  v1::GetUploadRequest request;
  request.set_name(name);
  v1::Upload upload;
  MAPSIEVE_RETURN_IF_ERROR(
      FromGrpc(uploads->GetUpload(NewContext().get(), request, &upload)));
  return upload;
}

absl::StatusOr<int64_t> TestClient::Write(const std::string& name,
                                          std::span<const std::byte> bytes,
                                          int64_t offset, size_t piece_bytes) {
  const auto context = NewContext();
  const auto stream = uploads->WriteUpload(context.get());
  for (size_t at = 0; at < bytes.size(); at += piece_bytes) {
    const auto piece =
        bytes.subspan(at, std::min(piece_bytes, bytes.size() - at));
    if (!stream->Write(
            WriteRequest(name, offset + static_cast<int64_t>(at), piece))) {
      break;
    }
  }
  stream->WritesDone();
  int64_t committed_bytes = -1;
  for (v1::WriteUploadResponse response; stream->Read(&response);) {
    committed_bytes = response.committed_bytes();
  }
  MAPSIEVE_RETURN_IF_ERROR(FromGrpc(stream->Finish()));
  return committed_bytes;
}

absl::StatusOr<v1::Operation> TestClient::Finalize(const std::string& name) {
  v1::FinalizeUploadRequest request;
  request.set_name(name);
  v1::Operation operation;
  MAPSIEVE_RETURN_IF_ERROR(FromGrpc(
      uploads->FinalizeUpload(NewContext().get(), request, &operation)));
  return operation;
}

absl::StatusOr<v1::UploadReport> TestClient::Upload(
    const std::string& map_id, const std::string& upload_id,
    const core::LatticeCloud& cloud) {
  const std::vector<std::byte> bytes = UploadBytes(cloud, 1000);
  MAPSIEVE_ASSIGN_OR_RETURN(const v1::Upload upload,
                            CreateUpload(map_id, upload_id, bytes));
  MAPSIEVE_RETURN_IF_ERROR(Write(upload.name(), bytes).status());
  MAPSIEVE_ASSIGN_OR_RETURN(const v1::Operation started,
                            Finalize(upload.name()));
  MAPSIEVE_ASSIGN_OR_RETURN(const v1::Operation operation,
                            Wait(started.name()));
  v1::FinalizeUploadResponse response;
  if (!operation.response().UnpackTo(&response)) {
    return absl::InternalError(operation.DebugString());
  }
  return response.report();
}

absl::StatusOr<v1::Operation> TestClient::Process(const std::string& map_id) {
  v1::ProcessMapRequest request;
  request.set_name("maps/" + map_id);
  v1::Operation operation;
  MAPSIEVE_RETURN_IF_ERROR(FromGrpc(
      processing->ProcessMap(NewContext().get(), request, &operation)));
  return operation;
}

absl::StatusOr<v1::Operation> TestClient::Wait(const std::string& name) {
  v1::WaitOperationRequest request;
  request.set_name(name);
  request.mutable_timeout()->set_seconds(50);
  v1::Operation operation;
  MAPSIEVE_RETURN_IF_ERROR(FromGrpc(
      operations->WaitOperation(NewContext().get(), request, &operation)));
  if (!operation.done()) return absl::DeadlineExceededError(name);
  if (operation.has_error()) {
    return absl::Status(static_cast<absl::StatusCode>(operation.error().code()),
                        operation.error().message());
  }
  return operation;
}

absl::StatusOr<Answer> TestClient::Query(
    const v1::QueryRegionRequest& request) {
  const auto context = NewContext();
  const auto stream = queries->QueryRegion(context.get(), request);
  Answer answer;
  v1::QueryRegionResponse response;
  int message = 0;
  bool complete = false;
  for (; stream->Read(&response); ++message) {
    if ((message == 0) != response.has_header() || complete) {
      return absl::InternalError("messages out of order");
    }
    if (response.has_header()) {
      answer.header = response.header();
      answer.cloud.lattice = core::Lattice(answer.header.step_nm());
    } else if (response.has_batch()) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          const auto blocks,
          core::SplitBlocks(TextBytes(response.batch().block())));
      for (const auto& block : blocks) {
        MAPSIEVE_ASSIGN_OR_RETURN(const core::LatticeCloud part,
                                  core::DecodePoints(block));
        MAPSIEVE_RETURN_IF_ERROR(answer.cloud.attributes.AppendAll(
            answer.cloud.size(), part.attributes, part.size()));
        answer.cloud.positions.insert(answer.cloud.positions.end(),
                                      part.positions.begin(),
                                      part.positions.end());
      }
    } else if (response.has_summary()) {
      answer.summary = response.summary();
      complete = true;
    } else {
      return absl::InternalError("an empty message");
    }
  }
  MAPSIEVE_RETURN_IF_ERROR(FromGrpc(stream->Finish()));
  if (!complete) return absl::InternalError("no summary");
  return answer;
}

}  // namespace mapsieve::rpc
