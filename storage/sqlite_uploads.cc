#include "storage/sqlite_uploads.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/status.h"
#include "storage/names.h"
#include "storage/record_checks.h"

namespace mapsieve::storage {
namespace {

// In the order of TakeUpload.
constexpr char kSelectUpload[] =
    "SELECT uploads.uid, maps.uid, uploads.id, expected_bytes, content_hash, "
    "state, committed_bytes, uploads.create_time, uploads.update_time, "
    "revision, report FROM uploads JOIN maps USING (map_key) ";

absl::StatusOr<UploadRecord> TakeUpload(SqliteStatement& row) {
  UploadRecord upload;
  row.Take(upload.uid)
      .Take(upload.map_uid)
      .Take(upload.spec.id)
      .Take(upload.spec.expected_bytes);
  row.Check(upload.spec.expected_bytes.value_or(0) >= 0, "is negative");
  row.Take(upload.spec.content_hash)
      .Take(upload.state)
      .TakeCount(upload.committed_bytes)
      .Take(upload.create_time)
      .Take(upload.update_time)
      .TakeCount(upload.revision)
      .TakeBlob(upload.report);
  MAPSIEVE_RETURN_IF_ERROR(row.status());
  return upload;
}

constexpr int64_t kUploadsOfAPage = 1000;

const char* StateName(UploadState state) {
  switch (state) {
    case UploadState::kActive:
      return "active";
    case UploadState::kFinalizing:
      return "finalizing";
    case UploadState::kFinalized:
      return "finalized";
    case UploadState::kFailed:
      return "failed";
  }
  return "unknown";
}

absl::Status CheckState(const UploadRecord& upload, UploadState expected) {
  if (upload.state == expected) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("upload ", upload.spec.id, ": expected to be ",
                   StateName(expected), ", it is ", StateName(upload.state)));
}

absl::Status NoSuchUpload(const std::string& name) {
  return absl::NotFoundError(
      absl::StrCat("upload ", Quoted(name), " does not exist"));
}

absl::Status UpdateState(SqliteDatabase& database, const UploadRecord& upload) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement update,
      database.Prepare("UPDATE uploads SET state = ?, revision = ?, "
                       "report = ?, update_time = ? WHERE uid = ?"));
  return update.Bind(upload.state)
      .Bind(upload.revision)
      .BindBlob(upload.report)
      .Bind(upload.update_time)
      .Bind(upload.uid)
      .Run();
}

absl::Status RemoveUpload(SqliteDatabase& database,
                          const std::string& upload_uid) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement remove,
      database.Prepare("DELETE FROM uploads WHERE uid = ?"));
  return remove.Bind(upload_uid).Run();
}

/// A time that the points of an upload were added to its map.
struct Addition {
  /// 0: none.
  int64_t revision = 0;
  std::string report;
};

/// The last time, in the history of revision `number`, that the points of the
/// upload `id` were added.
absl::StatusOr<Addition> LastAddition(SqliteDatabase& database,
                                      const MapRow& map, int64_t number,
                                      const std::string& id) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(
          "WITH RECURSIVE ", kHistory,
          " SELECT revision, report FROM upload_revisions WHERE map_key = ?1 "
          "AND "
          "upload_id = ?3 AND revision IN (SELECT number FROM history) "
          "ORDER BY revision DESC")));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool found,
                            query.Bind(map.key).Bind(number).Bind(id).Step());
  Addition addition;
  if (found) query.TakeCount(addition.revision).TakeBlob(addition.report);
  MAPSIEVE_RETURN_IF_ERROR(query.status());
  return addition;
}

}  // namespace

