#ifndef MAPSIEVE_SERVER_ENGINE_STORED_TILES_H_
#define MAPSIEVE_SERVER_ENGINE_STORED_TILES_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <stop_token>
#include <unordered_set>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/mutex.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/labels.h"
#include "core/spdf/tile_filter.h"
#include "core/spdf/tile_update.h"
#include "server/engine/chunk_repair.h"
#include "server/engine/death_history.h"
#include "server/engine/product_levels.h"
#include "server/engine/run_checkpoint.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Tile by tile the raw points of a stored revision for the filter, and the
/// filter's answer for ProductLevels and as history chunks. Memory: the
/// chunks of one tile for each worker, and answers up to a limit before they
/// are written.
class StoredTiles final : public core::TileStore, public core::PreviousRun {
 public:
  struct Options {
    /// Decoded answers that wait to be written.
    int64_t max_pending_bytes = 0;
    /// Reads, encodes and stores answers.
    Executor* io = nullptr;
    std::stop_token stop;
    /// Keeps states, so that the run can be resumed; null: `scratch` does.
    RunCheckpoint* checkpoint = nullptr;
    /// Gets the histories instead of the store; null: they are new.
    const ChunkRepair* repair = nullptr;
  };

  /// Reads the list of tiles. `previous`: the revision whose history serves
  /// tiles that the run has not filtered yet; null for none. The references
  /// outlive the object.
  static absl::StatusOr<std::unique_ptr<StoredTiles>> Open(
      storage::Store& store, const storage::ReadSnapshot& snapshot,
      const storage::ReadSnapshot* previous, storage::Scratch& scratch,
      ProductLevels& products, const Options& options);

  /// How the points of `tiles` differ from those of the previous revision. Has
  /// to be called before anything is loaded, with all tiles that may differ
  /// (FindChangedTiles). Reads as many tiles at a time as the context has
  /// workers. Errors of storage; kDataLoss: points and history of the previous
  /// revision disagree; kCancelled.
  absl::StatusOr<std::vector<core::TileChange>> CompareTiles(
      std::span<const core::CellKey> tiles, const ExecutionContext& context);

  std::vector<core::TileInfo> Tiles() const override { return tiles_; }
  absl::StatusOr<int64_t> LoadPoints(
      const core::CellKey& key, std::span<core::LatticePoint> room) override;
  absl::Status LoadPointRows(const core::CellKey& key,
                             std::span<const core::RowRange> rows,
                             std::span<core::LatticePoint> room) override;
  absl::Status StoreState(const core::CellKey& key, core::TileStateKind kind,
                          std::span<const std::byte> bytes) override;
  absl::Status LoadState(const core::CellKey& key, core::TileStateKind kind,
                         std::span<const core::RowRange> rows,
                         std::span<std::byte> room) override;
  absl::Status FinishVisit(std::span<const std::byte> record) override;
  std::vector<std::vector<std::byte>> FinishedVisits() override;
  absl::Status Emit(const core::TileResult& result) override;

  // core::PreviousRun; only with a previous revision.
  absl::StatusOr<core::LabeledSurvivors> LoadSurvivors(
      const core::CellKey& tile) override;

  /// Writes what is pending; to be called after the last Emit.
  absl::Status Flush();

  /// References to the history chunks written. Safe from collection while this
  /// object lives.
  const std::vector<storage::ChunkRef>& chunks() const {
    return history_chunks_;
  }
  /// The tiles emitted.
  const std::unordered_set<core::CellKey, core::CellKeyHash>& emitted() const {
    return emitted_;
  }

 private:
  /// An answer that waits.
  struct Pending {
    core::CellKey tile;
    std::vector<core::DeathRound> deaths;
    std::vector<core::LatticePoint> positions;
    core::LabelColumns columns;
  };

  StoredTiles(storage::Store& store, const storage::ReadSnapshot& snapshot,
              const storage::ReadSnapshot* previous, storage::Scratch& scratch,
              ProductLevels& products, const Options& options);
  absl::Status ReadTileList();
  bool HasStoredDeaths(const core::CellKey& key) const;
  absl::Status KeepPoints(const core::CellKey& key,
                          std::span<const core::LatticePoint> points);
  absl::StatusOr<core::TileChange> CompareTile(const core::CellKey& tile);
  absl::StatusOr<core::LatticeCloud> CollectRepresentatives(
      const core::CellKey& tile, std::span<const core::LatticePoint> positions);

  const storage::ReadSnapshot& snapshot_;
  const storage::ReadSnapshot* const previous_;
  storage::Scratch& scratch_;
  const Options options_;
  ProductLevels& products_;
  DeathHistoryWriter history_;
  std::vector<storage::ChunkRef> history_chunks_;
  std::vector<core::TileInfo> tiles_;
  mutable Mutex mutex_;
  /// Tiles whose deaths are in scratch_.
  std::unordered_set<core::CellKey, core::CellKeyHash> stored_deaths_
      ABSL_GUARDED_BY(mutex_);
  std::unordered_set<core::CellKey, core::CellKeyHash> emitted_;
  std::vector<Pending> pending_;
  int64_t pending_bytes_ = 0;
  /// An upper bound of the memory of a decoded point of the map.
  const int64_t point_bytes_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_STORED_TILES_H_
