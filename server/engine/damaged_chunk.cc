#include "server/engine/damaged_chunk.h"

#include "core/base/status.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/chunk_writer.h"
#include "server/engine/death_history.h"
#include "storage/store.h"

namespace mapsieve::engine {
namespace {

using storage::ChunkKind;
using storage::ChunkRef;

StoredContent ToContent(ChunkKind kind) {
  switch (kind) {
    case ChunkKind::kRaw:
      break;
    case ChunkKind::kProduct:
      return StoredContent::kProduct;
    case ChunkKind::kHistory:
      return StoredContent::kHistory;
  }
  return StoredContent::kRaw;
}

absl::Status CheckContent(const storage::ReadSnapshot& snapshot,
                          const ChunkRef& chunk) {
  if (chunk.kind == ChunkKind::kHistory) {
    return ReadDeaths(snapshot, chunk).status();
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const core::LatticeCloud points,
                            ReadPoints(snapshot, chunk));
  MAPSIEVE_ASSIGN_OR_RETURN(ChunkRef found,
                            DescribeChunk(chunk.kind, chunk.tile, points));
  found.number = chunk.number;
  found.blob_id = chunk.blob_id;
  found.stored_bytes = chunk.stored_bytes;
  if (found == chunk) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat(snapshot.Describe(chunk),
                   ": the catalogue has other counts, depths or bounds of its "
                   "points than it holds"));
}

}  // namespace

DamagedChunk MakeDamagedChunk(const ChunkRef& chunk,
                              const absl::Status& damage) {
  return {.content = ToContent(chunk.kind),
          .tile = chunk.tile,
          .blob_id = chunk.blob_id,
          .problem = std::string(damage.message())};
}

absl::Status CheckChunk(const storage::ReadSnapshot& snapshot,
                        const ChunkRef& chunk) {
  const absl::Status status = CheckContent(snapshot, chunk);
  if (!absl::IsDataLoss(status)) return status;
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> next,
                            snapshot.ListAllChunks(chunk.number - 1, 1));
  const bool is_there = !next.empty() && next[0].number == chunk.number;
  return is_there ? status : absl::OkStatus();
}

}  // namespace mapsieve::engine
