#ifndef MAPSIEVE_STORAGE_RECORD_CHECKS_H_
#define MAPSIEVE_STORAGE_RECORD_CHECKS_H_

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/catalogue.h"
#include "storage/records.h"

/// The limits of records.h and the bytes of nested values, the same for every
/// implementation of Catalogue.
namespace mapsieve::storage {

/// kInvalidArgument, naming the field, its value and its limits.
absl::Status CheckMapSpec(const MapSpec& spec);
absl::Status CheckUploadSpec(const UploadSpec& spec);
absl::Status CheckOperation(const OperationRecord& operation);
/// `tile_level`: that of the map.
absl::Status CheckChunk(const ChunkRef& chunk, int tile_level);
absl::Status CheckRevisionChange(const RevisionChange& change, int tile_level);
absl::Status CheckPageSize(int64_t max_count);

/// Attributes as bytes: for each its name (uint16 length, bytes) and its type
/// (uint8).
std::string EncodeAttributes(const std::vector<core::ColumnSpec>& attributes);
/// The inverse. kDataLoss, with offset, expected and actual.
absl::StatusOr<std::vector<core::ColumnSpec>> DecodeAttributes(
    std::string_view bytes);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_RECORD_CHECKS_H_
