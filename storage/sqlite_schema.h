#ifndef MAPSIEVE_STORAGE_SQLITE_SCHEMA_H_
#define MAPSIEVE_STORAGE_SQLITE_SCHEMA_H_

#include "absl/status/status.h"
#include "storage/sqlite_catalogue.h"
#include "storage/sqlite_database.h"

namespace mapsieve::storage {

/// Makes the tables of FORMAT.md in an empty database, or of a catalogue of
/// version 3, or checks that it is a catalogue of this version. Errors: those
/// of OpenSqliteCatalogue.
absl::Status PrepareSchema(SqliteDatabase& database, IfAbsent if_absent);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_SCHEMA_H_
