#include "client/lab/render.h"

#include <png.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "client/formats/point_file.h"
#include "client/lab/colormap.h"
#include "core/cloud/label.h"
#include "tests/lab/picture_test_util.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

using core::Label;
using core::Point3;
using core::PointCloud;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using testing::StatusIs;

RenderOptions Plain(int width = 200, int height = 200) {
  RenderOptions options;
  options.width = width;
  options.height = height;
  options.captions = false;
  return options;
}

absl::StatusOr<Image> Render(const std::vector<PointCloud>& panels,
                             const RenderOptions& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      Renderer renderer,
      Renderer::Create(options, std::vector<std::string>(panels.size())));
  for (size_t i = 0; i < panels.size(); ++i) {
    MAPSIEVE_RETURN_IF_ERROR(renderer.Observe(panels[i], i));
  }
  for (size_t i = 0; i < panels.size(); ++i) {
    MAPSIEVE_RETURN_IF_ERROR(renderer.Draw(panels[i], i));
  }
  return renderer.Compose();
}

// Points at the corners of a square: none south-west, junction south-east,
// curve north-west, surface north-east.
PointCloud Corners() {
  return MakeCloud<uint8_t>({{0, 0, 0}, {10, 0, 0}, {0, 10, 0}, {10, 10, 0}},
                            "label", {0, 1, 2, 3});
}

// `count` points on a square of 10 units, heights 0 to 1.
PointCloud RandomSquare(int count) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(0, 1);
  PointCloud cloud;
  for (int i = 0; i < count; ++i) {
    cloud.positions.push_back(
        {10 * uniform(random), 10 * uniform(random), uniform(random)});
  }
  return cloud;
}

// A folder of its own for each test, removed at the end.
class RenderFileTest : public ::testing::Test {
 protected:
  RenderFileTest()
      : folder_(std::filesystem::temp_directory_path() /
                ("mapsieve_render_test_" + std::to_string(getpid()))) {
    std::filesystem::create_directories(folder_);
  }
  ~RenderFileTest() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path folder_;
};

TEST(Renderer, DrawsLabelsInTheirColorsWithNorthUp) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image,
                                Render({Corners()}, Plain()));
  EXPECT_EQ(InkColor(image, {0, 100, 100, 200}), LabelColor(Label::kNone));
  EXPECT_EQ(InkColor(image, {100, 100, 200, 200}),
            LabelColor(Label::kJunction));
  EXPECT_EQ(InkColor(image, {0, 0, 100, 100}), LabelColor(Label::kCurve));
  EXPECT_EQ(InkColor(image, {100, 0, 200, 100}), LabelColor(Label::kSurface));
}

TEST(Renderer, ColorsByHeightWhereThereIsNoGeometricLabel) {
  PointCloud cloud = RandomSquare(100);
  for (Point3& p : cloud.positions) p.z = p.x < 5 ? 100 : 200;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Image image, Render({cloud}, Plain()));
  EXPECT_GT(CountPixels(image, ScaleColor(0)), 100);
  EXPECT_GT(CountPixels(image, ScaleColor(1)), 100);
  // A label of another type is an attribute like others.
  const std::vector<float> labels(cloud.size(), 3);
  cloud = MakeCloud<float>(cloud.positions, "label", labels);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(image, Render({cloud}, Plain()));
  EXPECT_EQ(CountPixels(image, LabelColor(Label::kSurface)), 0);
  EXPECT_GT(CountPixels(image, ScaleColor(1)), 100);
}

TEST(Renderer, ColorsByHeightOnRequestDespiteALabel) {
  RenderOptions options = Plain();
  options.color_by = "height";
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image,
                                Render({Corners()}, options));
  EXPECT_EQ(InkColor(image, {100, 0, 200, 100}), ScaleColor(0.5));
}

