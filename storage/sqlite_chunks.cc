#include "storage/sqlite_chunks.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "storage/record_checks.h"
#include "storage/tile_order.h"

namespace mapsieve::storage {
namespace {

constexpr int64_t kLast = std::numeric_limits<int64_t>::max();
// removed_revision of a chunk that is still there.
constexpr int64_t kNever = kLast;

// In the order of VisitNumbers.
constexpr char kNumberColumns[] =
    "point_count, stored_bytes, none_count, junction_count, curve_count, "
    "surface_count, min_x, min_y, min_z, max_x, max_y, max_z";

// The numbers that a ChunkRef and a TileSummary have in common.
template <typename Record, typename Visit>
void VisitNumbers(Record& record, const Visit& visit) {
  visit(record.point_count);
  visit(record.stored_bytes);
  for (auto& count : record.label_counts) visit(count);
  for (auto* corner : {&record.bounds.min, &record.bounds.max}) {
    visit(corner->x);
    visit(corner->y);
    visit(corner->z);
  }
}

absl::StatusOr<core::CellKey> TakeTile(SqliteDatabase& database,
                                       SqliteStatement& row) {
  std::string key;
  row.TakeBlob(key);
  MAPSIEVE_RETURN_IF_ERROR(row.status());
  auto tile = ParseTileOrderKey(key);
  if (!tile.ok()) {
    return Annotate(tile.status(), absl::StrCat(database.path(), ": damaged"));
  }
  return tile;
}

constexpr char kChunkColumns[] =
    "number, kind, min_depth, max_depth, blob_id, tile_key";

absl::StatusOr<ChunkRef> TakeChunk(SqliteDatabase& database, const MapRow& map,
                                   SqliteStatement& row) {
  ChunkRef chunk;
  row.TakeCount(chunk.number)
      .Take(chunk.kind)
      .Take(chunk.min_depth)
      .Take(chunk.max_depth)
      .Take(chunk.blob_id);
  MAPSIEVE_ASSIGN_OR_RETURN(chunk.tile, TakeTile(database, row));
  VisitNumbers(chunk, [&](int64_t& field) { row.Take(field); });
  MAPSIEVE_RETURN_IF_ERROR(row.status());
  if (const auto status = CheckChunk(chunk, map.record.spec.tile_level);
      !status.ok()) {
    return absl::DataLossError(absl::StrCat(database.path(),
                                            ": damaged: chunk ", chunk.number,
                                            ": ", status.message()));
  }
  return chunk;
}

// Adds `sign` times the chunk to the sums of its revision.
void AddChunk(const ChunkRef& chunk, int sign, RevisionTotals& totals) {
  totals.stored_bytes += sign * chunk.stored_bytes;
  if (chunk.kind == ChunkKind::kRaw) {
    totals.raw_chunk_count += sign;
    totals.raw_point_count += sign * chunk.point_count;
  }
  if (chunk.kind != ChunkKind::kProduct) return;
  totals.product_chunk_count += sign;
  totals.product_point_count += sign * chunk.point_count;
  for (size_t label = 0; label < core::kLabelCount; ++label) {
    totals.label_counts[label] += sign * chunk.label_counts[label];
  }
}

// Applies one change to the chunks and tiles of one map.
class Change {
 public:
  Change(SqliteDatabase& database, const MapRow& map,
         const RevisionTotals& parent_totals)
      : database_(database),
        map_(map),
        revision_(map.record.newest_revision + 1),
        totals_(parent_totals) {}

  absl::StatusOr<RevisionTotals> Apply(const RevisionChange& change) {
    for (const int64_t number : change.removed) {
      MAPSIEVE_RETURN_IF_ERROR(Remove(number));
    }
    if (change.removes_product) MAPSIEVE_RETURN_IF_ERROR(RemoveProduct());
    const bool raw_removed = totals_.raw_chunk_count != parent_raw_chunk_count_;
    for (const ChunkRef& chunk : change.added) {
      MAPSIEVE_RETURN_IF_ERROR(Add(chunk));
    }
    if (raw_removed) MAPSIEVE_RETURN_IF_ERROR(MeasureBounds());
    MAPSIEVE_RETURN_IF_ERROR(UpdateTiles(change.spec.product.has_value()));
    return totals_;
  }

