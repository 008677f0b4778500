#ifndef MAPSIEVE_SERVER_ENGINE_STORED_TILES_H_
#define MAPSIEVE_SERVER_ENGINE_STORED_TILES_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <stop_token>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/labels.h"
#include "core/spdf/tile_filter.h"
#include "server/engine/chunk_writer.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Tile by tile the raw points of a stored revision for the filter, and the
/// filter's answer as product chunks. Memory: the raw chunks of one tile one
/// after the other, and answers up to a limit before they are written.
class StoredTiles final : public core::TileStore {
 public:
  /// Reads the list of tiles. `products` gets the answer; the references
  /// outlive the object.
  static absl::StatusOr<std::unique_ptr<StoredTiles>> Open(
      const storage::ReadSnapshot& snapshot, storage::Scratch& scratch,
      ChunkWriter& products, int64_t max_pending_bytes, std::stop_token stop);

  std::vector<core::TileInfo> Tiles() const override { return tiles_; }
  absl::StatusOr<int64_t> LoadPoints(
      const core::CellKey& key, std::span<core::LatticePoint> room) override;
  absl::Status StoreState(const core::CellKey& key, core::TileStateKind kind,
                          std::span<const std::byte> bytes) override;
  absl::StatusOr<std::vector<std::byte>> LoadState(
      const core::CellKey& key, core::TileStateKind kind) override;
  absl::Status Emit(const core::TileResult& result) override;

  /// Writes what is pending; to be called after the last Emit.
  absl::Status Flush();

  /// Points emitted of each label that are no outliers.
  core::LabelCounts CountKept(const core::OutlierTest& test) const;

 private:
  StoredTiles(const storage::ReadSnapshot& snapshot, storage::Scratch& scratch,
              ChunkWriter& products, int64_t max_pending_bytes,
              std::stop_token stop);
  absl::StatusOr<core::LatticeCloud> CollectRepresentatives(
      const core::CellKey& tile, std::span<const core::LatticePoint> positions);

  const storage::ReadSnapshot& snapshot_;
  storage::Scratch& scratch_;
  ChunkWriter& products_;
  const int64_t max_pending_bytes_;
  const std::stop_token stop_;
  std::vector<core::TileInfo> tiles_;
  std::vector<TileCloud> pending_;
  int64_t pending_bytes_ = 0;
  /// Points emitted, by label and confidence.
  std::array<std::vector<int64_t>, core::kLabelCount> histogram_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_STORED_TILES_H_