TEST(Renderer, GivesFewWholeNumbersOneColorEach) {
  RenderOptions options = Plain();
  options.color_by = "kind";
  const PointCloud cloud =
      MakeCloud<int16_t>({{0, 0, 0}, {10, 0, 0}, {0, 10, 0}, {10, 10, 0}},
                         "kind", {-7, 300, 5, 300});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image, Render({cloud}, options));
  EXPECT_EQ(InkColor(image, {0, 100, 100, 200}), CategoryColor(0));
  EXPECT_EQ(InkColor(image, {0, 0, 100, 100}), CategoryColor(1));
  EXPECT_EQ(InkColor(image, {100, 100, 200, 200}), CategoryColor(2));
  EXPECT_EQ(InkColor(image, {100, 0, 200, 100}), CategoryColor(2));
}

TEST(Renderer, DrawsManyWholeNumbersOnAScaleThatOutliersDoNotStretch) {
  PointCloud cloud = RandomSquare(200);
  std::vector<uint16_t> values;
  for (size_t i = 0; i < cloud.size(); ++i) {
    values.push_back(static_cast<uint16_t>(cloud.positions[i].x * 10));
  }
  values[0] = 65535;
  cloud = MakeCloud<uint16_t>(cloud.positions, "intensity", values);
  RenderOptions options = Plain();
  options.color_by = "intensity";
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image, Render({cloud}, options));
  // More than the outlier alone has the colour of the end.
  EXPECT_GT(CountPixels(image, ScaleColor(1)), 70);
}

TEST(Renderer, DrawsPointsWithoutAValueGrey) {
  PointCloud cloud =
      MakeCloud<float>({{0, 0, 0}, {10, 0, 0}, {0, 10, 0}, {10, 10, 0}}, "time",
                       {1, std::numeric_limits<float>::quiet_NaN(), 3, 4});
  cloud.attributes.Find("time")->SetMissing(3);
  RenderOptions options = Plain();
  options.color_by = "time";
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image, Render({cloud}, options));
  EXPECT_EQ(InkColor(image, {100, 100, 200, 200}), kNoValueColor);
  EXPECT_EQ(InkColor(image, {100, 0, 200, 100}), kNoValueColor);
  EXPECT_EQ(InkColor(image, {0, 100, 100, 200}), ScaleColor(0));
  EXPECT_EQ(InkColor(image, {0, 0, 100, 100}), ScaleColor(1));
}

TEST(Renderer, SurvivesExtremeValues) {
  const double huge = std::numeric_limits<double>::max();
  const PointCloud cloud =
      MakeCloud<double>({{0, 0, 0}, {huge, 0, 0}, {0, 10, -huge}, {10, 10, 0}},
                        "value", {-huge, 0, 1, huge});
  RenderOptions options = Plain();
  options.captions = true;
  options.color_by = "value";
  MAPSIEVE_EXPECT_OK(Render({cloud}, options));
}

TEST(Renderer, NamesTheAttributesThatThereAre) {
  RenderOptions options = Plain();
  options.color_by = "colour";
  EXPECT_THAT(Render({Corners()}, options),
              StatusIs(absl::StatusCode::kNotFound,
                       AllOf(HasSubstr("\"colour\""), HasSubstr("height"),
                             HasSubstr("label"))));
}

TEST(Renderer, ShowsTheNearestPoint) {
  const PointCloud cloud =
      MakeCloud<uint8_t>({{0, 0, 1}, {0, 0, 3}, {0, 0, 2}}, "label", {1, 2, 3});
  RenderOptions options = Plain();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Image image, Render({cloud}, options));
  EXPECT_EQ(image.At(100, 100), LabelColor(Label::kCurve));

  // Looking north from the south, level with the ground.
  options.view = RenderOptions::View::kOblique;
  options.azimuth_deg = 0;
  options.elevation_deg = 0;
  const PointCloud row = MakeCloud<uint8_t>({{0, 5, 0}, {0, -5, 0}, {0, 0, 0}},
                                            "label", {1, 3, 2});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(image, Render({row}, options));
  EXPECT_EQ(image.At(100, 100), LabelColor(Label::kSurface));
}

