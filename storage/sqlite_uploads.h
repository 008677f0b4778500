#ifndef MAPSIEVE_STORAGE_SQLITE_UPLOADS_H_
#define MAPSIEVE_STORAGE_SQLITE_UPLOADS_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "storage/catalogue.h"
#include "storage/sqlite_database.h"
#include "storage/sqlite_maps.h"

/// The table uploads. Each function runs inside a transaction of its caller and
/// has the contract of the Catalogue function of its name.
namespace mapsieve::storage {

template <>
inline constexpr int64_t kLargestEnumerator<UploadState> =
    static_cast<int64_t>(UploadState::kFailed);

absl::StatusOr<UploadRecord> CreateUpload(SqliteDatabase& database,
                                          const std::string& map_uid,
                                          const UploadSpec& spec);
absl::StatusOr<UploadRecord> GetUpload(SqliteDatabase& database,
                                       const std::string& map_uid,
                                       const std::string& id);
absl::StatusOr<UploadRecord> GetUploadByUid(SqliteDatabase& database,
                                            const std::string& upload_uid);
absl::StatusOr<std::vector<UploadRecord>> ListUploads(
    SqliteDatabase& database, const std::string& map_uid,
    const std::string& after, int64_t max_count);
absl::Status SetCommittedBytes(SqliteDatabase& database,
                               const std::string& upload_uid, int64_t bytes);
absl::StatusOr<UploadRecord> SetUploadState(SqliteDatabase& database,
                                            const std::string& upload_uid,
                                            UploadState from, UploadState to,
                                            const std::string& report);
absl::Status DeleteUpload(SqliteDatabase& database,
                          const std::string& upload_uid);
absl::StatusOr<int64_t> DeleteIdleUploads(SqliteDatabase& database,
                                          absl::Time idle_since);

/// Marks an upload of `map_uid` as finalized by `revision`. kNotFound;
/// kFailedPrecondition: it is not kFinalizing.
absl::Status FinalizeUpload(SqliteDatabase& database,
                            const std::string& map_uid,
                            const std::string& upload_uid,
                            const RevisionRecord& revision,
                            const std::string& report);

/// Finalizes uploads whose points a rollback of `map`, as it is before, to
/// revision `number` brings back: they were begun anew since.
absl::Status FinalizeRestoredUploads(SqliteDatabase& database,
                                     const MapRow& map, int64_t number);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_UPLOADS_H_
