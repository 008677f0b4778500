#ifndef MAPSIEVE_SERVER_ENGINE_EDIT_MAP_H_
#define MAPSIEVE_SERVER_ENGINE_EDIT_MAP_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "server/engine/chunk_writer.h"
#include "server/engine/ingest.h"
#include "server/engine/opaque_records.h"
#include "server/engine/region.h"
#include "server/engine/types.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// What a revision loses when the raw points of a region are taken out of it.
struct RegionCut {
  /// Numbers of the chunks that hold such points.
  std::vector<int64_t> removed_chunks;
  int64_t removed_point_count = 0;
  /// Tiles of these points.
  int64_t tile_count = 0;
};

/// Finds the raw points of `snapshot` inside `region`, and stores through
/// `rest`, a writer of raw chunks, what else their chunks hold. Chunks that
/// the region does not meet are not read, nor those that it encloses.
/// Progress: chunks that it meets. Memory: about limits.bucket_bytes and one
/// chunk. kCancelled; kResourceExhausted: more than limits.chunk_count chunks
/// lose points; errors of storage.
absl::StatusOr<RegionCut> CutRegion(const storage::ReadSnapshot& snapshot,
                                    const Region& region,
                                    const IngestLimits& limits,
                                    const ExecutionContext& context,
                                    ChunkWriter& rest);

/// Does what `spec`, of the verb kDeleteRegion, asks of the newest revision of
/// the map `map_id`, if its uid is still that of `spec`, and commits the result
/// as one new revision, or none where there are no points. Done already: tells
/// the report. After an error the map is as before. Errors as
/// Engine::DeleteRegion has them for the operation; kAborted: the map changed
/// meanwhile.
absl::StatusOr<DeleteReport> DeleteStoredRegion(
    storage::Store& store, const std::string& map_id, const JobSpec& spec,
    const IngestLimits& limits, const ExecutionContext& context);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_EDIT_MAP_H_
