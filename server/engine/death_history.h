#ifndef MAPSIEVE_SERVER_ENGINE_DEATH_HISTORY_H_
#define MAPSIEVE_SERVER_ENGINE_DEATH_HISTORY_H_

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/geometry/cell_key.h"
#include "core/spdf/tile_filter.h"
#include "storage/store.h"

/// The round in which the filter dropped each distinct point of a tile, as
/// history chunks (storage/FORMAT.md has their bytes).
namespace mapsieve::engine {

/// The bytes of a history chunk.
std::vector<std::byte> EncodeDeaths(std::span<const core::DeathRound> deaths);

/// Stores histories. Chunks are safe from collection while the writer lives:
/// destroy it after the commit. Thread-safe.
class DeathHistoryWriter {
 public:
  explicit DeathHistoryWriter(storage::Store& store);

  /// `deaths`: one a distinct point of the tile, in Morton order, at least one.
  /// Durable when it returns. Errors of storage.
  absl::StatusOr<std::vector<storage::ChunkRef>> Write(
      const core::CellKey& tile,
      std::span<const core::DeathRound> deaths) const;

 private:
  const std::unique_ptr<storage::BlobWriter> blobs_;
};

/// What one chunk of the snapshot's map holds. kDataLoss, with
/// ReadSnapshot::Describe: damaged.
absl::StatusOr<std::vector<core::DeathRound>> ReadDeaths(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk);

/// What was written for the tile; empty if nothing was. kDataLoss as above.
absl::StatusOr<std::vector<core::DeathRound>> ReadDeaths(
    const storage::ReadSnapshot& snapshot, const core::CellKey& tile);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_DEATH_HISTORY_H_
