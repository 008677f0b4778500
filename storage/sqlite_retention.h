#ifndef MAPSIEVE_STORAGE_SQLITE_RETENTION_H_
#define MAPSIEVE_STORAGE_SQLITE_RETENTION_H_

#include <cstdint>
#include <set>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "storage/catalogue.h"
#include "storage/sqlite_database.h"
#include "storage/sqlite_maps.h"

/// Which revisions are kept, and what others hold. Each function runs inside a
/// transaction of its caller.
namespace mapsieve::storage {

/// These have the contract of the Catalogue function of their name.
absl::StatusOr<int64_t> ExpireRevisions(SqliteDatabase& database,
                                        const std::string& map_uid,
                                        int64_t kept_count);
absl::StatusOr<std::vector<BlobId>> ForgetExpired(
    SqliteDatabase& database, const std::string& map_uid,
    const std::set<int64_t>& pinned);

/// A part of Catalogue::MeasureReclaimable.
struct ReclaimablePart {
  /// Behind which reference it begins, in the order of their removal.
  int64_t removed_revision = 0;
  int64_t number = 0;
  /// Bytes up to there.
  int64_t bytes = 0;
  bool is_last = false;
};
/// The sum of `done` and the next part.
absl::StatusOr<ReclaimablePart> MeasurePart(SqliteDatabase& database,
                                            const std::string& map_uid,
                                            const ReclaimablePart& done);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_RETENTION_H_
