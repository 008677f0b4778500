#ifndef MAPSIEVE_SERVER_ENGINE_DAMAGED_CHUNK_H_
#define MAPSIEVE_SERVER_ENGINE_DAMAGED_CHUNK_H_

#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "core/geometry/cell_key.h"

namespace mapsieve::storage {
class ReadSnapshot;
struct ChunkRef;
}  // namespace mapsieve::storage

namespace mapsieve::engine {

/// What a stored chunk holds.
enum class StoredContent : uint8_t {
  kRaw = 1,
  kProduct = 2,
  kHistory = 3,
};

/// A chunk that is missing, or not what was stored.
struct DamagedChunk {
  StoredContent content = StoredContent::kRaw;
  core::CellKey tile;
  std::string blob_id;
  /// Map, revision, tile, chunk, file, offset, what was expected and what was
  /// found.
  std::string problem;
};

/// `damage`: what reading `chunk` gave.
DamagedChunk MakeDamagedChunk(const storage::ChunkRef& chunk,
                              const absl::Status& damage);

/// Reads a chunk of any revision of the snapshot's map. OK if the last revision
/// that has it expired meanwhile. kDataLoss: it is missing, or not what was
/// stored, or not what its reference says.
absl::Status CheckChunk(const storage::ReadSnapshot& snapshot,
                        const storage::ChunkRef& chunk);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_DAMAGED_CHUNK_H_
