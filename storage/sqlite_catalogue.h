#ifndef MAPSIEVE_STORAGE_SQLITE_CATALOGUE_H_
#define MAPSIEVE_STORAGE_SQLITE_CATALOGUE_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "storage/catalogue.h"
#include "storage/file_system.h"

namespace mapsieve::storage {

/// What to do where there is no catalogue, or an empty one.
enum class IfAbsent { kCreate, kFail };

/// Opens the catalogue in the SQLite database `path`; FORMAT.md describes its
/// tables. One of version 3 or 4 becomes one of this version, of which a crash
/// leaves all or nothing. The caller sees to it that one process at a time has
/// it open, and syncs the directory after the file was made. `file_system`
/// outlives it. kDataLoss: damaged, no SQLite database, or absent and
/// `if_absent` is kFail; kFailedPrecondition: a database of another program or
/// of another version of this one.
absl::StatusOr<std::unique_ptr<Catalogue>> OpenSqliteCatalogue(
    FileSystem& file_system, const std::string& path, IfAbsent if_absent);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_CATALOGUE_H_