absl::StatusOr<UploadRecord> CreateUpload(SqliteDatabase& database,
                                          const std::string& map_uid,
                                          const UploadSpec& spec) {
  MAPSIEVE_RETURN_IF_ERROR(CheckUploadSpec(spec));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadLivingMap(database, map_uid));
  auto existing = GetUpload(database, map_uid, spec.id);
  if (existing.ok()) {
    if (!(existing->spec == spec)) {
      return absl::AlreadyExistsError(
          absl::StrCat("upload ", spec.id, " of map ", map.record.spec.id,
                       " exists already, with another size or content hash"));
    }
    if (existing->state != UploadState::kFinalized) return existing;
    MAPSIEVE_ASSIGN_OR_RETURN(
        const Addition addition,
        LastAddition(database, map, map.record.newest_revision, spec.id));
    if (addition.revision != 0) {
      existing->revision = addition.revision;
      MAPSIEVE_RETURN_IF_ERROR(UpdateState(database, *existing));
      return existing;
    }
    MAPSIEVE_RETURN_IF_ERROR(RemoveUpload(database, existing->uid));
  } else if (!absl::IsNotFound(existing.status())) {
    return existing;
  }

  const absl::Time now = absl::Now();
  {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement insert,
        database.Prepare(
            "INSERT INTO uploads (uid, map_key, id, expected_bytes, "
            "content_hash, state, committed_bytes, create_time, update_time, "
            "revision, report) VALUES (lower(hex(randomblob(16))), ?, ?, ?, ?, "
            "?, 0, ?, ?, 0, x'')"));
    MAPSIEVE_RETURN_IF_ERROR(insert.Bind(map.key)
                                 .Bind(spec.id)
                                 .Bind(spec.expected_bytes)
                                 .Bind(spec.content_hash)
                                 .Bind(UploadState::kActive)
                                 .Bind(now)
                                 .Bind(now)
                                 .Run());
  }
  return GetUpload(database, map_uid, spec.id);
}

absl::StatusOr<UploadRecord> GetUpload(SqliteDatabase& database,
                                       const std::string& map_uid,
                                       const std::string& id) {
  MAPSIEVE_RETURN_IF_ERROR(CheckResourceId(id));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(kSelectUpload,
                                    "WHERE maps.uid = ? AND uploads.id = ?")));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool found,
                            query.Bind(map_uid).Bind(id).Step());
  if (!found) return NoSuchUpload(id);
  return TakeUpload(query);
}

absl::StatusOr<UploadRecord> GetUploadByUid(SqliteDatabase& database,
                                            const std::string& upload_uid) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(kSelectUpload, "WHERE uploads.uid = ?")));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool found, query.Bind(upload_uid).Step());
  if (!found) return NoSuchUpload(upload_uid);
  return TakeUpload(query);
}

absl::StatusOr<std::vector<UploadRecord>> ListUploads(
    SqliteDatabase& database, const std::string& map_uid,
    const std::string& after, int64_t max_count) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPageSize(max_count));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(kSelectUpload,
                                    "WHERE maps.uid = ? AND uploads.id > ? "
                                    "ORDER BY uploads.id LIMIT ?")));
  query.Bind(map_uid).Bind(after).Bind(max_count);
  std::vector<UploadRecord> uploads;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return uploads;
    MAPSIEVE_ASSIGN_OR_RETURN(UploadRecord upload, TakeUpload(query));
    uploads.push_back(std::move(upload));
  }
}

absl::Status SetCommittedBytes(SqliteDatabase& database,
                               const std::string& upload_uid, int64_t bytes) {
  MAPSIEVE_ASSIGN_OR_RETURN(const UploadRecord upload,
                            GetUploadByUid(database, upload_uid));
  MAPSIEVE_RETURN_IF_ERROR(CheckState(upload, UploadState::kActive));
  if (bytes < upload.committed_bytes) {
    return absl::InvalidArgumentError(absl::StrCat(
        "upload ", upload.spec.id, ": expected at least the ",
        upload.committed_bytes, " bytes committed before, got ", bytes));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement update,
      database.Prepare("UPDATE uploads SET committed_bytes = ?, "
                       "update_time = ? WHERE uid = ?"));
  return update.Bind(bytes).Bind(absl::Now()).Bind(upload_uid).Run();
}

