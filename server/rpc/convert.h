#ifndef MAPSIEVE_SERVER_RPC_CONVERT_H_
#define MAPSIEVE_SERVER_RPC_CONVERT_H_

#include <optional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "mapsieve/v1/map_service.pb.h"
#include "mapsieve/v1/operations.pb.h"
#include "mapsieve/v1/types.pb.h"
#include "mapsieve/v1/upload_service.pb.h"
#include "server/engine/types.h"
#include "server/engine/verify.h"

/// Messages to types of the engine and back; convert_query.h has regions and
/// queries. From a message: whatever the
/// message holds or lacks, the result is a value of the right form or
/// kInvalidArgument with the path of the field; the engine checks the values.
/// All functions are pure.
namespace mapsieve::rpc {

// Resource names.

/// {map} of "maps/{map}" in `field`.
absl::StatusOr<std::string> ParseMapName(std::string_view field,
                                         std::string_view name);
/// {map} of "maps/{map}/stats" in `field`.
absl::StatusOr<std::string> ParseStatsName(std::string_view field,
                                           std::string_view name);
/// {operation} of "operations/{operation}" in `field`.
absl::StatusOr<std::string> ParseOperationName(std::string_view field,
                                               std::string_view name);

struct UploadName {
  std::string map_id;
  std::string upload_id;

  friend bool operator==(const UploadName&, const UploadName&) = default;
};
/// {map} and {upload} of "maps/{map}/uploads/{upload}" in `field`.
absl::StatusOr<UploadName> ParseUploadName(std::string_view field,
                                           std::string_view name);

// From messages.

/// Page size and token of a list request.
template <typename Request>
engine::PageRequest ToPageRequest(const Request& request) {
  return {.page_size = request.page_size(), .page_token = request.page_token()};
}

engine::MapSpec ToMapSpec(const v1::CreateMapRequest& request);
absl::StatusOr<engine::UploadSpec> ToUploadSpec(
    const v1::CreateUploadRequest& request);
absl::StatusOr<core::SpdfOptions> ToSpdfOptions(const v1::SpdfOptions& options);

/// The content of `data` after its checksum was compared. kInvalidArgument: no
/// content, more than 1 MiB, no checksum; kDataLoss: another checksum.
absl::StatusOr<std::string_view> CheckedContent(
    std::string_view field, const v1::ChecksummedData& data);

// To messages.

v1::Map ToProto(const engine::MapInfo& map);
v1::MapStats ToProto(std::string_view map_id, const engine::MapStats& stats);
v1::Revision ToProto(std::string_view map_id,
                     const engine::RevisionInfo& revision);
v1::TileChange ToProto(const engine::TileChange& change);
v1::DamagedChunk ToProto(const engine::DamagedChunk& chunk);
v1::VerifyMapResponse ToProto(const engine::VerifyEvent& event);
v1::VerifySummary ToProto(const engine::VerifySummary& summary);
v1::Upload ToProto(std::string_view map_id, const engine::UploadInfo& upload);
v1::UploadReport ToProto(const engine::UploadReport& report);
v1::Operation ToProto(const engine::Operation& operation);
v1::SpdfOptions ToProto(const core::SpdfOptions& options);
v1::LabelCounts ToProto(const core::LabelCounts& counts);
v1::ColumnSpec ToProto(const core::ColumnSpec& column);

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_CONVERT_H_
