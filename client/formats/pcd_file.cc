#include "client/formats/pcd_file.h"

#include <lzf.h>

#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/formats/batch_columns.h"
#include "client/formats/file_input.h"
#include "client/formats/header_comments.h"
#include "client/formats/point_records.h"
#include "client/formats/text_numbers.h"
#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/cloud/column.h"

namespace mapsieve::client {
namespace {

using core::ScalarType;

constexpr std::string_view kPadding = "_";
constexpr int64_t kMaxRecordBytes = int64_t{1} << 20;
// The best that LZF can do: three bytes that stand for 264.
constexpr uint64_t kMaxLzfRatio = 88;

// Fields as the header describes them; the defaults are those of files that
// lack the line.
struct PcdField {
  std::string name;
  int64_t size = 4;
  char type = 'F';
  int64_t count = 1;

  bool is_padding() const { return name == kPadding; }
  size_t bytes() const { return static_cast<size_t>(size * count); }
};

struct PcdHeader {
  std::vector<PcdField> fields;
  std::optional<int64_t> width;
  std::optional<int64_t> height;
  std::optional<int64_t> points;
  // "ascii", "binary" or "binary_compressed".
  std::string data;
  // `points`, checked against the others.
  int64_t count = 0;
  // What comments tell, and the format once the header is complete.
  PointFileInfo info;
};

absl::Status Refuse(const InputCursor& cursor, std::string_view what) {
  return absl::InvalidArgumentError(
      absl::StrCat(cursor.file().name(), ": ", ToAbsl(what)));
}

absl::Status CheckVersion(const InputCursor& cursor, std::string_view word) {
  double version = 0;
  if (!ParseNumber(word, version)) {
    return cursor.DamagedLine(
        absl::StrCat("VERSION: expected a number, found ", Quoted(word)));
  }
  constexpr double kOldest = 0.4;
  constexpr double kNewest = 0.7;
  if (!(version >= kOldest && version <= kNewest)) {
    return absl::UnimplementedError(
        absl::StrCat(cursor.file().name(), ": PCD version ", ToAbsl(word),
                     " is not read; convert it to 0.7"));
  }
  return absl::OkStatus();
}

absl::Status TakeCount(const InputCursor& cursor, std::string_view key,
                       std::string_view word, std::optional<int64_t>& count) {
  int64_t value = 0;
  if (!ParseNumber(word, value) || value < 0) {
    return cursor.DamagedLine(absl::StrCat(
        ToAbsl(key), ": expected a number of points, found ", Quoted(word)));
  }
  count = value;
  return absl::OkStatus();
}

void TakeFields(std::string_view rest, PcdHeader& header) {
  header.fields.clear();
  for (auto word = TakeWord(rest); !word.empty(); word = TakeWord(rest)) {
    header.fields.push_back({.name = std::string(word)});
  }
}

// The lines SIZE, TYPE and COUNT have a word for every field.
absl::Status TakeFieldProperty(const InputCursor& cursor, std::string_view key,
                               std::string_view rest, PcdHeader& header) {
  size_t words = 0;
  for (auto word = TakeWord(rest); !word.empty(); word = TakeWord(rest)) {
    if (words++ >= header.fields.size()) continue;
    PcdField& field = header.fields[words - 1];
    if (key == "TYPE") {
      field.type = word.size() == 1 ? word.front() : '?';
      continue;
    }
    int64_t& number = key == "SIZE" ? field.size : field.count;
    if (!ParseNumber(word, number) || number < 1 || number > kMaxRecordBytes) {
      return cursor.DamagedLine(absl::StrCat(
          ToAbsl(key), " of field ", Quoted(field.name), ": expected 1 to ",
          kMaxRecordBytes, ", found ", Quoted(word)));
    }
  }
  if (words != header.fields.size()) {
    return cursor.DamagedLine(
        absl::StrCat(ToAbsl(key), ": expected a word for each of the ",
                     header.fields.size(), " fields, found ", words));
  }
  return absl::OkStatus();
}

// Takes one line; true if it was the last.
absl::StatusOr<bool> TakeHeaderLine(const InputCursor& cursor,
                                    std::string_view line, PcdHeader& header) {
  std::string_view rest = line;
  const std::string_view key = TakeWord(rest);
  if (key.empty() || key == "VIEWPOINT") return false;
  if (key.front() == '#') {
    TakeHeaderComment(TrimBlanks(line).substr(1), header.info);
    return false;
  }
  if (key == "FIELDS" || key == "COLUMNS") {
    TakeFields(rest, header);
    return false;
  }
  if (key == "SIZE" || key == "TYPE" || key == "COUNT") {
    MAPSIEVE_RETURN_IF_ERROR(TakeFieldProperty(cursor, key, rest, header));
    return false;
  }
  const std::string_view word = TakeWord(rest);
  if (key == "VERSION") {
    MAPSIEVE_RETURN_IF_ERROR(CheckVersion(cursor, word));
  } else if (key == "WIDTH") {
    MAPSIEVE_RETURN_IF_ERROR(TakeCount(cursor, key, word, header.width));
  } else if (key == "HEIGHT") {
    MAPSIEVE_RETURN_IF_ERROR(TakeCount(cursor, key, word, header.height));
  } else if (key == "POINTS") {
    MAPSIEVE_RETURN_IF_ERROR(TakeCount(cursor, key, word, header.points));
  } else if (key == "DATA") {
    if (word != "ascii" && word != "binary" && word != "binary_compressed") {
      return cursor.DamagedLine(
          absl::StrCat("DATA: expected ascii, binary or binary_compressed, "
                       "found ",
                       Quoted(word)));
    }
    header.data = std::string(word);
    header.info.format = absl::StrCat("PCD ", header.data);
    return true;
  } else {
    return cursor.DamagedLine(absl::StrCat(
        "expected an entry of a PCD header (VERSION, FIELDS, SIZE, TYPE, "
        "COUNT, WIDTH, HEIGHT, VIEWPOINT, POINTS, DATA), found ",
        Quoted(key)));
  }
  return false;
}

absl::Status SettleCount(const InputCursor& cursor, PcdHeader& header) {
  if (!header.points.has_value() && !header.width.has_value()) {
    return cursor.file().Damaged(cursor.offset(),
                                 "the header has neither POINTS nor WIDTH");
  }
  header.count = header.points.value_or(0);
  if (!header.width.has_value()) return absl::OkStatus();
  const int64_t height = header.height.value_or(1);
  int64_t product = 0;
  if (__builtin_mul_overflow(*header.width, height, &product) ||
      product != header.points.value_or(product)) {
    return cursor.file().Damaged(
        cursor.offset(),
        absl::StrCat("the header declares WIDTH ", *header.width,
                     " and HEIGHT ", height, ", but POINTS ", header.count));
  }
  header.count = product;
  return absl::OkStatus();
}

absl::StatusOr<PcdHeader> ReadHeader(InputCursor& cursor) {
  PcdHeader header;
  bool complete = false;
  while (!complete) {
    std::string_view line;
    MAPSIEVE_ASSIGN_OR_RETURN(const bool found, cursor.NextLine(line));
    if (!found || cursor.offset() > kMaxHeaderBytes) {
      return cursor.file().Damaged(
          cursor.offset(),
          "no DATA line ends the header; this is no PCD file or cut off");
    }
    MAPSIEVE_ASSIGN_OR_RETURN(complete, TakeHeaderLine(cursor, line, header));
  }
  if (header.fields.empty()) {
    return cursor.file().Damaged(cursor.offset(), "the header has no FIELDS");
  }
  MAPSIEVE_RETURN_IF_ERROR(SettleCount(cursor, header));
  return header;
}

absl::StatusOr<ScalarType> FieldType(const InputCursor& cursor,
                                     const PcdField& field) {
  struct Known {
    char type;
    uint8_t size;
    ScalarType scalar;
  };
  static constexpr Known kKnown[] = {
      {'I', 1, ScalarType::kInt8},    {'U', 1, ScalarType::kUint8},
      {'I', 2, ScalarType::kInt16},   {'U', 2, ScalarType::kUint16},
      {'I', 4, ScalarType::kInt32},   {'U', 4, ScalarType::kUint32},
      {'I', 8, ScalarType::kInt64},   {'U', 8, ScalarType::kUint64},
      {'F', 4, ScalarType::kFloat32}, {'F', 8, ScalarType::kFloat64}};
  for (const Known& known : kKnown) {
    if (known.type == field.type && known.size == field.size) {
      return known.scalar;
    }
  }
  return Refuse(cursor,
                absl::StrCat("field ", Quoted(field.name), " is TYPE ",
                             Quoted({&field.type, 1}), " SIZE ", field.size,
                             "; read are I and U of 1, 2, 4 and 8, F "
                             "of 4 and 8 bytes"));
}

// How the values of a point are laid out in the data.
enum class Order { kWords, kRecords, kColumns };

// Where the fields lie in data of `order`; `skip_padding`: there are no columns
// of padding.
absl::StatusOr<PointLayout> MakeLayout(const InputCursor& cursor,
                                       const PcdHeader& header, Order order,
                                       size_t record_bytes, bool skip_padding) {
  std::vector<PointValue> values;
  const auto points = static_cast<size_t>(header.count);
  size_t bytes_before = 0;
  size_t words_before = 0;
  for (const PcdField& field : header.fields) {
    if (field.is_padding() && skip_padding) continue;
    const auto count = static_cast<size_t>(field.count);
    if (!field.is_padding()) {
      MAPSIEVE_ASSIGN_OR_RETURN(const ScalarType type,
                                FieldType(cursor, field));
      if (values.size() + count > kMaxAttributes + 3) {
        return Refuse(cursor, absl::StrCat("has more than ", kMaxAttributes,
                                           " values a point besides x y z; "
                                           "take some out"));
      }
      for (size_t i = 0; i < count; ++i) {
        PointValue value{
            .name = count == 1 ? field.name : absl::StrCat(field.name, "_", i),
            .type = type};
        const size_t within = i * core::ScalarSize(type);
        switch (order) {
          case Order::kWords:
            value.at = words_before + i;
            break;
          case Order::kRecords:
            value.at = bytes_before + within;
            value.stride = record_bytes;
            break;
          case Order::kColumns:
            value.at = bytes_before * points + within;
            value.stride = field.bytes();
            break;
        }
        values.push_back(std::move(value));
      }
    }
    bytes_before += field.bytes();
    words_before += count;
  }
  return PointLayout::Create(std::move(values), cursor.file().name());
}

// Names what holds the position where it is no x, y, z.
absl::Status CheckPosition(const InputCursor& cursor, const PcdHeader& header) {
  const PcdField* triple = nullptr;
  size_t axes = 0;
  for (const PcdField& field : header.fields) {
    const std::string name = ToLower(field.name);
    if (name == "x" || name == "y" || name == "z") {
      ++axes;
      if (field.count != 1) {
        return Refuse(cursor, absl::StrCat("field ", field.name, " has COUNT ",
                                           field.count, "; expected 1"));
      }
    } else if (field.count == 3 && !field.is_padding() && triple == nullptr) {
      triple = &field;
    }
  }
  if (axes == 0 && triple != nullptr) {
    return Refuse(cursor,
                  absl::StrCat("no fields x, y and z; x y z in one field (",
                               Quoted(triple->name),
                               " has COUNT 3) is not read: name three fields"));
  }
  return absl::OkStatus();
}

// Data of columns, all in one block of LZF.
class CompressedReader final : public RecordReader {
 public:
  CompressedReader(PointFileInfo info, PointLayout layout, int64_t count,
                   InputCursor cursor, uint32_t compressed_bytes,
                   uint32_t raw_bytes)
      : RecordReader(std::move(info), std::move(layout), count),
        cursor_(std::move(cursor)),
        compressed_bytes_(compressed_bytes),
        raw_bytes_(raw_bytes) {}