 private:
  absl::Status Remove(int64_t number) {
    ChunkRef chunk;
    {
      MAPSIEVE_ASSIGN_OR_RETURN(
          SqliteStatement query,
          database_.Prepare(
              absl::StrCat("SELECT ", kChunkColumns, ", ", kNumberColumns,
                           " FROM chunks WHERE number = ? AND map_key = ? AND "
                           "added_revision < ? AND removed_revision = ?")));
      MAPSIEVE_ASSIGN_OR_RETURN(const bool found, query.Bind(number)
                                                      .Bind(map_.key)
                                                      .Bind(revision_)
                                                      .Bind(kNever)
                                                      .Step());
      if (!found) {
        return absl::InvalidArgumentError(
            absl::StrCat("chunk ", number, " to remove is not in revision ",
                         revision_ - 1, " of map ", map_.record.spec.id));
      }
      MAPSIEVE_ASSIGN_OR_RETURN(chunk, TakeChunk(database_, map_, query));
    }
    {
      MAPSIEVE_ASSIGN_OR_RETURN(
          SqliteStatement update,
          database_.Prepare(
              "UPDATE chunks SET removed_revision = ? WHERE number = ?"));
      MAPSIEVE_RETURN_IF_ERROR(update.Bind(revision_).Bind(number).Run());
    }
    AddChunk(chunk, -1, totals_);
    return CountRawChunk(chunk, -1);
  }

  absl::Status RemoveProduct() {
    {
      MAPSIEVE_ASSIGN_OR_RETURN(
          SqliteStatement query,
          database_.Prepare(
              "SELECT ifnull(sum(stored_bytes), 0) FROM chunks WHERE "
              "map_key = ? AND kind <> ? AND removed_revision = ?"));
      MAPSIEVE_ASSIGN_OR_RETURN(
          const bool row,
          query.Bind(map_.key).Bind(ChunkKind::kRaw).Bind(kNever).Step());
      int64_t bytes = 0;
      if (row) query.Take(bytes);
      MAPSIEVE_RETURN_IF_ERROR(query.status());
      totals_.stored_bytes -= bytes;
      totals_.product_chunk_count = 0;
      totals_.product_point_count = 0;
      totals_.label_counts = {};
    }
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement update,
        database_.Prepare("UPDATE chunks SET removed_revision = ? WHERE "
                          "map_key = ? AND kind <> ? AND "
                          "removed_revision = ?"));
    return update.Bind(revision_)
        .Bind(map_.key)
        .Bind(ChunkKind::kRaw)
        .Bind(kNever)
        .Run();
  }

  absl::Status Add(const ChunkRef& chunk) {
    {
      MAPSIEVE_ASSIGN_OR_RETURN(
          SqliteStatement insert,
          database_.Prepare(absl::StrCat(
              "INSERT INTO chunks (map_key, added_revision, kind, min_depth, "
              "max_depth, blob_id, "
              "tile_key, ",
              kNumberColumns,
              ") VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, "
              "?)")));
      insert.Bind(map_.key)
          .Bind(revision_)
          .Bind(chunk.kind)
          .Bind(chunk.min_depth)
          .Bind(chunk.max_depth)
          .Bind(chunk.blob_id)
          .BindBlob(TileOrderKey(chunk.tile));
      VisitNumbers(chunk, [&](int64_t field) { insert.Bind(field); });
      MAPSIEVE_RETURN_IF_ERROR(insert.Run());
    }
    if (chunk.kind == ChunkKind::kRaw) {
      totals_.bounds = totals_.raw_chunk_count == 0
                           ? chunk.bounds
                           : totals_.bounds.Union(chunk.bounds);
    }
    AddChunk(chunk, 1, totals_);
    return CountRawChunk(chunk, 1);
  }

  absl::Status CountRawChunk(const ChunkRef& chunk, int sign) {
    if (chunk.kind != ChunkKind::kRaw) return absl::OkStatus();
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement upsert,
        database_.Prepare(
            "INSERT INTO tiles (map_key, tile_key, raw_chunk_count, "
            "raw_revision, product_revision) VALUES (?, ?, ?, ?, 0) "
            "ON CONFLICT DO UPDATE SET "
            "raw_chunk_count = raw_chunk_count + excluded.raw_chunk_count, "
            "raw_revision = excluded.raw_revision"));
    return upsert.Bind(map_.key)
        .BindBlob(TileOrderKey(chunk.tile))
        .Bind(sign)
        .Bind(revision_)
        .Run();
  }

