#ifndef MAPSIEVE_CLIENT_API_ANSWERS_H_
#define MAPSIEVE_CLIENT_API_ANSWERS_H_

#include <functional>
#include <memory>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/api/map_client.h"
#include "client/api/map_types.h"
#include "grpcpp/channel.h"
#include "mapsieve/v1/query_service.grpc.pb.h"

/// How MapClient reads the streams of the query service.
namespace mapsieve::client {

/// MapClient::Query.
absl::StatusOr<std::unique_ptr<QueryStream>> OpenQueryStream(
    const std::shared_ptr<grpc::Channel>& channel, const QuerySpec& spec);

/// MapClient::Sync.
absl::StatusOr<SyncSummary> ReadSync(
    v1::QueryService::Stub& stub, const SyncSpec& spec,
    const std::function<absl::Status(const SyncChunk&)>& visit);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_API_ANSWERS_H_