TEST(Renderer, TurnsTheObliqueViewByCompass) {
  RenderOptions options = Plain();
  options.view = RenderOptions::View::kOblique;
  options.elevation_deg = 90;
  options.azimuth_deg = 90;
  // Looking east, east is up and south is right.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image,
                                Render({Corners()}, options));
  EXPECT_EQ(InkColor(image, {0, 0, 100, 100}), LabelColor(Label::kSurface));
  EXPECT_EQ(InkColor(image, {100, 0, 200, 100}), LabelColor(Label::kJunction));
}

TEST(Renderer, RaisesHighPointsInTheObliqueView) {
  RenderOptions options = Plain();
  options.view = RenderOptions::View::kOblique;
  options.azimuth_deg = 0;
  const PointCloud pole =
      MakeCloud<uint8_t>({{0, 0, 0}, {0, 0, 10}}, "label", {1, 3});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image, Render({pole}, options));
  EXPECT_EQ(InkColor(image, {0, 0, 200, 100}), LabelColor(Label::kSurface));
  EXPECT_EQ(InkColor(image, {0, 100, 200, 200}), LabelColor(Label::kJunction));
}

TEST(Renderer, TakesTheHeightOfThePictureFromTheExtent) {
  PointCloud cloud = RandomSquare(5000);
  for (Point3& p : cloud.positions) p.x *= 2;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image,
                                Render({cloud}, Plain(400, 0)));
  const PixelBox ink = InkBox(image);
  EXPECT_EQ(image.width(), 400);
  EXPECT_NEAR(image.height(), 211, 10);
  EXPECT_GT(ink.width(), 360);
  EXPECT_NEAR(ink.width() / 2.0, ink.height(), 10);
}

TEST(Renderer, KeepsTheScaleOfBothAxesInAnyFormat) {
  const PointCloud square = RandomSquare(5000);
  for (const auto& [width, height] :
       std::vector<std::pair<int, int>>{{400, 100}, {100, 400}}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image,
                                  Render({square}, Plain(width, height)));
    const PixelBox ink = InkBox(image);
    EXPECT_NEAR(ink.width(), ink.height(), 4);
    EXPECT_NEAR(ink.width(), 100 - 2 * 11, 8);
    EXPECT_NEAR(ink.left + ink.right, width, 4) << "not centred";
    EXPECT_NEAR(ink.top + ink.bottom, height, 4) << "not centred";
  }
}

TEST(Renderer, IsNotShrunkByAFarPoint) {
  PointCloud cloud = RandomSquare(1000);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image before, Render({cloud}, Plain()));
  cloud.positions.push_back({1e6, -1e6, 1e5});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image after, Render({cloud}, Plain()));
  EXPECT_GT(InkBox(after).width(), 0.9 * InkBox(before).width());
  EXPECT_GT(InkBox(after).height(), 0.9 * InkBox(before).height());
}

TEST(Renderer, LeavesOutPointsThatAreNowhere) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  PointCloud cloud = Corners();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image before, Render({cloud}, Plain()));
  PointCloud nowhere = MakeCloud<uint8_t>(
      {{nan, 5, 0}, {5, infinity, 0}, {5, 5, nan}}, "label", {1, 1, 1});
  cloud.positions.insert(cloud.positions.end(), nowhere.positions.begin(),
                         nowhere.positions.end());
  cloud.attributes.Find("label")->AppendAll(*nowhere.attributes.Find("label"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image after, Render({cloud}, Plain()));
  EXPECT_EQ(EncodePng(before).value(), EncodePng(after).value());
}

