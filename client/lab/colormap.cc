#include "client/lab/colormap.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace mapsieve::client {
namespace {

// By number.
constexpr std::array<Color, core::kLabelCount> kLabelColors = {
    kNoValueColor,
    Color{250, 90, 40},
    Color{255, 214, 80},
    Color{76, 148, 212},
};

// Okabe and Ito's palette, its black replaced by a light grey.
constexpr std::array<Color, kCategoryColorCount> kCategoryColors = {
    Color{86, 180, 233},  Color{230, 159, 0},   Color{0, 158, 115},
    Color{204, 121, 167}, Color{240, 228, 66},  Color{0, 114, 178},
    Color{213, 94, 0},    Color{200, 200, 200},
};

uint8_t Encode(double linear) {
  const double x = std::clamp(linear, 0.0, 1.0);
  const double encoded =
      x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
  return static_cast<uint8_t>(std::lround(255 * encoded));
}

// From the OKLab space in polar form; hue in degrees.
Color FromOklch(double lightness, double chroma, double hue) {
  const double radians = hue * std::numbers::pi / 180;
  const double a = chroma * std::cos(radians);
  const double b = chroma * std::sin(radians);
  const double l = lightness + 0.3963377774 * a + 0.2158037573 * b;
  const double m = lightness - 0.1055613458 * a - 0.0638541728 * b;
  const double s = lightness - 0.0894841775 * a - 1.2914855480 * b;
  const double l3 = l * l * l;
  const double m3 = m * m * m;
  const double s3 = s * s * s;
  return {Encode(4.0767416621 * l3 - 3.3077115913 * m3 + 0.2309699292 * s3),
          Encode(-1.2684380046 * l3 + 2.6097574011 * m3 - 0.3413193965 * s3),
          Encode(-0.0041960863 * l3 - 0.7034186147 * m3 + 1.7076147010 * s3)};
}

constexpr size_t kScaleSteps = 256;

std::array<Color, kScaleSteps> MakeScale() {
  std::array<Color, kScaleSteps> scale;
  for (size_t i = 0; i < kScaleSteps; ++i) {
    const double t = static_cast<double>(i) / (kScaleSteps - 1);
    // Chroma stays inside the sRGB gamut, which is narrow around teal.
    scale[i] = FromOklch(0.47 + 0.46 * t, 0.10 + 0.05 * t * t, 285 - 180 * t);
  }
  return scale;
}

}  // namespace

Color LabelColor(core::Label label) {
  const auto number = static_cast<size_t>(label);
  return number < kLabelColors.size() ? kLabelColors[number] : kNoValueColor;
}

Color CategoryColor(size_t index) {
  return kCategoryColors[index % kCategoryColorCount];
}

Color ScaleColor(double t) {
  static const std::array<Color, kScaleSteps> kScale = MakeScale();
  if (std::isnan(t)) return kNoValueColor;
  return kScale[static_cast<size_t>(
      std::lround(std::clamp(t, 0.0, 1.0) * (kScaleSteps - 1)))];
}

}  // namespace mapsieve::client
