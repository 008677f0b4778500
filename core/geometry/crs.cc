#include "core/geometry/crs.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>
#include <vector>

namespace mapsieve::core {
namespace {

constexpr bool IsBlank(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

void SkipBlanks(std::string_view& rest) {
  while (!rest.empty() && IsBlank(rest.front())) rest.remove_prefix(1);
}

/// KEYWORD[value, …, CHILD[…], …].
struct WktNode {
  /// In upper case.
  std::string keyword;
  /// Texts without their quotes, and numbers.
  std::vector<std::string> values;
  std::vector<WktNode> children;

  bool Is(std::initializer_list<std::string_view> keywords) const {
    return std::find(keywords.begin(), keywords.end(), keyword) !=
           keywords.end();
  }
};

/// Takes a text in double quotes, in which two of them stand for one.
std::optional<std::string> TakeQuoted(std::string_view& rest) {
  std::string text;
  rest.remove_prefix(1);
  while (true) {
    const size_t end = rest.find('"');
    if (end == std::string_view::npos) return std::nullopt;
    text += rest.substr(0, end);
    rest.remove_prefix(end + 1);
    if (rest.empty() || rest.front() != '"') return text;
    text += '"';
    rest.remove_prefix(1);
  }
}

/// Takes what stands before a blank, a comma or a bracket.
std::string TakeBare(std::string_view& rest) {
  const auto* end = std::find_if(rest.begin(), rest.end(), [](char c) {
    return IsBlank(c) ||
           std::string_view(",[]()\"").find(c) != std::string_view::npos;
  });
  std::string word(rest.begin(), end);
  rest.remove_prefix(word.size());
  return word;
}

/// Takes the values and children after an opening bracket, and the closing one.
/// `depth`: brackets that may still open.
bool TakeParts(std::string_view& rest, int depth, WktNode& node) {
  while (true) {
    SkipBlanks(rest);
    if (rest.empty()) return false;
    if (rest.front() == '"') {
      std::optional<std::string> text = TakeQuoted(rest);
      if (!text.has_value()) return false;
      node.values.push_back(*std::move(text));
    } else {
      std::string word = TakeBare(rest);
      SkipBlanks(rest);
      if (!rest.empty() && (rest.front() == '[' || rest.front() == '(')) {
        if (depth == 0) return false;
        rest.remove_prefix(1);
        std::transform(word.begin(), word.end(), word.begin(), [](char c) {
          return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
        });
        WktNode& child = node.children.emplace_back();
        child.keyword = std::move(word);
        if (!TakeParts(rest, depth - 1, child)) return false;
      } else {
        node.values.push_back(std::move(word));
      }
    }
    SkipBlanks(rest);
    if (rest.empty()) return false;
    const char end = rest.front();
    rest.remove_prefix(1);
    if (end == ']' || end == ')') return true;
    if (end != ',') return false;
  }
}

/// The node of a whole WKT; nothing if it is none.
std::optional<WktNode> ParseWkt(std::string_view text) {
  constexpr int kMaxDepth = 32;
  // Its only part is the node.
  const std::string list = std::string(text) + ']';
  std::string_view rest = list;
  WktNode root;
  if (!TakeParts(rest, kMaxDepth, root) || !rest.empty() ||
      !root.values.empty() || root.children.size() != 1) {
    return std::nullopt;
  }
  return std::move(root.children.front());
}

/// The system of the horizontal coordinates.
const WktNode& Horizontal(const WktNode& crs) {
  if (!crs.Is({"COMPD_CS", "COMPOUNDCRS", "BOUNDCRS", "SOURCECRS"}) ||
      crs.children.empty()) {
    return crs;
  }
  return Horizontal(crs.children.front());
}

/// A code at the start of `text`, which it takes; 0: there is none.
int TakeCode(std::string_view& text) {
  constexpr int kUserDefined = 32767;
  int code = 0;
  const auto [end, error] =
      std::from_chars(text.data(), text.data() + text.size(), code);
  if (error != std::errc()) return 0;
  text.remove_prefix(static_cast<size_t>(end - text.data()));
  return code > 0 && code < kUserDefined ? code : 0;
}

struct EpsgCodes {
  int horizontal = 0;
  int vertical = 0;
};

/// Those of "EPSG:n" and "EPSG:n+m"; none of any other text.
EpsgCodes ParseCodes(std::string_view text) {
  constexpr std::string_view kPrefix = "EPSG:";
  if (!text.starts_with(kPrefix)) return {};
  text.remove_prefix(kPrefix.size());
  EpsgCodes codes = {.horizontal = TakeCode(text), .vertical = 0};
  if (text.starts_with('+')) {
    text.remove_prefix(1);
    codes.vertical = TakeCode(text);
    if (codes.vertical == 0) return {};
  }
  return text.empty() && codes.horizontal != 0 ? codes : EpsgCodes();
}

/// The EPSG code that a system bears; 0: none.
int CodeOfNode(const WktNode& system) {
  for (const WktNode& child : system.children) {
    if (child.Is({"AUTHORITY", "ID"}) && child.values.size() > 1) {
      return ParseCodes(child.values[0] + ":" + child.values[1]).horizontal;
    }
  }
  return 0;
}

std::optional<double> NumberOf(const std::string& text) {
  double value = 0;
  const auto [end, error] =
      std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) {
    return std::nullopt;
  }
  return value;
}

/// The unit of `node` itself, or else of its first axis.
const WktNode* FindUnit(const WktNode& node) {
  for (const WktNode& child : node.children) {
    if (child.Is({"UNIT", "LENGTHUNIT", "ANGLEUNIT"}) &&
        !child.values.empty()) {
      return &child;
    }
  }
  for (const WktNode& child : node.children) {
    if (child.Is({"AXIS"})) return FindUnit(child);
  }
  return nullptr;
}

std::string NameOfUnit(const WktNode& unit, bool is_angle) {
  struct Known {
    std::string_view name;
    bool is_angle;
    /// In metres or radians.
    double size;
  };
  static constexpr Known kKnown[] = {{kMetre, false, 1},
                                     {kFoot, false, 0.3048},
                                     {kUsSurveyFoot, false, 1200.0 / 3937},
                                     {kDegree, true, 0.017453292519943295}};
  // The two feet differ by 2e-6.
  constexpr double kTolerance = 1e-7;
  const std::optional<double> size =
      unit.values.size() > 1 ? NumberOf(unit.values[1]) : std::nullopt;
  for (const Known& known : kKnown) {
    if (size.has_value() && known.is_angle == is_angle &&
        std::abs(*size - known.size) <= kTolerance * known.size) {
      return std::string(known.name);
    }
  }
  return unit.values.front();
}

}  // namespace

int ParseEpsgName(std::string_view text) { return ParseCodes(text).horizontal; }

int EpsgCodeOf(std::string_view crs) {
  const std::optional<WktNode> root = ParseWkt(crs);
  return root.has_value() ? CodeOfNode(Horizontal(*root)) : ParseEpsgName(crs);
}

int VerticalEpsgCodeOf(std::string_view crs) {
  const std::optional<WktNode> root = ParseWkt(crs);
  if (!root.has_value()) return ParseCodes(crs).vertical;
  if (!root->Is({"COMPD_CS", "COMPOUNDCRS"})) return 0;
  for (const WktNode& part : root->children) {
    if (part.Is({"VERT_CS", "VERTCRS", "VERTICALCRS"})) return CodeOfNode(part);
  }
  return 0;
}

std::string UnitOfCrs(std::string_view crs) {
  const std::optional<WktNode> root = ParseWkt(crs);
  if (!root.has_value()) return "";
  const WktNode& system = Horizontal(*root);
  const bool is_geographic = system.Is(
      {"GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS"});
  const WktNode* unit = FindUnit(system);
  // Those of geographic systems that leave it out are degrees.
  if (unit == nullptr) {
    return std::string(is_geographic ? kDegree : std::string_view());
  }
  return NameOfUnit(*unit, is_geographic && !unit->Is({"LENGTHUNIT"}));
}

std::string NameOfCrs(std::string_view crs) {
  const std::optional<WktNode> root = ParseWkt(crs);
  return root.has_value() && !root->values.empty() ? root->values.front()
                                                   : std::string(crs);
}

bool IsSameCrs(std::string_view a, std::string_view b) {
  const int code = EpsgCodeOf(a);
  const int other = EpsgCodeOf(b);
  if (code != 0 && other != 0) {
    const int heights = VerticalEpsgCodeOf(a);
    const int other_heights = VerticalEpsgCodeOf(b);
    return code == other &&
           (heights == 0 || other_heights == 0 || heights == other_heights);
  }
  const auto compact = [](std::string_view text) {
    std::string result;
    bool is_quoted = false;
    for (const char c : text) {
      if (c == '"') is_quoted = !is_quoted;
      if (is_quoted || !IsBlank(c)) result += c;
    }
    return result;
  };
  return compact(a) == compact(b);
}

}  // namespace mapsieve::core
