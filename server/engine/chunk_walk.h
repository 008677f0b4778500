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

/// The chunks of one kind that may hold points of a region and a level of
/// detail, by tile in Morton order; those of a product group by group of
/// depths, the coarsest first. A page of references is in memory at a time.
/// Used by one thread.
class ChunkWalk {
 public:
  /// `region`: nothing means everywhere. It and the snapshot outlive the walk.
  /// `min_depth`: of a product, chunks without points of that depth or more are
  /// left out.
  ChunkWalk(const storage::ReadSnapshot& snapshot, storage::ChunkKind kind,
            const std::optional<Region>& region, int min_depth = 0)
      : snapshot_(snapshot),
        kind_(kind),
        region_(region),
        min_depth_(min_depth) {}

  /// The next chunk; nothing after the last one. Errors of storage.
  absl::StatusOr<std::optional<storage::ChunkRef>> Next();

 private:
  absl::Status ReadPage();
  bool IsInGroup(const storage::ChunkRef& chunk) const;
  /// False: there is none.
  bool GoToNextGroup();

  const storage::ReadSnapshot& snapshot_;
  const storage::ChunkKind kind_;
  const std::optional<Region>& region_;
  const int min_depth_;
  size_t group_ = 0;
  std::vector<storage::ChunkRef> page_;
  size_t next_ = 0;
  std::optional<storage::ChunkPosition> after_;
  bool is_last_page_ = false;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_CHUNK_WALK_H_