 private:
  absl::Status ReadRows(size_t first, size_t count,
                        core::PointCloud& batch) override {
    if (count == 0) return absl::OkStatus();
    if (cursor_.has_value()) {
      MAPSIEVE_RETURN_IF_ERROR(Decompress(*cursor_));
      cursor_.reset();
    }
    layout().Decode(raw_.get(), first, count, /*swap=*/false, 0, batch);
    return absl::OkStatus();
  }

  absl::Status Decompress(InputCursor& cursor) {
    const int64_t offset = cursor.offset();
    MAPSIEVE_ASSIGN_OR_RETURN(const auto compressed,
                              cursor.Take(compressed_bytes_, "points"));
    raw_ = std::make_unique_for_overwrite<std::byte[]>(raw_bytes_);
    const uint32_t got = lzf_decompress(compressed.data(), compressed_bytes_,
                                        raw_.get(), raw_bytes_);
    if (got == raw_bytes_) return absl::OkStatus();
    return cursor.file().Damaged(
        offset, absl::StrCat("the compressed points are damaged: expected ",
                             raw_bytes_, " bytes, decompressing gave ", got));
  }

  // Gone once the points are in memory.
  std::optional<InputCursor> cursor_;
  uint32_t compressed_bytes_;
  uint32_t raw_bytes_;
  std::unique_ptr<std::byte[]> raw_;
};

absl::StatusOr<std::unique_ptr<PointReader>> OpenCompressed(
    InputCursor cursor, const PcdHeader& header, size_t record_bytes) {
  uint32_t compressed_bytes = 0;
  uint32_t raw_bytes = 0;
  bool skip_padding = false;
  if (header.count > 0) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const auto sizes, cursor.Take(2 * sizeof(uint32_t), "compressed size"));
    compressed_bytes = LoadLittleEndian<uint32_t>(sizes.data());
    raw_bytes = LoadLittleEndian<uint32_t>(sizes.data() + sizeof(uint32_t));
    // Writers leave padding out or keep it; the size tells which.
    size_t packed_bytes = record_bytes;
    for (const PcdField& field : header.fields) {
      if (field.is_padding()) packed_bytes -= field.bytes();
    }
    const auto points = static_cast<uint64_t>(header.count);
    const bool divides = raw_bytes % points == 0;
    const bool whole = divides && raw_bytes / points == record_bytes;
    skip_padding = !whole && divides && raw_bytes / points == packed_bytes;
    if (!whole && !skip_padding) {
      return cursor.file().Damaged(
          cursor.offset(),
          absl::StrCat("expected ", points, " points of ", record_bytes,
                       " bytes, found an uncompressed size of ", raw_bytes));
    }
    if (compressed_bytes > cursor.remaining() ||
        raw_bytes > kMaxLzfRatio * compressed_bytes) {
      return cursor.file().Damaged(
          cursor.offset(),
          absl::StrCat("expected ", compressed_bytes,
                       " compressed bytes that make ", raw_bytes,
                       ", the file has ", cursor.remaining(),
                       "; it is cut off or its sizes are wrong"));
    }
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      PointLayout layout,
      MakeLayout(cursor, header, Order::kColumns, record_bytes, skip_padding));
  return std::make_unique<CompressedReader>(header.info, std::move(layout),
                                            header.count, std::move(cursor),
                                            compressed_bytes, raw_bytes);
}

