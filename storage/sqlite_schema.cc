#include "storage/sqlite_schema.h"

#include <cstdint>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"

namespace mapsieve::storage {
namespace {

// "msve": marks the database as ours.
constexpr int64_t kApplicationId = 0x6d737665;
constexpr int64_t kSchemaVersion = 5;
// The version whose pages have no checksums.
constexpr int64_t kVersionWithoutChecksums = 3;

// FORMAT.md explains every table and column.
constexpr char kSchema[] = R"sql(
CREATE TABLE maps (
  map_key INTEGER PRIMARY KEY AUTOINCREMENT,
  uid TEXT NOT NULL UNIQUE,
  id TEXT NOT NULL,
  deleted INTEGER NOT NULL DEFAULT 0,
  display_name TEXT NOT NULL,
  step_nm INTEGER NOT NULL,
  tile_level INTEGER NOT NULL,
  crs_wkt TEXT NOT NULL,
  frame_id TEXT NOT NULL DEFAULT '',
  newest_revision INTEGER NOT NULL,
  create_time INTEGER NOT NULL,
  update_time INTEGER NOT NULL,
  process_options BLOB NOT NULL DEFAULT x''
) STRICT;
CREATE UNIQUE INDEX maps_by_id ON maps (id) WHERE deleted = 0;

CREATE TABLE revisions (
  map_key INTEGER NOT NULL REFERENCES maps,
  number INTEGER NOT NULL,
  kind INTEGER NOT NULL,
  create_time INTEGER NOT NULL,
  description BLOB NOT NULL,
  attributes BLOB NOT NULL,
  refused_non_finite INTEGER NOT NULL,
  refused_out_of_lattice INTEGER NOT NULL,
  processed_revision INTEGER NOT NULL,
  restored_revision INTEGER NOT NULL,
  raw_point_count INTEGER NOT NULL,
  raw_chunk_count INTEGER NOT NULL,
  product_point_count INTEGER NOT NULL,
  product_chunk_count INTEGER NOT NULL,
  none_count INTEGER NOT NULL,
  junction_count INTEGER NOT NULL,
  curve_count INTEGER NOT NULL,
  surface_count INTEGER NOT NULL,
  stored_bytes INTEGER NOT NULL,
  tile_count INTEGER NOT NULL,
  stale_tile_count INTEGER NOT NULL,
  min_x INTEGER NOT NULL, min_y INTEGER NOT NULL, min_z INTEGER NOT NULL,
  max_x INTEGER NOT NULL, max_y INTEGER NOT NULL, max_z INTEGER NOT NULL,
  product_options BLOB,
  distinct_point_count INTEGER NOT NULL,
  kept_none INTEGER NOT NULL,
  kept_junction INTEGER NOT NULL,
  kept_curve INTEGER NOT NULL,
  kept_surface INTEGER NOT NULL,
  max_confidence_none INTEGER NOT NULL,
  max_confidence_junction INTEGER NOT NULL,
  max_confidence_curve INTEGER NOT NULL,
  max_confidence_surface INTEGER NOT NULL,
  expired INTEGER NOT NULL DEFAULT 0,
  PRIMARY KEY (map_key, number)
) STRICT, WITHOUT ROWID;

CREATE TABLE chunks (
  number INTEGER PRIMARY KEY AUTOINCREMENT,
  map_key INTEGER NOT NULL REFERENCES maps,
  kind INTEGER NOT NULL,
  tile_key BLOB NOT NULL,
  added_revision INTEGER NOT NULL,
  removed_revision INTEGER NOT NULL DEFAULT 9223372036854775807,
  blob_id TEXT NOT NULL,
  point_count INTEGER NOT NULL,
  stored_bytes INTEGER NOT NULL,
  none_count INTEGER NOT NULL,
  junction_count INTEGER NOT NULL,
  curve_count INTEGER NOT NULL,
  surface_count INTEGER NOT NULL,
  min_x INTEGER NOT NULL, min_y INTEGER NOT NULL, min_z INTEGER NOT NULL,
  max_x INTEGER NOT NULL, max_y INTEGER NOT NULL, max_z INTEGER NOT NULL,
  min_depth INTEGER NOT NULL,
  max_depth INTEGER NOT NULL
) STRICT;
CREATE INDEX chunks_by_tile ON chunks (map_key, kind, tile_key, number);
CREATE INDEX chunks_by_blob ON chunks (blob_id);

CREATE TABLE tiles (
  map_key INTEGER NOT NULL REFERENCES maps,
  tile_key BLOB NOT NULL,
  raw_chunk_count INTEGER NOT NULL,
  raw_revision INTEGER NOT NULL,
  product_revision INTEGER NOT NULL,
  PRIMARY KEY (map_key, tile_key)
) STRICT, WITHOUT ROWID;

CREATE TABLE uploads (
  uid TEXT NOT NULL PRIMARY KEY,
  map_key INTEGER NOT NULL REFERENCES maps,
  id TEXT NOT NULL,
  expected_bytes INTEGER,
  content_hash TEXT NOT NULL,
  state INTEGER NOT NULL,
  committed_bytes INTEGER NOT NULL,
  create_time INTEGER NOT NULL,
  update_time INTEGER NOT NULL,
  revision INTEGER NOT NULL,
  report BLOB NOT NULL,
  UNIQUE (map_key, id)
) STRICT;

CREATE TABLE upload_revisions (
  map_key INTEGER NOT NULL REFERENCES maps,
  upload_id TEXT NOT NULL,
  revision INTEGER NOT NULL,
  report BLOB NOT NULL DEFAULT x'',
  PRIMARY KEY (map_key, upload_id, revision)
) STRICT, WITHOUT ROWID;

CREATE TABLE operations (
  number INTEGER PRIMARY KEY AUTOINCREMENT,
  id TEXT NOT NULL UNIQUE,
  target TEXT NOT NULL,
  verb TEXT NOT NULL,
  request BLOB NOT NULL,
  state INTEGER NOT NULL,
  cancel_requested INTEGER NOT NULL,
  done_count INTEGER NOT NULL,
  total_count INTEGER NOT NULL,
  error_code INTEGER NOT NULL,
  error_message TEXT NOT NULL,
  response BLOB NOT NULL,
  create_time INTEGER NOT NULL,
  update_time INTEGER NOT NULL
) STRICT;
CREATE INDEX operations_by_target ON operations (target, number);
CREATE INDEX operations_unfinished ON operations (number) WHERE state < 3;
)sql";

// What version 4 brought besides columns.
constexpr char kRetention[] = R"sql(
CREATE INDEX revisions_kept ON revisions (map_key, number) WHERE expired = 0;
CREATE INDEX chunks_removed ON chunks (map_key, removed_revision, number)
  WHERE removed_revision < 9223372036854775807;
CREATE TABLE tile_changes (
  map_key INTEGER NOT NULL REFERENCES maps,
  revision INTEGER NOT NULL,
  tile_key BLOB NOT NULL,
  PRIMARY KEY (map_key, revision, tile_key)
) STRICT, WITHOUT ROWID;
)sql";

