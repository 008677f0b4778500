#ifndef MAPSIEVE_CLIENT_FORMATS_RECORD_COLUMNS_H_
#define MAPSIEVE_CLIENT_FORMATS_RECORD_COLUMNS_H_

#include <cstddef>
#include <cstdint>
#include <cstring>

/// Binary point files hold records, clouds hold columns: the copies between
/// them, one field at a time. All functions are thread-safe.
namespace mapsieve::client {

/// Calls f with an unsigned integer of `width` (1, 2, 4 or 8) bytes, so that
/// the copy of a value is one instruction.
template <typename F>
void VisitWidth(size_t width, F&& f) {
  switch (width) {
    case 1:
      return f(uint8_t{});
    case 2:
      return f(uint16_t{});
    case 4:
      return f(uint32_t{});
    default:
      return f(uint64_t{});
  }
}

/// Copies the field of `width` (1, 2, 4 or 8) bytes at `field` of the first
/// record to `column`, and so on for `count` records of `record_bytes`.
inline void GatherField(const std::byte* field, size_t record_bytes,
                        size_t count, size_t width, std::byte* column) {
  VisitWidth(width, [&](auto value) {
    for (size_t i = 0; i < count; ++i) {
      std::memcpy(&value, field + i * record_bytes, sizeof(value));
      std::memcpy(column + i * sizeof(value), &value, sizeof(value));
    }
  });
}

/// The inverse of GatherField.
inline void ScatterField(const std::byte* column, size_t record_bytes,
                         size_t count, size_t width, std::byte* field) {
  VisitWidth(width, [&](auto value) {
    for (size_t i = 0; i < count; ++i) {
      std::memcpy(&value, column + i * sizeof(value), sizeof(value));
      std::memcpy(field + i * record_bytes, &value, sizeof(value));
    }
  });
}

/// Reverses the bytes of each of `count` values of `width` bytes.
inline void SwapBytes(std::byte* values, size_t count, size_t width) {
  VisitWidth(width, [&](auto value) {
    for (size_t i = 0; i < count; ++i) {
      std::byte* at = values + i * sizeof(value);
      std::memcpy(&value, at, sizeof(value));
      if constexpr (sizeof(value) == 2) value = __builtin_bswap16(value);
      if constexpr (sizeof(value) == 4) value = __builtin_bswap32(value);
      if constexpr (sizeof(value) == 8) value = __builtin_bswap64(value);
      std::memcpy(at, &value, sizeof(value));
    }
  });
}

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_RECORD_COLUMNS_H_
