#include "client/formats/csv_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/formats/batch_columns.h"
#include "client/formats/file_input.h"
#include "client/formats/output_file.h"
#include "client/formats/text_numbers.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

using core::Column;
using core::ColumnSpec;
using core::ScalarType;

constexpr char kBlanks = ' ';
constexpr size_t kMaxColumns = kMaxAttributes + 3;

bool IsComment(std::string_view line) {
  return line.starts_with('#') || line.starts_with("//");
}

// Splits a line into fields without blanks around them. `separator` kBlanks
// stands for any run of blanks. Stops beyond kMaxColumns.
void Split(std::string_view line, char separator,
           std::vector<std::string_view>& fields) {
  fields.clear();
  if (separator == kBlanks) {
    while (fields.size() <= kMaxColumns) {
      const std::string_view word = TakeWord(line);
      if (word.empty()) return;
      fields.push_back(word);
    }
    return;
  }
  while (fields.size() <= kMaxColumns) {
    const size_t end = line.find(separator);
    fields.push_back(TrimBlanks(line.substr(0, end)));
    if (end == std::string_view::npos) return;
    line.remove_prefix(end + 1);
  }
}

char DetectSeparator(std::string_view line) {
  for (const char separator : {';', ','}) {
    if (line.find(separator) != std::string_view::npos) return separator;
  }
  if (line.find('\t') == std::string_view::npos) return kBlanks;
  // Tabs among other blanks only align the columns.
  std::vector<std::string_view> fields;
  Split(line, '\t', fields);
  const bool aligned =
      std::any_of(fields.begin(), fields.end(), [](std::string_view field) {
        return std::any_of(field.begin(), field.end(), IsBlank);
      });
  return aligned ? kBlanks : '\t';
}

bool IsNumberOrEmpty(std::string_view field) {
  double value = 0;
  return field.empty() || ParseNumber(field, value);
}

// Without the quotes that spreadsheets put around names.
std::string_view Unquoted(std::string_view name) {
  if (name.size() >= 2 && name.front() == '"' && name.back() == '"') {
    name = name.substr(1, name.size() - 2);
  }
  return name;
}

struct Columns {
  std::array<size_t, 3> position{};
  std::vector<ColumnSpec> attributes;
  // By column: the attribute, or nothing for x, y, z.
  std::vector<std::optional<size_t>> attribute_of;
};

absl::StatusOr<Columns> NameColumns(const std::string& file_name,
                                    const std::vector<std::string>& names) {
  std::string listed;
  for (const std::string& name : names) {
    if (listed.size() > 100) {
      absl::StrAppend(&listed, ", …");
      break;
    }
    absl::StrAppend(&listed, listed.empty() ? "" : ", ", name);
  }
  Columns columns;
  columns.attribute_of.resize(names.size());
  std::array<bool, 3> found{};
  for (size_t i = 0; i < names.size(); ++i) {
    const std::string lower = ToLower(names[i]);
    if (lower.size() == 1 && lower[0] >= 'x' && lower[0] <= 'z') {
      const auto axis = static_cast<size_t>(lower[0] - 'x');
      if (found[axis]) {
        return absl::InvalidArgumentError(absl::StrCat(
            file_name, ": two columns are named \"", lower, "\"; rename one"));
      }
      found[axis] = true;
      columns.position[axis] = i;
      continue;
    }
    columns.attribute_of[i] = columns.attributes.size();
    columns.attributes.push_back(
        {names[i].empty() ? absl::StrCat("c", i) : names[i],
         ScalarType::kFloat64});
  }
  for (size_t axis = 0; axis < 3; ++axis) {
    if (found[axis]) continue;
    return absl::InvalidArgumentError(absl::StrCat(
        file_name, ": no column is named \"", std::string(1, "xyz"[axis]),
        "\" among ", listed, "; rename the columns or give their names"));
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckAttributes(file_name, columns.attributes));
  return columns;
}

