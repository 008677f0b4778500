#include "client/formats/point_records.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/formats/batch_columns.h"
#include "client/formats/output_file.h"
#include "client/formats/record_columns.h"
#include "client/formats/text_numbers.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

using core::ScalarType;

constexpr size_t kBlockBytes = size_t{1} << 18;
constexpr std::array<std::string_view, 3> kAxisNames = {"x", "y", "z"};
constexpr std::array<double core::Point3::*, 3> kAxes = {
    &core::Point3::x, &core::Point3::y, &core::Point3::z};

size_t BlockRows(size_t record_bytes) {
  return std::max<size_t>(1, kBlockBytes / record_bytes);
}

std::vector<PointValue>::iterator FindAxis(std::vector<PointValue>& values,
                                           std::string_view axis) {
  const auto exact =
      std::find_if(values.begin(), values.end(),
                   [&](const auto& v) { return v.name == axis; });
  if (exact != values.end()) return exact;
  return std::find_if(values.begin(), values.end(), [&](const auto& v) {
    return EqualsIgnoringCase(v.name, axis);
  });
}

std::string NameList(const std::vector<PointValue>& values) {
  constexpr size_t kMaxNames = 10;
  std::string list;
  for (size_t i = 0; i < std::min(values.size(), kMaxNames); ++i) {
    absl::StrAppend(&list, i == 0 ? "" : ", ", Quoted(values[i].name));
  }
  if (values.size() > kMaxNames) list += ", …";
  return list;
}

class TextReader final : public RecordReader {
 public:
  TextReader(PointFileInfo info, PointLayout layout, int64_t count,
             InputCursor cursor, TextRecord record)
      : RecordReader(std::move(info), std::move(layout), count),
        cursor_(std::move(cursor)),
        record_(std::move(record)),
        has_lists_(std::find(record_.is_list.begin(), record_.is_list.end(),
                             true) != record_.is_list.end()) {}

 private:
  absl::Status ReadRows(size_t first, size_t count,
                        core::PointCloud& batch) override {
    for (size_t row = 0; row < count; ++row) {
      MAPSIEVE_RETURN_IF_ERROR(NextWords(first + row));
      if (has_lists_) {
        MAPSIEVE_RETURN_IF_ERROR(DropLists());
      } else if (words_.size() != record_.is_list.size()) {
        return cursor_.DamagedLine(
            absl::StrCat("expected the ", record_.is_list.size(),
                         " values of a point, found ", words_.size()));
      }
      const PointValue* misfit = layout().Parse(words_, row, batch);
      if (misfit != nullptr) {
        return cursor_.DamagedLine(
            absl::StrCat(misfit->name, ": expected a number of type ",
                         ToAbsl(ScalarTypeName(misfit->type)), ", found ",
                         Quoted(words_[misfit->at])));
      }
    }
    return absl::OkStatus();
  }

  absl::Status NextWords(size_t point) {
    words_.clear();
    while (words_.empty()) {
      std::string_view line;
      MAPSIEVE_ASSIGN_OR_RETURN(const bool found, cursor_.NextLine(line));
      if (!found) {
        return cursor_.file().Damaged(
            cursor_.offset(),
            absl::StrCat("the file ends before point ", point + 1, " of ",
                         *info().point_count));
      }
      while (true) {
        const std::string_view word = TakeWord(line);
        if (word.empty()) break;
        if (record_.commas) {
          SplitAtCommas(word);
        } else {
          words_.push_back(word);
        }
      }
    }
    return absl::OkStatus();
  }

  void SplitAtCommas(std::string_view word) {
    while (!word.empty()) {
      const size_t length = std::min(word.find(','), word.size());
      if (length > 0) words_.push_back(word.substr(0, length));
      word.remove_prefix(std::min(length + 1, word.size()));
    }
  }

  // Leaves the words of scalars, one each.
  absl::Status DropLists() {
    size_t from = 0;
    size_t kept = 0;
    for (const bool is_list : record_.is_list) {
      if (from == words_.size()) {
        if (is_list) continue;
        return cursor_.DamagedLine(
            absl::StrCat("ends after ", from, " words, amid a point"));
      }
      const std::string_view word = words_[from++];
      if (!is_list) {
        words_[kept++] = word;
        continue;
      }
      uint64_t length = 0;
      if (!ParseNumber(word, length) || length > words_.size() - from) {
        return cursor_.DamagedLine(
            absl::StrCat("a list of ", Quoted(word), " values, but ",
                         words_.size() - from, " words are left"));
      }
      from += length;
    }
    if (from != words_.size()) {
      return cursor_.DamagedLine(absl::StrCat(
          "expected the ", from, " words of a point, found ", words_.size()));
    }
    words_.resize(kept);
    return absl::OkStatus();
  }

