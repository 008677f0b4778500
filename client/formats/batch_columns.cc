#include "client/formats/batch_columns.h"

#include <string>
#include <unordered_set>

#include "absl/strings/str_cat.h"
#include "client/formats/text_numbers.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

// Bytes of the UTF-8 sequence that `text` (not empty) begins with; 0 if it
// begins with none.
size_t Utf8Length(std::string_view text) {
  const auto byte = [&](size_t i) {
    return i < text.size() ? static_cast<unsigned char>(text[i]) : 0U;
  };
  const unsigned first = byte(0);
  if (first < 0x80) return 1;
  const size_t length = first >= 0xF0 ? 4 : first >= 0xE0 ? 3 : 2;
  if (first < 0xC2 || first > 0xF4) return 0;
  for (size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xC0U) != 0x80) return 0;
  }
  // Longer than needed, a surrogate, or beyond the last code point.
  if ((first == 0xE0 && byte(1) < 0xA0) || (first == 0xED && byte(1) > 0x9F) ||
      (first == 0xF0 && byte(1) < 0x90) || (first == 0xF4 && byte(1) > 0x8F)) {
    return 0;
  }
  return length;
}

bool IsUtf8(std::string_view text) {
  while (!text.empty()) {
    const size_t length = Utf8Length(text);
    if (length == 0) return false;
    text.remove_prefix(length);
  }
  return true;
}

}  // namespace

std::string CleanText(std::string_view text, char substitute) {
  const bool is_utf8 = IsUtf8(text);
  std::string clean(TrimBlanks(text));
  for (char& c : clean) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte < 0x20 || byte == 0x7F || (byte >= 0x80 && !is_utf8)) {
      c = substitute;
    }
  }
  return clean;
}

absl::Status CheckAttributes(std::string_view file_name,
                             const std::vector<core::ColumnSpec>& attributes) {
  if (attributes.size() > kMaxAttributes) {
    return absl::InvalidArgumentError(
        absl::StrCat(ToAbsl(file_name), ": has ", attributes.size(),
                     " attributes; at most ", kMaxAttributes, " are handled"));
  }
  std::unordered_set<std::string> names = {"x", "y", "z"};
  for (const core::ColumnSpec& attribute : attributes) {
    if (attribute.name.empty()) {
      return absl::InvalidArgumentError(absl::StrCat(
          ToAbsl(file_name), ": an attribute has no name; give it one"));
    }
    if (attribute.name.size() > kMaxNameBytes) {
      return absl::InvalidArgumentError(absl::StrCat(
          ToAbsl(file_name), ": the column name ", Quoted(attribute.name),
          " has ", attribute.name.size(), " bytes; at most ", kMaxNameBytes,
          " are handled: shorten it"));
    }
    if (!names.insert(attribute.name).second) {
      return absl::InvalidArgumentError(
          absl::StrCat(ToAbsl(file_name), ": two columns are named \"",
                       attribute.name, "\"; rename one"));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<const core::Column*>> MatchColumns(
    std::string_view file_name, const std::vector<core::ColumnSpec>& attributes,
    const core::PointCloud& batch) {
  const auto refuse = [&](const std::string& what) {
    return absl::InvalidArgumentError(
        absl::StrCat(ToAbsl(file_name), ": the batch ", what));
  };
  std::vector<const core::Column*> columns;
  columns.reserve(attributes.size());
  for (const core::ColumnSpec& attribute : attributes) {
    const core::Column* column = batch.attributes.Find(attribute.name);
    if (column == nullptr) {
      return refuse(
          absl::StrCat("lacks the attribute \"", attribute.name, "\""));
    }
    if (column->type() != attribute.type) {
      return refuse(absl::StrCat("has \"", attribute.name, "\" as ",
                                 ToAbsl(core::ScalarTypeName(column->type())),
                                 "; expected ",
                                 ToAbsl(core::ScalarTypeName(attribute.type))));
    }
    if (column->size() != batch.size()) {
      return refuse(absl::StrCat("has ", column->size(), " values of \"",
                                 attribute.name, "\" for ", batch.size(),
                                 " points"));
    }
    columns.push_back(column);
  }
  if (batch.attributes.columns().size() != attributes.size()) {
    return refuse(absl::StrCat("has ", batch.attributes.columns().size(),
                               " attributes; expected ", attributes.size()));
  }
  return columns;
}

}  // namespace mapsieve::client