class CsvReader : public PointReader {
 public:
  CsvReader(InputCursor cursor, char separator, Columns columns)
      : cursor_(std::move(cursor)),
        separator_(separator),
        columns_(std::move(columns)) {
    info_.format = separator == kBlanks ? "XYZ text" : "CSV text";
    info_.attributes = columns_.attributes;
  }

  const PointFileInfo& info() const override { return info_; }

  absl::StatusOr<core::PointCloud> ReadBatch(size_t max_points) override {
    constexpr size_t kFirstRows = 4096;
    core::PointCloud batch;
    std::vector<Column>& columns = batch.attributes.columns();
    for (const ColumnSpec& spec : info_.attributes) columns.emplace_back(spec);
    size_t size = 0;
    while (size < max_points) {
      std::string_view line;
      MAPSIEVE_ASSIGN_OR_RETURN(const bool more, cursor_.NextLine(line));
      if (!more) break;
      line = TrimBlanks(line);
      if (line.empty() || IsComment(line)) continue;
      if (size == batch.positions.size()) {
        const size_t rows =
            std::min(max_points, std::max(kFirstRows, 2 * size));
        batch.positions.resize(rows);
        for (Column& column : columns) column.Resize(rows);
      }
      MAPSIEVE_RETURN_IF_ERROR(ParseLine(line, size, batch));
      ++size;
    }
    batch.positions.resize(size);
    for (Column& column : columns) column.Resize(size);
    return batch;
  }

 private:
  absl::Status ParseLine(std::string_view line, size_t row,
                         core::PointCloud& batch) {
    Split(line, separator_, fields_);
    const size_t expected = columns_.attribute_of.size();
    if (fields_.size() == expected + 1 && fields_.back().empty()) {
      fields_.pop_back();
    }
    if (fields_.size() != expected) {
      return cursor_.DamagedLine(absl::StrCat(
          "expected ", expected, " columns, found ", fields_.size()));
    }
    for (size_t i = 0; i < expected; ++i) {
      double value = std::numeric_limits<double>::quiet_NaN();
      if (!fields_[i].empty() && !ParseNumber(fields_[i], value)) {
        return cursor_.DamagedLine(absl::StrCat("column ", i + 1,
                                                ": expected a number, found ",
                                                Quoted(fields_[i])));
      }
      if (!columns_.attribute_of[i].has_value()) {
        core::Point3& p = batch.positions[row];
        (i == columns_.position[0]   ? p.x
         : i == columns_.position[1] ? p.y
                                     : p.z) = value;
        continue;
      }
      Column& column = batch.attributes.columns()[*columns_.attribute_of[i]];
      if (std::isnan(value)) {
        column.SetMissing(row);
      } else {
        column.Set(row, value);
      }
    }
    return absl::OkStatus();
  }

  InputCursor cursor_;
  char separator_;
  Columns columns_;
  PointFileInfo info_;
  std::vector<std::string_view> fields_;
};

// What the lines before the points tell.
struct Beginning {
  // Where the points begin: offset and number of their first line.
  int64_t offset = 0;
  int64_t line = 1;
  char separator = kBlanks;
  std::vector<std::string> names;
};

std::vector<std::string> CleanNames(
    const std::vector<std::string_view>& names) {
  std::vector<std::string> clean;
  for (const std::string_view name : names) {
    clean.push_back(CleanText(Unquoted(name), '_'));
  }
  return clean;
}

// The names in a comment, if it names x, y, z.
std::vector<std::string> NamesInComment(std::string_view comment,
                                        char separator) {
  while (comment.starts_with('#') || comment.starts_with('/')) {
    comment.remove_prefix(1);
  }
  std::vector<std::string_view> fields;
  Split(comment, separator, fields);
  for (const std::string_view axis : {"x", "y", "z"}) {
    if (std::none_of(fields.begin(), fields.end(), [&](auto field) {
          return EqualsIgnoringCase(Unquoted(field), axis);
        })) {
      return {};
    }
  }
  return CleanNames(fields);
}

