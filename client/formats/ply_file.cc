#include "client/formats/ply_file.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
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
#include "client/formats/record_columns.h"
#include "client/formats/text_numbers.h"
#include "core/base/status.h"
#include "core/cloud/column.h"

namespace mapsieve::client {
namespace {

using core::ScalarType;

constexpr std::string_view kVertex = "vertex";

struct TypeName {
  std::string_view name;
  ScalarType type;
};
// The writer takes the first name of a type.
constexpr TypeName kTypeNames[] = {
    {"char", ScalarType::kInt8},       {"uchar", ScalarType::kUint8},
    {"short", ScalarType::kInt16},     {"ushort", ScalarType::kUint16},
    {"int", ScalarType::kInt32},       {"uint", ScalarType::kUint32},
    {"float", ScalarType::kFloat32},   {"double", ScalarType::kFloat64},
    {"int8", ScalarType::kInt8},       {"uint8", ScalarType::kUint8},
    {"int16", ScalarType::kInt16},     {"uint16", ScalarType::kUint16},
    {"int32", ScalarType::kInt32},     {"uint32", ScalarType::kUint32},
    {"float32", ScalarType::kFloat32}, {"float64", ScalarType::kFloat64}};

struct PlyProperty {
  std::string name;
  ScalarType type = ScalarType::kFloat32;
  // Of a list: the type of its length.
  std::optional<ScalarType> length_type;
};

struct PlyElement {
  std::string name;
  int64_t count = 0;
  std::vector<PlyProperty> properties;

