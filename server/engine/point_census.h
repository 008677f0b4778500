#ifndef MAPSIEVE_SERVER_ENGINE_POINT_CENSUS_H_
#define MAPSIEVE_SERVER_ENGINE_POINT_CENSUS_H_

#include <cstdint>
#include <span>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "server/engine/edit_map.h"
#include "server/engine/ingest.h"
#include "server/engine/types.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// The raw points of the map in the tiles of an upload are not looked at where
/// they are more than so many times its own.
inline constexpr int64_t kMaxComparedShare = 8;
/// An upload counts as one of at least so many points for that.
inline constexpr int64_t kMinComparedPoints = 65'536;

/// Level of the cells of PointCensus::density_histogram: the first whose edge
/// is at least one map unit, within a tile and at least a 64th of its edge.
int DensityCellLevel(int64_t step_nm, int tile_level);

/// Counts the points of `added`, raw chunks of tiles of `base` that it lacks,
/// among each other and beside the raw points of `base`. Of these, the chunks
/// that `cut` removes do not count and those of `rest` do, which may lie in any
/// tile. Depends on the sets of points alone, except that damaged chunks of
/// `base` leave overlapping_point_count open. Memory: about limits.bucket_bytes
/// and a decoded chunk for each worker, whatever the tiles hold.
/// kUnavailable: a chunk of `added` or `rest` is damaged; kCancelled; errors of
/// storage.
absl::StatusOr<PointCensus> TakeCensus(const storage::ReadSnapshot& base,
                                       std::span<const storage::ChunkRef> added,
                                       const RegionCut& cut,
                                       std::span<const storage::ChunkRef> rest,
                                       const IngestLimits& limits,
                                       const ExecutionContext& context);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_POINT_CENSUS_H_
