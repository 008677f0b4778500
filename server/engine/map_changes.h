#ifndef MAPSIEVE_SERVER_ENGINE_MAP_CHANGES_H_
#define MAPSIEVE_SERVER_ENGINE_MAP_CHANGES_H_

#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/cell_key.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// The tiles whose raw chunks hold something else at one revision of a map than
/// at another, in Morton order. Reads no chunk. Errors of storage.
absl::StatusOr<std::vector<core::CellKey>> FindChangedTiles(
    const storage::Catalogue& catalogue, const storage::ReadSnapshot& before,
    const storage::ReadSnapshot& now);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_MAP_CHANGES_H_
