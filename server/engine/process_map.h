#ifndef MAPSIEVE_SERVER_ENGINE_PROCESS_MAP_H_
#define MAPSIEVE_SERVER_ENGINE_PROCESS_MAP_H_

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/spdf/spdf_options.h"
#include "server/engine/chunk_repair.h"
#include "server/engine/types.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// How a run of the filter divides its memory.
struct ProcessLimits {
  /// Points of a unit of tiles that are filtered together; half of that in an
  /// update.
  int64_t unit_points = 0;
  /// Points of a tile, duplicates included: a tile is never cut.
  int64_t tile_points = 0;
  /// Answers that wait to be written.
  int64_t pending_bytes = 0;
  /// New tiles and levels that an update holds until depths are known.
  int64_t update_bytes = 0;
  /// Of a decoded chunk.
  int64_t chunk_bytes = 0;

  /// `memory_bytes`: the filter's part of EngineOptions::memory_bytes.
  static ProcessLimits Of(int64_t memory_bytes);
};

/// Filters the newest revision of the map `map_id`, if its uid is still
/// `map_uid`, and commits the result as one new revision. If the last product
/// was made with the same options, only tiles within reach of what changed
/// since are filtered, with the same result. Does nothing but tell the report
/// of before if that is the result for these points and options. After an error
/// the map is as before. Memory: about `limits`, except that one tile with its
/// surroundings always is there. `io` stores chunks, `context.executor`
/// filters. Progress: visits of tiles. Errors as Engine::ProcessMap has them
/// for the operation; kFailedPrecondition: no points; kAborted: the map changed
/// meanwhile.
///
/// A run over all tiles that ends without a commit, however it ends, leaves
/// what it has done in Store::OpenRunScratch; the next run over the same
/// revision with the same options and limits goes on from there.
absl::StatusOr<ProcessReport> ProcessStoredMap(
    storage::Store& store, const std::string& map_id,
    const std::string& map_uid, const core::SpdfOptions& options,
    const ProcessLimits& limits, Executor& io, const ExecutionContext& context);

/// Filters the raw points of `snapshot`, a revision that made its product, with
/// the options of that product, and gives all that comes of it to `repair`; the
/// map is not changed. Memory, `io`, `context` and progress as
/// ProcessStoredMap. kDataLoss: what it reads is damaged; kResourceExhausted: a
/// tile is too large, or the disk is full; kCancelled; kUnavailable.
absl::Status RepairProduct(storage::Store& store,
                           const storage::ReadSnapshot& snapshot,
                           const ChunkRepair& repair,
                           const ProcessLimits& limits, Executor& io,
                           const ExecutionContext& context);

/// kNotFound: the snapshot is of another map than at the request.
absl::Status CheckUid(const storage::ReadSnapshot& snapshot,
                      const std::string& map_uid);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_PROCESS_MAP_H_
