#include "client/formats/vtk_file.h"

#include <algorithm>
#include <array>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/formats/batch_columns.h"
#include "client/formats/file_input.h"
#include "client/formats/text_numbers.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

using core::Column;
using core::ScalarType;

// Every array has a cursor of its own.
constexpr size_t kCursorBytes = size_t{32} << 10;

// Numbers of one array: where they begin and what they are.
struct Section {
  int64_t offset = 0;
  int64_t line = 1;
  ScalarType type = ScalarType::kFloat32;
  std::vector<std::string> names;
};

struct Contents {
  std::string version;
  int64_t point_count = 0;
  std::optional<Section> positions;
  std::vector<Section> arrays;
};

std::optional<ScalarType> TypeOf(std::string_view name) {
  static constexpr std::array<std::pair<std::string_view, ScalarType>, 16>
      kTypes = {{{"bit", ScalarType::kUint8},
                 {"char", ScalarType::kInt8},
                 {"signed_char", ScalarType::kInt8},
                 {"unsigned_char", ScalarType::kUint8},
                 {"short", ScalarType::kInt16},
                 {"unsigned_short", ScalarType::kUint16},
                 {"int", ScalarType::kInt32},
                 {"unsigned_int", ScalarType::kUint32},
                 {"long", ScalarType::kInt64},
                 {"unsigned_long", ScalarType::kUint64},
                 {"vtkIdType", ScalarType::kInt64},
                 {"vtkIdtype", ScalarType::kInt64},
                 {"vtktypeint64", ScalarType::kInt64},
                 {"vtktypeuint64", ScalarType::kUint64},
                 {"float", ScalarType::kFloat32},
                 {"double", ScalarType::kFloat64}}};
  for (const auto& [known, type] : kTypes) {
    if (EqualsIgnoringCase(name, known)) return type;
  }
  return std::nullopt;
}

std::vector<std::string> ComponentNames(std::string_view keyword,
                                        const std::string& name,
                                        int64_t count) {
  if (keyword == "NORMALS") return {"nx", "ny", "nz"};
  if (keyword == "VECTORS") return {name + "_x", name + "_y", name + "_z"};
  if (keyword == "COLOR_SCALARS" && (count == 3 || count == 4)) {
    std::vector<std::string> names = {"red", "green", "blue", "alpha"};
    names.resize(static_cast<size_t>(count));
    return names;
  }
  if (count == 1) return {name};
  std::vector<std::string> names;
  for (int64_t i = 0; i < count; ++i) {
    names.push_back(absl::StrCat(name, "_", i));
  }
  return names;
}

// Finds the sections of a file in one pass.
class Scanner {
 public:
  explicit Scanner(std::shared_ptr<const InputFile> file)
      : cursor_(std::move(file)) {}