absl::StatusOr<Beginning> ReadBeginning(
    const std::shared_ptr<const InputFile>& file, const ReadOptions& options) {
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
  InputCursor cursor(file);
  MAPSIEVE_ASSIGN_OR_RETURN(const auto mark,
                            cursor.Peek(kByteOrderMark.size()));
  if (std::string_view(reinterpret_cast<const char*>(mark.data()),
                       mark.size()) == kByteOrderMark) {
    MAPSIEVE_RETURN_IF_ERROR(
        cursor.Skip(static_cast<int64_t>(mark.size()), "byte order mark"));
  }
  Beginning beginning;
  std::string comment;
  while (true) {
    beginning.offset = cursor.offset();
    std::string_view line;
    MAPSIEVE_ASSIGN_OR_RETURN(const bool more, cursor.NextLine(line));
    if (!more) {
      for (const char separator : {kBlanks, ';', ',', '\t'}) {
        beginning.separator = separator;
        beginning.names = NamesInComment(comment, separator);
        if (!beginning.names.empty()) return beginning;
      }
      return absl::DataLossError(absl::StrCat(
          file->name(), ": expected lines of x y z, found none but comments"));
    }
    line = TrimBlanks(line);
    if (line.empty()) continue;
    if (IsComment(line)) {
      comment = line;
      continue;
    }
    beginning.separator = DetectSeparator(line);
    beginning.line = cursor.line_number();
    std::vector<std::string_view> fields;
    Split(line, beginning.separator, fields);
    if (fields.size() > 3 && fields.back().empty()) fields.pop_back();
    if (fields.size() < 3) {
      return absl::InvalidArgumentError(
          absl::StrCat(file->name(), ", line ", beginning.line,
                       ": expected at least three columns, x, y, z, found ",
                       fields.size(), ": ", Quoted(line)));
    }
    const bool is_header =
        !std::all_of(fields.begin(), fields.end(), IsNumberOrEmpty);
    if (is_header) {
      beginning.offset = cursor.offset();
      ++beginning.line;
    }
    if (!options.column_names.empty()) {
      beginning.names = options.column_names;
      if (beginning.names.size() != fields.size()) {
        return absl::InvalidArgumentError(absl::StrCat(
            file->name(), ": ", beginning.names.size(),
            " column names are given, line ", cursor.line_number(), " has ",
            fields.size(), " columns; give one name a column"));
      }
      return beginning;
    }
    if (is_header) {
      beginning.names = CleanNames(fields);
      return beginning;
    }
    beginning.names = NamesInComment(comment, beginning.separator);
    if (beginning.names.size() != fields.size()) {
      beginning.names.clear();
      for (size_t i = 0; i < fields.size(); ++i) {
        beginning.names.push_back(i < 3 ? std::string(1, "xyz"[i])
                                        : absl::StrCat("c", i));
      }
    }
    return beginning;
  }
}

// How many decimals write every multiple of `step` exactly; -1 if 15 do not.
int DecimalsOf(double step) {
  double scaled = step;
  for (int decimals = 0; decimals <= 15 && step > 0; ++decimals) {
    const double whole = std::nearbyint(scaled);
    if (whole >= 1 && std::abs(scaled - whole) < 1e-6) return decimals;
    scaled *= 10;
  }
  return -1;
}

class CsvWriter : public PointWriter {
 public:
  CsvWriter(std::unique_ptr<OutputFile> file, const WriteOptions& options,
            char separator)
      : file_(std::move(file)),
        attributes_(options.attributes),
        decimals_(DecimalsOf(options.coordinate_step)),
        separator_(separator) {}

  absl::Status WriteHeader(const std::vector<std::string>& names) {
    text_ = separator_ == kBlanks ? "# " : "";
    for (const char* axis : {"x", "y", "z"}) AppendField(axis);
    for (const std::string& name : names) AppendField(name);
    return FlushLine();
  }