absl::StatusOr<UploadRecord> SetUploadState(SqliteDatabase& database,
                                            const std::string& upload_uid,
                                            UploadState from, UploadState to,
                                            const std::string& report) {
  if (from == UploadState::kFinalized || to == UploadState::kFinalized) {
    return absl::InvalidArgumentError(
        "only the commit of its points makes an upload finalized, for good");
  }
  MAPSIEVE_ASSIGN_OR_RETURN(UploadRecord upload,
                            GetUploadByUid(database, upload_uid));
  MAPSIEVE_RETURN_IF_ERROR(CheckState(upload, from));
  upload.state = to;
  upload.report = report;
  upload.update_time = absl::Now();
  MAPSIEVE_RETURN_IF_ERROR(UpdateState(database, upload));
  return GetUploadByUid(database, upload_uid);
}

absl::Status FinalizeUpload(SqliteDatabase& database,
                            const std::string& map_uid,
                            const std::string& upload_uid,
                            const RevisionRecord& revision,
                            const std::string& report) {
  MAPSIEVE_ASSIGN_OR_RETURN(UploadRecord upload,
                            GetUploadByUid(database, upload_uid));
  if (upload.map_uid != map_uid) return NoSuchUpload(upload_uid);
  MAPSIEVE_RETURN_IF_ERROR(CheckState(upload, UploadState::kFinalizing));
  upload.state = UploadState::kFinalized;
  upload.revision = revision.number;
  upload.report = report;
  upload.update_time = revision.create_time;
  MAPSIEVE_RETURN_IF_ERROR(UpdateState(database, upload));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement insert,
      database.Prepare(
          "INSERT INTO upload_revisions (map_key, upload_id, revision, report) "
          "SELECT map_key, id, revision, report FROM uploads WHERE uid = ?"));
  return insert.Bind(upload_uid).Run();
}

absl::Status FinalizeRestoredUploads(SqliteDatabase& database,
                                     const MapRow& map, int64_t number) {
  std::string after;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        std::vector<UploadRecord> page,
        ListUploads(database, map.record.uid, after, kUploadsOfAPage));
    if (page.empty()) return absl::OkStatus();
    after = page.back().spec.id;
    for (UploadRecord& upload : page) {
      if (upload.state == UploadState::kFinalized) continue;
      MAPSIEVE_ASSIGN_OR_RETURN(
          const Addition before,
          LastAddition(database, map, map.record.newest_revision,
                       upload.spec.id));
      MAPSIEVE_ASSIGN_OR_RETURN(
          const Addition restored,
          LastAddition(database, map, number, upload.spec.id));
      if (before.revision != 0 || restored.revision == 0) continue;
      upload.state = UploadState::kFinalized;
      upload.revision = restored.revision;
      upload.report = restored.report;
      upload.update_time = absl::Now();
      MAPSIEVE_RETURN_IF_ERROR(UpdateState(database, upload));
    }
  }
}

absl::Status DeleteUpload(SqliteDatabase& database,
                          const std::string& upload_uid) {
  MAPSIEVE_RETURN_IF_ERROR(GetUploadByUid(database, upload_uid).status());
  // Another upload may get its id: that one was never added.
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement forget,
      database.Prepare(
          "DELETE FROM upload_revisions WHERE (map_key, upload_id) = "
          "(SELECT map_key, id FROM uploads WHERE uid = ?)"));
  MAPSIEVE_RETURN_IF_ERROR(forget.Bind(upload_uid).Run());
  return RemoveUpload(database, upload_uid);
}

absl::StatusOr<int64_t> DeleteIdleUploads(SqliteDatabase& database,
                                          absl::Time idle_since) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement remove,
      database.Prepare(
          "DELETE FROM uploads WHERE state IN (?, ?) AND update_time < ?"));
  MAPSIEVE_RETURN_IF_ERROR(remove.Bind(UploadState::kActive)
                               .Bind(UploadState::kFailed)
                               .Bind(idle_since)
                               .Run());
  return database.changed_row_count();
}

}  // namespace mapsieve::storage