char TypeLetter(ScalarType type) {
  return core::VisitScalarType(type, [](auto zero) {
    using T = decltype(zero);
    if constexpr (std::is_floating_point_v<T>) return 'F';
    return std::is_signed_v<T> ? 'I' : 'U';
  });
}

std::string MakeHeader(ScalarType position, const std::string& comments,
                       const std::vector<WrittenValue>& values, int64_t count) {
  std::string fields = "FIELDS x y z";
  std::string sizes =
      position == ScalarType::kFloat32 ? "SIZE 4 4 4" : "SIZE 8 8 8";
  std::string types = "TYPE F F F";
  std::string counts = "COUNT 1 1 1";
  for (const WrittenValue& value : values) {
    absl::StrAppend(&fields, " ", value.name);
    absl::StrAppend(&sizes, " ", core::ScalarSize(value.type));
    absl::StrAppend(&types, " ", std::string(1, TypeLetter(value.type)));
    absl::StrAppend(&counts, " 1");
  }
  const std::string padding = CountPadding(count);
  return absl::StrCat("# .PCD v0.7 - Point Cloud Data file format", padding,
                      padding, "\n", comments, "VERSION 0.7\n", fields, "\n",
                      sizes, "\n", types, "\n", counts, "\nWIDTH ", count,
                      "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS ", count,
                      "\nDATA binary\n");
}

}  // namespace

