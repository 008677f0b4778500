#ifndef MAPSIEVE_CORE_CLOUD_PACKED_COLUMNS_H_
#define MAPSIEVE_CORE_CLOUD_PACKED_COLUMNS_H_

#include <string_view>
#include <vector>

#include "core/cloud/column.h"

/// What the filter finds of a point, in few bytes: how it is stored, and how it
/// travels to clients that know this. All functions are thread-safe.
namespace mapsieve::core {

/// uint16, 65535 is 1: `confidence`, float32.
inline constexpr std::string_view kPackedConfidence = "spdf.confidence";
/// uint32, an OctahedralVector: `nx`, `ny`, `nz`, float32.
inline constexpr std::string_view kPackedNormal = "spdf.normal";
/// uint32, an OctahedralVector: `tx`, `ty`, `tz`, float32.
inline constexpr std::string_view kPackedTangent = "spdf.tangent";

/// The columns that a packed one stands for; `spec` alone if it is none.
std::vector<ColumnSpec> UnpackedSpecs(const ColumnSpec& spec);

/// Appends the columns of UnpackedSpecs with the values of `column`, none of
/// which is missing if it is a packed one.
void Unpack(Column column, std::vector<Column>& unpacked);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CLOUD_PACKED_COLUMNS_H_