TEST(Renderer, DrawsWhatIsInTheBoxAlone) {
  // A floor below a ceiling that hides it, and a point aside.
  PointCloud cloud;
  std::vector<uint8_t> labels;
  for (int i = 0; i < 400; ++i) {
    const double x = i % 20;
    const auto y = static_cast<double>(i / 20);
    cloud.positions.insert(cloud.positions.end(), {{x, y, 0}, {x, y, 2.5}});
    labels.insert(labels.end(), {3, 2});
  }
  cloud.positions.push_back({9, 9, 1});
  labels.push_back(1);
  cloud = MakeCloud<uint8_t>(cloud.positions, "label", labels);
  RenderOptions options = Plain();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Image image, Render({cloud}, options));
  EXPECT_EQ(CountPixels(image, LabelColor(Label::kSurface)), 0);
  // Closed: what lies on a face is drawn.
  options.box_min.x = 0;
  options.box_max = {19, 19, 0};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(image, Render({cloud}, options));
  EXPECT_GT(CountPixels(image, LabelColor(Label::kSurface)), 1000);
  EXPECT_EQ(CountPixels(image, LabelColor(Label::kCurve)), 0);
  EXPECT_EQ(CountPixels(image, LabelColor(Label::kJunction)), 0);
  // The bounds are those of what is drawn.
  options.box_min = {8.5, 8.5, 0.5};
  options.box_max = {9.5, 9.5, 1.5};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(image, Render({cloud}, options));
  EXPECT_EQ(InkColor(image, {90, 90, 110, 110}), LabelColor(Label::kJunction));
  options.box_max.z = 0.9;
  EXPECT_THAT(Render({cloud}, options),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("in the box: there is nothing to draw")));
}

TEST(Renderer, RefusesACloudWithoutPoints) {
  EXPECT_THAT(Render({PointCloud{}}, Plain()),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("nothing to draw")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Renderer renderer,
                                Renderer::Create(Plain(), {"full", "empty"}));
  MAPSIEVE_ASSERT_OK(renderer.Observe(Corners(), 0));
  EXPECT_THAT(renderer.Draw(Corners(), 0),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("empty")));
}

TEST(Renderer, DrawsASinglePointInTheMiddle) {
  for (const bool captions : {false, true}) {
    RenderOptions options = Plain();
    options.captions = captions;
    const PointCloud one =
        MakeCloud<uint8_t>({{331050, 5183020, 92}}, "label", {1});
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image, Render({one}, options));
    EXPECT_EQ(image.At(100, 100), LabelColor(Label::kJunction));
  }
}

TEST(Renderer, DoesNotDependOnOrderOrBatches) {
  const PointCloud cloud = RandomSquare(3000);
  RenderOptions options = Plain();
  options.view = RenderOptions::View::kOblique;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image whole, Render({cloud}, options));

  PointCloud shuffled = cloud;
  std::shuffle(shuffled.positions.begin(), shuffled.positions.end(),
               std::mt19937(3));
  std::vector<PointCloud> batches;
  for (size_t i = 0; i < shuffled.size(); i += 700) {
    const size_t end = std::min(i + 700, shuffled.size());
    batches.emplace_back().positions.assign(&shuffled.positions[i],
                                            &shuffled.positions[0] + end);
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Renderer renderer, Renderer::Create(options));
  for (const auto& batch : batches) MAPSIEVE_ASSERT_OK(renderer.Observe(batch));
  for (const auto& batch : batches) MAPSIEVE_ASSERT_OK(renderer.Draw(batch));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image split, renderer.Compose());
  EXPECT_EQ(EncodePng(whole).value(), EncodePng(split).value());
}

TEST(Renderer, DrawsPanelsAtOneScale) {
  const PointCloud left = RandomSquare(5000);
  PointCloud right = left;
  std::erase_if(right.positions, [](const Point3& p) { return p.x > 5; });
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image,
                                Render({left, right}, Plain(400, 200)));
  const PixelBox left_ink = InkBox(image, {0, 0, 200, 200});
  const PixelBox right_ink = InkBox(image, {200, 0, 400, 200});
  EXPECT_NEAR(right_ink.width(), left_ink.width() / 2.0, 8);
  EXPECT_NEAR(right_ink.height(), left_ink.height(), 4);
}

TEST(Renderer, DrawsSparseCloudsWithLargerPoints) {
  const auto covered = [](int count) {
    const Image image = Render({RandomSquare(count)}, Plain()).value();
    return image.width() * image.height() - CountPixels(image, image.At(0, 0));
  };
  // Twenty times the points cover four times the area at most.
  EXPECT_LT(covered(10000), 4 * covered(500));
  EXPECT_GT(covered(10000), 25000) << "the square has holes";
}

