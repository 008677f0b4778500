#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "client/lab/colormap.h"
#include "client/lab/image.h"
#include "client/lab/legend.h"
#include "client/lab/splat_buffer.h"
#include "client/lab/text.h"
#include "client/lab/view_sample.h"
#include "tests/lab/picture_test_util.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

using ::testing::HasSubstr;
using testing::StatusIs;

constexpr Color kBlack{0, 0, 0};
constexpr Color kRed{200, 0, 0};
constexpr Color kGrey{128, 128, 128};

// Lightness of CIE 1976 in [0, 100].
double Lightness(Color color) {
  const auto linear = [](uint8_t channel) {
    const double x = channel / 255.0;
    return x <= 0.04045 ? x / 12.92 : std::pow((x + 0.055) / 1.055, 2.4);
  };
  const double luminance = 0.2126 * linear(color.red) +
                           0.7152 * linear(color.green) +
                           0.0722 * linear(color.blue);
  return luminance > 0.008856 ? 116 * std::cbrt(luminance) - 16
                              : 903.3 * luminance;
}

TEST(Image, CutsOffWhatIsOutside) {
  Image image(10, 5, kBlack);
  image.FillRect(-3, -3, 5, 5, kRed);
  image.FillRect(8, 4, 100, 100, kRed);
  image.FillDisc(-100, -100, 3, kRed);
  image.Blend(10, 0, kRed, 1);
  EXPECT_EQ(CountPixels(image, kRed), 2 * 2 + 2 * 1);
}

TEST(Image, BlendsByCoverage) {
  Image image(3, 1, kBlack);
  image.Blend(0, 0, kRed, 0);
  image.Blend(1, 0, kRed, 0.5);
  image.Blend(2, 0, kRed, 7);
  EXPECT_EQ(image.At(0, 0), kBlack);
  EXPECT_EQ(image.At(1, 0), (Color{100, 0, 0}));
  EXPECT_EQ(image.At(2, 0), kRed);
}

TEST(ScaleColor, RisesEvenlyInLightness) {
  const double first = Lightness(ScaleColor(0));
  const double last = Lightness(ScaleColor(1));
  EXPECT_LT(first, 45);
  EXPECT_GT(last, 85);
  for (int i = 0; i < 20; ++i) {
    const double step =
        Lightness(ScaleColor((i + 1) / 20.0)) - Lightness(ScaleColor(i / 20.0));
    EXPECT_NEAR(step, (last - first) / 20, 1.0) << i;
  }
}

TEST(ScaleColor, TakesAnyNumber) {
  const double infinity = std::numeric_limits<double>::infinity();
  EXPECT_EQ(ScaleColor(-infinity), ScaleColor(0));
  EXPECT_EQ(ScaleColor(infinity), ScaleColor(1));
  EXPECT_EQ(ScaleColor(std::numeric_limits<double>::quiet_NaN()),
            kNoValueColor);
}

TEST(LabelColor, TellsLabelsApart) {
  // Curves among surfaces stand out without colour vision.
  EXPECT_GT(Lightness(LabelColor(core::Label::kCurve)) -
                Lightness(LabelColor(core::Label::kSurface)),
            20);
  EXPECT_NE(LabelColor(core::Label::kJunction),
            LabelColor(core::Label::kSurface));
  for (const int other : {0, 4, 255}) {
    EXPECT_EQ(LabelColor(static_cast<core::Label>(other)), kNoValueColor);
  }
}

TEST(Font, DrawsWhatItMeasures) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Font font, Font::Open(""));
  Image image(300, 60, kBlack);
  font.Draw("HHHHH", 40, 20, 50, kRed, image);
  const PixelBox ink = InkBox(image);
  EXPECT_NEAR(ink.width(), font.Width("HHHHH", 40), 10);
  EXPECT_NEAR(ink.left, 20, 6);
  EXPECT_EQ(ink.bottom, 50);
  // Capitals of DejaVu Sans are 0.73 em high.
  EXPECT_NEAR(ink.height(), 29, 2);
  EXPECT_DOUBLE_EQ(font.Width("", 40), 0);
  EXPECT_NEAR(font.Width("HH", 40), 2 * font.Width("H", 40), 1e-9);
}

TEST(Font, TakesUtf8AndAnyOtherBytes) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Font font, Font::Open(""));
  EXPECT_NEAR(font.Width("µ", 40), 26, 3);
  EXPECT_GT(font.Width("\xff", 40), 0);
  EXPECT_EQ(font.Width("\xe2\x82", 40), font.Width("\xff\xff", 40));
  Image image(50, 50, kBlack);
  font.Draw("\xff\xc3(\xf0\x9f\x98", 40, -500, 1e3, kRed, image);
}