absl::StatusOr<std::unique_ptr<PointReader>> OpenPcdFile(
    const std::filesystem::path& path) {
  MAPSIEVE_ASSIGN_OR_RETURN(auto file, InputFile::Open(path));
  InputCursor cursor(std::move(file));
  MAPSIEVE_ASSIGN_OR_RETURN(const PcdHeader header, ReadHeader(cursor));
  MAPSIEVE_RETURN_IF_ERROR(CheckPosition(cursor, header));
  int64_t record_bytes = 0;
  size_t words = 0;
  for (const PcdField& field : header.fields) {
    // Both factors are at most kMaxRecordBytes.
    record_bytes += field.size * field.count;
    words += static_cast<size_t>(field.count);
    if (record_bytes > kMaxRecordBytes) {
      return Refuse(cursor, absl::StrCat("a point takes more than ",
                                         kMaxRecordBytes, " bytes"));
    }
  }
  const auto bytes = static_cast<size_t>(record_bytes);
  if (header.data == "binary_compressed") {
    return OpenCompressed(std::move(cursor), header, bytes);
  }
  const bool ascii = header.data == "ascii";
  MAPSIEVE_ASSIGN_OR_RETURN(
      PointLayout layout,
      MakeLayout(cursor, header, ascii ? Order::kWords : Order::kRecords, bytes,
                 /*skip_padding=*/false));
  if (ascii) {
    TextRecord record{.is_list = std::vector<bool>(words), .commas = true};
    return MakeTextReader(header.info, std::move(layout), header.count,
                          std::move(cursor), std::move(record));
  }
  return MakeBinaryReader(header.info, std::move(layout), header.count,
                          std::move(cursor), bytes, /*swap=*/false);
}

absl::StatusOr<std::unique_ptr<PointWriter>> CreatePcdFile(
    const std::filesystem::path& path, const WriteOptions& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<WrittenValue> values,
                            NameWrittenValues(path, options.attributes));
  for (const WrittenValue& value : values) {
    if (value.name == kPadding) {
      return absl::InvalidArgumentError(absl::StrCat(
          path.string(),
          ": an attribute is named \"_\", which is padding in PCD; rename "
          "it"));
    }
  }
  const ScalarType position = TypeOfPositions(options);
  const std::string comments = MakeHeaderComments("# ", options);
  return MakeRecordWriter(path, position, values, [=](int64_t count) {
    return MakeHeader(position, comments, values, count);
  });
}

}  // namespace mapsieve::client