  absl::Status MeasureBounds() {
    totals_.bounds = {};
    if (totals_.raw_chunk_count == 0) return absl::OkStatus();
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement query,
        database_.Prepare(
            "SELECT min(min_x), min(min_y), min(min_z), max(max_x), "
            "max(max_y), max(max_z) FROM chunks WHERE map_key = ? AND "
            "kind = ? AND removed_revision = ?"));
    MAPSIEVE_ASSIGN_OR_RETURN(
        const bool row,
        query.Bind(map_.key).Bind(ChunkKind::kRaw).Bind(kNever).Step());
    core::LatticeBox& bounds = totals_.bounds;
    if (row) {
      query.Take(bounds.min.x).Take(bounds.min.y).Take(bounds.min.z);
      query.Take(bounds.max.x).Take(bounds.max.y).Take(bounds.max.z);
    }
    return query.status();
  }

  absl::Status UpdateTiles(bool has_product) {
    if (has_product) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          SqliteStatement update,
          database_.Prepare(
              "UPDATE tiles SET product_revision = ? WHERE map_key = ?"));
      MAPSIEVE_RETURN_IF_ERROR(update.Bind(revision_).Bind(map_.key).Run());
    }
    {
      // Tiles without points that no product remembers.
      MAPSIEVE_ASSIGN_OR_RETURN(
          SqliteStatement remove,
          database_.Prepare("DELETE FROM tiles WHERE map_key = ? AND "
                            "raw_chunk_count = 0 AND (product_revision = 0 OR "
                            "product_revision >= raw_revision)"));
      MAPSIEVE_RETURN_IF_ERROR(remove.Bind(map_.key).Run());
    }
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement query,
        database_.Prepare("SELECT count(*) FILTER (WHERE raw_chunk_count > 0), "
                          "count(*) FILTER (WHERE raw_revision > "
                          "product_revision) FROM tiles WHERE map_key = ?"));
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Bind(map_.key).Step());
    if (row) query.Take(totals_.tile_count).Take(totals_.stale_tile_count);
    return query.status();
  }

  SqliteDatabase& database_;
  const MapRow& map_;
  const int64_t revision_;
  RevisionTotals totals_;
  const int64_t parent_raw_chunk_count_ = totals_.raw_chunk_count;
};

// The chunks asked for: those with from <= (tile_key, number) and
// tile_key <= to whose bounds intersect `region`.
struct Selection {
  std::string from_tile;
  int64_t after_number = -1;
  std::string to_tile;
  core::LatticeBox region;
};

constexpr char kSelected[] =
    " FROM chunks WHERE map_key = ? AND kind = ? AND added_revision <= ? AND "
    "removed_revision > ? AND (tile_key, number) > (?, ?) AND tile_key <= ? "
    "AND max_x > ? AND max_y > ? AND max_z > ? AND min_x < ? AND min_y < ? "
    "AND min_z < ?";

void BindSelection(const MapRow& map, int64_t revision, ChunkKind kind,
                   const Selection& selection, SqliteStatement& query) {
  query.Bind(map.key)
      .Bind(kind)
      .Bind(revision)
      .Bind(revision)
      .BindBlob(selection.from_tile)
      .Bind(selection.after_number)
      .BindBlob(selection.to_tile);
  for (const auto& corner : {selection.region.min, selection.region.max}) {
    query.Bind(corner.x).Bind(corner.y).Bind(corner.z);
  }
}

// The part of `region` that the lattice has; nothing if that is empty.
std::optional<core::LatticeBox> ClipToLattice(const core::LatticeBox& region) {
  constexpr int64_t kLimit = core::kLatticeLimit;
  const core::LatticeBox clipped{
      {std::max(region.min.x, -kLimit), std::max(region.min.y, -kLimit),
       std::max(region.min.z, -kLimit)},
      {std::min(region.max.x, kLimit), std::min(region.max.y, kLimit),
       std::min(region.max.z, kLimit)}};
  if (clipped.min.x >= clipped.max.x || clipped.min.y >= clipped.max.y ||
      clipped.min.z >= clipped.max.z) {
    return std::nullopt;
  }
  return clipped;
}

