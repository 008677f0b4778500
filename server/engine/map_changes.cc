#include "server/engine/map_changes.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "core/base/status.h"
#include "core/geometry/morton.h"
#include "server/engine/chunk_reader.h"

namespace mapsieve::engine {
namespace {

using core::CellKey;
using core::LatticeBox;
using core::LatticePoint;
using storage::ChunkRef;

/// Walks the raw chunks of a revision tile by tile.
class TileWalk {
 public:
  explicit TileWalk(const storage::ReadSnapshot& snapshot)
      : snapshot_(snapshot) {}

  /// Goes to the first or the next tile.
  absl::Status Next() {
    blobs_.clear();
    tile_.reset();
    while (true) {
      if (at_ == page_.size()) {
        MAPSIEVE_RETURN_IF_ERROR(ReadPage());
        if (page_.empty()) break;
      }
      const ChunkRef& chunk = page_[at_];
      if (tile_.has_value() && !(*tile_ == chunk.tile)) break;
      tile_ = chunk.tile;
      blobs_.push_back(chunk.blob_id);
      ++at_;
    }
    std::sort(blobs_.begin(), blobs_.end());
    return absl::OkStatus();
  }

  /// Nothing at the end.
  const std::optional<CellKey>& tile() const { return tile_; }
  /// The contents of its chunks, whatever their order.
  const std::vector<storage::BlobId>& blobs() const { return blobs_; }

 private:
  absl::Status ReadPage() {
    constexpr int64_t kPageSize = 1000;
    MAPSIEVE_ASSIGN_OR_RETURN(
        page_, snapshot_.ListChunks(storage::ChunkKind::kRaw, std::nullopt,
                                    after_, kPageSize));
    if (!page_.empty()) after_ = {page_.back().tile, page_.back().number};
    at_ = 0;
    return absl::OkStatus();
  }

  const storage::ReadSnapshot& snapshot_;
  std::optional<storage::ChunkPosition> after_;
  std::vector<ChunkRef> page_;
  size_t at_ = 0;
  std::optional<CellKey> tile_;
  std::vector<storage::BlobId> blobs_;
};

absl::StatusOr<std::vector<CellKey>> TilesWithOtherChunks(
    const storage::ReadSnapshot& before, const storage::ReadSnapshot& now) {
  TileWalk a(before);
  TileWalk b(now);
  MAPSIEVE_RETURN_IF_ERROR(a.Next());
  MAPSIEVE_RETURN_IF_ERROR(b.Next());
  std::vector<CellKey> tiles;
  const core::CellKeyLess less;
  while (a.tile().has_value() || b.tile().has_value()) {
    const bool a_first = !b.tile().has_value() ||
                         (a.tile().has_value() && less(*a.tile(), *b.tile()));
    const bool b_first = !a.tile().has_value() ||
                         (b.tile().has_value() && less(*b.tile(), *a.tile()));
    if (a_first || b_first || a.blobs() != b.blobs()) {
      tiles.push_back(a_first ? *a.tile() : *b.tile());
    }
    if (!b_first) MAPSIEVE_RETURN_IF_ERROR(a.Next());
    if (!a_first) MAPSIEVE_RETURN_IF_ERROR(b.Next());
  }
  return tiles;
}

/// Holds the points that are in one of two ascending lists only.
std::optional<LatticeBox> BoxOfDifference(const std::vector<LatticePoint>& a,
                                          const std::vector<LatticePoint>& b) {
  std::optional<LatticeBox> box;
  const auto add = [&box](const LatticePoint& q) {
    box = box.has_value() ? box->Union(core::BoxOf(q)) : core::BoxOf(q);
  };
  size_t i = 0;
  size_t j = 0;
  while (i < a.size() || j < b.size()) {
    if (i < a.size() && j < b.size() && a[i] == b[j]) {
      ++i;
      ++j;
    } else if (j == b.size() ||
               (i < a.size() && core::MortonLess(a[i], b[j]))) {
      add(a[i++]);
    } else {
      add(b[j++]);
    }
  }
  return box;
}

}  // namespace

absl::StatusOr<std::vector<core::TileChange>> FindChanges(
    const storage::ReadSnapshot& before, const storage::ReadSnapshot& now,
    const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<CellKey> tiles,
                            TilesWithOtherChunks(before, now));
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
