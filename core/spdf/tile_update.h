#ifndef MAPSIEVE_CORE_SPDF_TILE_UPDATE_H_
#define MAPSIEVE_CORE_SPDF_TILE_UPDATE_H_

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/cell_key.h"
#include "core/spdf/labels.h"
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

/// The survivors of a tile, in Morton order, and their labels.
struct LabeledSurvivors {
  std::vector<LatticePoint> positions;
  LabelColumns columns;
};

/// What the run before emitted.
class PreviousRun {
 public:
  virtual ~PreviousRun() = default;

  /// The last Emit of a tile. Called from several threads at once.
  virtual absl::StatusOr<LabeledSurvivors> LoadSurvivors(
      const CellKey& tile) = 0;
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
/// A point that has the points and death rounds within its reach that it had,
/// agrees still. All others, by small cells of tiles, are filtered through all
/// rounds against the death rounds around them; what lies within reach of a
/// death round that changed is filtered again, until none changes. That ends:
/// after n passes the death rounds up to n are right. The labels of a survivor
/// follow from the survivors within two reaches: where these are as they were,
/// it keeps those of `previous`.
/// Errors: as FilterTiles, those of `previous`; kDataLoss: `previous` lacks a
/// survivor.
absl::StatusOr<UpdateSummary> UpdateTiles(TileStore& store,
                                          PreviousRun& previous,
                                          std::span<const TileChange> changes,
                                          const Lattice& lattice,
                                          const SpdfOptions& options,
                                          const TilingOptions& tiling,
                                          const ExecutionContext& context);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_TILE_UPDATE_H_