  InputCursor cursor_;
  TextRecord record_;
  bool has_lists_;
  std::vector<std::string_view> words_;
};

class BinaryReader final : public RecordReader {
 public:
  BinaryReader(PointFileInfo info, PointLayout layout, int64_t count,
               InputCursor cursor, size_t record_bytes, bool swap)
      : RecordReader(std::move(info), std::move(layout), count),
        cursor_(std::move(cursor)),
        record_bytes_(record_bytes),
        swap_(swap) {}

 private:
  absl::Status ReadRows(size_t, size_t count,
                        core::PointCloud& batch) override {
    for (size_t row = 0; row < count;) {
      const size_t rows = std::min(BlockRows(record_bytes_), count - row);
      MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes,
                                cursor_.Take(rows * record_bytes_, "points"));
      layout().Decode(bytes.data(), 0, rows, swap_, row, batch);
      row += rows;
    }
    return absl::OkStatus();
  }

  InputCursor cursor_;
  size_t record_bytes_;
  bool swap_;
};

// Whether `value` survives the way through a double.
template <typename T>
bool IsExactAsDouble(T value) {
  const auto real = static_cast<double>(value);
  // 2^digits is exact, while the largest value may not be.
  return real < std::ldexp(1.0, std::numeric_limits<T>::digits) &&
         static_cast<T>(real) == value;
}

class RecordWriter final : public PointWriter {
 public:
  RecordWriter(std::unique_ptr<OutputFile> file, ScalarType position,
               std::vector<WrittenValue> values,
               std::function<std::string(int64_t)> header)
      : file_(std::move(file)),
        is_float_(position == ScalarType::kFloat32),
        values_(std::move(values)),
        header_(std::move(header)),
        record_bytes_(3 * ScalarSize(position)) {
    for (const WrittenValue& value : values_) {
      attributes_.push_back(value.spec);
      record_bytes_ += ScalarSize(value.type);
    }
  }

  absl::Status Begin() { return file_->Append(header_(0)); }

  absl::Status Write(const core::PointCloud& batch) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto columns, Match(batch));
    std::vector<std::byte> records;
    for (size_t first = 0; first < batch.size();) {
      const size_t count =
          std::min(BlockRows(record_bytes_), batch.size() - first);
      records.resize(count * record_bytes_);
      const std::span points(batch.positions.data() + first, count);
      size_t at = is_float_ ? PutPositions<float>(points, records)
                            : PutPositions<double>(points, records);
      for (size_t i = 0; i < values_.size(); ++i) {
        Encode(*columns[i], values_[i].type, first, count, records.data() + at);
        at += ScalarSize(values_[i].type);
      }
      MAPSIEVE_RETURN_IF_ERROR(file_->Append(records));
      first += count;
    }
    count_ += static_cast<int64_t>(batch.size());
    return absl::OkStatus();
  }

  absl::Status Finish() override {
    MAPSIEVE_RETURN_IF_ERROR(file_->Overwrite(0, TextBytes(header_(count_))));
    return file_->Finish();
  }

 private:
  // Returns the bytes of a position.
  template <typename T>
  size_t PutPositions(std::span<const core::Point3> points,
                      std::span<std::byte> records) const {
    for (size_t i = 0; i < points.size(); ++i) {
      const core::Point3& p = points[i];
      const std::array<T, 3> position = {
          static_cast<T>(p.x), static_cast<T>(p.y), static_cast<T>(p.z)};
      std::memcpy(records.data() + i * record_bytes_, position.data(),
                  sizeof(position));
    }
    return 3 * sizeof(T);
  }

  // The batch's columns in the order of values_.
  absl::StatusOr<std::vector<const core::Column*>> Match(
      const core::PointCloud& batch) const {
    MAPSIEVE_ASSIGN_OR_RETURN(auto columns,
                              MatchColumns(file_->name(), attributes_, batch));
    for (size_t i = 0; i < values_.size(); ++i) {
      if (values_[i].type == columns[i]->type()) continue;
      MAPSIEVE_RETURN_IF_ERROR(columns[i]->type() == ScalarType::kInt64
                                   ? CheckExact<int64_t>(*columns[i])
                                   : CheckExact<uint64_t>(*columns[i]));
    }
    return columns;
  }

  template <typename T>
  absl::Status CheckExact(const core::Column& column) const {
    for (size_t i = 0; i < column.size(); ++i) {
      const T value = column.Get<T>(i);
      if (IsExactAsDouble(value)) continue;
      return absl::InvalidArgumentError(absl::StrCat(
          file_->name(), ": ", column.name(), " of point ",
          count_ + static_cast<int64_t>(i) + 1, " is ", value,
          ", which the widest type of this format, float64, does not hold "
          "exactly; write a .las or .pcd file"));
    }
    return absl::OkStatus();
  }

  // Puts rows [first, first + count) of `column` at `field` and every
  // record_bytes_ after it, as `type`.
  void Encode(const core::Column& column, ScalarType type, size_t first,
              size_t count, std::byte* field) const {
    if (type == column.type()) {
      ScatterField(column.bytes().data() + first * column.value_size(),
                   record_bytes_, count, column.value_size(), field);
    } else {
      for (size_t i = 0; i < count; ++i) {
        const double value = column.GetAsDouble(first + i);
        std::memcpy(field + i * record_bytes_, &value, sizeof(value));
      }
    }
    if (!column.has_missing()) return;
    core::VisitScalarType(type, [&](auto zero) {
      using T = decltype(zero);
      if constexpr (std::is_floating_point_v<T>) {
        const T none = std::numeric_limits<T>::quiet_NaN();
        for (size_t i = 0; i < count; ++i) {
          if (!column.IsMissing(first + i)) continue;
          std::memcpy(field + i * record_bytes_, &none, sizeof(none));
        }
      }
    });
  }

  std::unique_ptr<OutputFile> file_;
  bool is_float_;
  std::vector<WrittenValue> values_;
  std::vector<core::ColumnSpec> attributes_;
  std::function<std::string(int64_t)> header_;
  size_t record_bytes_;
  int64_t count_ = 0;
};

}  // namespace