// Nothing if no chunk can be selected. On the Morton curve every tile of a box
// lies between the tiles of its two corners.
std::optional<Selection> Select(const MapRow& map,
                                const std::optional<core::LatticeBox>& region) {
  constexpr int64_t kLimit = core::kLatticeLimit;
  const auto clipped = ClipToLattice(region.value_or(
      core::LatticeBox{{-kLimit, -kLimit, -kLimit}, {kLimit, kLimit, kLimit}}));
  if (!clipped.has_value()) return std::nullopt;
  const int level = map.record.spec.tile_level;
  const core::LatticePoint last{clipped->max.x - 1, clipped->max.y - 1,
                                clipped->max.z - 1};
  return Selection{
      .from_tile = TileOrderKey(core::CellKey::Of(clipped->min, level)),
      .to_tile = TileOrderKey(core::CellKey::Of(last, level)),
      .region = *clipped};
}

// Leaves out what is not behind the chunk `number` of `tile`.
absl::Status SkipTo(const core::CellKey& tile, int64_t number,
                    Selection& selection) {
  if (!IsValidCell(tile)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "page position ", tile.ToString(), ": no cell of the octree"));
  }
  const std::string key = TileOrderKey(tile);
  if (key < selection.from_tile) return absl::OkStatus();
  selection.from_tile = key;
  selection.after_number = number;
  return absl::OkStatus();
}

absl::StatusOr<MapRow> ReadMapAt(SqliteDatabase& database,
                                 const std::string& map_uid, int64_t revision) {
  MAPSIEVE_ASSIGN_OR_RETURN(MapRow map, ReadMap(database, map_uid));
  MAPSIEVE_RETURN_IF_ERROR(CheckRevisionNumber(map, revision));
  return map;
}

absl::StatusOr<std::vector<ChunkRef>> TakeChunks(SqliteDatabase& database,
                                                 const MapRow& map,
                                                 SqliteStatement& query) {
  std::vector<ChunkRef> chunks;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return chunks;
    MAPSIEVE_ASSIGN_OR_RETURN(ChunkRef chunk, TakeChunk(database, map, query));
    chunks.push_back(std::move(chunk));
  }
}

absl::StatusOr<std::vector<ChunkRef>> ReadChunks(
    SqliteDatabase& database, const MapRow& map, int64_t revision,
    ChunkKind kind, const Selection& selection, int64_t max_count) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat("SELECT ", kChunkColumns, ", ",
                                    kNumberColumns, kSelected,
                                    " ORDER BY tile_key, number LIMIT ?")));
  BindSelection(map, revision, kind, selection, query);
  query.Bind(max_count);
  return TakeChunks(database, map, query);
}

}  // namespace

absl::StatusOr<RevisionTotals> ApplyChange(SqliteDatabase& database,
                                           const MapRow& map,
                                           const RevisionTotals& parent_totals,
                                           const RevisionChange& change) {
  return Change(database, map, parent_totals).Apply(change);
}

