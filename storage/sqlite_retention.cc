#include "storage/sqlite_retention.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "storage/sqlite_chunks.h"

namespace mapsieve::storage {
namespace {

// A part that writes a few MB.
constexpr size_t kForgottenOfAPart = 4096;
// A part that others wait for some milliseconds.
constexpr int64_t kMeasuredOfAPart = 4096;

// Before the text of a condition on removed_revision, for SQLite to find the
// index chunks_removed.
constexpr char kIsRemoved[] = " removed_revision < 9223372036854775807 ";

// The revisions that have readers or may get some: those that are kept, those
// that are pinned, and those whose products these have.
absl::StatusOr<std::set<int64_t>> ReadableRevisions(
    SqliteDatabase& database, const MapRow& map,
    const std::set<int64_t>& pinned) {
  std::set<int64_t> readable;
  {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement query,
        database.Prepare("SELECT number FROM revisions WHERE map_key = ? AND "
                         "expired = 0"));
    query.Bind(map.key);
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
      if (!row) break;
      int64_t number = 0;
      query.TakeCount(number);
      MAPSIEVE_RETURN_IF_ERROR(query.status());
      readable.insert(readable.end(), number);
    }
  }
  for (const int64_t number : pinned) {
    MAPSIEVE_ASSIGN_OR_RETURN(const RevisionRecord revision,
                              ReadRevision(database, map, number));
    readable.insert(number);
    if (revision.processed_revision != 0) {
      readable.insert(revision.processed_revision);
    }
  }
  return readable;
}

// No rollback has to know what changed in revisions up to this one: every kept
// revision with a product has one that was made then or later.
absl::StatusOr<int64_t> OldestProduct(SqliteDatabase& database,
                                      const MapRow& map) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare("SELECT ifnull(min(processed_revision), "
                       "9223372036854775807) FROM revisions WHERE "
                       "map_key = ? AND expired = 0 AND "
                       "processed_revision > 0"));
  MAPSIEVE_RETURN_IF_ERROR(query.Bind(map.key).Step().status());
  int64_t number = 0;
  query.Take(number);
  MAPSIEVE_RETURN_IF_ERROR(query.status());
  return number;
}

// What a reference that is to be forgotten tells about its tile.
struct Removed {
  int64_t number = 0;
  ChunkKind kind = ChunkKind::kRaw;
  std::string tile_key;
  int64_t added_revision = 0;
  int64_t removed_revision = 0;
  BlobId blob_id;
};

// Up to `max_count` references that belong to no revision but such between
// `first` and `last`.
absl::StatusOr<std::vector<Removed>> ReferencesBetween(SqliteDatabase& database,
                                                       const MapRow& map,
                                                       int64_t first,
                                                       int64_t last,
                                                       size_t max_count) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(
          "SELECT number, kind, tile_key, added_revision, removed_revision, "
          "blob_id FROM chunks WHERE map_key = ? AND",
          kIsRemoved,
          "AND removed_revision > ? AND removed_revision <= ? AND "
          "added_revision > ? LIMIT ?")));
  query.Bind(map.key).Bind(first).Bind(last).Bind(first).Bind(
      static_cast<int64_t>(max_count));
  std::vector<Removed> references;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return references;
    Removed reference;
    query.TakeCount(reference.number)
        .Take(reference.kind)
        .TakeBlob(reference.tile_key)
        .TakeCount(reference.added_revision)
        .TakeCount(reference.removed_revision)
        .Take(reference.blob_id);
    MAPSIEVE_RETURN_IF_ERROR(query.status());
    references.push_back(std::move(reference));
  }
}

// Keeps what a rollback has to know of a reference, and forgets the rest.
absl::Status Forget(SqliteDatabase& database, const MapRow& map,
                    const Removed& reference, int64_t oldest_product) {
  if (reference.kind == ChunkKind::kRaw) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement insert,
        database.Prepare("INSERT INTO tile_changes (map_key, revision, "
                         "tile_key) SELECT map_key, number, ? FROM revisions "
                         "WHERE map_key = ? AND number IN (?, ?) AND "
                         "number > ? AND restored_revision = 0 "
                         "ON CONFLICT DO NOTHING"));
    MAPSIEVE_RETURN_IF_ERROR(insert.BindBlob(reference.tile_key)
                                 .Bind(map.key)
                                 .Bind(reference.added_revision)
                                 .Bind(reference.removed_revision)
                                 .Bind(oldest_product)
                                 .Run());
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement remove,
      database.Prepare("DELETE FROM chunks WHERE number = ?"));
  return remove.Bind(reference.number).Run();
}

}  // namespace

