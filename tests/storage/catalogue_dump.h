#ifndef MAPSIEVE_TESTS_STORAGE_CATALOGUE_DUMP_H_
#define MAPSIEVE_TESTS_STORAGE_CATALOGUE_DUMP_H_

#include <string>

#include "absl/status/statusor.h"
#include "storage/catalogue.h"

namespace mapsieve::storage {

/// Whether uids and times are told, which two catalogues do not share.
enum class Identities { kTold, kLeftOut };

/// One line for a record, with every field.
std::string Describe(const MapRecord& map, Identities identities);
std::string Describe(const RevisionRecord& revision, Identities identities);
std::string Describe(const ChunkRef& chunk);
std::string Describe(const TileSummary& tile);
std::string Describe(const UploadRecord& upload, Identities identities);
std::string Describe(const OperationRecord& operation, Identities identities);

/// Everything that a catalogue of a few maps answers, or the first error.
absl::StatusOr<std::string> Dump(const Catalogue& catalogue,
                                 Identities identities);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_TESTS_STORAGE_CATALOGUE_DUMP_H_
