#include "server/engine/chunk_repair.h"

#include <cstdint>

#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/codec/points_codec.h"
#include "server/engine/death_history.h"
#include "server/engine/product_chunk.h"

namespace mapsieve::engine {

using storage::ChunkKind;
using storage::ChunkRef;

ChunkRepair::ChunkRepair(storage::Store& store)
    : blobs_(store.NewBlobWriter()) {}

absl::StatusOr<std::unique_ptr<ChunkRepair>> ChunkRepair::Make(
    storage::Store& store, const storage::ReadSnapshot& snapshot,
    const std::vector<ChunkRef>& damaged) {
  std::unique_ptr<ChunkRepair> repair(new ChunkRepair(store));
  for (const ChunkRef& chunk : damaged) {
    repair->damaged_.insert(chunk.blob_id);
    TileChunks& tiles =
        chunk.kind == ChunkKind::kProduct ? repair->product_ : repair->history_;
    if (tiles.contains(chunk.tile)) continue;
    MAPSIEVE_ASSIGN_OR_RETURN(tiles[chunk.tile],
                              snapshot.ListTileChunks(chunk.kind, chunk.tile));
  }
  return repair;
}

absl::Status ChunkRepair::PutProduct(const std::vector<TileCloud>& clouds,
                                     Executor& io,
                                     const std::stop_token& stop) const {
  return TryParallelFor(io, static_cast<int64_t>(clouds.size()),
                        [&](int64_t i) -> absl::Status {
                          if (stop.stop_requested()) {
                            return absl::CancelledError("cancelled");
                          }
                          return PutCloud(clouds[static_cast<size_t>(i)]);
                        });
}

absl::Status ChunkRepair::PutCloud(const TileCloud& cloud) const {
  const auto tile = product_.find(cloud.tile);
  if (tile == product_.end()) return absl::OkStatus();
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> depths,
                            DepthsOf(cloud.points.attributes));
  const size_t group = DepthGroupOf(depths.front());
  const std::vector<uint32_t> order = core::MortonOrder(cloud.points.positions);
  size_t begin = 0;
  for (const ChunkRef& chunk : tile->second) {
    if (DepthGroupOf(chunk.min_depth) != group) continue;
    const auto count = static_cast<size_t>(chunk.point_count);
    if (count > order.size() - begin) break;
    if (damaged_.contains(chunk.blob_id)) {
      MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                                core::EncodePoints(cloud.points.Select(
                                    std::span(order).subspan(begin, count))));
      MAPSIEVE_RETURN_IF_ERROR(PutIfDamaged(chunk.blob_id, block));
    }
    begin += count;
  }
  return absl::OkStatus();
}

absl::Status ChunkRepair::PutHistory(
    const core::CellKey& tile, std::span<const core::DeathRound> deaths) const {
  const auto found = history_.find(tile);
  if (found == history_.end()) return absl::OkStatus();
  for (const ChunkRef& chunk : found->second) {
    const auto count = static_cast<size_t>(chunk.point_count);
    if (count > deaths.size()) break;
    if (damaged_.contains(chunk.blob_id)) {
      MAPSIEVE_RETURN_IF_ERROR(
          PutIfDamaged(chunk.blob_id, EncodeDeaths(deaths.first(count))));
    }
    deaths = deaths.subspan(count);
  }
  return absl::OkStatus();
}

absl::Status ChunkRepair::PutIfDamaged(const storage::BlobId& id,
                                       std::span<const std::byte> bytes) const {
  if (ContentHash(bytes) != id) return absl::OkStatus();
  return blobs_->Put(bytes).status();
}

}  // namespace mapsieve::engine