  absl::Status Write(const core::PointCloud& batch) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto columns,
                              MatchColumns(file_->name(), attributes_, batch));
    for (size_t row = 0; row < batch.size(); ++row) {
      const core::Point3& p = batch.positions[row];
      for (const double coordinate : {p.x, p.y, p.z}) {
        AppendSeparator();
        if (decimals_ < 0) {
          AppendNumber(text_, coordinate);
        } else {
          AppendFixed(text_, coordinate, decimals_);
        }
      }
      for (const Column* column : columns) {
        AppendSeparator();
        if (!column->IsMissing(row)) {
          AppendScalar(text_, *column, row);
        } else if (separator_ == kBlanks) {
          text_ += "nan";
        }
      }
      MAPSIEVE_RETURN_IF_ERROR(FlushLine());
    }
    return absl::OkStatus();
  }

  absl::Status Finish() override { return file_->Finish(); }

 private:
  void AppendSeparator() {
    if (!at_line_begin_) text_ += separator_;
    at_line_begin_ = false;
  }
  void AppendField(std::string_view field) {
    AppendSeparator();
    text_ += field;
  }
  absl::Status FlushLine() {
    text_ += '\n';
    MAPSIEVE_RETURN_IF_ERROR(file_->Append(text_));
    text_.clear();
    at_line_begin_ = true;
    return absl::OkStatus();
  }

  std::unique_ptr<OutputFile> file_;
  std::vector<ColumnSpec> attributes_;
  int decimals_;
  char separator_;
  std::string text_;
  bool at_line_begin_ = true;
};

}  // namespace

absl::StatusOr<std::unique_ptr<PointReader>> OpenCsvFile(
    const std::filesystem::path& path, const ReadOptions& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(auto file, InputFile::Open(path));
  MAPSIEVE_ASSIGN_OR_RETURN(const Beginning beginning,
                            ReadBeginning(file, options));
  MAPSIEVE_ASSIGN_OR_RETURN(Columns columns,
                            NameColumns(file->name(), beginning.names));
  InputCursor cursor(std::move(file), beginning.offset);
  cursor.StartAtLine(beginning.line);
  return std::make_unique<CsvReader>(std::move(cursor), beginning.separator,
                                     std::move(columns));
}

absl::StatusOr<std::unique_ptr<PointWriter>> CreateCsvFile(
    const std::filesystem::path& path, const WriteOptions& options) {
  const std::string name = path.string();
  if (!std::isfinite(options.coordinate_step) || options.coordinate_step < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat(name, ": expected a coordinate step of 0 or more, got ",
                     NumberText(options.coordinate_step)));
  }
  const char separator =
      EqualsIgnoringCase(path.extension().string(), ".csv") ? ',' : kBlanks;
  std::vector<ColumnSpec> written = options.attributes;
  std::vector<std::string> names;
  for (ColumnSpec& attribute : written) {
    for (char& c : attribute.name) {
      // Quotes would be taken off where the file is read.
      const bool separates =
          separator == kBlanks
              ? IsBlank(c)
              : c == ',' || c == ';' || c == '\t' || c == '\n' || c == '\r';
      if (separates || c == '"') c = '_';
    }
    names.push_back(attribute.name);
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckAttributes(name, written));
  for (const std::string& written_name : names) {
    for (const std::string_view axis : {"x", "y", "z"}) {
      if (!EqualsIgnoringCase(written_name, axis)) continue;
      return absl::InvalidArgumentError(
          absl::StrCat(name, ": an attribute is named \"", written_name,
                       "\", which is the position in this format; rename it"));
    }
  }
  MAPSIEVE_ASSIGN_OR_RETURN(auto file, OutputFile::Create(path));
  auto writer =
      std::make_unique<CsvWriter>(std::move(file), options, separator);
  MAPSIEVE_RETURN_IF_ERROR(writer->WriteHeader(names));
  return writer;
}

}  // namespace mapsieve::client
