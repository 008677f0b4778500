#include "server/engine/map_changes.h"

#include <optional>

#include "core/base/status.h"
#include "core/geometry/morton.h"
#include "server/engine/chunk_reader.h"

namespace mapsieve::engine {
namespace {

using core::CellKey;
using core::LatticeBox;
using core::LatticePoint;

absl::StatusOr<std::vector<CellKey>> TilesWithOtherChunks(
    const storage::Catalogue& catalogue, const storage::ReadSnapshot& before,
    const storage::ReadSnapshot& now) {
  constexpr int64_t kPageSize = 1000;
  std::vector<CellKey> tiles;
  std::optional<CellKey> after;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<CellKey> page,
        catalogue.ListChangedTiles(now.map().uid, before.revision().number,
                                   now.revision().number,
                                   storage::ChunkKind::kRaw, after, kPageSize));
    if (page.empty()) return tiles;
    for (const CellKey& tile : page) {
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

/// Holds the points that only one of two lists in Morton order has.
std::optional<LatticeBox> BoxOfDifference(const std::vector<LatticePoint>& a,
                                          const std::vector<LatticePoint>& b) {
  std::optional<LatticeBox> box;
  core::ForEachDifference(a, b, [&box](const LatticePoint& q) {
    box = box.has_value() ? box->Union(core::BoxOf(q)) : core::BoxOf(q);
  });
  return box;
}

}  // namespace

absl::StatusOr<std::vector<core::TileChange>> FindChanges(
    const storage::Catalogue& catalogue, const storage::ReadSnapshot& before,
    const storage::ReadSnapshot& now, const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<CellKey> tiles,
                            TilesWithOtherChunks(catalogue, before, now));
  std::vector<core::TileChange> changes(tiles.size());
  MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
      *context.executor, static_cast<int64_t>(tiles.size()),
      [&](int64_t i) -> absl::Status {
        MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
        const CellKey& tile = tiles[static_cast<size_t>(i)];
        MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<LatticePoint> old_points,
                                  ReadDistinctPoints(before, tile));
        MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<LatticePoint> new_points,
                                  ReadDistinctPoints(now, tile));
        changes[static_cast<size_t>(i)] = {
            tile, BoxOfDifference(old_points, new_points)};
        return absl::OkStatus();
      }));
  return changes;
}

}  // namespace mapsieve::engine
