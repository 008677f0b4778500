#ifndef MAPSIEVE_TESTS_RPC_TEST_CLIENT_H_
#define MAPSIEVE_TESTS_RPC_TEST_CLIENT_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"
#include "grpcpp/channel.h"
#include "mapsieve/v1/map_service.grpc.pb.h"
#include "mapsieve/v1/operations.grpc.pb.h"
#include "mapsieve/v1/processing_service.grpc.pb.h"
#include "mapsieve/v1/query_service.grpc.pb.h"
#include "mapsieve/v1/upload_service.grpc.pb.h"

namespace mapsieve::rpc {

absl::Status FromGrpc(const grpc::Status& status);

/// `count` points of a fixed scene with attributes, on a 1 mm lattice.
core::LatticeCloud TestScene(int count);

/// `cloud` as point blocks of `block_points` points, back to back.
std::vector<std::byte> UploadBytes(const core::LatticeCloud& cloud,
                                   size_t block_points);

/// What a complete stream of QueryRegion held.
struct Answer {
  v1::QueryHeader header;
  core::LatticeCloud cloud;
  v1::QuerySummary summary;
};

/// The generated stubs and the few steps that most tests take. Every step gives
/// up after a minute.
class TestClient {
 public:
  explicit TestClient(const std::string& address);

  absl::StatusOr<v1::Map> CreateMap(const std::string& map_id,
                                    double tile_edge = 0);
  absl::StatusOr<v1::Upload> CreateUpload(const std::string& map_id,
                                          const std::string& upload_id,
                                          std::span<const std::byte> bytes);
  absl::StatusOr<v1::Upload> GetUpload(const std::string& name);
  /// Sends `bytes` from `offset` on, in pieces, and returns what the last
  /// acknowledgement says.
  absl::StatusOr<int64_t> Write(const std::string& name,
                                std::span<const std::byte> bytes,
                                int64_t offset = 0,
                                size_t piece_bytes = 100'000);
  absl::StatusOr<v1::Operation> Finalize(const std::string& name);
  /// CreateUpload, Write, Finalize, Wait.
  absl::StatusOr<v1::UploadReport> Upload(const std::string& map_id,
                                          const std::string& upload_id,
                                          const core::LatticeCloud& cloud);
  absl::StatusOr<v1::Operation> Process(const std::string& map_id);
  /// Until it is done; its error if it has one.
  absl::StatusOr<v1::Operation> Wait(const std::string& name);
  absl::StatusOr<Answer> Query(const v1::QueryRegionRequest& request);

  std::unique_ptr<grpc::ClientContext> NewContext() const;

  std::shared_ptr<grpc::Channel> channel;
  std::unique_ptr<v1::MapService::Stub> maps;
  std::unique_ptr<v1::UploadService::Stub> uploads;
  std::unique_ptr<v1::ProcessingService::Stub> processing;
  std::unique_ptr<v1::QueryService::Stub> queries;
  std::unique_ptr<v1::Operations::Stub> operations;
};

/// One request of WriteUpload with the right checksum.
v1::WriteUploadRequest WriteRequest(const std::string& name, int64_t offset,
                                    std::span<const std::byte> bytes);

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_TESTS_RPC_TEST_CLIENT_H_
