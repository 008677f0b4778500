#ifndef MAPSIEVE_CORE_CLOUD_COLUMN_H_
#define MAPSIEVE_CORE_CLOUD_COLUMN_H_

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "absl/status/status.h"
#include "core/base/bytes.h"

namespace mapsieve::core {

/// Type of one value of an attribute. The numbers are part of the formats.
enum class ScalarType : uint8_t {
  kInt8 = 1,
  kUint8 = 2,
  kInt16 = 3,
  kUint16 = 4,
  kInt32 = 5,
  kUint32 = 6,
  kInt64 = 7,
  kUint64 = 8,
  kFloat32 = 9,
  kFloat64 = 10,
};

/// Bytes of a value of `type`; 0 for a number that is not a ScalarType.
constexpr size_t ScalarSize(ScalarType type) {
  switch (type) {
    case ScalarType::kInt8:
    case ScalarType::kUint8:
      return 1;
    case ScalarType::kInt16:
    case ScalarType::kUint16:
      return 2;
    case ScalarType::kInt32:
    case ScalarType::kUint32:
    case ScalarType::kFloat32:
      return 4;
    case ScalarType::kInt64:
    case ScalarType::kUint64:
    case ScalarType::kFloat64:
      return 8;
  }
  return 0;
}

/// "int8", "uint8", … "float64".
std::string_view ScalarTypeName(ScalarType type);

/// The ScalarType of a C++ arithmetic type.
template <typename T>
constexpr ScalarType ScalarTypeOf() {
  if constexpr (std::is_floating_point_v<T>) {
    return sizeof(T) == 4 ? ScalarType::kFloat32 : ScalarType::kFloat64;
  } else {
    constexpr int kLog2 = sizeof(T) == 1   ? 0
                          : sizeof(T) == 2 ? 1
                          : sizeof(T) == 4 ? 2
                                           : 3;
    return static_cast<ScalarType>(1 + 2 * kLog2 +
                                   (std::is_unsigned_v<T> ? 1 : 0));
  }
}

/// Calls f(T{}) with the C++ type of `type` and returns its result.
template <typename F>
auto VisitScalarType(ScalarType type, F&& f) {
  switch (type) {
    case ScalarType::kInt8:
      return f(int8_t{});
    case ScalarType::kUint8:
      return f(uint8_t{});
    case ScalarType::kInt16:
      return f(int16_t{});
    case ScalarType::kUint16:
      return f(uint16_t{});
    case ScalarType::kInt32:
      return f(int32_t{});
    case ScalarType::kUint32:
      return f(uint32_t{});
    case ScalarType::kInt64:
      return f(int64_t{});
    case ScalarType::kUint64:
      return f(uint64_t{});
    case ScalarType::kFloat32:
      return f(float{});
    case ScalarType::kFloat64:
      break;
  }
  return f(double{});
}

/// Name and type of an attribute.
struct ColumnSpec {
  std::string name;
  ScalarType type = ScalarType::kFloat32;

  friend bool operator==(const ColumnSpec&, const ColumnSpec&) = default;
};

/// One attribute of many points: values of one type in little-endian bytes,
/// one a point. A point may lack the value ("missing", which is not zero): its
/// bytes are then zero and IsMissing says so.
class Column {
 public:
  Column() = default;
  explicit Column(ColumnSpec spec, size_t size = 0)
      : spec_(std::move(spec)), bytes_(size * ScalarSize(spec_.type)) {}

  const ColumnSpec& spec() const { return spec_; }
  const std::string& name() const { return spec_.name; }
  ScalarType type() const { return spec_.type; }
  size_t value_size() const { return ScalarSize(spec_.type); }
  size_t size() const { return bytes_.size() / value_size(); }

  void Rename(std::string name) { spec_.name = std::move(name); }
  /// New values are zero and present.
  void Resize(size_t size);
  void Reserve(size_t size) { bytes_.reserve(size * value_size()); }

  std::span<const std::byte> bytes() const { return bytes_; }
  std::span<std::byte> mutable_bytes() { return bytes_; }

  /// `T` is the column's own type.
  template <typename T>
  T Get(size_t i) const {
    T value;
    std::memcpy(&value, bytes_.data() + i * sizeof(T), sizeof(T));
    return value;
  }
  template <typename T>
  void Set(size_t i, T value) {
    std::memcpy(bytes_.data() + i * sizeof(T), &value, sizeof(T));
  }
  template <typename T>
  void Append(T value) {
    const size_t i = size();
    Resize(i + 1);
    Set(i, value);
  }
  /// The value converted to double, whatever the type.
  double GetAsDouble(size_t i) const;

  bool has_missing() const { return !missing_.empty(); }
  bool IsMissing(size_t i) const {
    return !missing_.empty() && missing_[i] != 0;
  }
  /// Zeroes the value.
  void SetMissing(size_t i);
  /// One byte a point, 1 where the value is missing; empty if none is.
  std::span<const uint8_t> missing() const { return missing_; }

  /// Appends row `i` of `other`, which has the same spec.
  void AppendFrom(const Column& other, size_t i);
  /// Appends all rows of `other`, which has the same spec.
  void AppendAll(const Column& other);
  /// Appends `count` missing values.
  void AppendMissing(size_t count);
  /// The rows `rows` in that order.
  Column Select(std::span<const uint32_t> rows) const;

  friend bool operator==(const Column&, const Column&) = default;

 private:
  ColumnSpec spec_;
  std::vector<std::byte> bytes_;
  std::vector<uint8_t> missing_;
};

/// Columns of the same length, found by name.
class ColumnSet {
 public:
  const std::vector<Column>& columns() const { return columns_; }
  std::vector<Column>& columns() { return columns_; }
  const Column* Find(std::string_view name) const;
  Column* Find(std::string_view name);
  std::vector<ColumnSpec> specs() const;

  /// Adds a column. kInvalidArgument if the name is taken.
  absl::Status Add(Column column);
  /// Appends `other` (of `other_size` rows) below the `size` rows held so far;
  /// columns that one side lacks are missing there. kInvalidArgument if a name
  /// has another type here, naming both; nothing is changed then.
  absl::Status AppendAll(size_t size, const ColumnSet& other,
                         size_t other_size);
  /// Every column at `rows`, in that order.
  ColumnSet Select(std::span<const uint32_t> rows) const;
  /// Sorts the columns by name: the canonical order.
  void SortByName();

  friend bool operator==(const ColumnSet&, const ColumnSet&) = default;

 private:
  std::vector<Column> columns_;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CLOUD_COLUMN_H_