absl::StatusOr<int64_t> ExpireRevisions(SqliteDatabase& database,
                                        const std::string& map_uid,
                                        int64_t kept_count) {
  if (kept_count < 1) {
    return absl::InvalidArgumentError(absl::StrCat(
        "revisions to keep: expected at least 1, got ", kept_count));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadMap(database, map_uid));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement update,
      database.Prepare("UPDATE revisions SET expired = 1 WHERE map_key = ?1 "
                       "AND expired = 0 AND number <= ?2 AND number NOT IN "
                       "(SELECT processed_revision FROM revisions WHERE "
                       "map_key = ?1 AND number > ?2)"));
  MAPSIEVE_RETURN_IF_ERROR(
      update.Bind(map.key).Bind(map.record.newest_revision - kept_count).Run());
  return database.changed_row_count();
}

absl::StatusOr<std::vector<BlobId>> ForgetExpired(
    SqliteDatabase& database, const std::string& map_uid,
    const std::set<int64_t>& pinned) {
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadMap(database, map_uid));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::set<int64_t> readable,
                            ReadableRevisions(database, map, pinned));
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t oldest_product,
                            OldestProduct(database, map));
  std::vector<BlobId> blobs;
  int64_t before = 0;
  for (const int64_t number : readable) {
    const int64_t first = std::exchange(before, number);
    if (number == first + 1) continue;
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<Removed> references,
        ReferencesBetween(database, map, first, number,
                          kForgottenOfAPart - blobs.size()));
    for (const Removed& reference : references) {
      MAPSIEVE_RETURN_IF_ERROR(
          Forget(database, map, reference, oldest_product));
      blobs.push_back(reference.blob_id);
    }
    if (blobs.size() == kForgottenOfAPart) return blobs;
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement remove,
      database.Prepare(
          "DELETE FROM tile_changes WHERE map_key = ? AND revision <= ?"));
  MAPSIEVE_RETURN_IF_ERROR(remove.Bind(map.key).Bind(oldest_product).Run());
  return blobs;
}

absl::StatusOr<ReclaimablePart> MeasurePart(SqliteDatabase& database,
                                            const std::string& map_uid,
                                            const ReclaimablePart& done) {
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadMap(database, map_uid));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const RevisionRecord newest,
      ReadRevision(database, map, map.record.newest_revision));
  // A blob counts where it is referred to first.
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(
          "SELECT removed_revision, number, iif(EXISTS (SELECT 1 FROM chunks "
          "AS other WHERE other.blob_id = chunks.blob_id AND "
          "(other.map_key <> ?1 OR other.number < chunks.number OR "
          "other.removed_revision = 9223372036854775807 OR "
          "(other.added_revision <= ?2 AND other.removed_revision > ?2))), 0, "
          "stored_bytes) FROM chunks WHERE map_key = ?1 AND",
          kIsRemoved,
          "AND (removed_revision, number) > (?3, ?4) "
          "ORDER BY removed_revision, number LIMIT ?5")));
  query.Bind(map.key)
      .Bind(newest.processed_revision)
      .Bind(done.removed_revision)
      .Bind(done.number)
      .Bind(kMeasuredOfAPart);
  ReclaimablePart part = done;
  for (int64_t count = 0;; ++count) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) {
      part.is_last = count < kMeasuredOfAPart;
      return part;
    }
    int64_t bytes = 0;
    query.TakeCount(part.removed_revision)
        .TakeCount(part.number)
        .TakeCount(bytes);
    MAPSIEVE_RETURN_IF_ERROR(query.status());
    part.bytes += bytes;
  }
}

}  // namespace mapsieve::storage
