#ifndef MAPSIEVE_SERVER_ENGINE_TILE_CHECK_H_
#define MAPSIEVE_SERVER_ENGINE_TILE_CHECK_H_

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/cell_key.h"
#include "core/spdf/spdf_options.h"
#include "server/engine/memory_pool.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// What the comparison of a tile found.
struct TileCheck {
  /// Survivors in the tile, outliers included.
  int64_t point_count = 0;
  /// What differs first; empty if nothing does.
  std::string difference;
};

/// Filters the points of a tile again, together with all points that can have
/// a say in it, as one cloud in memory, and compares positions, labels,
/// confidences, eigenvalues, axes and, as far as those points decide them,
/// depths with the product stored in `snapshot`, which was made with `options`.
/// kResourceExhausted: `reservation` does not get the memory; kCancelled;
/// kDataLoss: a chunk that it reads is damaged.
absl::StatusOr<TileCheck> CheckTile(const storage::ReadSnapshot& snapshot,
                                    const core::SpdfOptions& options,
                                    const core::CellKey& tile,
                                    Reservation& reservation,
                                    const ExecutionContext& context);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_TILE_CHECK_H_