  absl::StatusOr<Contents> Scan() {
    MAPSIEVE_RETURN_IF_ERROR(ScanHeader());
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(const bool more, Next());
      if (!more) break;
      MAPSIEVE_RETURN_IF_ERROR(ScanSection(std::string(token_)));
    }
    if (!contents_.positions.has_value()) {
      return cursor_.DamagedLine("the file ends; expected a section POINTS");
    }
    return std::move(contents_);
  }

 private:
  absl::Status ScanHeader() {
    constexpr std::string_view kMagic = "# vtk DataFile Version";
    std::string_view line;
    MAPSIEVE_RETURN_IF_ERROR(NextLine(line, "the VTK header"));
    if (!line.starts_with(kMagic)) {
      return cursor_.DamagedLine(absl::StrCat("expected \"", ToAbsl(kMagic),
                                              "\", found ", Quoted(line),
                                              "; this is not legacy VTK"));
    }
    contents_.version =
        CleanText(line.substr(kMagic.size(), kMaxVersionBytes), '_');
    MAPSIEVE_RETURN_IF_ERROR(NextLine(line, "the title"));
    MAPSIEVE_RETURN_IF_ERROR(NextLine(line, "ASCII or BINARY"));
    line = TrimBlanks(line);
    if (EqualsIgnoringCase(line, "BINARY")) {
      return absl::UnimplementedError(
          absl::StrCat(cursor_.file().name(),
                       ": binary VTK is not read; save it as ASCII VTK or as "
                       "PLY"));
    }
    if (!EqualsIgnoringCase(line, "ASCII")) {
      return cursor_.DamagedLine(
          absl::StrCat("expected ASCII or BINARY, found ", Quoted(line)));
    }
    return absl::OkStatus();
  }

  absl::Status ScanSection(const std::string& keyword) {
    if (keyword == "DATASET") {
      MAPSIEVE_ASSIGN_OR_RETURN(const std::string kind, Word("the dataset"));
      if (kind == "POLYDATA" || kind == "UNSTRUCTURED_GRID") {
        return absl::OkStatus();
      }
      return absl::UnimplementedError(
          absl::StrCat(cursor_.file().name(), ": the dataset ", Quoted(kind),
                       " is not read; POLYDATA and UNSTRUCTURED_GRID are"));
    }
    if (keyword == "POINTS") return ScanPoints();
    if (keyword == "VERTICES" || keyword == "LINES" || keyword == "POLYGONS" ||
        keyword == "TRIANGLE_STRIPS" || keyword == "CELLS") {
      return ScanCells();
    }
    if (keyword == "CELL_TYPES") {
      MAPSIEVE_ASSIGN_OR_RETURN(const int64_t count, Count("CELL_TYPES"));
      return SkipNumbers(count, 1, "CELL_TYPES");
    }
    if (keyword == "METADATA") return SkipParagraph();
    if (keyword == "POINT_DATA" || keyword == "CELL_DATA") {
      MAPSIEVE_ASSIGN_OR_RETURN(tuple_count_, Count(keyword));
      of_points_ = keyword == "POINT_DATA";
      if (of_points_ && (!contents_.positions.has_value() ||
                         tuple_count_ != contents_.point_count)) {
        return cursor_.DamagedLine(absl::StrCat(
            "POINT_DATA of ", tuple_count_, " points; expected ",
            contents_.point_count, ", the number of POINTS before it"));
      }
      return absl::OkStatus();
    }
    if (keyword == "FIELD") return ScanField();
    return ScanArray(keyword);
  }

  absl::Status ScanPoints() {
    if (contents_.positions.has_value()) {
      return cursor_.DamagedLine("a second section POINTS; expected one");
    }
    MAPSIEVE_ASSIGN_OR_RETURN(contents_.point_count, Count("POINTS"));
    MAPSIEVE_ASSIGN_OR_RETURN(const std::string type, Word("type of POINTS"));
    if (!TypeOf(type).has_value()) {
      return cursor_.DamagedLine(
          absl::StrCat("POINTS: expected a type, found ", Quoted(type)));
    }
    // Text holds no rounding to float: all of its digits count.
    MAPSIEVE_ASSIGN_OR_RETURN(contents_.positions,
                              Begin(ScalarType::kFloat64, {"x", "y", "z"}));
    return SkipNumbers(contents_.point_count, 3, "POINTS");
  }

  absl::Status ScanCells() {
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t count, Count("cells"));
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, Count("cells"));
    MAPSIEVE_ASSIGN_OR_RETURN(const bool more, Next());
    if (!more || token_ != "OFFSETS") {
      PutBack(more);
      return SkipNumbers(size, 1, "cells");
    }
    // The layout of version 5: two arrays with a type each.
    MAPSIEVE_RETURN_IF_ERROR(Word("type of OFFSETS").status());
    MAPSIEVE_RETURN_IF_ERROR(SkipNumbers(count, 1, "OFFSETS"));
    MAPSIEVE_ASSIGN_OR_RETURN(const std::string keyword, Word("CONNECTIVITY"));
    if (keyword != "CONNECTIVITY") {
      return cursor_.DamagedLine(
          absl::StrCat("expected CONNECTIVITY, found ", Quoted(keyword)));
    }
    MAPSIEVE_RETURN_IF_ERROR(Word("type of CONNECTIVITY").status());
    return SkipNumbers(size, 1, "CONNECTIVITY");
  }

  absl::Status ScanField() {
    MAPSIEVE_RETURN_IF_ERROR(Word("name of FIELD").status());
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t count, Count("FIELD"));
    for (int64_t i = 0; i < count; ++i) {
      MAPSIEVE_ASSIGN_OR_RETURN(std::string name, Word("name of an array"));
      // An array's metadata may lie between the arrays.
      if (name == "METADATA") {
        MAPSIEVE_RETURN_IF_ERROR(SkipParagraph());
        MAPSIEVE_ASSIGN_OR_RETURN(name, Word("name of an array"));
      }
      MAPSIEVE_ASSIGN_OR_RETURN(const int64_t components, Count(Quoted(name)));
      MAPSIEVE_ASSIGN_OR_RETURN(const int64_t tuples, Count(Quoted(name)));
      MAPSIEVE_ASSIGN_OR_RETURN(const std::string type, Word("type"));
      if (of_points_ && tuples != tuple_count_) {
        return cursor_.DamagedLine(absl::StrCat(
            "array ", Quoted(name), ": expected a value for each of ",
            tuple_count_, " points, found ", tuples));
      }
      MAPSIEVE_RETURN_IF_ERROR(
          ScanValues("FIELD", name, type, components, tuples));
    }
    return absl::OkStatus();
  }

  // A section of POINT_DATA or CELL_DATA.
  absl::Status ScanArray(const std::string& keyword) {
    static constexpr std::array<std::pair<std::string_view, int>, 9> kArrays = {
        {{"SCALARS", 1},
         {"VECTORS", 3},
         {"NORMALS", 3},
         {"TENSORS", 9},
         {"TENSORS6", 6},
         {"GLOBAL_IDS", 1},
         {"PEDIGREE_IDS", 1},
         {"EDGE_FLAGS", 1},
         {"TEXTURE_COORDINATES", 0}}};
    const bool is_colour = keyword == "COLOR_SCALARS";
    const bool is_table = keyword == "LOOKUP_TABLE";
    const auto known =
        std::find_if(kArrays.begin(), kArrays.end(),
                     [&](const auto& array) { return array.first == keyword; });
    if (known == kArrays.end() && !is_colour && !is_table) {
      return cursor_.DamagedLine(
          absl::StrCat("expected a section, found ", Quoted(keyword),
                       "; the section before it may have more numbers than "
                       "it declares"));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const std::string name, Word("name of an array"));
    if (is_table) {
      MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, Count("LOOKUP_TABLE"));
      return SkipNumbers(size, 4, "LOOKUP_TABLE");
    }
    if (is_colour) {
      MAPSIEVE_ASSIGN_OR_RETURN(const int64_t components, Count(Quoted(name)));
      return ScanValues(keyword, name, "float", components, tuple_count_);
    }
    int64_t components = known->second;
    if (components == 0) {
      MAPSIEVE_ASSIGN_OR_RETURN(components, Count(Quoted(name)));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const std::string type, Word("type"));
    if (keyword == "SCALARS") {
      std::string_view rest;
      MAPSIEVE_RETURN_IF_ERROR(NextLine(rest, "SCALARS"));
      rest = TrimBlanks(rest);
      if (!rest.empty() && !ParseNumber(rest, components)) {
        return cursor_.DamagedLine(absl::StrCat(
            "SCALARS: expected a number of components, found ", Quoted(rest)));
      }
      MAPSIEVE_ASSIGN_OR_RETURN(const bool more, Next());
      if (more && token_ == "LOOKUP_TABLE") {
        MAPSIEVE_RETURN_IF_ERROR(Word("name of LOOKUP_TABLE").status());
      } else {
        PutBack(more);
      }
    }
    return ScanValues(keyword, name, type, components, tuple_count_);
  }

  absl::Status ScanValues(std::string_view keyword, const std::string& raw_name,
                          const std::string& type_name, int64_t components,
                          int64_t tuples) {
    const std::string name = CleanText(raw_name, '_');
    if (components < 1 || components > static_cast<int64_t>(kMaxAttributes)) {
      return cursor_.DamagedLine(
          absl::StrCat("array ", Quoted(name), ": expected 1 to ",
                       kMaxAttributes, " components, found ", components));
    }
    const std::optional<ScalarType> type = TypeOf(type_name);
    if (!type.has_value()) {
      return absl::UnimplementedError(
          absl::StrCat(cursor_.file().name(), ", line ", cursor_.line_number(),
                       ": array ", Quoted(name), " of type ", Quoted(type_name),
                       " is not read; leave it out"));
    }
    if (of_points_) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          Section section,
          Begin(*type, ComponentNames(keyword, name, components)));
      value_count_ += section.names.size();
      if (value_count_ > kMaxAttributes) {
        return cursor_.DamagedLine(absl::StrCat(
            "more than ", kMaxAttributes, " values a point; leave some out"));
      }
      contents_.arrays.push_back(std::move(section));
    }
    return SkipNumbers(tuples, components, Quoted(name));
  }

  // A section whose first number is the next word.
  absl::StatusOr<Section> Begin(ScalarType type,
                                std::vector<std::string> names) {
    Section section{.type = type, .names = std::move(names)};
    MAPSIEVE_ASSIGN_OR_RETURN(const bool more, Next());
    section.offset =
        cursor_.offset() - (more ? static_cast<int64_t>(token_.size()) : 0);
    section.line = cursor_.line_number();
    PutBack(more);
    return section;
  }

  absl::Status SkipNumbers(int64_t count, int64_t components,
                           std::string_view what) {
    // A number takes at least two bytes, so this many are not there.
    if (count > cursor_.file().size() / components) {
      return cursor_.DamagedLine(
          absl::StrCat(ToAbsl(what), ": declares ", count, " times ",
                       components, " numbers, more than the file has bytes"));
    }
    for (int64_t i = 0; i < count * components; ++i) {
      MAPSIEVE_ASSIGN_OR_RETURN(const bool more, Next());
      if (more && LooksLikeNumber(token_)) continue;
      return cursor_.DamagedLine(
          absl::StrCat(ToAbsl(what), ": expected ", count * components,
                       " numbers, found ", i,
                       more ? absl::StrCat(" and then ", Quoted(token_))
                            : " and the end of the file"));
    }
    return absl::OkStatus();
  }

  static bool LooksLikeNumber(std::string_view token) {
    const char c = token.front();
    return (c >= '0' && c <= '9') || c == '-' || c == '+' || c == '.' ||
           EqualsIgnoringCase(token.substr(0, 3), "nan") ||
           EqualsIgnoringCase(token.substr(0, 3), "inf");
  }

  // Passes over all up to the next empty line.
  absl::Status SkipParagraph() {
    std::string_view line;
    MAPSIEVE_RETURN_IF_ERROR(NextLine(line, "METADATA"));
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(const bool more, cursor_.NextLine(line));
      if (!more || TrimBlanks(line).empty()) return absl::OkStatus();
    }
  }

  absl::Status NextLine(std::string_view& line, const char* what) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool more, cursor_.NextLine(line));
    if (more) return absl::OkStatus();
    return cursor_.DamagedLine(absl::StrCat("the file ends; expected ", what));
  }

  absl::StatusOr<std::string> Word(std::string_view what) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool more, Next());
    if (more) return std::string(token_);
    return cursor_.DamagedLine(
        absl::StrCat("the file ends; expected ", ToAbsl(what)));
  }

  absl::StatusOr<int64_t> Count(std::string_view what) {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::string word, Word(what));
    int64_t count = 0;
    if (ParseNumber(word, count) && count >= 0) return count;
    return cursor_.DamagedLine(
        absl::StrCat(ToAbsl(what), ": expected a count, found ", Quoted(word)));
  }

  // The next word into token_, or again the one put back.
  absl::StatusOr<bool> Next() {
    if (put_back_) {
      put_back_ = false;
      return true;
    }
    return cursor_.NextToken(token_);
  }
  void PutBack(bool there_is_one) { put_back_ = there_is_one; }

  static constexpr size_t kMaxVersionBytes = 16;

  InputCursor cursor_;
  std::string_view token_;
  bool put_back_ = false;
  Contents contents_;
  int64_t tuple_count_ = 0;
  bool of_points_ = false;
  size_t value_count_ = 0;
};