TEST(Font, ShortensWhatDoesNotFit) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Font font, Font::Open(""));
  EXPECT_EQ(font.Fit("short", 10, 1000), "short");
  const double width = font.Width("écol…", 10);
  EXPECT_EQ(font.Fit("école", 10, font.Width("école", 10)), "école");
  EXPECT_EQ(font.Fit("écolecole", 10, width), "écol…");
  EXPECT_EQ(font.Fit("ééé", 10, font.Width("é…", 10)), "é…");
  EXPECT_EQ(font.Fit("anything", 10, 0), "");
}

TEST(Font, RefusesOtherFiles) {
  EXPECT_THAT(Font::Open("/nowhere/no.ttf"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("no.ttf")));
  EXPECT_THAT(
      Font::Open("/dev/null"),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("/dev/null")));
}

TEST(FormatCount, GroupsThousands) {
  EXPECT_EQ(FormatCount(0), "0");
  EXPECT_EQ(FormatCount(999), "999");
  EXPECT_EQ(FormatCount(1000), "1,000");
  EXPECT_EQ(FormatCount(4650123), "4,650,123");
}

TEST(ChooseScaleBar, PicksTheLongestRoundLength) {
  EXPECT_DOUBLE_EQ(ChooseScaleBar(10, 99).length, 5);
  EXPECT_DOUBLE_EQ(ChooseScaleBar(10, 100).length, 10);
  EXPECT_DOUBLE_EQ(ChooseScaleBar(10, 210).length, 20);
  EXPECT_DOUBLE_EQ(ChooseScaleBar(10, 210).pixels, 200);
  EXPECT_DOUBLE_EQ(ChooseScaleBar(1000, 90).length, 0.05);
}

TEST(DrawLegend, LeavesOutWhatDoesNotFit) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Font font, Font::Open(""));
  const CaptionStyle style{.em = 15, .text = kGrey, .muted = kGrey};
  Legend legend;
  legend.entries = {{"first", kRed}, {"second", {0, 200, 0}}};
  legend.scale = {"height", 0, 10};
  for (const double right : {0.0, 60.0, 160.0, 800.0}) {
    Image image(800, 30, kBlack);
    DrawLegend(legend, font, style, 0, right, 15, image);
    EXPECT_LE(InkBox(image).right, right + 1);
    EXPECT_EQ(CountPixels(image, kRed) > 0, right >= 60);
    EXPECT_EQ(CountPixels(image, {0, 200, 0}) > 0, right >= 160);
    EXPECT_EQ(CountPixels(image, ScaleColor(0)) > 0, right >= 800);
  }
}

TEST(SplatBuffer, KeepsTheNearestSplatInEitherOrder) {
  for (const bool near_first : {true, false}) {
    SplatBuffer buffer(9, 9, 4, 90);
    if (near_first) buffer.Splat(4.5, 4.5, 1, kRed);
    buffer.Splat(4.5, 4.5, 2, kGrey);
    if (!near_first) buffer.Splat(4.5, 4.5, 1, kRed);
    Image image(9, 9, kBlack);
    buffer.Resolve(1, 0, 0, image);
    EXPECT_EQ(image.At(4, 4), kRed);
    EXPECT_EQ(CountPixels(image, kGrey), 0);
  }
}

TEST(SplatBuffer, DrawsRoundSplatsAndCutsThemOffAtTheEdge) {
  Image image(20, 20, kBlack);
  SplatBuffer buffer(20, 20, 10, 90);
  buffer.Splat(10, 10, 0, kRed);
  buffer.Splat(std::nan(""), 10, 0, kGrey);
  buffer.Splat(1e300, -1e300, 0, kGrey);
  buffer.Resolve(0, 0, 0, image);
  const int full = CountPixels(image, kRed);
  EXPECT_NEAR(full, 3.14159 * 25, 20);
  EXPECT_EQ(image.At(5, 5), kBlack) << "a corner of the square is inside";

  Image half(20, 20, kBlack);
  SplatBuffer edge(20, 20, 10, 90);
  edge.Splat(0, 10, 0, kRed);
  edge.Resolve(0, 0, 0, half);
  EXPECT_NEAR(CountPixels(half, kRed), full / 2.0, 8);
}

// Brightness at column `x` of a level floor beside a block that is `height`
// pixels higher and begins at column 20, seen from above.
int FloorBrightness(double height, double shading, int x) {
  SplatBuffer buffer(40, 40, 2, 90);
  for (int row = 0; row < 40; ++row) {
    for (int column = 0; column < 40; ++column) {
      buffer.Splat(column + 0.5, row + 0.5, column < 20 ? height : 0, kGrey);
    }
  }
  Image image(40, 40, kBlack);
  buffer.Resolve(shading, 0, 0, image);
  return image.At(x, 20).red;
}

