#ifndef MAPSIEVE_SERVER_ENGINE_MAP_CHANGES_H_
#define MAPSIEVE_SERVER_ENGINE_MAP_CHANGES_H_

#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/spdf/tile_update.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// The tiles whose raw points or attributes differ between two revisions of a
/// map, in Morton order. Reads the raw chunks of tiles whose chunks differ, one
/// tile for each worker at a time. Errors of storage; kCancelled.
absl::StatusOr<std::vector<core::TileChange>> FindChanges(
    const storage::ReadSnapshot& before, const storage::ReadSnapshot& now,
    const ExecutionContext& context);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_MAP_CHANGES_H_
