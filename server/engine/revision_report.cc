#include "server/engine/revision_report.h"

#include <algorithm>
#include <charconv>
#include <optional>
#include <utility>
#include <vector>

#include "core/base/status.h"
#include "core/geometry/cell_key.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/opaque_records.h"
#include "storage/names.h"

namespace mapsieve::engine {
namespace {

using core::CellKey;
using storage::ChunkKind;
using storage::ChunkRef;
using storage::ReadSnapshot;

RevisionKind ToKind(storage::RevisionKind kind) {
  switch (kind) {
    case storage::RevisionKind::kCreate:
      return RevisionKind::kCreate;
    case storage::RevisionKind::kUpload:
      return RevisionKind::kUpload;
    case storage::RevisionKind::kProcess:
      return RevisionKind::kProcess;
    case storage::RevisionKind::kDeleteRegion:
      return RevisionKind::kDeleteRegion;
    case storage::RevisionKind::kReplaceRegion:
      return RevisionKind::kReplaceRegion;
    case storage::RevisionKind::kRollback:
      return RevisionKind::kRollback;
  }
  return RevisionKind::kCreate;
}

/// The chunks of one kind in a tile of two revisions.
struct TwoChunkLists {
  std::vector<ChunkRef> base;
  std::vector<ChunkRef> target;

  TileChangeKind Compare() const {
    if (ContentsOf(base) == ContentsOf(target)) return TileChangeKind::kNone;
    if (base.empty()) return TileChangeKind::kAdded;
    if (target.empty()) return TileChangeKind::kRemoved;
    return TileChangeKind::kChanged;
  }
};

absl::StatusOr<TwoChunkLists> ReadBoth(const ReadSnapshot& base,
                                       const ReadSnapshot& target,
                                       ChunkKind kind, const CellKey& tile) {
  TwoChunkLists lists;
  MAPSIEVE_ASSIGN_OR_RETURN(lists.base, base.ListTileChunks(kind, tile));
  MAPSIEVE_ASSIGN_OR_RETURN(lists.target, target.ListTileChunks(kind, tile));
  return lists;
}

int64_t CountPoints(const std::vector<ChunkRef>& chunks) {
  int64_t count = 0;
  for (const ChunkRef& chunk : chunks) count += chunk.point_count;
  return count;
}

core::LabelCounts CountLabels(const std::vector<ChunkRef>& chunks) {
  core::LabelCounts counts{};
  for (const ChunkRef& chunk : chunks) {
    for (size_t l = 0; l < core::kLabelCount; ++l) {
      counts[l] += chunk.label_counts[l];
    }
  }
  return counts;
}

absl::StatusOr<TileChange> CompareTile(const ReadSnapshot& base,
                                       const ReadSnapshot& target,
                                       const CellKey& tile) {
  MAPSIEVE_ASSIGN_OR_RETURN(const TwoChunkLists raw,
                            ReadBoth(base, target, ChunkKind::kRaw, tile));
  MAPSIEVE_ASSIGN_OR_RETURN(const TwoChunkLists product,
                            ReadBoth(base, target, ChunkKind::kProduct, tile));
  return TileChange{.tile = tile,
                    .raw = raw.Compare(),
                    .product = product.Compare(),
                    .base_raw_point_count = CountPoints(raw.base),
                    .target_raw_point_count = CountPoints(raw.target),
                    .base_label_counts = CountLabels(product.base),
                    .target_label_counts = CountLabels(product.target)};
}

std::string FormatToken(const CellKey& tile) {
  return absl::StrCat(tile.x, ",", tile.y, ",", tile.z);
}

absl::StatusOr<std::optional<CellKey>> ParseToken(const std::string& token,
                                                  int tile_level) {
  if (token.empty()) return std::nullopt;
  CellKey tile = {tile_level, 0, 0, 0};
  const char* next = token.data();
  const char* const end = next + token.size();
  bool is_token = true;
  for (int64_t* coordinate : {&tile.x, &tile.y, &tile.z}) {
    const auto parsed = std::from_chars(next, end, *coordinate);
    is_token = is_token && parsed.ec == std::errc();
    next = parsed.ptr;
    if (coordinate == &tile.z) break;
    is_token = is_token && next != end && *next == ',';
    if (is_token) ++next;
  }
  if (is_token && next == end) return tile;
  return absl::InvalidArgumentError(
      absl::StrCat("page_token ", storage::Quoted(token),
                   " is none of a comparison of revisions"));
}

}  // namespace

absl::StatusOr<RevisionInfo> DescribeRevision(
    const storage::Catalogue& catalogue, const std::string& map_uid,
    const storage::RevisionRecord& revision) {
  const storage::RevisionTotals& totals = revision.totals;
  RevisionInfo info = {.number = revision.number,
                       .kind = ToKind(revision.spec.kind),
                       .create_time = revision.create_time,
                       .is_expired = revision.is_expired,
                       .restored_revision = revision.restored_revision,
                       .raw_point_count = totals.raw_point_count,
                       .processed_revision = revision.processed_revision,
                       .stored_bytes = totals.stored_bytes,
                       .tile_count = totals.tile_count,
                       .stale_tile_count = totals.stale_tile_count};
  switch (info.kind) {
    case RevisionKind::kCreate:
      break;
    case RevisionKind::kUpload:
    case RevisionKind::kDeleteRegion:
    case RevisionKind::kReplaceRegion: {
      MAPSIEVE_ASSIGN_OR_RETURN(EditRecord edit,
                                ParseEditRecord(revision.spec.description));
      info.upload_id = std::move(edit.upload_id);
      info.region = edit.region;
      info.added_point_count = edit.added_point_count;
      info.removed_point_count = edit.removed_point_count;
      break;
    }
    case RevisionKind::kProcess:
      if (revision.spec.product.has_value()) {
        MAPSIEVE_ASSIGN_OR_RETURN(
            info.options, ParseSpdfOptions(revision.spec.product->options));
      }
      break;
    case RevisionKind::kRollback: {
      MAPSIEVE_ASSIGN_OR_RETURN(
          const storage::RevisionRecord parent,
          catalogue.GetRevision(map_uid, revision.parent));
      const int64_t more =
          totals.raw_point_count - parent.totals.raw_point_count;
      info.added_point_count = std::max<int64_t>(more, 0);
      info.removed_point_count = std::max<int64_t>(-more, 0);
      break;
    }
  }
  std::optional<storage::ProductSummary> product = revision.spec.product;
  if (revision.processed_revision != 0 &&
      revision.processed_revision != revision.number) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        storage::RevisionRecord processed,
        catalogue.GetRevision(map_uid, revision.processed_revision));
    product = std::move(processed.spec.product);
  }
  if (product.has_value()) info.label_counts = product->kept_counts;
  for (const int64_t count : info.label_counts) info.point_count += count;
  return info;
}

