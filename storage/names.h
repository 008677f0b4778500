#ifndef MAPSIEVE_STORAGE_NAMES_H_
#define MAPSIEVE_STORAGE_NAMES_H_

#include <string>
#include <string_view>

#include "absl/status/status.h"

/// Names that come from outside are checked against these before they touch a
/// path or the catalogue.
namespace mapsieve::storage {

/// OK for the id of a map: [a-z]([a-z0-9-]{0,61}[a-z0-9])?, else
/// kInvalidArgument quoting it.
absl::Status CheckMapId(std::string_view id);

/// OK for the id of an upload or of an operation, which may begin with a digit
/// (a hash does): [a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?, else kInvalidArgument.
absl::Status CheckResourceId(std::string_view id);

/// Whether `text` is 32 lower-case hexadecimal digits: a ContentHash or a uid.
bool IsHexId(std::string_view text);

/// `text` between quotes for a message, without control characters and cut
/// after 80 bytes.
std::string Quoted(std::string_view text);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_NAMES_H_
