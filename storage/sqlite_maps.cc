#include "storage/sqlite_maps.h"

#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/status.h"
#include "storage/names.h"
#include "storage/record_checks.h"

namespace mapsieve::storage {
namespace {

// A part that writes a few MB.
constexpr int64_t kChunksOfAPart = 4096;

// In the order of TakeMap.
constexpr char kMapColumns[] =
    "map_key, deleted, uid, id, display_name, step_nm, tile_level, crs_wkt, "
    "frame_id, newest_revision, (SELECT min(number) FROM revisions WHERE "
    "revisions.map_key = maps.map_key AND expired = 0), create_time, "
    "update_time, process_options";

absl::StatusOr<MapRow> TakeMap(SqliteStatement& row) {
  MapRow map;
  MapRecord& record = map.record;
  MapSpec& spec = record.spec;
  row.Take(map.key)
      .Take(map.deleted)
      .Take(record.uid)
      .Take(spec.id)
      .Take(spec.display_name)
      .Take(spec.step_nm);
  row.Check(spec.step_nm >= 1 && spec.step_nm <= core::kMaxStepNm,
            "is no lattice step");
  row.Take(spec.tile_level);
  row.Check(spec.tile_level >= 0 && spec.tile_level <= core::kMaxTileLevel,
            "is no level of tiles");
  row.Take(spec.crs_wkt)
      .Take(spec.frame_id)
      .TakeCount(record.newest_revision)
      .TakeCount(record.oldest_revision)
      .Take(record.create_time)
      .Take(record.update_time)
      .TakeBlob(record.process_options);
  MAPSIEVE_RETURN_IF_ERROR(row.status());
  return map;
}

// In the order of TakeRevision.
constexpr char kRevisionColumns[] =
    "number, kind, create_time, description, attributes, refused_non_finite, "
    "refused_out_of_lattice, processed_revision, restored_revision, expired, "
    "raw_point_count, raw_chunk_count, product_point_count, "
    "product_chunk_count, none_count, "
    "junction_count, curve_count, surface_count, stored_bytes, tile_count, "
    "stale_tile_count, min_x, min_y, min_z, max_x, max_y, max_z, "
    "product_options, distinct_point_count, kept_none, kept_junction, "
    "kept_curve, kept_surface, max_confidence_none, max_confidence_junction, "
    "max_confidence_curve, max_confidence_surface";
constexpr char kRevisionParameters[] =
    "?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, "
    "?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?";

template <typename Totals, typename Visit>
void VisitTotals(Totals& totals, const Visit& visit) {
  visit(totals.raw_point_count);
  visit(totals.raw_chunk_count);
  visit(totals.product_point_count);
  visit(totals.product_chunk_count);
  for (auto& count : totals.label_counts) visit(count);
  visit(totals.stored_bytes);
  visit(totals.tile_count);
  visit(totals.stale_tile_count);
}

template <typename Totals, typename Visit>
void VisitBounds(Totals& totals, const Visit& visit) {
  for (auto* corner : {&totals.bounds.min, &totals.bounds.max}) {
    visit(corner->x);
    visit(corner->y);
    visit(corner->z);
  }
}

template <typename Product, typename Visit>
void VisitProductCounts(Product& product, const Visit& visit) {
  visit(product.distinct_point_count);
  for (auto& count : product.kept_counts) visit(count);
}

absl::StatusOr<RevisionRecord> TakeRevision(SqliteStatement& row) {
  RevisionRecord revision;
  RevisionSpec& spec = revision.spec;
  std::string attributes;
  row.TakeCount(revision.number)
      .Take(spec.kind)
      .Take(revision.create_time)
      .TakeBlob(spec.description)
      .TakeBlob(attributes)
      .TakeCount(spec.refused.non_finite)
      .TakeCount(spec.refused.out_of_lattice)
      .TakeCount(revision.processed_revision)
      .TakeCount(revision.restored_revision)
      .Take(revision.is_expired);
  revision.parent = revision.number - 1;
  const auto take_count = [&](int64_t& count) { row.TakeCount(count); };
  VisitTotals(revision.totals, take_count);
  VisitBounds(revision.totals, [&](int64_t& coordinate) {
    row.Take(coordinate);
    row.Check(
        coordinate >= -core::kLatticeLimit && coordinate <= core::kLatticeLimit,
        "lies outside the lattice");
  });
  ProductSummary product;
  const bool has_product = !row.TakeNull();
  if (has_product) row.TakeBlob(product.options);
  VisitProductCounts(product, take_count);
  for (uint16_t& confidence : product.max_confidence) row.Take(confidence);
  if (has_product) spec.product = std::move(product);
  MAPSIEVE_RETURN_IF_ERROR(row.status());
  MAPSIEVE_ASSIGN_OR_RETURN(spec.attributes, DecodeAttributes(attributes));
  return revision;
}

absl::Status NoSuchMap(const std::string& name) {
  return absl::NotFoundError(
      absl::StrCat("map ", Quoted(name), " does not exist"));
}

}  // namespace

absl::StatusOr<MapRow> ReadMap(SqliteDatabase& database,
                               const std::string& map_uid) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(
          absl::StrCat("SELECT ", kMapColumns, " FROM maps WHERE uid = ?")));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool found, query.Bind(map_uid).Step());
  if (!found) return NoSuchMap(map_uid);
  return TakeMap(query);
}

