#ifndef MAPSIEVE_SERVER_ENGINE_ATTRIBUTE_SCHEMA_H_
#define MAPSIEVE_SERVER_ENGINE_ATTRIBUTE_SCHEMA_H_

#include <map>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/cloud/column.h"
#include "storage/catalogue.h"

namespace mapsieve::engine {

/// The attributes of a map's raw points: one type for each name.
class AttributeSchema {
 public:
  /// The schema of the newest revision of `map`.
  static absl::StatusOr<AttributeSchema> Of(const storage::Catalogue& catalogue,
                                            const storage::MapRecord& map);

  /// Adds the attributes of a block. kInvalidArgument: one has another type
  /// here (both are named), a reserved or too long name, or there would be more
  /// than kMaxMapAttributes; those before it are added then.
  absl::Status Add(std::span<const core::ColumnSpec> columns);

  /// By name.
  std::vector<core::ColumnSpec> columns() const;

 private:
  std::map<std::string, core::ScalarType> types_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_ATTRIBUTE_SCHEMA_H_