absl::StatusOr<RevisionComparison> CompareRevisions(
    storage::Store& store, const std::string& map_id, int64_t base,
    int64_t target, int64_t max_count, const std::string& token) {
  for (const auto& [field, number] :
       {std::pair{"base_revision", base}, {"target_revision", target}}) {
    // For a snapshot 0 would be the newest.
    if (number >= 1) continue;
    return absl::OutOfRangeError(
        absl::StrCat(field, " is ", number, "; revisions begin with 1"));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const auto before,
                            store.OpenSnapshot(map_id, base));
  MAPSIEVE_ASSIGN_OR_RETURN(const auto after,
                            store.OpenSnapshot(map_id, target));
  const std::string& uid = before->map().uid;
  if (after->map().uid != uid) {
    return absl::NotFoundError(
        absl::StrCat("map ", map_id, " was deleted meanwhile"));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<CellKey> position,
                            ParseToken(token, before->map().spec.tile_level));
  const storage::Catalogue& catalogue = store.catalogue();
  RevisionComparison result;
  MAPSIEVE_ASSIGN_OR_RETURN(
      result.base, DescribeRevision(catalogue, uid, before->revision()));
  MAPSIEVE_ASSIGN_OR_RETURN(
      result.target, DescribeRevision(catalogue, uid, after->revision()));
  std::vector<CellKey> tiles;
  for (const ChunkKind kind : {ChunkKind::kRaw, ChunkKind::kProduct}) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<CellKey> changed,
        catalogue.ListChangedTiles(uid, base, target, kind, position,
                                   max_count + 1));
    tiles.insert(tiles.end(), changed.begin(), changed.end());
  }
  std::sort(tiles.begin(), tiles.end(), core::CellKeyLess());
  tiles.erase(std::unique(tiles.begin(), tiles.end()), tiles.end());
  if (static_cast<int64_t>(tiles.size()) > max_count) {
    tiles.resize(static_cast<size_t>(max_count));
    result.tiles.next_page_token = FormatToken(tiles.back());
  }
  for (const CellKey& tile : tiles) {
    MAPSIEVE_ASSIGN_OR_RETURN(const TileChange change,
                              CompareTile(*before, *after, tile));
    if (change.raw == TileChangeKind::kNone &&
        change.product == TileChangeKind::kNone) {
      continue;
    }
    result.tiles.items.push_back(change);
  }
  return result;
}

}  // namespace mapsieve::engine