  bool has_lists() const {
    return std::any_of(properties.begin(), properties.end(),
                       [](const auto& p) { return p.length_type.has_value(); });
  }
  // Bytes of the scalars of one record.
  size_t scalar_bytes() const {
    size_t bytes = 0;
    for (const PlyProperty& property : properties) {
      if (!property.length_type.has_value()) {
        bytes += core::ScalarSize(property.type);
      }
    }
    return bytes;
  }
};

enum class Encoding { kAscii, kLittleEndian, kBigEndian };

struct PlyHeader {
  // The format, and what comments tell.
  PointFileInfo info;
  std::optional<Encoding> encoding;
  std::vector<PlyElement> elements;
  bool complete = false;
};

std::vector<PlyElement>::const_iterator FindVertex(const PlyHeader& header) {
  return std::find_if(header.elements.begin(), header.elements.end(),
                      [](const auto& e) { return e.name == kVertex; });
}

absl::Status Refuse(const InputCursor& cursor, std::string_view what) {
  return absl::InvalidArgumentError(
      absl::StrCat(cursor.file().name(), ", line ", cursor.line_number(), ": ",
                   ToAbsl(what)));
}

absl::StatusOr<ScalarType> ParseType(const InputCursor& cursor,
                                     std::string_view property,
                                     std::string_view word) {
  for (const TypeName& known : kTypeNames) {
    if (known.name == word) return known.type;
  }
  return Refuse(cursor, absl::StrCat("property ", Quoted(property),
                                     " is of type ", Quoted(word),
                                     ", which PLY does not have; its types are "
                                     "char, uchar, short, ushort, int, uint, "
                                     "float and double"));
}

absl::Status TakeFormat(const InputCursor& cursor, std::string_view rest,
                        PlyHeader& header) {
  const std::string_view encoding = TakeWord(rest);
  const std::string_view version = TakeWord(rest);
  if (encoding == "ascii") {
    header.encoding = Encoding::kAscii;
  } else if (encoding == "binary_little_endian") {
    header.encoding = Encoding::kLittleEndian;
  } else if (encoding == "binary_big_endian") {
    header.encoding = Encoding::kBigEndian;
  } else {
    return cursor.DamagedLine(
        absl::StrCat("format: expected ascii, binary_little_endian or "
                     "binary_big_endian, found ",
                     Quoted(encoding)));
  }
  if (version != "1.0") {
    return Refuse(cursor, absl::StrCat("PLY version ", Quoted(version),
                                       "; only 1.0 exists"));
  }
  header.info.format = absl::StrCat("PLY ", ToAbsl(encoding));
  return absl::OkStatus();
}

absl::Status TakeElement(const InputCursor& cursor, std::string_view rest,
                         PlyHeader& header) {
  PlyElement element{.name = CleanText(TakeWord(rest), '_')};
  const std::string_view count = TakeWord(rest);
  if (!ParseNumber(count, element.count) || element.count < 0) {
    return cursor.DamagedLine(absl::StrCat("element ", Quoted(element.name),
                                           ": expected how many, found ",
                                           Quoted(count)));
  }
  if (element.name == kVertex && FindVertex(header) != header.elements.end()) {
    return cursor.DamagedLine("a second element \"vertex\"");
  }
  header.elements.push_back(std::move(element));
  return absl::OkStatus();
}

absl::Status TakeProperty(const InputCursor& cursor, std::string_view rest,
                          PlyHeader& header) {
  if (header.elements.empty()) {
    return cursor.DamagedLine("a property before any element");
  }
  std::vector<PlyProperty>& properties = header.elements.back().properties;
  std::vector<std::string_view> words;
  for (auto word = TakeWord(rest); !word.empty(); word = TakeWord(rest)) {
    words.push_back(word);
  }
  const bool is_list = !words.empty() && words.front() == "list";
  if (words.size() != (is_list ? 4 : 2)) {
    return cursor.DamagedLine(
        "expected \"property TYPE NAME\" or \"property list LENGTH-TYPE "
        "TYPE NAME\"");
  }
  const std::string_view name = words.back();
  PlyProperty property{.name = CleanText(name, '_')};
  MAPSIEVE_ASSIGN_OR_RETURN(property.type,
                            ParseType(cursor, name, words[words.size() - 2]));
  if (is_list) {
    MAPSIEVE_ASSIGN_OR_RETURN(property.length_type,
                              ParseType(cursor, name, words[1]));
    if (*property.length_type == ScalarType::kFloat32 ||
        *property.length_type == ScalarType::kFloat64) {
      return Refuse(
          cursor,
          absl::StrCat("list ", Quoted(name), ": its length is of type ",
                       Quoted(words[1]), "; it must be an integer"));
    }
  }
  properties.push_back(std::move(property));
  return absl::OkStatus();
}

absl::Status TakeHeaderLine(const InputCursor& cursor, std::string_view line,
                            PlyHeader& header) {
  std::string_view rest = line;
  const std::string_view key = TakeWord(rest);
  if (key == "comment") TakeHeaderComment(rest, header.info);
  if (key.empty() || key == "comment" || key == "obj_info") {
    return absl::OkStatus();
  }
  // Data instead of a header line may well have three "words".
  if (std::any_of(line.begin(), line.end(),
                  [](char c) { return c >= '\0' && c < ' ' && c != '\t'; })) {
    return cursor.DamagedLine(
        absl::StrCat("binary data amid the header: ", Quoted(line)));
  }
  if (key == "format") return TakeFormat(cursor, rest, header);
  if (key == "element") return TakeElement(cursor, rest, header);
  if (key == "property") return TakeProperty(cursor, rest, header);
  if (key == "end_header") {
    header.complete = true;
    return absl::OkStatus();
  }
  return cursor.DamagedLine(absl::StrCat(
      "expected format, element, property, comment, obj_info or end_header, "
      "found ",
      Quoted(key)));
}

absl::StatusOr<PlyHeader> ReadHeader(InputCursor& cursor) {
  std::string_view line;
  MAPSIEVE_ASSIGN_OR_RETURN(bool found, cursor.NextLine(line));
  if (!found || TrimBlanks(line) != "ply") {
    return cursor.file().Damaged(
        0, absl::StrCat("expected the first line of a PLY file, \"ply\", "
                        "found ",
                        found ? Quoted(line) : "the end of the file"));
  }
  PlyHeader header;
  while (!header.complete) {
    MAPSIEVE_ASSIGN_OR_RETURN(found, cursor.NextLine(line));
    if (!found || cursor.offset() > kMaxHeaderBytes) {
      return cursor.file().Damaged(cursor.offset(),
                                   "no line end_header; the file is cut off");
    }
    MAPSIEVE_RETURN_IF_ERROR(TakeHeaderLine(cursor, line, header));
  }
  if (!header.encoding.has_value()) {
    return cursor.file().Damaged(cursor.offset(),
                                 "the header has no line format");
  }
  return header;
}

// Takes the length of a list.
absl::StatusOr<int64_t> TakeLength(InputCursor& cursor,
                                   const PlyProperty& property, bool swap) {
  const size_t width = core::ScalarSize(*property.length_type);
  MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes,
                            cursor.Take(width, property.name));
  std::array<std::byte, 8> number{};
  std::memcpy(number.data(), bytes.data(), width);
  if (swap) SwapBytes(number.data(), 1, width);
  const int64_t length =
      core::VisitScalarType(*property.length_type, [&](auto value) {
        std::memcpy(&value, number.data(), sizeof(value));
        return static_cast<int64_t>(value);
      });
  if (length < 0) {
    return cursor.file().Damaged(
        cursor.offset(), absl::StrCat("list ", Quoted(property.name), " has ",
                                      length, " values"));
  }
  return length;
}

// Passes over one record of `element`; its scalars go to `scalars`, if wanted.
absl::Status TakeRecord(InputCursor& cursor, const PlyElement& element,
                        bool swap, std::byte* scalars) {
  for (const PlyProperty& property : element.properties) {
    const size_t width = core::ScalarSize(property.type);
    if (property.length_type.has_value()) {
      MAPSIEVE_ASSIGN_OR_RETURN(const int64_t length,
                                TakeLength(cursor, property, swap));
      // A length has at most 32 bits.
      MAPSIEVE_RETURN_IF_ERROR(
          cursor.Skip(length * static_cast<int64_t>(width), property.name));
      continue;
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes,
                              cursor.Take(width, property.name));
    if (scalars != nullptr) {
      std::memcpy(scalars, bytes.data(), width);
      scalars += width;
    }
  }
  return absl::OkStatus();
}

absl::Status SkipElement(InputCursor& cursor, const PlyElement& element,
                         Encoding encoding) {
  if (element.properties.empty()) return absl::OkStatus();
  if (encoding == Encoding::kAscii) {
    for (int64_t done = 0; done < element.count;) {
      std::string_view line;
      MAPSIEVE_ASSIGN_OR_RETURN(const bool found, cursor.NextLine(line));
      if (!found) {
        return cursor.file().Damaged(
            cursor.offset(),
            absl::StrCat("the file ends after ", done, " of ", element.count,
                         " lines of element ", Quoted(element.name)));
      }
      if (!TrimBlanks(line).empty()) ++done;
    }
    return absl::OkStatus();
  }
  if (element.has_lists()) {
    const bool swap = encoding == Encoding::kBigEndian;
    for (int64_t i = 0; i < element.count; ++i) {
      MAPSIEVE_RETURN_IF_ERROR(TakeRecord(cursor, element, swap, nullptr));
    }
    return absl::OkStatus();
  }
  const size_t bytes = element.scalar_bytes();
  MAPSIEVE_RETURN_IF_ERROR(CheckPointsFit(cursor, element.count, bytes));
  return cursor.Skip(element.count * static_cast<int64_t>(bytes), element.name);
}

// Reads binary vertices that have lists.
class ListReader final : public RecordReader {
 public:
  ListReader(PointFileInfo info, PointLayout layout, PlyElement vertex,
             InputCursor cursor, bool swap)
      : RecordReader(std::move(info), std::move(layout), vertex.count),
        vertex_(std::move(vertex)),
        cursor_(std::move(cursor)),
        swap_(swap),
        record_(vertex_.scalar_bytes()) {}

