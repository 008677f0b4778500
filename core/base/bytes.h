#ifndef MAPSIEVE_CORE_BASE_BYTES_H_
#define MAPSIEVE_CORE_BASE_BYTES_H_

#include <bit>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/status.h"

namespace mapsieve {

template <typename T>
concept Scalar = std::is_arithmetic_v<T> || std::is_enum_v<T>;

/// Reads a little-endian scalar from `bytes`; the caller guarantees the size.
template <Scalar T>
T LoadLittleEndian(const std::byte* bytes) {
  static_assert(std::endian::native == std::endian::little);
  T value;
  std::memcpy(&value, bytes, sizeof(T));
  return value;
}

/// Bytes of a contiguous range of trivially copyable values.
template <typename T>
std::span<const std::byte> AsBytes(const T& range) {
  return std::as_bytes(std::span(range));
}

/// Bytes of a text.
inline std::span<const std::byte> TextBytes(std::string_view text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

/// Appends little-endian fields to a byte string.
class ByteWriter {
 public:
  template <Scalar T>
  void Put(T value) {
    const size_t at = bytes_.size();
    bytes_.resize(at + sizeof(T));
    std::memcpy(bytes_.data() + at, &value, sizeof(T));
  }
  void PutBytes(std::span<const std::byte> bytes) {
    bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
  }
  /// A uint16 length and that many bytes; `text` is at most 65535 long.
  void PutShortText(std::string_view text) {
    Put(static_cast<uint16_t>(text.size()));
    PutBytes(TextBytes(text));
  }
  size_t size() const { return bytes_.size(); }
  std::vector<std::byte>& bytes() { return bytes_; }

 private:
  std::vector<std::byte> bytes_;
};

/// Takes little-endian fields from bytes that nobody has checked. Every read
/// beyond the end is kDataLoss and names the field and the offset.
class ByteReader {
 public:
  explicit ByteReader(std::span<const std::byte> bytes) : bytes_(bytes) {}

  size_t offset() const { return offset_; }
  size_t remaining() const { return bytes_.size() - offset_; }

  template <Scalar T>
  absl::StatusOr<T> Take(const char* field) {
    MAPSIEVE_RETURN_IF_ERROR(Need(sizeof(T), field));
    const T value = LoadLittleEndian<T>(bytes_.data() + offset_);
    offset_ += sizeof(T);
    return value;
  }
  absl::StatusOr<std::span<const std::byte>> TakeBytes(size_t size,
                                                       const char* field) {
    MAPSIEVE_RETURN_IF_ERROR(Need(size, field));
    const auto result = bytes_.subspan(offset_, size);
    offset_ += size;
    return result;
  }
  /// The inverse of ByteWriter::PutShortText.
  absl::StatusOr<std::string> TakeShortText(const char* field) {
    MAPSIEVE_ASSIGN_OR_RETURN(const uint16_t size, Take<uint16_t>(field));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto text, TakeBytes(size, field));
    return std::string(reinterpret_cast<const char*>(text.data()), text.size());
  }

 private:
  absl::Status Need(size_t size, const char* field) const {
    if (size <= remaining()) return absl::OkStatus();
    return absl::DataLossError(absl::StrCat(field, " at offset ", offset_,
                                            ": expected ", size,
                                            " bytes, have ", remaining()));
  }

  std::span<const std::byte> bytes_;
  size_t offset_ = 0;
};

}  // namespace mapsieve

#endif  // MAPSIEVE_CORE_BASE_BYTES_H_
