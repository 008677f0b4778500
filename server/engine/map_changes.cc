#include "server/engine/map_changes.h"

#include <optional>

#include "core/base/status.h"
#include "server/engine/chunk_reader.h"

namespace mapsieve::engine {

absl::StatusOr<std::vector<core::CellKey>> FindChangedTiles(
    const storage::Catalogue& catalogue, const storage::ReadSnapshot& before,
    const storage::ReadSnapshot& now) {
  constexpr int64_t kPageSize = 1000;
  std::vector<core::CellKey> tiles;
  std::optional<core::CellKey> after;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<core::CellKey> page,
        catalogue.ListChangedTiles(now.map().uid, before.revision().number,
                                   now.revision().number,
                                   storage::ChunkKind::kRaw, after, kPageSize));
    if (page.empty()) return tiles;
    for (const core::CellKey& tile : page) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          const auto old_chunks,
          before.ListTileChunks(storage::ChunkKind::kRaw, tile));
      MAPSIEVE_ASSIGN_OR_RETURN(
          const auto new_chunks,
          now.ListTileChunks(storage::ChunkKind::kRaw, tile));
      if (ContentsOf(old_chunks) != ContentsOf(new_chunks)) {
        tiles.push_back(tile);
      }
    }
    after = page.back();
  }
}

}  // namespace mapsieve::engine
