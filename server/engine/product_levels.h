#ifndef MAPSIEVE_SERVER_ENGINE_PRODUCT_LEVELS_H_
#define MAPSIEVE_SERVER_ENGINE_PRODUCT_LEVELS_H_

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <stop_token>
#include <string>
#include <unordered_map>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/base/mutex.h"
#include "core/codec/points_codec.h"
#include "core/spdf/labels.h"
#include "core/spdf/levels.h"
#include "server/engine/chunk_repair.h"
#include "server/engine/chunk_writer.h"
#include "server/engine/product_chunk.h"
#include "server/engine/types.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// The tiles of a product on their way to chunks by depth: takes what the
/// filter made of some tiles and keeps it, in scratch files what is much, knows
/// the chunks of the others, and once core::ComputeDepths has run over them,
/// has written chunks of the new tiles and, of the others, of the groups of
/// depths in which one changed. Memory: answers up to a limit, or one tile;
/// points of coarse levels up to the same limit; new tiles and new points of
/// levels, together up to another.
class ProductLevels final : public core::LevelStore,
                            public core::PreviousLevels {
 public:
  struct Options {
    /// Decoded points that are written at a time.
    int64_t max_pending_bytes = 0;
    /// Of a decoded chunk.
    int64_t max_chunk_bytes = 0;
    /// Reads, encodes and stores.
    Executor* io = nullptr;
    /// Of scratch files. kNone takes less time, and some four times the room.
    core::Compression scratch_compression = core::Compression::kLz4;
    std::stop_token stop;
    /// Gets the chunks instead of the store; null: they are new.
    const ChunkRepair* repair = nullptr;
  };

  /// `snapshot`: what AddPrevious refers to. The references outlive the object.
  ProductLevels(storage::Store& store, const storage::ReadSnapshot& snapshot,
                storage::Scratch& scratch, const Options& options);

  /// So much of new tiles and points of levels, decoded, is not put into
  /// scratch files; to be called before Add, else it is none.
  void KeepInMemory(int64_t bytes) { max_new_bytes_ = bytes; }
  /// Takes new tiles: clouds of MakeProductCloud in Morton order, at least a
  /// point each. Errors of storage; kCancelled.
  absl::Status Add(std::vector<TileCloud> clouds);
  /// A product chunk of the snapshot. `is_kept`: in a tile that is as it was,
  /// else in one that is new or gone.
  void AddPrevious(const storage::ChunkRef& chunk, bool is_kept);

  /// What level_counts leaves out, and if it is the same as before, the counts
  /// then; to be called before ComputeDepths.
  void StartCounts(const core::OutlierTest& outliers,
                   const std::optional<LevelCounts>& counts_before);

  // core::LevelStore
  std::vector<core::TileInfo> Tiles() const override;
  absl::StatusOr<int64_t> LoadPoints(
      int level, const core::CellKey& cell,
      std::span<core::LatticePoint> room) override;
  absl::Status StorePoints(int level, const core::CellKey& cell,
                           std::span<const core::LatticePoint> points) override;
  absl::Status EmitDepths(const core::CellKey& tile, int level,
                          std::span<const uint8_t> depths) override;

  // core::PreviousLevels
  std::vector<core::CellKey> ChangedTiles() const override;
  int64_t CountAtMost(int level, const core::CellKey& tile) const override;
  absl::StatusOr<int64_t> Load(int level, const core::CellKey& tile,
                               std::span<core::LatticePoint> room) override;

  /// Writes what is pending and completes the counts; to be called after
  /// ComputeDepths.
  absl::Status Finish();

  /// References to what was written; safe from collection while this object
  /// lives.
  const std::vector<storage::ChunkRef>& chunks() const {
    return chunks_.chunks();
  }
  /// Points of each level of detail that are no outliers.
  const LevelCounts& level_counts() const { return level_counts_; }
  /// Numbers of the chunks of kept tiles that these replace.
  const std::vector<int64_t>& replaced() const { return replaced_; }

 private:
  struct PreviousChunk {
    storage::ChunkRef ref;
    /// Its points are in new chunks.
    bool is_replaced = false;
  };
  struct Tile {
    int64_t point_count = 0;
    /// Its points are not those of before.
    bool is_new = false;
    /// Those of a new tile, if there was room for them; else they are in
    /// scratch files.
    std::optional<core::LatticeCloud> points;
    /// Its points are those of the chunks.
    bool is_kept = false;
    std::vector<PreviousChunk> before;
  };
  /// What EmitDepths got.
  struct Pending {
    core::CellKey tile;
    int level = 0;
    std::vector<uint8_t> depths;
  };
  /// Points to be written, and their depths.
  struct DeepPoints {
    core::LatticeCloud points;
    std::vector<uint8_t> depths;
  };
  /// Points of the coarse levels of a tile as it was.
  struct CoarsePoints {
    std::vector<core::LatticePoint> positions;
    std::vector<uint8_t> depths;
  };

  bool TakeRoom(int64_t bytes);
  absl::Status WriteScratch(const std::string& name,
                            const core::LatticeCloud& points) const;
  absl::StatusOr<core::LatticeCloud> ReadScratch(const std::string& name) const;
  absl::StatusOr<core::LatticeCloud> TakeNow(const core::CellKey& tile);
  absl::StatusOr<core::LatticeCloud> LoadBefore(
      const core::CellKey& tile, int min_depth,
      const core::DecodeOptions& options) const;
  absl::StatusOr<DeepPoints> LoadPending(const Pending& pending);
  const CoarsePoints* FindCoarse(const core::CellKey& tile) const;
  void KeepCoarse(const core::CellKey& tile,
                  std::span<const core::LatticePoint> positions,
                  std::span<const uint8_t> depths);
  LevelCounts CountLevels(const LabelColumnView& labels,
                          std::span<const uint8_t> depths) const;
  absl::StatusOr<LevelCounts> CountLevelsOf(
      const storage::ChunkRef& chunk) const;
  void AddToCounts(const LevelCounts& counts, int64_t sign);
  absl::Status Flush();

  const storage::ReadSnapshot& snapshot_;
  storage::Scratch& scratch_;
  const Options options_;
  const int64_t point_bytes_;
  ChunkWriter chunks_;
  std::map<core::CellKey, Tile, core::CellKeyLess> tiles_;
  /// What StorePoints got of levels above 0, if there was room for it; else it
  /// is in scratch files.
  std::array<std::unordered_map<core::CellKey, std::vector<core::LatticePoint>,
                                core::CellKeyHash>,
             core::kMaxDepth + 1>
      made_;
  /// Of Tile::points and made_.
  int64_t new_bytes_ = 0;
  int64_t max_new_bytes_ = 0;
  std::vector<Pending> pending_;
  int64_t pending_bytes_ = 0;
  std::vector<int64_t> replaced_;
  std::optional<core::OutlierTest> outliers_;
  /// Counts start with those before: tiles count as differences.
  bool counts_differences_ = false;
  LevelCounts level_counts_{};

  mutable Mutex mutex_;
  /// Nothing is taken out, so that entries stay where they are.
  std::unordered_map<core::CellKey, CoarsePoints, core::CellKeyHash> coarse_
      ABSL_GUARDED_BY(mutex_);
  int64_t coarse_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_PRODUCT_LEVELS_H_
