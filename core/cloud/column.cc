#include "core/cloud/column.h"

#include <algorithm>

#include "core/base/status.h"

namespace mapsieve::core {

std::string_view ScalarTypeName(ScalarType type) {
  switch (type) {
    case ScalarType::kInt8:
      return "int8";
    case ScalarType::kUint8:
      return "uint8";
    case ScalarType::kInt16:
      return "int16";
    case ScalarType::kUint16:
      return "uint16";
    case ScalarType::kInt32:
      return "int32";
    case ScalarType::kUint32:
      return "uint32";
    case ScalarType::kInt64:
      return "int64";
    case ScalarType::kUint64:
      return "uint64";
    case ScalarType::kFloat32:
      return "float32";
    case ScalarType::kFloat64:
      return "float64";
  }
  return "unknown";
}

void Column::Resize(size_t size) {
  bytes_.resize(size * value_size());
  if (!missing_.empty()) missing_.resize(size);
}

double Column::GetAsDouble(size_t i) const {
  return VisitScalarType(type(), [&](auto zero) {
    return static_cast<double>(Get<decltype(zero)>(i));
  });
}

void Column::SetMissing(size_t i) {
  if (missing_.empty()) missing_.resize(size());
  missing_[i] = 1;
  std::memset(bytes_.data() + i * value_size(), 0, value_size());
}

void Column::AppendFrom(const Column& other, size_t i) {
  const size_t row = size();
  const auto value = other.bytes().subspan(i * value_size(), value_size());
  bytes_.insert(bytes_.end(), value.begin(), value.end());
  if (!missing_.empty()) missing_.push_back(0);
  if (other.IsMissing(i)) SetMissing(row);
}

void Column::AppendAll(const Column& other) {
  const size_t old_size = size();
  bytes_.insert(bytes_.end(), other.bytes_.begin(), other.bytes_.end());
  if (missing_.empty() && other.missing_.empty()) return;
  missing_.resize(old_size);
  if (other.missing_.empty()) {
    missing_.resize(size());
  } else {
    missing_.insert(missing_.end(), other.missing_.begin(),
                    other.missing_.end());
  }
}

void Column::AppendMissing(size_t count) {
  if (count == 0) return;
  if (missing_.empty()) missing_.resize(size());
  bytes_.resize(bytes_.size() + count * value_size());
  missing_.resize(missing_.size() + count, 1);
}

Column Column::Select(std::span<const uint32_t> rows) const {
  Column result(spec_, rows.size());
  // A width that the compiler knows is a single move.
  VisitScalarType(type(), [&](auto zero) {
    constexpr size_t kWidth = sizeof(zero);
    for (size_t i = 0; i < rows.size(); ++i) {
      std::memcpy(result.bytes_.data() + i * kWidth,
                  bytes_.data() + rows[i] * kWidth, kWidth);
    }
  });
  if (!missing_.empty()) {
    std::vector<uint8_t> missing(rows.size());
    bool any = false;
    for (size_t i = 0; i < rows.size(); ++i) {
      missing[i] = missing_[rows[i]];
      any = any || missing[i] != 0;
    }
    if (any) result.missing_ = std::move(missing);
  }
  return result;
}

const Column* ColumnSet::Find(std::string_view name) const {
  for (const Column& column : columns_) {
    if (column.name() == name) return &column;
  }
  return nullptr;
}

Column* ColumnSet::Find(std::string_view name) {
  return const_cast<Column*>(std::as_const(*this).Find(name));
}

std::vector<ColumnSpec> ColumnSet::specs() const {
  std::vector<ColumnSpec> specs;
  specs.reserve(columns_.size());
  for (const Column& column : columns_) specs.push_back(column.spec());
  return specs;
}

absl::Status ColumnSet::Add(Column column) {
  if (Find(column.name()) != nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat("two attributes are named \"", column.name(), "\""));
  }
  columns_.push_back(std::move(column));
  return absl::OkStatus();
}

absl::Status ColumnSet::AppendAll(size_t size, const ColumnSet& other,
                                  size_t other_size) {
  for (const Column& theirs : other.columns_) {
    const Column* ours = Find(theirs.name());
    if (ours != nullptr && ours->type() != theirs.type()) {
      return absl::InvalidArgumentError(
          absl::StrCat("attribute \"", theirs.name(), "\" is ",
                       ToAbsl(ScalarTypeName(theirs.type())), " here and ",
                       ToAbsl(ScalarTypeName(ours->type())),
                       " before; convert it or give it another name"));
    }
  }
  for (const Column& theirs : other.columns_) {
    Column* ours = Find(theirs.name());
    if (ours == nullptr) {
      columns_.emplace_back(theirs.spec());
      ours = &columns_.back();
      ours->AppendMissing(size);
    }
    ours->AppendAll(theirs);
  }
  for (Column& ours : columns_) {
    ours.AppendMissing(size + other_size - ours.size());
  }
  return absl::OkStatus();
}

ColumnSet ColumnSet::Select(std::span<const uint32_t> rows) const {
  ColumnSet result;
  result.columns_.reserve(columns_.size());
  for (const Column& column : columns_) {
    result.columns_.push_back(column.Select(rows));
  }
  return result;
}

void ColumnSet::SortByName() {
  std::sort(
      columns_.begin(), columns_.end(),
      [](const Column& a, const Column& b) { return a.name() < b.name(); });
}

}  // namespace mapsieve::core
