#ifndef MAPSIEVE_CLIENT_FORMATS_TEXT_NUMBERS_H_
#define MAPSIEVE_CLIENT_FORMATS_TEXT_NUMBERS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "core/cloud/column.h"

/// Numbers and words of text formats; the locale plays no part. All functions
/// are thread-safe.
namespace mapsieve::client {

/// Space, tab, CR, LF, vertical tab or form feed.
constexpr bool IsBlank(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

/// `text` without blanks at both ends.
std::string_view TrimBlanks(std::string_view text);

/// Takes the next word from the front of `rest`; empty if none is left.
std::string_view TakeWord(std::string_view& rest);

/// ASCII letters in lower case.
std::string ToLower(std::string_view text);

/// Whether both are the same but for the case of ASCII letters.
bool EqualsIgnoringCase(std::string_view a, std::string_view b);

/// `text` in double quotes for a message: what is not printable escaped, what
/// is long cut.
std::string Quoted(std::string_view text);

/// Parses all of `text` as a decimal number of type T: an optional sign, then
/// digits; floating point takes fractions, exponents, "nan" and "inf" in any
/// case, and gives the nearest value, 0 where the magnitude is too small.
/// Integers take "3.0" and "1e3" too, when the value is whole. False, and
/// `value` untouched, if it is anything else or does not fit T.
template <typename T>
bool ParseNumber(std::string_view text, T& value);

/// Parses `text` as `type` into ScalarSize(type) bytes at `value`.
bool ParseScalar(core::ScalarType type, std::string_view text,
                 std::byte* value);

/// Appends the shortest text that reads back as the same number; "nan", "inf".
template <typename T>
void AppendNumber(std::string& text, T value);

/// The text that AppendNumber appends, for messages.
std::string NumberText(double value);

/// Appends row `row` of `column` by AppendNumber.
void AppendScalar(std::string& text, const core::Column& column, size_t row);

/// Appends `value` with exactly `decimals` (0 to 20) digits after the point.
void AppendFixed(std::string& text, double value, int decimals);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_TEXT_NUMBERS_H_
