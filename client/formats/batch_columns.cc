#include "client/formats/batch_columns.h"

#include <string>
#include <unordered_set>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"

namespace mapsieve::client {

absl::Status CheckAttributes(std::string_view file_name,
                             const std::vector<core::ColumnSpec>& attributes) {
  if (attributes.size() > kMaxAttributes) {
    return absl::InvalidArgumentError(
        absl::StrCat(ToAbsl(file_name), ": has ", attributes.size(),
                     " attributes; at most ", kMaxAttributes, " are handled"));
  }
  std::unordered_set<std::string> names = {"x", "y", "z"};
  for (const core::ColumnSpec& attribute : attributes) {
    if (attribute.name.empty()) {
      return absl::InvalidArgumentError(absl::StrCat(
          ToAbsl(file_name), ": an attribute has no name; give it one"));
    }
    if (!names.insert(attribute.name).second) {
      return absl::InvalidArgumentError(
          absl::StrCat(ToAbsl(file_name), ": two columns are named \"",
                       attribute.name, "\"; rename one"));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<const core::Column*>> MatchColumns(
    std::string_view file_name, const std::vector<core::ColumnSpec>& attributes,
    const core::PointCloud& batch) {
  const auto refuse = [&](const std::string& what) {
    return absl::InvalidArgumentError(
        absl::StrCat(ToAbsl(file_name), ": the batch ", what));
  };
  std::vector<const core::Column*> columns;
  columns.reserve(attributes.size());
  for (const core::ColumnSpec& attribute : attributes) {
    const core::Column* column = batch.attributes.Find(attribute.name);
    if (column == nullptr) {
      return refuse(
          absl::StrCat("lacks the attribute \"", attribute.name, "\""));
    }
    if (column->type() != attribute.type) {
      return refuse(absl::StrCat("has \"", attribute.name, "\" as ",
                                 ToAbsl(core::ScalarTypeName(column->type())),
                                 "; expected ",
                                 ToAbsl(core::ScalarTypeName(attribute.type))));
    }
    if (column->size() != batch.size()) {
      return refuse(absl::StrCat("has ", column->size(), " values of \"",
                                 attribute.name, "\" for ", batch.size(),
                                 " points"));
    }
    columns.push_back(column);
  }
  if (batch.attributes.columns().size() != attributes.size()) {
    return refuse(absl::StrCat("has ", batch.attributes.columns().size(),
                               " attributes; expected ", attributes.size()));
  }
  return columns;
}

}  // namespace mapsieve::client
