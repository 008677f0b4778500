#ifndef MAPSIEVE_CORE_SPDF_TILE_UPDATE_H_
#define MAPSIEVE_CORE_SPDF_TILE_UPDATE_H_

#include <cstdint>
#include <optional>
#include <span>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/cell_key.h"
#include "core/spdf/spdf_options.h"
#include "core/spdf/tile_filter.h"

namespace mapsieve::core {

/// A tile that is not as it was when the map was filtered.
struct TileChange {
  CellKey tile;
  /// Holds every point that came or went; nothing if only attributes changed.
  std::optional<LatticeBox> box;
};

struct UpdateSummary {
  /// Sums over the tiles emitted. round_count: the last round in which any of
  /// them was filtered.
  SpdfSummary emitted;
  int64_t emitted_tile_count = 0;
};

/// Filters anew what `changes`, of some tiles of a filtered map, have touched,
/// and emits the tiles whose answer may differ: what FilterTiles would emit for
/// them. All others have the answer of before. `changes` may name tiles that
/// have no points any more.
///
/// LoadState(kDeaths) of `store` must give, before the first StoreState of a
/// tile, one entry for every distinct point: that of the last Emit, or any for
/// a point that was not there. `options` are those of the run before.
///
/// Why this is the same: the death round of a point follows from the points
/// within its reach and which of them died in earlier rounds, so by induction
/// over the rounds there is one set of death rounds that agrees with itself.
/// A tile whose points, and the points and death rounds within reach of it, are
/// as they were, agrees still. Every other tile is filtered through all rounds
/// against the death rounds around it; if its own changed, those within reach
/// of the change are filtered again, until none changes. That ends: after n
/// passes the death rounds up to n are right.
/// Errors: as FilterTiles.
absl::StatusOr<UpdateSummary> UpdateTiles(TileStore& store,
                                          std::span<const TileChange> changes,
                                          const Lattice& lattice,
                                          const SpdfOptions& options,
                                          const TilingOptions& tiling,
                                          const ExecutionContext& context);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_TILE_UPDATE_H_
