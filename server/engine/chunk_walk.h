#ifndef MAPSIEVE_SERVER_ENGINE_CHUNK_WALK_H_
#define MAPSIEVE_SERVER_ENGINE_CHUNK_WALK_H_

#include <cstddef>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/engine/region.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// The chunks of one kind that may hold points of a region, by tile in Morton
/// order. A page of references is in memory at a time. Used by one thread.
class ChunkWalk {
 public:
  /// `region`: nothing means everywhere. It and the snapshot outlive the walk.
  ChunkWalk(const storage::ReadSnapshot& snapshot, storage::ChunkKind kind,
            const std::optional<Region>& region)
      : snapshot_(snapshot), kind_(kind), region_(region) {}

  /// The next chunk; nothing after the last one. Errors of storage.
  absl::StatusOr<std::optional<storage::ChunkRef>> Next();

 private:
  absl::Status ReadPage();

  const storage::ReadSnapshot& snapshot_;
  const storage::ChunkKind kind_;
  const std::optional<Region>& region_;
  std::vector<storage::ChunkRef> page_;
  size_t next_ = 0;
  std::optional<storage::ChunkPosition> after_;
  bool is_last_page_ = false;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_CHUNK_WALK_H_