absl::Status RestoreChunks(SqliteDatabase& database, const MapRow& map,
                           const RevisionRecord& target) {
  const int64_t revision = map.record.newest_revision + 1;
  {
    // Where a chunk of the target is gone, all chunks of that kind and tile
    // get new references: their order, which is that of the numbers, stays.
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement update,
        database.Prepare(
            "UPDATE chunks SET removed_revision = ?3 WHERE map_key = ?1 AND "
            "removed_revision = ?4 AND (added_revision > ?2 OR "
            "(kind, tile_key) IN (SELECT kind, tile_key FROM chunks WHERE "
            "map_key = ?1 AND added_revision <= ?2 AND "
            "removed_revision > ?2 AND removed_revision < ?3))"));
    MAPSIEVE_RETURN_IF_ERROR(update.Bind(map.key)
                                 .Bind(target.number)
                                 .Bind(revision)
                                 .Bind(kNever)
                                 .Run());
  }
  {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement insert,
        database.Prepare(absl::StrCat(
            "INSERT INTO chunks (map_key, added_revision, kind, min_depth, "
            "max_depth, blob_id, tile_key, ",
            kNumberColumns,
            ") SELECT map_key, ?3, kind, min_depth, max_depth, blob_id, "
            "tile_key, ",
            kNumberColumns,
            " FROM chunks WHERE map_key = ?1 AND added_revision <= ?2 AND "
            "removed_revision > ?2 AND removed_revision <= ?3 "
            "ORDER BY number")));
    MAPSIEVE_RETURN_IF_ERROR(
        insert.Bind(map.key).Bind(target.number).Bind(revision).Run());
  }
  {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement remove,
        database.Prepare("DELETE FROM tiles WHERE map_key = ?"));
    MAPSIEVE_RETURN_IF_ERROR(remove.Bind(map.key).Run());
  }
  // The tiles as they were: what changed their points last is in the history
  // of the target, and the product took in those that had points when it was
  // made. Of references that expired, tile_changes tells what a target needs:
  // what changed a tile after the target's product was made.
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement insert,
      database.Prepare(absl::StrCat(
          "WITH RECURSIVE ", kHistory,
          ", changes (number) AS (SELECT number FROM revisions WHERE "
          "map_key = ?1 AND restored_revision = 0 AND "
          "number IN (SELECT number FROM history)) "
          "INSERT INTO tiles (map_key, tile_key, raw_chunk_count, "
          "raw_revision, product_revision) SELECT ?1, tile_key, "
          "count(*) FILTER (WHERE added_revision <= ?2 AND "
          "removed_revision > ?2) AS raw_chunk_count, "
          "max(max(1, iif(added_revision IN changes, added_revision, 0), "
          "iif(removed_revision IN changes, removed_revision, 0))) "
          "AS raw_revision, "
          "iif(count(*) FILTER (WHERE added_revision <= ?3 AND "
          "removed_revision > ?3) > 0, ?3, 0) AS product_revision "
          "FROM (SELECT tile_key, added_revision, removed_revision FROM chunks "
          "WHERE map_key = ?1 AND kind = ?4 UNION ALL "
          "SELECT tile_key, revision, revision FROM tile_changes "
          "WHERE map_key = ?1) GROUP BY tile_key "
          "HAVING raw_chunk_count > 0 OR "
          "(product_revision > 0 AND product_revision < raw_revision)")));
  return insert.Bind(map.key)
      .Bind(target.number)
      .Bind(target.processed_revision)
      .Bind(ChunkKind::kRaw)
      .Run();
}

absl::StatusOr<std::vector<ChunkRef>> ListChunks(
    SqliteDatabase& database, const std::string& map_uid, int64_t revision,
    ChunkKind kind, const std::optional<core::LatticeBox>& region,
    const std::optional<ChunkPosition>& after, int64_t max_count) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPageSize(max_count));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map,
                            ReadMapAt(database, map_uid, revision));
  auto selection = Select(map, region);
  if (!selection.has_value()) return std::vector<ChunkRef>();
  if (after.has_value()) {
    MAPSIEVE_RETURN_IF_ERROR(SkipTo(after->tile, after->number, *selection));
  }
  return ReadChunks(database, map, revision, kind, *selection, max_count);
}

absl::StatusOr<std::vector<ChunkRef>> ListTileChunks(
    SqliteDatabase& database, const std::string& map_uid, int64_t revision,
    ChunkKind kind, const core::CellKey& tile) {
  if (!IsValidCell(tile)) {
    return absl::InvalidArgumentError(
        absl::StrCat("tile ", tile.ToString(), ": no cell of the octree"));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map,
                            ReadMapAt(database, map_uid, revision));
  auto selection = Select(map, std::nullopt);
  selection->from_tile = TileOrderKey(tile);
  selection->to_tile = selection->from_tile;
  return ReadChunks(database, map, revision, kind, *selection, kLast);
}

absl::StatusOr<std::vector<ChunkRef>> ListAllChunks(SqliteDatabase& database,
                                                    const std::string& map_uid,
                                                    int64_t after,
                                                    int64_t max_count) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPageSize(max_count));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadMap(database, map_uid));
  MAPSIEVE_ASSIGN_OR_RETURN(SqliteStatement query,
                            database.Prepare(absl::StrCat(
                                "SELECT ", kChunkColumns, ", ", kNumberColumns,
                                " FROM chunks WHERE map_key = ? AND "
                                "number > ? ORDER BY number LIMIT ?")));
  query.Bind(map.key).Bind(after).Bind(max_count);
  return TakeChunks(database, map, query);
}

