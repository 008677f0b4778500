#ifndef MAPSIEVE_STORAGE_SQLITE_MAPS_H_
#define MAPSIEVE_STORAGE_SQLITE_MAPS_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/catalogue.h"
#include "storage/sqlite_database.h"

/// The tables maps and revisions. Each function runs inside a transaction of
/// its caller and has the contract of the Catalogue function of its name.
namespace mapsieve::storage {

template <>
inline constexpr int64_t kLargestEnumerator<RevisionKind> =
    static_cast<int64_t>(RevisionKind::kRollback);

/// A table expression, of one column `number`: the history of revision ?2 of
/// the map with the key ?1.
inline constexpr char kHistory[] =
    "history (number) AS (VALUES (?2) UNION "
    "SELECT iif(restored_revision > 0, restored_revision, history.number - 1) "
    "FROM history JOIN revisions ON revisions.map_key = ?1 AND "
    "revisions.number = history.number WHERE history.number > 1)";

struct MapRow {
  int64_t key = 0;
  bool deleted = false;
  MapRecord record;
};

/// The map of that uid, deleted or not. kNotFound.
absl::StatusOr<MapRow> ReadMap(SqliteDatabase& database,
                               const std::string& map_uid);
/// The same, and kNotFound if it is deleted.
absl::StatusOr<MapRow> ReadLivingMap(SqliteDatabase& database,
                                     const std::string& map_uid);

absl::StatusOr<MapRecord> CreateMap(SqliteDatabase& database,
                                    const MapSpec& spec);
absl::StatusOr<MapRecord> GetMap(SqliteDatabase& database,
                                 const std::string& id);
absl::StatusOr<std::vector<MapRecord>> ListMaps(SqliteDatabase& database,
                                                const std::string& after,
                                                int64_t max_count);
absl::Status DeleteMap(SqliteDatabase& database, const std::string& id);
absl::StatusOr<std::vector<std::string>> ListDeletedMaps(
    SqliteDatabase& database, const std::string& after, int64_t max_count);
/// Does a part of PurgeMap; true once the map is purged whole.
absl::StatusOr<bool> PurgePart(SqliteDatabase& database,
                               const std::string& map_uid);

/// kOutOfRange if the map has no revision of that number.
absl::Status CheckRevisionNumber(const MapRow& map, int64_t number);
absl::StatusOr<RevisionRecord> ReadRevision(SqliteDatabase& database,
                                            const MapRow& map, int64_t number);
/// The same, and kOutOfRange if it is expired.
absl::StatusOr<RevisionRecord> ReadKeptRevision(SqliteDatabase& database,
                                                const MapRow& map,
                                                int64_t number);
absl::Status InsertRevision(SqliteDatabase& database, int64_t map_key,
                            const RevisionRecord& revision);
/// Makes `revision` the newest of the map.
absl::Status SetNewestRevision(SqliteDatabase& database, int64_t map_key,
                               const RevisionRecord& revision);
/// Sets those of the two that are not empty.
absl::Status SetPlace(SqliteDatabase& database, int64_t map_key,
                      const std::string& crs_wkt, const std::string& frame_id);
absl::Status SetProcessOptions(SqliteDatabase& database, int64_t map_key,
                               const std::string& options);
absl::StatusOr<std::vector<RevisionRecord>> ListRevisions(
    SqliteDatabase& database, const std::string& map_uid, int64_t before,
    int64_t max_count);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_MAPS_H_
