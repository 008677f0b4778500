#ifndef MAPSIEVE_SERVER_ENGINE_CHUNK_REPAIR_H_
#define MAPSIEVE_SERVER_ENGINE_CHUNK_REPAIR_H_

#include <cstddef>
#include <map>
#include <memory>
#include <set>
#include <span>
#include <stop_token>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/cell_key.h"
#include "core/spdf/tile_filter.h"
#include "server/engine/chunk_writer.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Puts damaged chunks of a revision's product and history back, out of what a
/// run of the filter over that revision makes of its tiles. A tile is divided
/// as its references say, so the limits of the run do not matter, and only
/// bytes that have the id of a damaged blob are stored: nothing else is
/// touched. Thread-safe.
class ChunkRepair {
 public:
  /// `damaged`: blobs of product and history chunks. Reads the references of
  /// `snapshot` to the tiles that have one of them. Errors of storage.
  static absl::StatusOr<std::unique_ptr<ChunkRepair>> Make(
      storage::Store& store, const storage::ReadSnapshot& snapshot,
      const std::vector<storage::ChunkRef>& damaged);

  /// Product clouds of SplitByDepth. Errors of storage; kCancelled.
  absl::Status PutProduct(const std::vector<TileCloud>& clouds, Executor& io,
                          const std::stop_token& stop) const;
  /// One entry a distinct point of the tile, in Morton order. Errors of
  /// storage.
  absl::Status PutHistory(const core::CellKey& tile,
                          std::span<const core::DeathRound> deaths) const;

 private:
  using TileChunks = std::map<core::CellKey, std::vector<storage::ChunkRef>,
                              core::CellKeyLess>;

  explicit ChunkRepair(storage::Store& store);
  absl::Status PutCloud(const TileCloud& cloud) const;
  absl::Status PutIfDamaged(const storage::BlobId& id,
                            std::span<const std::byte> bytes) const;

  const std::unique_ptr<storage::BlobWriter> blobs_;
  std::set<storage::BlobId> damaged_;
  /// All chunks of tiles that have a damaged one, by number.
  TileChunks product_;
  TileChunks history_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_CHUNK_REPAIR_H_
