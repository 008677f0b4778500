#include "storage/names.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace mapsieve::storage {
namespace {

constexpr size_t kMaxIdBytes = 63;
constexpr size_t kMaxQuotedBytes = 80;

bool IsLetter(char c) { return c >= 'a' && c <= 'z'; }
bool IsDigit(char c) { return c >= '0' && c <= '9'; }

bool IsSegment(std::string_view id) {
  return !id.empty() && id.size() <= kMaxIdBytes && id.front() != '-' &&
         id.back() != '-' && std::all_of(id.begin(), id.end(), [](char c) {
           return IsLetter(c) || IsDigit(c) || c == '-';
         });
}

}  // namespace

absl::Status CheckMapId(std::string_view id) {
  if (IsSegment(id) && IsLetter(id.front())) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      "map id ", Quoted(id), ": expected 1 to ", kMaxIdBytes,
      " of a-z, 0-9 and -, beginning with a letter, not ending with -"));
}

absl::Status CheckResourceId(std::string_view id) {
  if (IsSegment(id)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("id ", Quoted(id), ": expected 1 to ", kMaxIdBytes,
                   " of a-z, 0-9 and -, not beginning or ending with -"));
}

bool IsHexId(std::string_view text) {
  return text.size() == 32 && std::all_of(text.begin(), text.end(), [](char c) {
           return IsDigit(c) || (c >= 'a' && c <= 'f');
         });
}

std::string Quoted(std::string_view text) {
  std::string result = "\"";
  for (const char c : text.substr(0, kMaxQuotedBytes)) {
    result += static_cast<unsigned char>(c) < 0x20 || c == 0x7f ? '?' : c;
  }
  result += text.size() > kMaxQuotedBytes ? "…\"" : "\"";
  return result;
}

}  // namespace mapsieve::storage
