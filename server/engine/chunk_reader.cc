#include "server/engine/chunk_reader.h"

#include <cstddef>
#include <string>
#include <vector>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"

namespace mapsieve::engine {

absl::StatusOr<core::LatticeCloud> ReadPoints(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk,
    const core::DecodeOptions& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                            snapshot.ReadChunk(chunk));
  absl::StatusOr<core::LatticeCloud> points =
      core::DecodePoints(block, options);
  absl::Status status = points.status();
  if (status.ok() && points->size() != static_cast<size_t>(chunk.point_count)) {
    status = absl::DataLossError(absl::StrCat(
        "expected ", chunk.point_count, " points, found ", points->size()));
  }
  if (!status.ok()) {
    return Annotate(status, absl::StrCat("blob ", chunk.blob_id, " of tile ",
                                         chunk.tile.ToString()));
  }
  return points;
}

absl::StatusOr<std::vector<core::LatticePoint>> ReadDistinctPoints(
    const storage::ReadSnapshot& snapshot, const core::CellKey& tile) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<storage::ChunkRef> chunks,
      snapshot.ListTileChunks(storage::ChunkKind::kRaw, tile));
  std::vector<core::LatticePoint> points;
  for (const storage::ChunkRef& chunk : chunks) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const core::LatticeCloud cloud,
        ReadPoints(snapshot, chunk,
                   {.attributes = std::vector<std::string>()}));
    points.insert(points.end(), cloud.positions.begin(), cloud.positions.end());
  }
  return core::DistinctPoints(points);
}

}  // namespace mapsieve::engine