class VtkReader : public PointReader {
 public:
  VtkReader(const std::shared_ptr<const InputFile>& file, Contents contents)
      : contents_(std::move(contents)) {
    info_.format = absl::StrCat("VTK ", contents_.version, " ASCII");
    info_.point_count = contents_.point_count;
    cursors_.reserve(contents_.arrays.size() + 1);
    AddCursor(file, *contents_.positions);
    for (const Section& array : contents_.arrays) {
      AddCursor(file, array);
      for (const std::string& name : array.names) {
        info_.attributes.push_back({name, array.type});
      }
    }
  }

  const PointFileInfo& info() const override { return info_; }

  absl::StatusOr<core::PointCloud> ReadBatch(size_t max_points) override {
    const size_t size = static_cast<size_t>(std::min<uint64_t>(
        max_points, static_cast<uint64_t>(contents_.point_count - done_)));
    core::PointCloud batch;
    batch.positions.resize(size);
    for (core::Point3& p : batch.positions) {
      for (double* coordinate : {&p.x, &p.y, &p.z}) {
        MAPSIEVE_RETURN_IF_ERROR(
            ReadNumber(cursors_[0], ScalarType::kFloat64,
                       reinterpret_cast<std::byte*>(coordinate)));
      }
    }
    std::vector<Column>& columns = batch.attributes.columns();
    columns.reserve(info_.attributes.size());
    for (size_t i = 0; i < contents_.arrays.size(); ++i) {
      const Section& array = contents_.arrays[i];
      const size_t first = columns.size();
      for (const std::string& name : array.names) {
        columns.emplace_back(core::ColumnSpec{name, array.type}, size);
      }
      const size_t width = core::ScalarSize(array.type);
      for (size_t row = 0; row < size; ++row) {
        for (size_t k = first; k < columns.size(); ++k) {
          MAPSIEVE_RETURN_IF_ERROR(
              ReadNumber(cursors_[i + 1], array.type,
                         columns[k].mutable_bytes().data() + row * width));
        }
      }
    }
    done_ += static_cast<int64_t>(size);
    return batch;
  }