absl::StatusOr<MapRow> ReadLivingMap(SqliteDatabase& database,
                                     const std::string& map_uid) {
  MAPSIEVE_ASSIGN_OR_RETURN(MapRow map, ReadMap(database, map_uid));
  if (!map.deleted) return map;
  return absl::NotFoundError(
      absl::StrCat("map ", map.record.spec.id, " was deleted"));
}

absl::StatusOr<MapRecord> GetMap(SqliteDatabase& database,
                                 const std::string& id) {
  MAPSIEVE_RETURN_IF_ERROR(CheckMapId(id));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(
          "SELECT ", kMapColumns, " FROM maps WHERE id = ? AND deleted = 0")));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool found, query.Bind(id).Step());
  if (!found) return NoSuchMap(id);
  MAPSIEVE_ASSIGN_OR_RETURN(MapRow map, TakeMap(query));
  return std::move(map.record);
}

absl::StatusOr<MapRecord> CreateMap(SqliteDatabase& database,
                                    const MapSpec& spec) {
  MAPSIEVE_RETURN_IF_ERROR(CheckMapSpec(spec));
  const auto existing = GetMap(database, spec.id);
  if (existing.ok()) {
    return absl::AlreadyExistsError(
        absl::StrCat("map ", spec.id, " exists already"));
  }
  if (!absl::IsNotFound(existing.status())) return existing.status();

  RevisionRecord first;
  first.number = 1;
  first.create_time = absl::Now();
  first.spec.kind = RevisionKind::kCreate;
  {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement insert,
        database.Prepare(
            "INSERT INTO maps (uid, id, display_name, step_nm, tile_level, "
            "crs_wkt, frame_id, newest_revision, create_time, update_time) "
            "VALUES (lower(hex(randomblob(16))), ?, ?, ?, ?, ?, ?, ?, ?, "
            "?)"));
    MAPSIEVE_RETURN_IF_ERROR(insert.Bind(spec.id)
                                 .Bind(spec.display_name)
                                 .Bind(spec.step_nm)
                                 .Bind(spec.tile_level)
                                 .Bind(spec.crs_wkt)
                                 .Bind(spec.frame_id)
                                 .Bind(first.number)
                                 .Bind(first.create_time)
                                 .Bind(first.create_time)
                                 .Run());
  }
  MAPSIEVE_RETURN_IF_ERROR(
      InsertRevision(database, database.last_row_number(), first));
  return GetMap(database, spec.id);
}

