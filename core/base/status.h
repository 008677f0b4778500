#ifndef MAPSIEVE_CORE_BASE_STATUS_H_
#define MAPSIEVE_CORE_BASE_STATUS_H_

#include <string_view>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

/// Errors travel as absl::Status across every module border; nothing of ours
/// throws, exits or prints. CONTRIBUTING.md lists what each code means.

namespace mapsieve {

/// Debian builds Abseil with a string_view of its own: this is the one
/// conversion, for status messages and absl::StrCat.
inline absl::string_view ToAbsl(std::string_view text) {
  return {text.data(), text.size()};
}

/// The inverse of ToAbsl.
inline std::string_view ToStd(absl::string_view text) {
  return {text.data(), text.size()};
}

/// Returns `status` with "context: " before its message, unless that begins
/// with the context already; OK stays OK.
inline absl::Status Annotate(const absl::Status& status,
                             std::string_view context) {
  if (status.ok() || ToStd(status.message()).starts_with(context)) {
    return status;
  }
  return absl::Status(status.code(),
                      absl::StrCat(ToAbsl(context), ": ", status.message()));
}

}  // namespace mapsieve

/// Returns from the enclosing function if `expression` is not OK.
#define MAPSIEVE_RETURN_IF_ERROR(expression) \
  MAPSIEVE_RETURN_IF_ERROR_IMPL_(            \
      MAPSIEVE_CONCAT_(mapsieve_status_, __COUNTER__), expression)

/// Declares or assigns `target` from a StatusOr expression, or returns its
/// error from the enclosing function.
#define MAPSIEVE_ASSIGN_OR_RETURN(target, expression) \
  MAPSIEVE_ASSIGN_OR_RETURN_IMPL_(                    \
      MAPSIEVE_CONCAT_(mapsieve_status_or_, __COUNTER__), target, expression)

#define MAPSIEVE_CONCAT_INNER_(a, b) a##b
#define MAPSIEVE_CONCAT_(a, b) MAPSIEVE_CONCAT_INNER_(a, b)
// The names differ, since an expression may hold a lambda that uses the macros.
#define MAPSIEVE_RETURN_IF_ERROR_IMPL_(status, expression)               \
  do {                                                                   \
    if (absl::Status status = (expression); !status.ok()) return status; \
  } while (false)
#define MAPSIEVE_ASSIGN_OR_RETURN_IMPL_(result, target, expression) \
  auto result = (expression);                                       \
  if (!result.ok()) return std::move(result).status();              \
  target = std::move(result).value()

#endif  // MAPSIEVE_CORE_BASE_STATUS_H_
