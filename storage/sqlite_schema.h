#ifndef MAPSIEVE_STORAGE_SQLITE_SCHEMA_H_
#define MAPSIEVE_STORAGE_SQLITE_SCHEMA_H_

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/sqlite_catalogue.h"
#include "storage/sqlite_database.h"

namespace mapsieve::storage {

/// Whether it is a catalogue of version 3, whose pages have no checksums.
absl::StatusOr<bool> LacksPageChecksums(SqliteDatabase& database);

/// Makes the tables of FORMAT.md in an empty database, makes those of version 3
/// or 4 into them, or checks that it is a catalogue of this version; its pages
/// have checksums. One transaction. Errors: those of OpenSqliteCatalogue.
absl::Status PrepareSchema(SqliteDatabase& database, IfAbsent if_absent);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_SCHEMA_H_
