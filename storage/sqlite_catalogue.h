#ifndef MAPSIEVE_STORAGE_SQLITE_CATALOGUE_H_
#define MAPSIEVE_STORAGE_SQLITE_CATALOGUE_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "storage/catalogue.h"

namespace mapsieve::storage {

/// Opens the catalogue in the SQLite database `path`, which is made if absent;
/// FORMAT.md describes its tables. The caller sees to it that one process at a
/// time has it open, and syncs the directory after the file was made.
/// kDataLoss: damaged, or no SQLite database; kFailedPrecondition: a database
/// of another program or of a newer version of this one.
absl::StatusOr<std::unique_ptr<Catalogue>> OpenSqliteCatalogue(
    const std::string& path);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_CATALOGUE_H_