TEST(SplatBuffer, DarkensTheFootOfAStep) {
  EXPECT_LT(FloorBrightness(20, 1, 18), 100);
  EXPECT_EQ(FloorBrightness(20, 1, 5), kGrey.red);
  EXPECT_EQ(FloorBrightness(20, 1, 30), kGrey.red);
  EXPECT_EQ(FloorBrightness(20, 0, 18), kGrey.red);
  EXPECT_LT(FloorBrightness(20, 2, 18), FloorBrightness(20, 1, 18));
}

TEST(SplatBuffer, LeavesLevelGroundBrightInAnObliqueView) {
  const double elevation = 30;
  const double depth_per_row = std::sqrt(3);  // 1 / tan(30 degrees)
  SplatBuffer buffer(40, 40, 2, elevation);
  for (int row = 0; row < 40; ++row) {
    for (int column = 0; column < 40; ++column) {
      buffer.Splat(column + 0.5, row + 0.5, (40 - row) * depth_per_row, kGrey);
    }
  }
  Image image(40, 40, kBlack);
  buffer.Resolve(1, 0, 0, image);
  EXPECT_NEAR(image.At(20, 20).red, kGrey.red, 3);
}

TEST(RobustRange, CutsOffAFewFarValuesOnly) {
  std::vector<double> values;
  for (int i = 0; i <= 1000; ++i) values.push_back(i);
  EXPECT_EQ(RobustRange(values), (Range{0, 1000}));
  values.push_back(1e9);
  values.push_back(-1e9);
  EXPECT_EQ(RobustRange(values), (Range{0, 1000}));
  // What is near is kept, however thin it is.
  values.push_back(1400);
  EXPECT_EQ(RobustRange(values), (Range{0, 1400}));
  // The four highest of a thousand are too few to matter, a tenth is not, nor
  // is one of three.
  values.insert(values.end(), 3, 1e9);
  EXPECT_EQ(RobustRange(values), (Range{0, 1400}));
  values.insert(values.end(), 110, 1e9);
  EXPECT_EQ(RobustRange(values).max, 1e9);
  std::vector<double> three = {0, 1, 1e6};
  EXPECT_EQ(RobustRange(three), (Range{0, 1e6}));
  std::vector<double> twenty(20, 1);
  twenty[7] = 1e6;
  EXPECT_EQ(RobustRange(twenty), (Range{1, 1}));
  std::vector<double> one = {5};
  EXPECT_EQ(RobustRange(one), (Range{5, 5}));
}

TEST(TrimmedRange, LeavesOutTheGivenFraction) {
  std::vector<double> values;
  for (int i = 99; i >= 0; --i) values.push_back(i);
  EXPECT_EQ(TrimmedRange(values, 0), (Range{0, 99}));
  EXPECT_EQ(TrimmedRange(values, 0.02), (Range{2, 97}));
}

TEST(ViewSample, KeepsAFairShareOfManyPoints) {
  ViewSample sample(1000);
  for (int i = 0; i < 100000; ++i) sample.Add({i / 1e5, i % 64 / 64.0, 0});
  EXPECT_EQ(sample.point_count(), 100000);
  const auto& points = sample.points();
  EXPECT_LE(points.size(), 1000u);
  EXPECT_GE(points.size(), 400u);
  double mean_u = 0;
  double mean_v = 0;
  for (const ViewPoint& point : points) {
    mean_u += point.u / static_cast<double>(points.size());
    mean_v += point.v / static_cast<double>(points.size());
  }
  EXPECT_NEAR(mean_u, 0.5, 0.05);
  EXPECT_NEAR(mean_v, 0.5, 0.05) << "the share follows a period of the stream";
}

TEST(ViewSample, KeepsAllOfFewPointsInOrder) {
  ViewSample sample(1000);
  for (int i = 0; i < 1000; ++i) sample.Add({1.0 * i, 0, 0});
  ASSERT_EQ(sample.points().size(), 1000u);
  for (size_t i = 0; i < 1000; ++i) {
    ASSERT_EQ(sample.points()[i].u, static_cast<double>(i));
  }
}

TEST(ViewSample, MeasuresTheAreaThatPointsCover) {
  ViewSample sample(100000);
  for (int i = 0; i < 100; ++i) {
    for (int k = 0; k < 100; ++k) sample.Add({i / 100.0, k / 100.0, 0});
  }
  EXPECT_NEAR(sample.CoveredArea({0, 1}, {0, 1}), 1, 0.05);
  EXPECT_NEAR(sample.CoveredArea({0, 2}, {0, 4}), 1, 0.3);
  EXPECT_NEAR(sample.CoveredArea({0, 0.5}, {0, 1}), 0.5, 0.05);
  EXPECT_EQ(sample.CoveredArea({0, 0}, {0, 1}), 0);
  EXPECT_GT(sample.CoveredArea({0, 1e-9}, {0, 1}), 0);
}

}  // namespace
}  // namespace mapsieve::client