 private:
  absl::Status ReadRows(size_t, size_t count,
                        core::PointCloud& batch) override {
    for (size_t row = 0; row < count; ++row) {
      MAPSIEVE_RETURN_IF_ERROR(
          TakeRecord(cursor_, vertex_, swap_, record_.data()));
      layout().Decode(record_.data(), 0, 1, swap_, row, batch);
    }
    return absl::OkStatus();
  }

  PlyElement vertex_;
  InputCursor cursor_;
  bool swap_;
  std::vector<std::byte> record_;
};

absl::StatusOr<PointLayout> MakeLayout(const InputCursor& cursor,
                                       const PlyElement& vertex, bool ascii) {
  std::vector<PointValue> values;
  const size_t stride = vertex.scalar_bytes();
  size_t bytes_before = 0;
  for (const PlyProperty& property : vertex.properties) {
    if (property.length_type.has_value()) continue;
    values.push_back({.name = property.name,
                      .type = property.type,
                      .at = ascii ? values.size() : bytes_before,
                      .stride = stride});
    bytes_before += core::ScalarSize(property.type);
  }
  return PointLayout::Create(std::move(values), cursor.file().name());
}

absl::StatusOr<std::unique_ptr<PointReader>> OpenVertices(
    InputCursor cursor, const PlyHeader& header, const PlyElement& vertex) {
  const bool ascii = header.encoding == Encoding::kAscii;
  const bool swap = header.encoding == Encoding::kBigEndian;
  MAPSIEVE_ASSIGN_OR_RETURN(PointLayout layout,
                            MakeLayout(cursor, vertex, ascii));
  if (ascii) {
    TextRecord record;
    for (const PlyProperty& property : vertex.properties) {
      record.is_list.push_back(property.length_type.has_value());
    }
    return MakeTextReader(header.info, std::move(layout), vertex.count,
                          std::move(cursor), std::move(record));
  }
  const size_t scalar_bytes = vertex.scalar_bytes();
  if (!vertex.has_lists()) {
    return MakeBinaryReader(header.info, std::move(layout), vertex.count,
                            std::move(cursor), scalar_bytes, swap);
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckPointsFit(cursor, vertex.count, scalar_bytes));
  return std::make_unique<ListReader>(header.info, std::move(layout), vertex,
                                      std::move(cursor), swap);
}

std::string_view NameOfType(ScalarType type) {
  for (const TypeName& known : kTypeNames) {
    if (known.type == type) return known.name;
  }
  return {};
}

std::string MakeHeader(ScalarType position, const std::string& comments,
                       const std::vector<WrittenValue>& values, int64_t count) {
  std::string header = absl::StrCat(
      "ply\nformat binary_little_endian 1.0\ncomment written by mapsieve",
      CountPadding(count), "\n", comments, "element vertex ", count, "\n");
  for (const char axis : {'x', 'y', 'z'}) {
    absl::StrAppend(&header, "property ", ToAbsl(NameOfType(position)), " ",
                    std::string(1, axis), "\n");
  }
  for (const WrittenValue& value : values) {
    absl::StrAppend(&header, "property ", ToAbsl(NameOfType(value.type)), " ",
                    value.name, "\n");
  }
  return header + "end_header\n";
}

}  // namespace

