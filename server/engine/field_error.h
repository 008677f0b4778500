#ifndef MAPSIEVE_SERVER_ENGINE_FIELD_ERROR_H_
#define MAPSIEVE_SERVER_ENGINE_FIELD_ERROR_H_

#include <optional>
#include <string>
#include <string_view>

#include "absl/status/status.h"

namespace mapsieve::engine {

/// kInvalidArgument about a field of a request, of which `field` is the path
/// as the API names it: "FIELD: MESSAGE", and FieldOf tells the field.
absl::Status FieldError(std::string_view field, std::string_view message);

/// The field that `status` is about, if FieldError made it.
std::optional<std::string> FieldOf(const absl::Status& status);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_FIELD_ERROR_H_
