#ifndef MAPSIEVE_CLIENT_LAB_LEGEND_H_
#define MAPSIEVE_CLIENT_LAB_LEGEND_H_

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "client/lab/image.h"
#include "client/lab/text.h"

namespace mapsieve::client {

/// How captions look.
struct CaptionStyle {
  /// Size of the text, in pixels of the em.
  double em = 18;
  Color text;
  /// For what matters less: counts, lines.
  Color muted;
};

/// "1,234,567" of a number >= 0.
std::string FormatCount(int64_t count);

/// What the colours of a picture mean.
struct Legend {
  struct Entry {
    std::string name;
    Color color;
  };
  /// A colour scale from `min` to `max`.
  struct Scale {
    std::string name;
    double min = 0;
    double max = 0;
  };
  std::vector<Entry> entries;
  std::optional<Scale> scale;
};

/// Draws `legend` as one line from `left` to at most `right`, centred on the
/// row `middle`; entries that do not fit are left out, from the end.
void DrawLegend(const Legend& legend, const Font& font,
                const CaptionStyle& style, double left, double right,
                double middle, Image& image);

/// A bar that stands for a round length.
struct ScaleBar {
  /// Map units: 1, 2 or 5 times a power of ten.
  double length = 0;
  double pixels = 0;
};

/// The longest bar of at most `max_pixels` at `pixels_per_unit` (> 0).
ScaleBar ChooseScaleBar(double pixels_per_unit, double max_pixels);

/// Draws `bar` and its length in `unit`, ending at `right`, centred on the row
/// `middle`; returns the pixel column where it begins.
double DrawScaleBar(const ScaleBar& bar, std::string_view unit,
                    const Font& font, const CaptionStyle& style, double right,
                    double middle, Image& image);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_LEGEND_H_
