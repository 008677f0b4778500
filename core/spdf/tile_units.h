#ifndef MAPSIEVE_CORE_SPDF_TILE_UNITS_H_
#define MAPSIEVE_CORE_SPDF_TILE_UNITS_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <unordered_map>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/bulk_vector.h"
#include "core/base/executor.h"
#include "core/base/status.h"
#include "core/geometry/cell_key.h"
#include "core/spdf/spdf_options.h"
#include "core/spdf/tile_cells.h"
#include "core/spdf/tile_filter.h"
#include "core/spdf/work_unit.h"

namespace mapsieve::core {

/// One tile's part of a loaded unit.
struct LoadedTile {
  /// Its number in PointUnits::tiles.
  size_t tile = 0;
  bool is_core = false;
  /// The tile's points in the unit: [begin, end).
  size_t begin = 0;
  size_t end = 0;
  /// The rows of the tile's points that were loaded, in ascending order.
  std::vector<RowRange> rows;
};

/// Some tiles, the core, with the points around them.
struct LoadedUnit {
  /// In their order; core and halo.
  std::vector<LoadedTile> tiles;
  std::unique_ptr<WorkUnit> work;
};

/// Forms units of tiles and loads them with a halo. Used by one thread; tiles
/// are loaded on the context's executor. The references outlive it.
class PointUnits {
 public:
  /// Numbers of tiles, ascending.
  using Unit = std::vector<size_t>;

  PointUnits(PointTiles& source, const SpdfOptions& options,
             const SpdfConstants& constants, const ExecutionContext& context);

  const std::vector<TileInfo>& tiles() const { return tiles_; }
  std::optional<size_t> Find(const CellKey& key) const;
  /// Numbers of the tiles that intersect `box`, ascending.
  std::vector<size_t> TilesIn(const LatticeBox& box) const;

  /// Divides `wanted`, ascending, into units of tiles that follow each other,
  /// each of up to `max_unit_points` or one tile.
  std::vector<Unit> Group(std::span<const size_t> wanted,
                          int64_t max_unit_points) const;

  /// The boxes of the unit's tiles.
  std::vector<LatticeBox> BoxesOf(const Unit& unit) const;

  /// Numbers of the tiles outside `unit` within `margin` steps of `boxes`, and
  /// for each the boxes that near, grown by the margin.
  std::unordered_map<size_t, std::vector<LatticeBox>> HaloTiles(
      const Unit& unit, std::span<const LatticeBox> boxes,
      int64_t margin) const;

  /// The points of the unit's tiles, and others within `margin` steps of
  /// `boxes`.
  absl::StatusOr<LoadedUnit> Load(const Unit& unit,
                                  std::span<const LatticeBox> boxes,
                                  int64_t margin);
  /// And others within `margin` steps of the tiles.
  absl::StatusOr<LoadedUnit> Load(const Unit& unit, int64_t margin) {
    return Load(unit, BoxesOf(unit), margin);
  }

  /// The points of a tile; valid until the next call.
  absl::StatusOr<std::span<const LatticePoint>> LoadPoints(size_t tile);

 protected:
  /// Calls use(batch) for adjacent `tiles`: enough to keep every worker busy,
  /// few enough for copies of their points to be small beside a unit.
  template <typename Use>
  absl::Status ForEachBatch(std::span<LoadedTile> tiles, const Use& use) const;

  const ExecutionContext& context_;
  const std::vector<TileInfo> tiles_;
  /// Of a batch of tiles; kept from batch to batch, since fresh memory is dear.
  BulkVector<LatticePoint> batch_points_;

 private:
  using HaloOf = std::unordered_map<size_t, std::vector<LatticeBox>>;

  absl::Status LoadBatch(const HaloOf& halo, std::span<LoadedTile> batch,
                         WorkUnit& work);
  absl::Status LoadTile(const HaloOf& halo, LoadedTile& tile,
                        std::span<LatticePoint>& points);

  PointTiles& source_;
  const SpdfOptions& options_;
  const SpdfConstants& constants_;
  std::unordered_map<CellKey, size_t, CellKeyHash> tile_numbers_;
  /// One entry a tile; made when it is loaded for the first time.
  std::vector<TileDirectory> directories_;
};

/// PointUnits of the filter's store, which also moves what the filter keeps of
/// tiles between the store and a WorkUnit.
class TileUnits : public PointUnits {
 public:
  TileUnits(TileStore& store, const SpdfOptions& options,
            const SpdfConstants& constants, const ExecutionContext& context)
      : PointUnits(store, options, constants, context), store_(store) {}

  /// Fills `states`, one entry a point of the unit: of core tiles, and of the
  /// halo if asked for.
  template <typename T>
  absl::Status LoadStates(const LoadedUnit& loaded, TileStateKind kind,
                          bool with_halo, BulkVector<T>& states);
  /// Stores the states of a tile of the core.
  template <typename T>
  absl::Status StoreTileStates(const LoadedTile& tile, TileStateKind kind,
                               const BulkVector<T>& states);
  /// Stores the states of the core tiles.
  template <typename T>
  absl::Status StoreStates(const LoadedUnit& loaded, TileStateKind kind,
                           const BulkVector<T>& states);

  /// Hands the answers for the core tiles to the store and adds them to
  /// `summary`.
  absl::Status Emit(const LoadedUnit& loaded, const WorkUnit::Labeled& labeled,
                    SpdfSummary& summary);

 private:
  absl::Status EmitBatch(WorkUnit& unit, std::span<const LoadedTile> tiles,
                         const WorkUnit::Labeled& labeled,
                         SpdfSummary& summary);

  TileStore& store_;
  BulkVector<uint32_t> batch_rows_;
};

template <typename T>
absl::Status TileUnits::LoadStates(const LoadedUnit& loaded, TileStateKind kind,
                                   bool with_halo, BulkVector<T>& states) {
  states.resize(loaded.work->size());
  return TryParallelFor(
      *context_.executor, static_cast<int64_t>(loaded.tiles.size()),
      [&](int64_t i) {
        const LoadedTile& tile = loaded.tiles[static_cast<size_t>(i)];
        if (tile.rows.empty() || (!tile.is_core && !with_halo)) {
          return absl::OkStatus();
        }
        return store_.LoadState(
            tiles_[tile.tile].key, kind, tile.rows,
            std::as_writable_bytes(
                std::span(states).subspan(tile.begin, tile.end - tile.begin)));
      });
}

template <typename T>
absl::Status TileUnits::StoreTileStates(const LoadedTile& tile,
                                        TileStateKind kind,
                                        const BulkVector<T>& states) {
  return store_.StoreState(tiles_[tile.tile].key, kind,
                           std::as_bytes(std::span(states).subspan(
                               tile.begin, tile.end - tile.begin)));
}

template <typename T>
absl::Status TileUnits::StoreStates(const LoadedUnit& loaded,
                                    TileStateKind kind,
                                    const BulkVector<T>& states) {
  for (const LoadedTile& tile : loaded.tiles) {
    if (!tile.is_core) continue;
    MAPSIEVE_RETURN_IF_ERROR(StoreTileStates(tile, kind, states));
  }
  return absl::OkStatus();
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_TILE_UNITS_H_