absl::StatusOr<int64_t> CountAllChunks(SqliteDatabase& database,
                                       const std::string& map_uid) {
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadMap(database, map_uid));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare("SELECT count(*) FROM chunks WHERE map_key = ?"));
  MAPSIEVE_RETURN_IF_ERROR(query.Bind(map.key).Step().status());
  int64_t count = 0;
  query.TakeCount(count);
  MAPSIEVE_RETURN_IF_ERROR(query.status());
  return count;
}

absl::StatusOr<std::vector<TileSummary>> ListTiles(
    SqliteDatabase& database, const std::string& map_uid, int64_t revision,
    ChunkKind kind, const std::optional<core::LatticeBox>& region,
    const std::optional<core::CellKey>& after, int64_t max_count) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPageSize(max_count));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map,
                            ReadMapAt(database, map_uid, revision));
  auto selection = Select(map, region);
  if (!selection.has_value()) return std::vector<TileSummary>();
  if (after.has_value()) {
    MAPSIEVE_RETURN_IF_ERROR(SkipTo(*after, kLast, *selection));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(
          "SELECT tile_key, count(*), sum(point_count), sum(stored_bytes), "
          "sum(none_count), sum(junction_count), sum(curve_count), "
          "sum(surface_count), min(min_x), min(min_y), min(min_z), "
          "max(max_x), max(max_y), max(max_z)",
          kSelected, " GROUP BY tile_key ORDER BY tile_key LIMIT ?")));
  BindSelection(map, revision, kind, *selection, query);
  query.Bind(max_count);
  std::vector<TileSummary> tiles;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return tiles;
    TileSummary tile;
    MAPSIEVE_ASSIGN_OR_RETURN(tile.tile, TakeTile(database, query));
    query.TakeCount(tile.chunk_count);
    VisitNumbers(tile, [&](int64_t& field) { query.Take(field); });
    MAPSIEVE_RETURN_IF_ERROR(query.status());
    tiles.push_back(tile);
  }
}

absl::StatusOr<std::vector<core::CellKey>> ListChangedTiles(
    SqliteDatabase& database, const std::string& map_uid, int64_t revision,
    int64_t other, ChunkKind kind, const std::optional<core::CellKey>& after,
    int64_t max_count) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPageSize(max_count));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map,
                            ReadMapAt(database, map_uid, revision));
  MAPSIEVE_RETURN_IF_ERROR(CheckRevisionNumber(map, other));
  auto selection = Select(map, std::nullopt);
  if (after.has_value()) {
    MAPSIEVE_RETURN_IF_ERROR(SkipTo(*after, kLast, *selection));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(
          "SELECT DISTINCT tile_key FROM chunks WHERE map_key = ?1 AND "
          "kind = ?2 AND (tile_key, number) > (?3, ?4) AND "
          "(added_revision <= ?5 AND removed_revision > ?5) != "
          "(added_revision <= ?6 AND removed_revision > ?6) "
          "ORDER BY tile_key LIMIT ?7"));
  query.Bind(map.key)
      .Bind(kind)
      .BindBlob(selection->from_tile)
      .Bind(selection->after_number)
      .Bind(revision)
      .Bind(other)
      .Bind(max_count);
  std::vector<core::CellKey> tiles;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return tiles;
    MAPSIEVE_ASSIGN_OR_RETURN(const core::CellKey tile,
                              TakeTile(database, query));
    tiles.push_back(tile);
  }
}

absl::StatusOr<std::vector<bool>> AreBlobsReferenced(
    SqliteDatabase& database, std::span<const BlobId> ids) {
  std::vector<bool> referenced;
  referenced.reserve(ids.size());
  for (const BlobId& id : ids) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement query,
        database.Prepare("SELECT 1 FROM chunks WHERE blob_id = ? LIMIT 1"));
    MAPSIEVE_ASSIGN_OR_RETURN(const bool found, query.Bind(id).Step());
    referenced.push_back(found);
  }
  return referenced;
}

}  // namespace mapsieve::storage
