#ifndef MAPSIEVE_SERVER_RPC_CONVERT_QUERY_H_
#define MAPSIEVE_SERVER_RPC_CONVERT_QUERY_H_

#include <optional>

#include "absl/status/statusor.h"
#include "mapsieve/v1/map_service.pb.h"
#include "mapsieve/v1/query_service.pb.h"
#include "mapsieve/v1/upload_service.pb.h"
#include "server/engine/query.h"
#include "server/engine/sync.h"
#include "server/engine/types.h"

/// Regions, queries and their answers, converted as convert.h says.
namespace mapsieve::rpc {

absl::StatusOr<engine::QuerySpec> ToQuerySpec(
    const v1::QueryRegionRequest& request);
absl::StatusOr<engine::SyncSpec> ToSyncSpec(
    const v1::SyncRegionRequest& request);
/// The region of a request; nothing if it has none. kInvalidArgument also for a
/// request with fields that are not known here.
absl::StatusOr<std::optional<engine::RegionShape>> ToRegion(
    const v1::FinalizeUploadRequest& request);
/// kInvalidArgument also for a request without a region.
absl::StatusOr<engine::RegionShape> ToRegion(
    const v1::DeleteRegionRequest& request);

v1::QuerySummary ToProto(const engine::QuerySummary& summary);
v1::SyncHeader ToProto(const engine::SyncHeader& header);
v1::SyncPart ToProto(const engine::SyncPart& part);
v1::SyncSummary ToProto(const engine::SyncSummary& summary);

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_CONVERT_QUERY_H_
