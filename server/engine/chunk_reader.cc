#include "server/engine/chunk_reader.h"

#include <cstddef>
#include <vector>

#include "core/base/status.h"

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

}  // namespace mapsieve::engine