absl::StatusOr<PointLayout> PointLayout::Create(std::vector<PointValue> values,
                                                std::string_view file_name) {
  PointLayout layout;
  const std::string all = NameList(values);
  for (size_t axis = 0; axis < kAxisNames.size(); ++axis) {
    const auto found = FindAxis(values, kAxisNames[axis]);
    if (found == values.end()) {
      return absl::InvalidArgumentError(
          absl::StrCat(ToAbsl(file_name), ": no ", ToAbsl(kAxisNames[axis]),
                       " among ", all, "; points need x, y and z"));
    }
    layout.position_[axis] = std::move(*found);
    values.erase(found);
  }
  for (PointValue& value : values) value.name = CleanText(value.name, '_');
  layout.attributes_ = std::move(values);
  MAPSIEVE_RETURN_IF_ERROR(CheckAttributes(file_name, layout.attributes()));
  return layout;
}

std::vector<core::ColumnSpec> PointLayout::attributes() const {
  std::vector<core::ColumnSpec> specs;
  specs.reserve(attributes_.size());
  for (const PointValue& value : attributes_) {
    specs.push_back({value.name, value.type});
  }
  return specs;
}

core::PointCloud PointLayout::MakeBatch(size_t size) const {
  core::PointCloud batch;
  batch.positions.resize(size);
  for (const PointValue& value : attributes_) {
    batch.attributes.columns().emplace_back(
        core::ColumnSpec{value.name, value.type}, size);
  }
  return batch;
}

void PointLayout::Decode(const std::byte* data, size_t first, size_t count,
                         bool swap, size_t row, core::PointCloud& batch) const {
  for (size_t axis = 0; axis < kAxes.size(); ++axis) {
    const PointValue& value = position_[axis];
    const std::byte* field = data + value.at + first * value.stride;
    core::Point3* points = batch.positions.data() + row;
    core::VisitScalarType(value.type, [&](auto number) {
      for (size_t i = 0; i < count; ++i) {
        std::memcpy(&number, field + i * value.stride, sizeof(number));
        if (swap) {
          SwapBytes(reinterpret_cast<std::byte*>(&number), 1, sizeof(number));
        }
        points[i].*kAxes[axis] = static_cast<double>(number);
      }
    });
  }
  for (size_t i = 0; i < attributes_.size(); ++i) {
    const PointValue& value = attributes_[i];
    const size_t width = core::ScalarSize(value.type);
    std::byte* column =
        batch.attributes.columns()[i].mutable_bytes().data() + row * width;
    GatherField(data + value.at + first * value.stride, value.stride, count,
                width, column);
    if (swap) SwapBytes(column, count, width);
  }
}

