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
  /// All of its points are loaded.
  bool is_whole = false;
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

  /// Of the unit's tiles too only the points within `margin` steps of `boxes`.
  absl::StatusOr<LoadedUnit> LoadNear(const Unit& unit,
                                      std::span<const LatticeBox> boxes,
                                      int64_t margin);

  /// All points of a tile. Thread-safe.
  absl::StatusOr<BulkVector<LatticePoint>> LoadPoints(size_t tile) const;

  /// Calls use(batch) for adjacent `tiles`: enough to keep every worker busy,
  /// few enough for copies of their points to be small beside a unit.
  template <typename Use>
  absl::Status ForEachBatch(std::span<LoadedTile> tiles, const Use& use) const;

 protected:
  const ExecutionContext& context_;
  const std::vector<TileInfo> tiles_;
  /// Of a batch of tiles; kept from batch to batch, since fresh memory is dear.
  BulkVector<LatticePoint> batch_points_;

 private:
  using HaloOf = std::unordered_map<size_t, std::vector<LatticeBox>>;

  absl::StatusOr<LoadedUnit> Load(const Unit& unit, const HaloOf& near,
                                  bool whole_core);
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

template <typename Use>
absl::Status PointUnits::ForEachBatch(std::span<LoadedTile> tiles,
                                      const Use& use) const {
  // Points of tiles that are loaded, or answered for, at a time.
  constexpr int64_t kBatchPointsPerWorker = 1 << 16;
  const int64_t batch_points =
      kBatchPointsPerWorker * context_.executor->worker_count();
  size_t begin = 0;
  int64_t points = 0;
  for (size_t t = 0; t < tiles.size(); ++t) {
    points += tiles_[tiles[t].tile].point_count;
    if (points < batch_points && t + 1 < tiles.size()) continue;
    MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
    MAPSIEVE_RETURN_IF_ERROR(use(tiles.subspan(begin, t + 1 - begin)));
    begin = t + 1;
    points = 0;
  }
  return absl::OkStatus();
}

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
  /// The states of the `count` points of a tile. Thread-safe.
  template <typename T>
  absl::StatusOr<BulkVector<T>> LoadTileStates(size_t tile, TileStateKind kind,
                                               size_t count) const;
  /// Stores the states of all points of a tile.
  template <typename T>
  absl::Status StoreTileStates(size_t tile, TileStateKind kind,
                               std::span<const T> states);
  /// Stores the states of the core tiles.
  template <typename T>
  absl::Status StoreStates(const LoadedUnit& loaded, TileStateKind kind,
                           const BulkVector<T>& states);

  /// Hands the answers for the core tiles to the store and adds them to
  /// `summary`.
  absl::Status Emit(const LoadedUnit& loaded, const WorkUnit::Labeled& labeled,
                    SpdfSummary& summary);
  /// The same for one answer.
  absl::Status Emit(const TileResult& result, SpdfSummary& summary);

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
absl::StatusOr<BulkVector<T>> TileUnits::LoadTileStates(size_t tile,
                                                        TileStateKind kind,
                                                        size_t count) const {
  BulkVector<T> states(count);
  if (count == 0) return states;
  const RowRange rows = {0, static_cast<uint32_t>(count)};
  MAPSIEVE_RETURN_IF_ERROR(
      store_.LoadState(tiles_[tile].key, kind, {&rows, 1},
                       std::as_writable_bytes(std::span(states))));
  return states;
}

template <typename T>
absl::Status TileUnits::StoreTileStates(size_t tile, TileStateKind kind,
                                        std::span<const T> states) {
  return store_.StoreState(tiles_[tile].key, kind, std::as_bytes(states));
}

template <typename T>
absl::Status TileUnits::StoreStates(const LoadedUnit& loaded,
                                    TileStateKind kind,
                                    const BulkVector<T>& states) {
  for (const LoadedTile& tile : loaded.tiles) {
    if (!tile.is_core) continue;
    MAPSIEVE_RETURN_IF_ERROR(StoreTileStates<T>(
        tile.tile, kind,
        std::span(states).subspan(tile.begin, tile.end - tile.begin)));
  }
  return absl::OkStatus();
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_TILE_UNITS_H_
