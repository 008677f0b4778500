#include "client/lab/legend.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/lab/colormap.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

constexpr double kColorBarEms = 12;
// From the middle of a line of text to its baseline.
constexpr double kBaselineEms = 0.36;

// As many decimals as tell 1 % of the scale apart.
std::string FormatValue(double value, double range) {
  const double digits = std::ceil(-std::log10(range / 100));
  if (!(digits < 12 && std::abs(value) < 1e9)) {
    return absl::StrFormat("%.4g", value);
  }
  const int decimals = static_cast<int>(std::clamp(digits, 0.0, 9.0));
  return absl::StrFormat("%.*f", decimals, value);
}

}  // namespace

std::string FormatCount(int64_t count) {
  const std::string digits = std::to_string(count);
  std::string text;
  for (size_t i = 0; i < digits.size(); ++i) {
    if (i > 0 && (digits.size() - i) % 3 == 0) text += ',';
    text += digits[i];
  }
  return text;
}

void DrawLegend(const Legend& legend, const Font& font,
                const CaptionStyle& style, double left, double right,
                double middle, Image& image) {
  const double em = style.em;
  const double baseline = middle + kBaselineEms * em;
  const double radius = 0.38 * em;
  double x = left;
  for (const Legend::Entry& entry : legend.entries) {
    const double text_x = x + 2 * radius + 0.45 * em;
    const double end = text_x + font.Width(entry.name, em);
    if (end > right) return;
    image.FillDisc(x + radius, middle, radius, entry.color);
    font.Draw(entry.name, em, text_x, baseline, style.text, image);
    x = end + 1.2 * em;
  }
  if (!legend.scale.has_value()) return;

  const Legend::Scale& scale = *legend.scale;
  const double range = scale.max - scale.min;
  const std::string min = FormatValue(scale.min, range);
  const std::string max = FormatValue(scale.max, range);
  const double gap = 0.5 * em;
  const double min_x = x + font.Width(scale.name, em) + em;
  const double bar_x = min_x + font.Width(min, em) + gap;
  const double max_x = bar_x + kColorBarEms * em + gap;
  if (max_x + font.Width(max, em) > right) return;
  font.Draw(scale.name, em, x, baseline, style.text, image);
  font.Draw(min, em, min_x, baseline, style.muted, image);
  font.Draw(max, em, max_x, baseline, style.muted, image);
  const int bar_width = static_cast<int>(kColorBarEms * em);
  const int bar_height = static_cast<int>(0.6 * em);
  for (int i = 0; i < bar_width; ++i) {
    image.FillRect(static_cast<int>(bar_x) + i,
                   static_cast<int>(middle) - bar_height / 2, 1, bar_height,
                   ScaleColor(double{1} * i / (bar_width - 1)));
  }
}

ScaleBar ChooseScaleBar(double pixels_per_unit, double max_pixels) {
  const double longest = max_pixels / pixels_per_unit;
  const double decade = std::pow(10, std::floor(std::log10(longest)));
  const double factor = longest >= 5 * decade   ? 5
                        : longest >= 2 * decade ? 2
                                                : 1;
  return {factor * decade, factor * decade * pixels_per_unit};
}

double DrawScaleBar(const ScaleBar& bar, std::string_view unit,
                    const Font& font, const CaptionStyle& style, double right,
                    double middle, Image& image) {
  const double em = style.em;
  const std::string text =
      absl::StrCat(absl::StrFormat("%.10g", bar.length), " ", ToAbsl(unit));
  const double text_x = right - font.Width(text, em);
  font.Draw(text, em, text_x, middle + kBaselineEms * em, style.text, image);

  const int thickness = std::max(static_cast<int>(em / 9), 1);
  const int tick = static_cast<int>(0.6 * em);
  const int length = static_cast<int>(std::lround(bar.pixels));
  const int left = static_cast<int>(text_x - 0.5 * em) - length;
  const int row = static_cast<int>(middle);
  image.FillRect(left, row - thickness / 2, length, thickness, style.text);
  for (const int x : {left, left + length - thickness}) {
    image.FillRect(x, row - tick / 2, thickness, tick, style.text);
  }
  return left;
}

}  // namespace mapsieve::client