TEST(Renderer, TakesThePointSizeThatIsGiven) {
  RenderOptions options = Plain();
  for (const double size : {4.0, 20.0}) {
    options.point_size_px = size;
    const PointCloud one = MakeCloud<uint8_t>({{0, 0, 0}}, "label", {1});
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image, Render({one}, options));
    EXPECT_NEAR(InkBox(image).width(), size, 1.5);
  }
}

TEST(Renderer, DrawsCaptionsOnRequest) {
  RenderOptions options = Plain(600, 400);
  options.captions = true;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Renderer renderer,
                                Renderer::Create(options, {"a title"}));
  MAPSIEVE_ASSERT_OK(renderer.Observe(Corners()));
  MAPSIEVE_ASSERT_OK(renderer.Draw(Corners()));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image, renderer.Compose());
  EXPECT_GT(InkBox(image, {0, 0, 600, 20}).width(), 60) << "no title";
  // The labels that occur in the legend, left, and the scale bar, right.
  for (const Label label :
       {Label::kNone, Label::kJunction, Label::kCurve, Label::kSurface}) {
    bool found = false;
    for (int x = 0; x < 450; ++x) {
      found = found || image.At(x, 387) == LabelColor(label);
    }
    EXPECT_TRUE(found) << core::LabelName(label);
  }
  EXPECT_GT(InkBox(image, {500, 380, 600, 400}).width(), 30);
  EXPECT_EQ(image.At(0, 0), image.At(599, 399));
}

TEST(Renderer, HasALightBackgroundOnRequest) {
  RenderOptions options = Plain();
  options.background = RenderOptions::Background::kLight;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image,
                                Render({Corners()}, options));
  EXPECT_EQ(image.At(0, 0), (Color{255, 255, 255}));
}

TEST(Renderer, RefusesToObserveAfterDrawing) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Renderer renderer, Renderer::Create(Plain()));
  MAPSIEVE_ASSERT_OK(renderer.Observe(Corners()));
  MAPSIEVE_ASSERT_OK(renderer.Draw(Corners()));
  EXPECT_THAT(renderer.Observe(Corners()),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("")));
}

TEST(Renderer, RefusesPanelsThatDoNotExist) {
  EXPECT_THAT(Renderer::Create(Plain(), {}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("panel")));
  EXPECT_THAT(Renderer::Create(Plain(), std::vector<std::string>(9)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("9")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Renderer renderer, Renderer::Create(Plain()));
  EXPECT_THAT(renderer.Observe(Corners(), 1),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("1")));
}

TEST(Renderer, NamesTheFontThatIsMissing) {
  RenderOptions options;
  options.font = "/nowhere/no.ttf";
  EXPECT_THAT(Renderer::Create(options),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("no.ttf")));
  options.captions = false;
  MAPSIEVE_EXPECT_OK(Renderer::Create(options));
}

TEST(RenderOptions, NamesTheFieldThatIsWrong) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto expect_error = [](auto change, const char* field) {
    RenderOptions options;
    change(options);
    EXPECT_THAT(options.Validate(),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(field)));
  };
  MAPSIEVE_EXPECT_OK(RenderOptions{}.Validate());
  expect_error([](auto& o) { o.width = 63; }, "width");
  expect_error([](auto& o) { o.width = 8193; }, "width");
  expect_error([](auto& o) { o.height = -1; }, "height");
  expect_error([](auto& o) { o.width = o.height = 8192; }, "width x height");
  expect_error([&](auto& o) { o.azimuth_deg = nan; }, "azimuth_deg");
  expect_error([](auto& o) { o.elevation_deg = 91; }, "elevation_deg");
  expect_error([](auto& o) { o.box_max.y = NAN; }, "box_min");
  expect_error([](auto& o) { o.box_min.z = 1, o.box_max.z = 0; }, "box_min");
  expect_error([](auto& o) { o.point_size_px = 65; }, "point_size_px");
  expect_error([&](auto& o) { o.shading = nan; }, "shading");
  expect_error([](auto& o) { o.color_by = ""; }, "color_by");
}

