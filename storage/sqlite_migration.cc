#include "storage/sqlite_migration.h"

#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "storage/sqlite_catalogue.h"
#include "storage/sqlite_schema.h"

namespace mapsieve::storage {
namespace {

absl::Status RemoveIfThere(FileSystem& file_system, const std::string& path) {
  const absl::Status status = file_system.Remove(path);
  return absl::IsNotFound(status) ? absl::OkStatus() : status;
}

// Brings all that its log holds into the database, synced, and closes the last
// connection, which removes the log: one beside another database of that name
// would be replayed over it.
absl::Status CloseWithoutLog(FileSystem& file_system,
                             std::unique_ptr<SqliteDatabase> database) {
  const std::string path = database->path();
  MAPSIEVE_ASSIGN_OR_RETURN(
      const int64_t busy,
      database->QueryInteger("PRAGMA wal_checkpoint(TRUNCATE)"));
  database.reset();
  MAPSIEVE_ASSIGN_OR_RETURN(const bool has_log,
                            file_system.Exists(path + "-wal"));
  if (busy == 0 && !has_log) return absl::OkStatus();
  return absl::UnavailableError(absl::StrCat(
      path,
      ": its log cannot be removed while another program has the file open; "
      "close that and start again"));
}

}  // namespace

absl::Status AddPageChecksums(FileSystem& file_system,
                              std::unique_ptr<SqliteDatabase> catalogue) {
  const std::string path = catalogue->path();
  const std::string copy = path + ".new";
  for (const char* suffix : {"", "-journal", "-wal", "-shm"}) {
    MAPSIEVE_RETURN_IF_ERROR(RemoveIfThere(file_system, copy + suffix));
  }
  {
    MAPSIEVE_ASSIGN_OR_RETURN(SqliteStatement vacuum,
                              catalogue->Prepare("VACUUM INTO ?"));
    MAPSIEVE_RETURN_IF_ERROR(vacuum.Bind(copy).Run());
  }
  MAPSIEVE_RETURN_IF_ERROR(CloseWithoutLog(file_system, std::move(catalogue)));
  MAPSIEVE_ASSIGN_OR_RETURN(auto database,
                            SqliteDatabase::Open(file_system, copy));
  MAPSIEVE_RETURN_IF_ERROR(PrepareSchema(*database, IfAbsent::kFail));
  MAPSIEVE_RETURN_IF_ERROR(CloseWithoutLog(file_system, std::move(database)));

  const std::string directory = std::filesystem::path(path).parent_path();
  // That the logs are gone comes first.
  MAPSIEVE_RETURN_IF_ERROR(file_system.SyncDirectory(directory));
  MAPSIEVE_RETURN_IF_ERROR(file_system.Rename(copy, path));
  return file_system.SyncDirectory(directory);
}

}  // namespace mapsieve::storage
