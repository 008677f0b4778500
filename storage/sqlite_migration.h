#ifndef MAPSIEVE_STORAGE_SQLITE_MIGRATION_H_
#define MAPSIEVE_STORAGE_SQLITE_MIGRATION_H_

#include <memory>

#include "absl/status/status.h"
#include "storage/file_system.h"
#include "storage/sqlite_database.h"

namespace mapsieve::storage {

/// Puts a catalogue of this version, whose pages have checksums, in the place
/// of `catalogue`, which is of version 3 (LacksPageChecksums) and the only
/// connection. A copy is made beside it and then renamed: whenever that ends
/// early, by an error or a crash, the old catalogue is there as it was, or the
/// new one whole. Needs as much space again while it runs. kUnavailable:
/// another program has the catalogue open; else the errors of
/// OpenSqliteCatalogue.
absl::Status AddPageChecksums(FileSystem& file_system,
                              std::unique_ptr<SqliteDatabase> catalogue);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_MIGRATION_H_