 private:
  void AddCursor(const std::shared_ptr<const InputFile>& file,
                 const Section& section) {
    InputCursor& cursor =
        cursors_.emplace_back(file, section.offset, kCursorBytes);
    cursor.StartAtLine(section.line);
  }

  static absl::Status ReadNumber(InputCursor& cursor, ScalarType type,
                                 std::byte* value) {
    std::string_view token;
    MAPSIEVE_ASSIGN_OR_RETURN(const bool more, cursor.NextToken(token));
    if (more && ParseScalar(type, token, value)) return absl::OkStatus();
    return cursor.DamagedLine(absl::StrCat(
        "expected a number of type ", ToAbsl(core::ScalarTypeName(type)),
        ", found ", more ? Quoted(token) : "the end of the file"));
  }

  Contents contents_;
  PointFileInfo info_;
  std::vector<InputCursor> cursors_;
  int64_t done_ = 0;
};

}  // namespace

absl::StatusOr<std::unique_ptr<PointReader>> OpenVtkFile(
    const std::filesystem::path& path) {
  MAPSIEVE_ASSIGN_OR_RETURN(auto file, InputFile::Open(path));
  MAPSIEVE_ASSIGN_OR_RETURN(Contents contents, Scanner(file).Scan());
  auto reader = std::make_unique<VtkReader>(file, std::move(contents));
  MAPSIEVE_RETURN_IF_ERROR(
      CheckAttributes(file->name(), reader->info().attributes));
  return reader;
}

}  // namespace mapsieve::client
