#ifndef MAPSIEVE_CLIENT_API_CONVERT_H_
#define MAPSIEVE_CLIENT_API_CONVERT_H_

#include <string>

#include "absl/status/status.h"
#include "client/api/map_types.h"
#include "grpcpp/support/status.h"
#include "mapsieve/v1/map_service.pb.h"
#include "mapsieve/v1/operations.pb.h"
#include "mapsieve/v1/processing_service.pb.h"
#include "mapsieve/v1/query_service.pb.h"
#include "mapsieve/v1/upload_service.pb.h"

/// The client's types and their messages.
namespace mapsieve::client {

absl::Status ToStatus(const grpc::Status& status);
absl::Status ToStatus(const v1::RpcStatus& status);

/// "maps/{id}" and back.
std::string MapName(const std::string& map_id);
/// The last segment of a resource name.
std::string LastSegment(const std::string& name);

MapInfo FromProto(const v1::Map& map);
MapStats FromProto(const v1::MapStats& stats);
UploadReport FromProto(const v1::UploadReport& report);
ProcessReport FromProto(const v1::ProcessMapResponse& response);
OperationInfo FromProto(const v1::Operation& operation);
QueryHeader FromProto(const v1::QueryHeader& header);
QuerySummary FromProto(const v1::QuerySummary& summary);
core::ColumnSpec FromProto(const v1::ColumnSpec& column);
SyncSummary FromProto(const v1::SyncSummary& summary);

RevisionInfo FromProto(const v1::Revision& revision);
TileChange FromProto(const v1::TileChange& change);
DamagedChunk FromProto(const v1::DamagedChunk& chunk);
DifferingTile FromProto(const v1::DifferingTile& tile);

/// Sets the field `region` of a request; nothing leaves it unset.
void SetRegion(const Region& region, v1::FinalizeUploadRequest& request);
void SetRegion(const Region& region, v1::DeleteRegionRequest& request);

v1::SpdfOptions ToProto(const ProcessOptions& options);
v1::QueryRegionRequest ToProto(const QuerySpec& spec);
v1::SyncRegionRequest ToProto(const SyncSpec& spec);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_API_CONVERT_H_
