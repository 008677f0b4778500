#ifndef MAPSIEVE_SERVER_ENGINE_INGEST_H_
#define MAPSIEVE_SERVER_ENGINE_INGEST_H_

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "server/engine/opaque_records.h"
#include "server/engine/region.h"
#include "server/engine/types.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// How an upload that is added divides its memory.
struct IngestLimits {
  /// Of an upload's block, encoded as well as decoded.
  int64_t block_bytes = 0;
  /// Points collected per tile before they are written as chunks.
  int64_t bucket_bytes = 0;
  /// Of a decoded chunk.
  int64_t chunk_bytes = 0;
  /// Chunks of one upload: they become one commit.
  int64_t chunk_count = 0;

  static IngestLimits Of(int64_t memory_bytes);
};

/// The notes of an upload; those of none where a crash came before them, or
/// where an earlier version of the service kept none.
absl::StatusOr<UploadNotes> NotesOf(const storage::UploadRecord& upload);

/// Adds the points of a complete upload to its map, named `map_id`, as one new
/// revision, and marks the upload finalized in the same transaction; then drops
/// its staged bytes. `region`: the raw points of before that lie there are
/// taken out in the same revision. A map without points takes the CRS and the
/// frame id of the upload's source where it has none itself. Done already:
/// tells the report. After an error the map is as before and the upload is
/// kFailed, if its bytes can never become points of this map, else kActive.
/// Errors as Engine::FinalizeUpload has them for the operation.
///
/// Raw chunks hold all attributes that the block of their points had. Memory:
/// about `limits`, however large the upload.
absl::StatusOr<UploadReport> AddUpload(storage::Store& store,
                                       const std::string& map_id,
                                       const std::string& upload_uid,
                                       const std::optional<RegionShape>& region,
                                       const IngestLimits& limits,
                                       const ExecutionContext& context);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_INGEST_H_
