#include "client/formats/text_numbers.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <system_error>
#include <type_traits>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

char LowerChar(char c) {
  return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
}

// Whether a number out of range is too small, not too large. Nothing near 1 is
// out of range, so the exponent's sign tells, or the lack of an integer part.
bool IsTooSmall(std::string_view text) {
  const size_t exponent = text.find_first_of("eE");
  if (exponent != std::string_view::npos) {
    return text.substr(exponent + 1).starts_with('-');
  }
  return text.find_first_of("123456789") > text.find('.');
}

template <typename T>
bool ParseFloating(std::string_view text, T& value) {
  T parsed{};
  const char* end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, parsed);
  if (stop != end) return false;
  if (error == std::errc::result_out_of_range) {
    if (!IsTooSmall(text)) return false;
    parsed = text.front() == '-' ? T{-0.0} : T{0};
  } else if (error != std::errc{}) {
    return false;
  }
  value = parsed;
  return true;
}

}  // namespace

std::string_view TrimBlanks(std::string_view text) {
  while (!text.empty() && IsBlank(text.front())) text.remove_prefix(1);
  while (!text.empty() && IsBlank(text.back())) text.remove_suffix(1);
  return text;
}

std::string_view TakeWord(std::string_view& rest) {
  size_t begin = 0;
  while (begin < rest.size() && IsBlank(rest[begin])) ++begin;
  size_t end = begin;
  while (end < rest.size() && !IsBlank(rest[end])) ++end;
  const std::string_view word = rest.substr(begin, end - begin);
  rest.remove_prefix(end);
  return word;
}

std::string ToLower(std::string_view text) {
  std::string lower(text);
  for (char& c : lower) c = LowerChar(c);
  return lower;
}

bool EqualsIgnoringCase(std::string_view a, std::string_view b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](char x, char y) {
    return LowerChar(x) == LowerChar(y);
  });
}

std::string Quoted(std::string_view text) {
  constexpr size_t kShown = 40;
  const std::string_view shown = text.substr(0, kShown);
  return absl::StrCat("\"", absl::CHexEscape(ToAbsl(shown)),
                      shown.size() < text.size() ? "…\"" : "\"");
}

template <typename T>
bool ParseNumber(std::string_view text, T& value) {
  if (text.size() > 1 && text.front() == '+' && text[1] != '-') {
    text.remove_prefix(1);
  }
  if constexpr (std::is_floating_point_v<T>) {
    return !text.empty() && ParseFloating(text, value);
  } else {
    const char* end = text.data() + text.size();
    T parsed{};
    const auto [stop, error] = std::from_chars(text.data(), end, parsed);
    if (stop == end && error == std::errc{}) {
      value = parsed;
      return true;
    }
    // Only what looks like floating point may still be a whole number.
    if (text.find_first_of(".eE") == std::string_view::npos) return false;
    double real = 0;
    if (!ParseFloating(text, real)) return false;
    // 2^digits is exact, while the largest value may not be.
    const double limit = std::ldexp(1.0, std::numeric_limits<T>::digits);
    const double low = std::is_signed_v<T> ? -limit : 0.0;
    if (!(real >= low && real < limit) || real != std::floor(real)) {
      return false;
    }
    value = static_cast<T>(real);
    return true;
  }
}

template <typename T>
void AppendNumber(std::string& text, T value) {
  if constexpr (std::is_floating_point_v<T>) {
    if (std::isnan(value)) {
      text += "nan";
      return;
    }
  }
  std::array<char, 32> digits{};
  const auto result =
      std::to_chars(digits.data(), digits.data() + digits.size(), value);
  text.append(digits.data(), result.ptr);
}

#define MAPSIEVE_INSTANTIATE(T)                            \
  template bool ParseNumber<T>(std::string_view text, T&); \
  template void AppendNumber<T>(std::string & text, T)
MAPSIEVE_INSTANTIATE(int8_t);
MAPSIEVE_INSTANTIATE(uint8_t);
MAPSIEVE_INSTANTIATE(int16_t);
MAPSIEVE_INSTANTIATE(uint16_t);
MAPSIEVE_INSTANTIATE(int32_t);
MAPSIEVE_INSTANTIATE(uint32_t);
MAPSIEVE_INSTANTIATE(int64_t);
MAPSIEVE_INSTANTIATE(uint64_t);
MAPSIEVE_INSTANTIATE(float);
MAPSIEVE_INSTANTIATE(double);
#undef MAPSIEVE_INSTANTIATE

bool ParseScalar(core::ScalarType type, std::string_view text,
                 std::byte* value) {
  return core::VisitScalarType(type, [&](auto zero) {
    auto parsed = zero;
    if (!ParseNumber(text, parsed)) return false;
    std::memcpy(value, &parsed, sizeof(parsed));
    return true;
  });
}

std::string NumberText(double value) {
  std::string text;
  AppendNumber(text, value);
  return text;
}

void AppendScalar(std::string& text, const core::Column& column, size_t row) {
  core::VisitScalarType(column.type(), [&](auto zero) {
    AppendNumber(text, column.Get<decltype(zero)>(row));
  });
}

void AppendFixed(std::string& text, double value, int decimals) {
  if (!std::isfinite(value)) {
    AppendNumber(text, value);
    return;
  }
  // The largest double has 309 digits before the point.
  std::array<char, 336> digits{};
  const auto result =
      std::to_chars(digits.data(), digits.data() + digits.size(), value,
                    std::chars_format::fixed, decimals);
  text.append(digits.data(), result.ptr);
}

}  // namespace mapsieve::client
