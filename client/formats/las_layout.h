#ifndef MAPSIEVE_CLIENT_FORMATS_LAS_LAYOUT_H_
#define MAPSIEVE_CLIENT_FORMATS_LAS_LAYOUT_H_

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "core/cloud/column.h"

/// Where LAS keeps things, for its reader and its writer.
namespace mapsieve::client {

inline constexpr int kLasPointFormats = 11;

/// Header of LAS 1.0 to 1.2, which later ones extend, and of LAS 1.4.
inline constexpr size_t kLasOldHeaderBytes = 227;
inline constexpr size_t kLasHeaderBytes = 375;
/// Heads of a variable length record and of an extended one.
inline constexpr size_t kLasVlrHeadBytes = 54;
inline constexpr size_t kLasEvlrHeadBytes = 60;
/// One description in the record of extra bytes.
inline constexpr size_t kLasExtraBytes = 192;
inline constexpr size_t kLasExtraNameBytes = 32;

/// Description of an extra attribute that our writer put there under the name
/// of a standard field, because its values do not fit that field.
inline constexpr std::string_view kLasInsteadOfField =
    "instead of the standard field";

/// A value in a point record.
struct LasField {
  std::string name;
  core::ScalarType type = core::ScalarType::kUint8;
  /// Bytes from the record's start.
  size_t offset = 0;
  /// Bits of the byte at `offset` from `shift` on; 0: the field is whole bytes.
  int bits = 0;
  int shift = 0;
};

/// Bytes of a record of point format 0 to 10, without extra bytes.
size_t LasRecordBytes(int point_format);

/// The fields of point format 0 to 10 after x, y, z, in record order.
std::vector<LasField> LasFields(int point_format);

/// The number that stands for `type` in a description of extra bytes.
int LasExtraType(core::ScalarType type);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_LAS_LAYOUT_H_
