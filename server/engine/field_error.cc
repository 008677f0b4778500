#include "server/engine/field_error.h"

#include "absl/strings/cord.h"
#include "core/base/status.h"

namespace mapsieve::engine {
namespace {

constexpr char kFieldPayload[] = "mapsieve/field";

}  // namespace

absl::Status FieldError(std::string_view field, std::string_view message) {
  absl::Status status = absl::InvalidArgumentError(
      absl::StrCat(ToAbsl(field), ": ", ToAbsl(message)));
  status.SetPayload(kFieldPayload, absl::Cord(ToAbsl(field)));
  return status;
}

std::optional<std::string> FieldOf(const absl::Status& status) {
  const auto field = status.GetPayload(kFieldPayload);
  if (!field.has_value()) return std::nullopt;
  return std::string(*field);
}

}  // namespace mapsieve::engine