const PointValue* PointLayout::Parse(std::span<const std::string_view> words,
                                     size_t row,
                                     core::PointCloud& batch) const {
  for (size_t axis = 0; axis < kAxes.size(); ++axis) {
    const PointValue& value = position_[axis];
    if (!ParseNumber(words[value.at], batch.positions[row].*kAxes[axis])) {
      return &value;
    }
  }
  for (size_t i = 0; i < attributes_.size(); ++i) {
    const PointValue& value = attributes_[i];
    std::byte* column = batch.attributes.columns()[i].mutable_bytes().data();
    if (!ParseScalar(value.type, words[value.at],
                     column + row * core::ScalarSize(value.type))) {
      return &value;
    }
  }
  return nullptr;
}

RecordReader::RecordReader(PointFileInfo info, PointLayout layout,
                           int64_t count)
    : info_(std::move(info)),
      layout_(std::move(layout)),
      count_(static_cast<size_t>(count)) {
  info_.point_count = count;
  info_.attributes = layout_.attributes();
}

absl::StatusOr<core::PointCloud> RecordReader::ReadBatch(size_t max_points) {
  const size_t count = std::min(max_points, count_ - done_);
  core::PointCloud batch = layout_.MakeBatch(count);
  MAPSIEVE_RETURN_IF_ERROR(ReadRows(done_, count, batch));
  done_ += count;
  return batch;
}

absl::Status CheckPointsFit(const InputCursor& cursor, int64_t count,
                            size_t bytes) {
  const auto left = static_cast<uint64_t>(cursor.remaining());
  if (static_cast<uint64_t>(count) <= left / bytes) return absl::OkStatus();
  return cursor.file().Damaged(
      cursor.offset(),
      absl::StrCat("the header declares ", count, " records of at least ",
                   bytes, " bytes, but only ", left,
                   " bytes follow; the file is cut off or its header wrong"));
}

absl::StatusOr<std::unique_ptr<PointReader>> MakeTextReader(PointFileInfo info,
                                                            PointLayout layout,
                                                            int64_t count,
                                                            InputCursor cursor,
                                                            TextRecord record) {
  const auto scalars = static_cast<size_t>(
      std::count(record.is_list.begin(), record.is_list.end(), false));
  // A value takes a character, and one more between it and the next.
  MAPSIEVE_RETURN_IF_ERROR(
      CheckPointsFit(cursor, count, std::max<size_t>(2 * scalars, 2) - 1));
  return std::make_unique<TextReader>(std::move(info), std::move(layout), count,
                                      std::move(cursor), std::move(record));
}

absl::StatusOr<std::unique_ptr<PointReader>> MakeBinaryReader(
    PointFileInfo info, PointLayout layout, int64_t count, InputCursor cursor,
    size_t record_bytes, bool swap) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPointsFit(cursor, count, record_bytes));
  return std::make_unique<BinaryReader>(std::move(info), std::move(layout),
                                        count, std::move(cursor), record_bytes,
                                        swap);
}

absl::StatusOr<std::vector<WrittenValue>> NameWrittenValues(
    const std::filesystem::path& path,
    const std::vector<core::ColumnSpec>& attributes) {
  std::vector<WrittenValue> values;
  std::vector<core::ColumnSpec> written;
  for (const core::ColumnSpec& spec : attributes) {
    std::string name = CleanText(spec.name, '_');
    std::replace(name.begin(), name.end(), ' ', '_');
    written.push_back({name, spec.type});
    values.push_back({.spec = spec, .name = name, .type = spec.type});
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckAttributes(path.string(), written));
  return values;
}

std::string CountPadding(int64_t count) {
  const size_t digits = std::to_string(count).size();
  return std::string(std::numeric_limits<int64_t>::digits10 + 1 - digits, ' ');
}

absl::StatusOr<std::unique_ptr<PointWriter>> MakeRecordWriter(
    const std::filesystem::path& path, ScalarType position,
    std::vector<WrittenValue> values,
    std::function<std::string(int64_t)> header) {
  MAPSIEVE_ASSIGN_OR_RETURN(auto file, OutputFile::Create(path));
  auto writer = std::make_unique<RecordWriter>(
      std::move(file), position, std::move(values), std::move(header));
  MAPSIEVE_RETURN_IF_ERROR(writer->Begin());
  return writer;
}

}  // namespace mapsieve::client