struct Identity {
  int64_t application = 0;
  int64_t version = 0;
};

absl::StatusOr<Identity> ReadIdentity(SqliteDatabase& database) {
  Identity identity;
  MAPSIEVE_ASSIGN_OR_RETURN(identity.application,
                            database.QueryInteger("PRAGMA application_id"));
  MAPSIEVE_ASSIGN_OR_RETURN(identity.version,
                            database.QueryInteger("PRAGMA user_version"));
  return identity;
}

absl::Status SetVersion(SqliteDatabase& database) {
  return database.Execute(
      absl::StrCat("PRAGMA user_version = ", kSchemaVersion));
}

// The tables of an earlier version as those of kSchemaVersion.
absl::Status MigrateTables(SqliteDatabase& database, int64_t version) {
  if (version == kVersionWithoutChecksums) {
    MAPSIEVE_RETURN_IF_ERROR(database.Execute(
        "ALTER TABLE revisions ADD COLUMN expired INTEGER NOT NULL DEFAULT 0"));
    MAPSIEVE_RETURN_IF_ERROR(database.Execute(
        "ALTER TABLE upload_revisions ADD COLUMN report BLOB NOT NULL DEFAULT "
        "x''"));
    MAPSIEVE_RETURN_IF_ERROR(database.Execute(kRetention));
  }
  MAPSIEVE_RETURN_IF_ERROR(database.Execute(
      "ALTER TABLE maps ADD COLUMN frame_id TEXT NOT NULL DEFAULT ''"));
  return SetVersion(database);
}

}  // namespace

absl::StatusOr<bool> LacksPageChecksums(SqliteDatabase& database) {
  if (database.has_page_checksums()) return false;
  MAPSIEVE_ASSIGN_OR_RETURN(const Identity identity, ReadIdentity(database));
  return identity.application == kApplicationId &&
         identity.version == kVersionWithoutChecksums;
}

absl::Status PrepareSchema(SqliteDatabase& database, IfAbsent if_absent) {
  SqliteTransaction transaction(database);
  MAPSIEVE_RETURN_IF_ERROR(transaction.Begin(SqliteTransaction::Kind::kWrite));
  MAPSIEVE_ASSIGN_OR_RETURN(const Identity identity, ReadIdentity(database));
  const auto [application, version] = identity;
  if (application == kApplicationId) {
    if (version < kVersionWithoutChecksums || version > kSchemaVersion) {
      return absl::FailedPreconditionError(absl::StrCat(
          database.path(), ": a catalogue of version ", version,
          ", this program reads versions ", kVersionWithoutChecksums, " to ",
          kSchemaVersion, "; use the program that wrote it, or a newer one"));
    }
    if (!database.has_page_checksums()) {
      return absl::DataLossError(absl::StrCat(
          database.path(),
          ", offset 20: damaged: expected 8 reserved bytes a page, as a "
          "catalogue of version ",
          version, " has; restore the data directory from a backup"));
    }
    if (version < kSchemaVersion) {
      MAPSIEVE_RETURN_IF_ERROR(MigrateTables(database, version));
    }
    return transaction.Commit();
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      const int64_t object_count,
      database.QueryInteger("SELECT count(*) FROM sqlite_schema"));
  if (application != 0 || version != 0 || object_count != 0) {
    return absl::FailedPreconditionError(
        absl::StrCat(database.path(),
                     ": a database of another program; name another data "
                     "directory"));
  }
  if (if_absent == IfAbsent::kFail) {
    return absl::DataLossError(
        absl::StrCat(database.path(),
                     ": there are blobs beside it, but the catalogue is "
                     "gone; restore the data directory from a backup"));
  }
  MAPSIEVE_RETURN_IF_ERROR(database.Execute(kSchema));
  MAPSIEVE_RETURN_IF_ERROR(database.Execute(kRetention));
  MAPSIEVE_RETURN_IF_ERROR(database.Execute(
      absl::StrCat("PRAGMA application_id = ", kApplicationId)));
  MAPSIEVE_RETURN_IF_ERROR(SetVersion(database));
  return transaction.Commit();
}

}  // namespace mapsieve::storage