absl::StatusOr<std::unique_ptr<PointReader>> OpenPlyFile(
    const std::filesystem::path& path) {
  MAPSIEVE_ASSIGN_OR_RETURN(auto file, InputFile::Open(path));
  InputCursor cursor(std::move(file));
  MAPSIEVE_ASSIGN_OR_RETURN(const PlyHeader header, ReadHeader(cursor));
  const auto vertex = FindVertex(header);
  if (vertex == header.elements.end()) {
    return MakeTextReader(header.info, PointLayout(), 0, std::move(cursor), {});
  }
  for (auto element = header.elements.begin(); element != vertex; ++element) {
    MAPSIEVE_RETURN_IF_ERROR(SkipElement(cursor, *element, *header.encoding));
  }
  return OpenVertices(std::move(cursor), header, *vertex);
}

absl::StatusOr<std::unique_ptr<PointWriter>> CreatePlyFile(
    const std::filesystem::path& path, const WriteOptions& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<WrittenValue> values,
                            NameWrittenValues(path, options.attributes));
  for (WrittenValue& value : values) {
    if (NameOfType(value.type).empty()) value.type = ScalarType::kFloat64;
  }
  const ScalarType position = TypeOfPositions(options);
  const std::string comments = MakeHeaderComments("comment ", options);
  return MakeRecordWriter(path, position, values, [=](int64_t count) {
    return MakeHeader(position, comments, values, count);
  });
}

}  // namespace mapsieve::client