absl::StatusOr<std::vector<MapRecord>> ListMaps(SqliteDatabase& database,
                                                const std::string& after,
                                                int64_t max_count) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPageSize(max_count));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(
          "SELECT ", kMapColumns,
          " FROM maps WHERE deleted = 0 AND id > ? ORDER BY id LIMIT ?")));
  query.Bind(after).Bind(max_count);
  std::vector<MapRecord> maps;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return maps;
    MAPSIEVE_ASSIGN_OR_RETURN(MapRow map, TakeMap(query));
    maps.push_back(std::move(map.record));
  }
}

absl::Status DeleteMap(SqliteDatabase& database, const std::string& id) {
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRecord map, GetMap(database, id));
  {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement remove,
        database.Prepare("DELETE FROM uploads WHERE map_key = "
                         "(SELECT map_key FROM maps WHERE uid = ?)"));
    MAPSIEVE_RETURN_IF_ERROR(remove.Bind(map.uid).Run());
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement update,
      database.Prepare("UPDATE maps SET deleted = 1 WHERE uid = ?"));
  return update.Bind(map.uid).Run();
}

absl::StatusOr<std::vector<std::string>> ListDeletedMaps(
    SqliteDatabase& database, const std::string& after, int64_t max_count) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPageSize(max_count));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare("SELECT uid FROM maps WHERE deleted = 1 AND uid > ? "
                       "ORDER BY uid LIMIT ?"));
  query.Bind(after).Bind(max_count);
  std::vector<std::string> uids;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return uids;
    query.Take(uids.emplace_back());
    MAPSIEVE_RETURN_IF_ERROR(query.status());
  }
}

absl::StatusOr<bool> PurgePart(SqliteDatabase& database,
                               const std::string& map_uid) {
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadMap(database, map_uid));
  if (!map.deleted) {
    return absl::FailedPreconditionError(absl::StrCat(
        "map ", map.record.spec.id, " is not deleted; delete it first"));
  }
  {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement remove,
        database.Prepare("DELETE FROM chunks WHERE number IN (SELECT number "
                         "FROM chunks WHERE map_key = ? LIMIT ?)"));
    MAPSIEVE_RETURN_IF_ERROR(remove.Bind(map.key).Bind(kChunksOfAPart).Run());
  }
  if (database.changed_row_count() == kChunksOfAPart) return false;
  for (const char* table :
       {"tiles", "tile_changes", "upload_revisions", "revisions", "maps"}) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement remove,
        database.Prepare(
            absl::StrCat("DELETE FROM ", table, " WHERE map_key = ?")));
    MAPSIEVE_RETURN_IF_ERROR(remove.Bind(map.key).Run());
  }
  return true;
}

absl::Status CheckRevisionNumber(const MapRow& map, int64_t number) {
  if (number >= 1 && number <= map.record.newest_revision) {
    return absl::OkStatus();
  }
  return absl::OutOfRangeError(
      absl::StrCat("map ", map.record.spec.id, " has no revision ", number,
                   ": expected 1 to ", map.record.newest_revision));
}

absl::StatusOr<RevisionRecord> ReadRevision(SqliteDatabase& database,
                                            const MapRow& map, int64_t number) {
  MAPSIEVE_RETURN_IF_ERROR(CheckRevisionNumber(map, number));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(
          absl::StrCat("SELECT ", kRevisionColumns,
                       " FROM revisions WHERE map_key = ? AND number = ?")));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool found,
                            query.Bind(map.key).Bind(number).Step());
  if (!found) {
    return absl::DataLossError(
        absl::StrCat(database.path(), ": damaged: revision ", number,
                     " of map ", map.record.spec.id, " is missing"));
  }
  return TakeRevision(query);
}