class ProgressLog : public ProgressSink {
 public:
  void Report(int64_t done, int64_t total) override {
    last_done = done;
    last_total = total;
  }
  int64_t last_done = 0;
  int64_t last_total = 0;
};

TEST_F(RenderFileTest, WritesAPngThatLibpngReads) {
  const auto input = folder_ / "corners.ply";
  const auto output = folder_ / "corners.png";
  MAPSIEVE_ASSERT_OK(WritePointFile(
      input, Corners(), {.attributes = Corners().attributes.specs()}));
  ProgressLog progress;
  MAPSIEVE_ASSERT_OK(
      RenderFile(input, output, Plain(), {.progress = &progress}));
  EXPECT_EQ(progress.last_done, 8);
  EXPECT_EQ(progress.last_total, 8);

  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  ASSERT_NE(png_image_begin_read_from_file(&png, output.c_str()), 0);
  EXPECT_EQ(png.width, 200u);
  EXPECT_EQ(png.height, 200u);
  png.format = PNG_FORMAT_RGB;
  std::vector<uint8_t> pixels(PNG_IMAGE_SIZE(png));
  ASSERT_NE(png_image_finish_read(&png, nullptr, pixels.data(), 0, nullptr), 0);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Image image,
                                Render({Corners()}, Plain()));
  for (int i = 0; i < 200 * 200; ++i) {
    const uint8_t* p = &pixels[3 * static_cast<size_t>(i)];
    ASSERT_EQ(image.At(i % 200, i / 200), (Color{p[0], p[1], p[2]})) << i;
  }
}

TEST_F(RenderFileTest, ComparesFilesAndNamesTheOneThatIsWrong) {
  const auto good = folder_ / "good.ply";
  const auto bare = folder_ / "bare.ply";
  const auto output = folder_ / "out.png";
  PointCloud positions;
  positions.positions = Corners().positions;
  MAPSIEVE_ASSERT_OK(WritePointFile(
      good, Corners(), {.attributes = Corners().attributes.specs()}));
  MAPSIEVE_ASSERT_OK(WritePointFile(bare, positions));

  const std::array<RenderPanel, 2> panels = {{{"before", bare}, {"", good}}};
  RenderOptions options;
  options.width = 400;
  MAPSIEVE_ASSERT_OK(RenderComparison(panels, output, options));
  EXPECT_TRUE(std::filesystem::exists(output));
  std::filesystem::remove(output);

  options.color_by = "label";
  EXPECT_THAT(RenderComparison(panels, output, options),
              StatusIs(absl::StatusCode::kNotFound,
                       AllOf(HasSubstr("bare.ply"), HasSubstr("\"label\""))));
  EXPECT_FALSE(std::filesystem::exists(output));
}

TEST_F(RenderFileTest, RefusesFilesItCannotReadOrWrite) {
  const auto input = folder_ / "in.ply";
  MAPSIEVE_ASSERT_OK(WritePointFile(
      input, Corners(), {.attributes = Corners().attributes.specs()}));
  EXPECT_THAT(RenderFile(folder_ / "no.ply", folder_ / "out.png"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("no.ply")));
  EXPECT_THAT(RenderFile(input, folder_ / "out.jpg"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(".png")));
  EXPECT_THAT(RenderFile(input, folder_ / "no" / "out.png"),
              Not(testing::IsOk()));
}

TEST_F(RenderFileTest, StopsWhenAskedTo) {
  const auto input = folder_ / "in.ply";
  MAPSIEVE_ASSERT_OK(WritePointFile(
      input, Corners(), {.attributes = Corners().attributes.specs()}));
  std::stop_source source;
  source.request_stop();
  EXPECT_THAT(RenderFile(input, folder_ / "out.png", Plain(),
                         {.stop = source.get_token()}),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("")));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "out.png"));
}

}  // namespace
}  // namespace mapsieve::client
