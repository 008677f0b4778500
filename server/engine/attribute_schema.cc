#include "server/engine/attribute_schema.h"

#include <algorithm>
#include <utility>

#include "core/base/status.h"
#include "core/codec/points_codec.h"
#include "server/engine/types.h"

namespace mapsieve::engine {
namespace {

/// Longest prefix that an answer puts before a name.
constexpr size_t kRenamingBytes = std::string_view("input_").size();

absl::Status CheckName(const std::string& name) {
  if (name.starts_with(kReservedAttributePrefix)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "attribute \"", name, "\": names that begin with ",
        ToAbsl(kReservedAttributePrefix), " are reserved; rename it"));
  }
  constexpr size_t kLimit = core::kMaxColumnNameBytes - kRenamingBytes;
  if (name.size() > kLimit) {
    return absl::InvalidArgumentError(
        absl::StrCat("attribute \"", name, "\": the name has ", name.size(),
                     " bytes; it must have at most ", kLimit));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<AttributeSchema> AttributeSchema::Of(
    const storage::Catalogue& catalogue, const storage::MapRecord& map) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const storage::RevisionRecord revision,
      catalogue.GetRevision(map.uid, map.newest_revision));
  AttributeSchema schema;
  for (const core::ColumnSpec& column : revision.spec.attributes) {
    schema.types_[column.name] = column.type;
  }
  return schema;
}

absl::Status AttributeSchema::Add(std::span<const core::ColumnSpec> columns) {
  for (const core::ColumnSpec& column : columns) {
    const auto found = types_.find(column.name);
    if (found == types_.end()) {
      MAPSIEVE_RETURN_IF_ERROR(CheckName(column.name));
      if (types_.size() >= kMaxMapAttributes) {
        return absl::InvalidArgumentError(absl::StrCat(
            "attribute \"", column.name, "\": the map has ", types_.size(),
            " attributes already, which is the limit; leave some out"));
      }
      types_[column.name] = column.type;
    } else if (found->second != column.type) {
      return absl::InvalidArgumentError(
          absl::StrCat("attribute \"", column.name, "\" is ",
                       ToAbsl(core::ScalarTypeName(column.type)), " here and ",
                       ToAbsl(core::ScalarTypeName(found->second)),
                       " in the map; convert it or give it another name"));
    }
  }
  return absl::OkStatus();
}

std::vector<core::ColumnSpec> AttributeSchema::columns() const {
  std::vector<core::ColumnSpec> columns;
  columns.reserve(types_.size());
  for (const auto& [name, type] : types_) columns.push_back({name, type});
  return columns;
}

}  // namespace mapsieve::engine