absl::StatusOr<RevisionRecord> ReadKeptRevision(SqliteDatabase& database,
                                                const MapRow& map,
                                                int64_t number) {
  MAPSIEVE_ASSIGN_OR_RETURN(RevisionRecord revision,
                            ReadRevision(database, map, number));
  if (!revision.is_expired) return revision;
  return absl::OutOfRangeError(absl::StrCat(
      "map ", map.record.spec.id, ": revision ", number,
      " expired; the oldest one that is kept is ", map.record.oldest_revision));
}

absl::Status InsertRevision(SqliteDatabase& database, int64_t map_key,
                            const RevisionRecord& revision) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement insert,
      database.Prepare(absl::StrCat("INSERT INTO revisions (", kRevisionColumns,
                                    ", map_key) VALUES (", kRevisionParameters,
                                    ", ?)")));
  const RevisionSpec& spec = revision.spec;
  insert.Bind(revision.number)
      .Bind(spec.kind)
      .Bind(revision.create_time)
      .BindBlob(spec.description)
      .BindBlob(EncodeAttributes(spec.attributes))
      .Bind(spec.refused.non_finite)
      .Bind(spec.refused.out_of_lattice)
      .Bind(revision.processed_revision)
      .Bind(revision.restored_revision)
      .Bind(revision.is_expired);
  const auto bind = [&](int64_t value) { insert.Bind(value); };
  VisitTotals(revision.totals, bind);
  VisitBounds(revision.totals, bind);
  if (spec.product.has_value()) {
    insert.BindBlob(spec.product->options);
  } else {
    insert.BindNull();
  }
  const ProductSummary product = spec.product.value_or(ProductSummary());
  VisitProductCounts(product, bind);
  for (const uint16_t confidence : product.max_confidence) {
    insert.Bind(confidence);
  }
  return insert.Bind(map_key).Run();
}

absl::Status SetNewestRevision(SqliteDatabase& database, int64_t map_key,
                               const RevisionRecord& revision) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement update,
      database.Prepare("UPDATE maps SET newest_revision = ?, update_time = ? "
                       "WHERE map_key = ?"));
  return update.Bind(revision.number)
      .Bind(revision.create_time)
      .Bind(map_key)
      .Run();
}

absl::Status SetPlace(SqliteDatabase& database, int64_t map_key,
                      const std::string& crs_wkt, const std::string& frame_id) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement update,
      database.Prepare(
          "UPDATE maps SET crs_wkt = ifnull(nullif(?, ''), crs_wkt), "
          "frame_id = ifnull(nullif(?, ''), frame_id) WHERE map_key = ?"));
  return update.Bind(crs_wkt).Bind(frame_id).Bind(map_key).Run();
}

absl::Status SetProcessOptions(SqliteDatabase& database, int64_t map_key,
                               const std::string& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement update,
      database.Prepare("UPDATE maps SET process_options = ? WHERE "
                       "map_key = ?"));
  return update.BindBlob(options).Bind(map_key).Run();
}

absl::StatusOr<std::vector<RevisionRecord>> ListRevisions(
    SqliteDatabase& database, const std::string& map_uid, int64_t before,
    int64_t max_count) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPageSize(max_count));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadMap(database, map_uid));
  MAPSIEVE_ASSIGN_OR_RETURN(SqliteStatement query,
                            database.Prepare(absl::StrCat(
                                "SELECT ", kRevisionColumns,
                                " FROM revisions WHERE map_key = ? AND "
                                "number < ? ORDER BY number DESC LIMIT ?")));
  query.Bind(map.key)
      .Bind(before == 0 ? std::numeric_limits<int64_t>::max() : before)
      .Bind(max_count);
  std::vector<RevisionRecord> revisions;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return revisions;
    MAPSIEVE_ASSIGN_OR_RETURN(RevisionRecord revision, TakeRevision(query));
    revisions.push_back(std::move(revision));
  }
}

}  // namespace mapsieve::storage
