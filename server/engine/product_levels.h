#ifndef MAPSIEVE_SERVER_ENGINE_PRODUCT_LEVELS_H_
#define MAPSIEVE_SERVER_ENGINE_PRODUCT_LEVELS_H_

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <stop_token>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/codec/points_codec.h"
#include "core/spdf/labels.h"
#include "core/spdf/levels.h"
#include "server/engine/chunk_writer.h"
#include "server/engine/types.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// The tiles of a product on their way to chunks by depth: takes what the
/// filter made of some tiles and keeps it in scratch files, knows the chunks of
/// the others, and once core::ComputeDepths has run over all of them, has
/// written chunks of the new tiles and of those whose depths changed. Memory:
/// answers up to a limit, or one tile.
class ProductLevels final : public core::LevelStore {
 public:
  struct Options {
    /// Decoded points that are written at a time.
    int64_t max_pending_bytes = 0;
    /// Of a decoded chunk.
    int64_t max_chunk_bytes = 0;
    /// Reads, encodes and stores.
    Executor* io = nullptr;
    std::stop_token stop;
  };

  /// `snapshot`: what Keep refers to. The references outlive the object.
  ProductLevels(storage::Store& store, const storage::ReadSnapshot& snapshot,
                storage::Scratch& scratch, const Options& options);

  /// Takes new tiles: clouds of MakeProductCloud in Morton order, at least a
  /// point each. Errors of storage; kCancelled.
  absl::Status Add(std::vector<TileCloud> clouds);
  /// A product chunk of the snapshot in a tile that is not new.
  void Keep(const storage::ChunkRef& chunk);

  std::vector<core::TileInfo> Tiles() const override;
  absl::StatusOr<int64_t> LoadPoints(
      int level, const core::CellKey& cell,
      std::span<core::LatticePoint> room) override;
  absl::Status StorePoints(int level, const core::CellKey& cell,
                           std::span<const core::LatticePoint> points) override;
  absl::Status EmitDepths(const core::CellKey& tile,
                          std::span<const uint8_t> depths) override;

  /// What level_counts leaves out; to be called before ComputeDepths.
  void LeaveOut(const core::OutlierTest& outliers) { outliers_ = outliers; }

  /// Writes what is pending; to be called after ComputeDepths.
  absl::Status Flush();

  /// References to what was written; safe from collection while this object
  /// lives.
  const std::vector<storage::ChunkRef>& chunks() const {
    return chunks_.chunks();
  }
  /// Points of each level of detail that are no outliers.
  const LevelCounts& level_counts() const { return level_counts_; }
  /// Numbers of kept chunks that these replace.
  const std::vector<int64_t>& replaced() const { return replaced_; }

 private:
  /// Where the points of a tile are: in a scratch file, or in chunks.
  struct Source {
    int64_t point_count = 0;
    std::vector<storage::ChunkRef> kept;
  };
  struct Pending {
    core::CellKey tile;
    std::vector<uint8_t> depths;
  };

  absl::StatusOr<core::LatticeCloud> Load(
      const core::CellKey& tile, const core::DecodeOptions& options) const;
  absl::StatusOr<LevelCounts> CountLevels(
      const core::LatticeCloud& points, std::span<const uint8_t> depths) const;

  const storage::ReadSnapshot& snapshot_;
  storage::Scratch& scratch_;
  const Options options_;
  const int64_t point_bytes_;
  ChunkWriter chunks_;
  std::map<core::CellKey, Source, core::CellKeyLess> tiles_;
  std::vector<Pending> pending_;
  int64_t pending_bytes_ = 0;
  std::vector<int64_t> replaced_;
  std::optional<core::OutlierTest> outliers_;
  LevelCounts level_counts_{};
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_PRODUCT_LEVELS_H_
