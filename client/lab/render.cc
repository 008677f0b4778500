#include "client/lab/render.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <numbers>
#include <optional>
#include <string_view>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/formats/output_file.h"
#include "client/formats/point_file.h"
#include "client/lab/colormap.h"
#include "client/lab/legend.h"
#include "client/lab/splat_buffer.h"
#include "client/lab/text.h"
#include "client/lab/view_sample.h"
#include "core/base/status.h"
#include "core/cloud/label.h"

namespace mapsieve::client {
namespace {

using core::Column;
using core::Label;
using core::Point3;
using core::PointCloud;
using core::ScalarType;

constexpr size_t kBatchPoints = size_t{1} << 16;
// Coordinates beyond it are no place: they would overflow the bounds.
constexpr double kFarthest = 1e12;
constexpr double kNoValue = std::numeric_limits<double>::quiet_NaN();
// Automatic diameters of points, in pixels.
constexpr double kSmallestAutoSize = 1.5;
constexpr double kLargestAutoSize = 8;
// Points beyond each end of a colour scale.
constexpr double kScaleTrim = 0.02;

// A parallel projection.
struct Camera {
  Point3 right;
  Point3 up;
  Point3 forward;

  explicit Camera(const RenderOptions& options) {
    const bool top = options.view == RenderOptions::View::kTop;
    constexpr double kDegree = std::numbers::pi / 180;
    const double azimuth = top ? 0 : options.azimuth_deg * kDegree;
    const double elevation = (top ? 90 : options.elevation_deg) * kDegree;
    const double east = std::sin(azimuth);
    const double north = std::cos(azimuth);
    const double sine = std::sin(elevation);
    // Exactly 0 in a view from above: u and v are then x and y themselves.
    const double cosine = elevation == 90 * kDegree ? 0 : std::cos(elevation);
    right = {north, -east, 0};
    up = {east * sine, north * sine, cosine};
    forward = {east * cosine, north * cosine, -sine};
  }
};

double Dot(const Point3& a, const Point3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

bool IsDrawable(const Point3& p) {
  return std::abs(p.x) <= kFarthest && std::abs(p.y) <= kFarthest &&
         std::abs(p.z) <= kFarthest;
}

bool IsSmallInteger(ScalarType type) {
  return type != ScalarType::kFloat32 && type != ScalarType::kFloat64 &&
         core::ScalarSize(type) <= 4;
}

// What the colours of one panel stand for.
struct ColorSource {
  enum class Kind { kHeight, kLabel, kAttribute };
  Kind kind = Kind::kHeight;
  std::string column;
  // An attribute of whole numbers, which may turn out to be classes.
  bool is_integer = false;
};

absl::StatusOr<ColorSource> ChooseColorSource(const std::string& color_by,
                                              const PointCloud& batch) {
  const Column* label = batch.attributes.Find("label");
  const bool has_label =
      label != nullptr && label->type() == ScalarType::kUint8;
  if (has_label && (color_by == "auto" || color_by == "label")) {
    return ColorSource{ColorSource::Kind::kLabel, "label", true};
  }
  if (color_by == "auto" || color_by == "height") return ColorSource{};
  const Column* column = batch.attributes.Find(color_by);
  if (column != nullptr) {
    return ColorSource{ColorSource::Kind::kAttribute, color_by,
                       IsSmallInteger(column->type())};
  }
  std::vector<std::string> names = {"height"};
  for (const Column& present : batch.attributes.columns()) {
    names.push_back(present.name());
  }
  return absl::NotFoundError(
      absl::StrCat("no attribute \"", color_by,
                   "\" to colour by; there are: ", absl::StrJoin(names, ", ")));
}

// Value of row `i`, which the colour stands for; NaN if there is none.
double ColorValue(const PointCloud& batch, const Column* column, size_t i) {
  if (column == nullptr) return batch.positions[i].z;
  return column->IsMissing(i) ? kNoValue : column->GetAsDouble(i);
}

struct Rectangle {
  int left = 0;
  int top = 0;
  int width = 0;
  int height = 0;
};

struct Panel {
  std::string title;
  std::optional<ColorSource> source;
  ViewSample sample{Renderer::kSampleSize};
  double nearest = std::numeric_limits<double>::infinity();
  // Points of each value, while `source` may be classes.
  std::map<int64_t, int64_t> classes;
  bool has_classes = true;

  Rectangle area;
  std::optional<SplatBuffer> buffer;

  bool is_labeled() const { return source->kind == ColorSource::Kind::kLabel; }
  void CountClass(double value);
};

void Panel::CountClass(double value) {
  if (!has_classes || std::isnan(value)) return;
  ++classes[static_cast<int64_t>(value)];
  has_classes = is_labeled() || classes.size() <= kCategoryColorCount;
  if (!has_classes) classes.clear();
}

}  // namespace

absl::Status RenderOptions::Validate() const {
  const auto check = [](std::string_view field, double value, double min,
                        double max) {
    if (value >= min && value <= max) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrCat(
        ToAbsl(field), " is ", value, ", expected ", min, " to ", max));
  };
  MAPSIEVE_RETURN_IF_ERROR(check("width", width, kMinSide, kMaxSide));
  if (height != 0) {
    MAPSIEVE_RETURN_IF_ERROR(check("height", height, kMinSide, kMaxSide));
    MAPSIEVE_RETURN_IF_ERROR(
        check("width x height", double{1} * width * height, 0, kMaxPixels));
  }
  MAPSIEVE_RETURN_IF_ERROR(check("azimuth_deg", azimuth_deg,
                                 std::numeric_limits<double>::lowest(),
                                 std::numeric_limits<double>::max()));
  MAPSIEVE_RETURN_IF_ERROR(check("elevation_deg", elevation_deg, 0, 90));
  // Written so that NaN fails.
  if (!(box_min.x <= box_max.x && box_min.y <= box_max.y &&
        box_min.z <= box_max.z)) {
    return absl::InvalidArgumentError(
        "box_min is above box_max, or one of them is no number");
  }
  if (point_size_px != 0) {
    MAPSIEVE_RETURN_IF_ERROR(check("point_size_px", point_size_px, 0.5, 64));
  }
  MAPSIEVE_RETURN_IF_ERROR(check("shading", shading, 0, 4));
  if (color_by.empty()) {
    return absl::InvalidArgumentError(
        "color_by is empty, expected auto, height or an attribute");
  }
  return absl::OkStatus();
}

struct Renderer::State {
  explicit State(const RenderOptions& render_options)
      : options(render_options), camera(render_options) {
    const bool dark = options.background == RenderOptions::Background::kDark;
    background = dark ? Color{16, 20, 27} : Color{255, 255, 255};
    style.text = dark ? Color{232, 236, 241} : Color{28, 33, 40};
    style.muted = dark ? Color{150, 158, 170} : Color{100, 108, 118};
    style.em = std::clamp(options.width / 75.0, 11.0, 48.0);
  }

  absl::Status CheckPanel(size_t panel) const {
    if (panel < panels.size()) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrCat(
        "panel ", panel, " does not exist; there are ", panels.size()));
  }

  bool IsShown(const Point3& p) const {
    const Point3& low = options.box_min;
    const Point3& high = options.box_max;
    return IsDrawable(p) && low.x <= p.x && p.x <= high.x && low.y <= p.y &&
           p.y <= high.y && low.z <= p.z && p.z <= high.z;
  }

  ViewPoint Project(const PointCloud& batch, const Column* column,
                    size_t i) const {
    const Point3& p = batch.positions[i];
    return {Dot(camera.right, p), Dot(camera.up, p),
            ColorValue(batch, column, i)};
  }

  absl::StatusOr<const Column*> FindColorColumn(const Panel& panel,
                                                const PointCloud& batch) const {
    if (panel.source->column.empty()) return nullptr;
    const Column* column = batch.attributes.Find(panel.source->column);
    if (column != nullptr) return column;
    return absl::NotFoundError(
        absl::StrCat("a batch of the points lacks the attribute \"",
                     panel.source->column, "\", which earlier ones have"));
  }

  absl::Status LayOut();
  void FindBounds();
  int ChooseHeight(double aspect) const;
  void PlacePanels();
  void FindColors();
  double PointSize(const Panel& panel, double covered_area) const;
  Color ColorOf(const Panel& panel, double value) const;
  Legend MakeLegend() const;
  void DrawCaptions(Image& image) const;

  // Pixels of the strips around the panels.
  int margin() const { return static_cast<int>(std::lround(style.em)); }
  int header_height() const {
    if (!options.captions) return 0;
    const bool two_lines = panels.size() > 1 && !options.title.empty();
    return static_cast<int>((two_lines ? 3.9 : 2.2) * style.em);
  }
  int footer_height() const {
    return options.captions ? static_cast<int>(2.4 * style.em) : 0;
  }

  RenderOptions options;
  Camera camera;
  std::optional<Font> font;
  std::vector<Panel> panels;
  Color background;
  CaptionStyle style;

  // Set by LayOut, before the first point is drawn.
  bool is_laid_out = false;
  int height = 0;
  Range u;
  Range v;
  double scale = 1;  // pixels per map unit
  // Common to the panels that are neither labelled nor drawn as classes.
  Range values;
  bool uses_scale = false;
  // Of the panels that are drawn as classes; the index is the colour.
  std::vector<int64_t> classes;
};

absl::Status Renderer::State::LayOut() {
  if (is_laid_out) return absl::OkStatus();
  for (const Panel& panel : panels) {
    if (panel.sample.point_count() == 0) {
      return absl::InvalidArgumentError(absl::StrCat(
          panel.title.empty() ? "the cloud" : panel.title,
          " has no point with finite coordinates in the box: there is nothing "
          "to draw"));
    }
  }
  FindBounds();
  PlacePanels();
  FindColors();
  is_laid_out = true;
  return absl::OkStatus();
}

void Renderer::State::FindBounds() {
  const auto robust = [](const Panel& panel, double ViewPoint::*axis) {
    std::vector<double> coordinates;
    for (const ViewPoint& point : panel.sample.points()) {
      coordinates.push_back(point.*axis);
    }
    return RobustRange(coordinates);
  };
  u = robust(panels[0], &ViewPoint::u);
  v = robust(panels[0], &ViewPoint::v);
  for (const Panel& panel : panels) {
    u = u.Union(robust(panel, &ViewPoint::u));
    v = v.Union(robust(panel, &ViewPoint::v));
  }
}

// Height of the picture for panels of `aspect` (height / width).
int Renderer::State::ChooseHeight(double aspect) const {
  if (options.height != 0) return options.height;
  const int count = static_cast<int>(panels.size());
  const double panel_width =
      static_cast<double>(options.width - (count + 1) * margin()) / count;
  const double ideal =
      panel_width * aspect + header_height() + footer_height() + 2 * margin();
  const double limit =
      std::min<double>(RenderOptions::kMaxSide,
                       double{RenderOptions::kMaxPixels} / options.width);
  return static_cast<int>(std::clamp(
      ideal, std::max<double>(0.3 * options.width, RenderOptions::kMinSide),
      std::min(1.2 * options.width, limit)));
}

void Renderer::State::PlacePanels() {
  // A cloud without extent gets a picture of one unit.
  const double extent = std::max(u.length(), v.length());
  const double smallest = extent > 0 ? 1e-6 * extent : 1;
  const double u_length = std::max(u.length(), smallest);
  const double v_length = std::max(v.length(), smallest);

  height = ChooseHeight(v_length / u_length);
  const int count = static_cast<int>(panels.size());
  const int top = std::max(header_height(), margin());
  const int panel_height =
      std::max(height - top - std::max(footer_height(), margin()), 1);
  const int panel_width =
      std::max((options.width - (count + 1) * margin()) / count, 1);
  // Room for the splats of the outermost points.
  const auto inside = [](int side) {
    return std::max<double>(side - kLargestAutoSize, 1);
  };
  scale =
      std::min(inside(panel_width) / u_length, inside(panel_height) / v_length);

  double covered_area = 0;
  for (const Panel& panel : panels) {
    covered_area = std::max(covered_area, panel.sample.CoveredArea(u, v));
  }
  for (int i = 0; i < count; ++i) {
    Panel& panel = panels[static_cast<size_t>(i)];
    panel.area = {margin() + i * (panel_width + margin()), top, panel_width,
                  panel_height};
    panel.buffer.emplace(
        panel_width, panel_height, PointSize(panel, covered_area),
        options.view == RenderOptions::View::kTop ? 90 : options.elevation_deg);
  }
}

double Renderer::State::PointSize(const Panel& panel,
                                  double covered_area) const {
  if (options.point_size_px != 0) return options.point_size_px;
  const auto count = static_cast<double>(panel.sample.point_count());
  const double spacing = std::sqrt(covered_area / count) * scale;
  if (!(covered_area > 0)) return kLargestAutoSize;
  return std::clamp(2 * spacing, kSmallestAutoSize, kLargestAutoSize);
}

void Renderer::State::FindColors() {
  std::vector<double> scale_values;
  std::map<int64_t, int64_t> all_classes;
  bool are_classes = true;
  for (const Panel& panel : panels) {
    if (panel.is_labeled()) continue;
    are_classes = are_classes && panel.source->is_integer && panel.has_classes;
    all_classes.insert(panel.classes.begin(), panel.classes.end());
    for (const ViewPoint& point : panel.sample.points()) {
      if (std::isfinite(point.value)) scale_values.push_back(point.value);
    }
  }
  are_classes = are_classes && all_classes.size() <= kCategoryColorCount;
  if (scale_values.empty()) return;
  if (are_classes) {
    for (const auto& [value, count] : all_classes) classes.push_back(value);
    return;
  }
  uses_scale = true;
  values = TrimmedRange(scale_values, kScaleTrim);
  if (!(values.length() > 0)) values = {values.min - 0.5, values.max + 0.5};
}

Color Renderer::State::ColorOf(const Panel& panel, double value) const {
  if (std::isnan(value)) return kNoValueColor;
  if (panel.is_labeled()) return LabelColor(static_cast<Label>(value));
  if (uses_scale) return ScaleColor((value - values.min) / values.length());
  const auto found = std::lower_bound(classes.begin(), classes.end(),
                                      static_cast<int64_t>(value));
  return CategoryColor(static_cast<size_t>(found - classes.begin()));
}

Legend Renderer::State::MakeLegend() const {
  core::LabelCounts label_counts{};
  Legend legend;
  std::string name;
  for (const Panel& panel : panels) {
    if (panel.is_labeled()) {
      for (const auto& [value, count] : panel.classes) {
        const auto label = static_cast<size_t>(value);
        label_counts[label < core::kLabelCount ? label : 0] += count;
      }
    } else {
      name = panel.source->column.empty() ? "height" : panel.source->column;
    }
  }
  // Surfaces first, points without a label last.
  for (size_t i = core::kLabelCount; i-- > 0;) {
    if (label_counts[i] == 0) continue;
    const auto label = static_cast<Label>(i);
    std::string text(core::LabelName(label));
    if (panels.size() == 1) {
      absl::StrAppend(&text, " ", FormatCount(label_counts[i]));
    }
    legend.entries.push_back({text, LabelColor(label)});
  }
  for (size_t i = 0; i < classes.size(); ++i) {
    legend.entries.push_back(
        {absl::StrCat(name, " ", classes[i]), CategoryColor(i)});
  }
  if (uses_scale) legend.scale = {name, values.min, values.max};
  return legend;
}

void Renderer::State::DrawCaptions(Image& image) const {
  const double em = style.em;
  const auto baseline = [&](double line) { return (1.45 + 1.7 * line) * em; };
  double line = 0;
  if (panels.size() > 1 && !options.title.empty()) {
    const double size = 1.2 * em;
    font->Draw(font->Fit(options.title, size, image.width() - 2 * margin()),
               size, margin(), baseline(0), style.text, image);
    line = 1;
  }
  for (const Panel& panel : panels) {
    const bool uses_title = panels.size() == 1 && !options.title.empty();
    const std::string& title = uses_title ? options.title : panel.title;
    const std::string count =
        absl::StrCat(FormatCount(panel.sample.point_count()),
                     panel.sample.point_count() == 1 ? " point" : " points");
    const double gap = title.empty() ? 0 : 0.8 * em;
    const double count_width = font->Width(count, em);
    const std::string fitting =
        font->Fit(title, em, panel.area.width - count_width - gap);
    font->Draw(fitting, em, panel.area.left, baseline(line), style.text, image);
    font->Draw(count, em, panel.area.left + font->Width(fitting, em) + gap,
               baseline(line), style.muted, image);
  }

  const double middle = image.height() - footer_height() / 2.0;
  const double right = image.width() - margin();
  const ScaleBar bar = ChooseScaleBar(scale, panels[0].area.width / 4.0);
  const double bar_left = DrawScaleBar(bar, options.length_unit, *font, style,
                                       right, middle, image);
  DrawLegend(MakeLegend(), *font, style, margin(), bar_left - 2 * em, middle,
             image);
}

Renderer::Renderer(std::unique_ptr<State> state) : state_(std::move(state)) {}
Renderer::Renderer(Renderer&& other) noexcept = default;
Renderer& Renderer::operator=(Renderer&& other) noexcept = default;
Renderer::~Renderer() = default;

absl::StatusOr<Renderer> Renderer::Create(
    const RenderOptions& options,
    const std::vector<std::string>& panel_titles) {
  MAPSIEVE_RETURN_IF_ERROR(Annotate(options.Validate(), "render"));
  if (panel_titles.empty() || panel_titles.size() > kMaxPanels) {
    return absl::InvalidArgumentError(
        absl::StrCat("render: ", panel_titles.size(), " panels, expected 1 to ",
                     kMaxPanels));
  }
  auto state = std::make_unique<State>(options);
  if (options.captions) {
    MAPSIEVE_ASSIGN_OR_RETURN(state->font, Font::Open(options.font));
  }
  for (const std::string& title : panel_titles) {
    state->panels.emplace_back().title = title;
  }
  return Renderer(std::move(state));
}

absl::Status Renderer::Observe(const PointCloud& batch, size_t panel_index) {
  MAPSIEVE_RETURN_IF_ERROR(state_->CheckPanel(panel_index));
  if (state_->is_laid_out) {
    return absl::FailedPreconditionError(
        "points cannot be observed once drawing has begun");
  }
  Panel& panel = state_->panels[panel_index];
  if (!panel.source.has_value()) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        panel.source, ChooseColorSource(state_->options.color_by, batch));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const Column* column,
                            state_->FindColorColumn(panel, batch));
  for (size_t i = 0; i < batch.size(); ++i) {
    if (!state_->IsShown(batch.positions[i])) continue;
    const ViewPoint point = state_->Project(batch, column, i);
    panel.sample.Add(point);
    panel.nearest = std::min(panel.nearest,
                             Dot(state_->camera.forward, batch.positions[i]));
    if (panel.source->is_integer) panel.CountClass(point.value);
  }
  return absl::OkStatus();
}

absl::Status Renderer::Draw(const PointCloud& batch, size_t panel_index) {
  MAPSIEVE_RETURN_IF_ERROR(state_->CheckPanel(panel_index));
  MAPSIEVE_RETURN_IF_ERROR(state_->LayOut());
  const State& state = *state_;
  Panel& panel = state_->panels[panel_index];
  MAPSIEVE_ASSIGN_OR_RETURN(const Column* column,
                            state.FindColorColumn(panel, batch));
  const double center_u = (state.u.min + state.u.max) / 2;
  const double center_v = (state.v.min + state.v.max) / 2;
  for (size_t i = 0; i < batch.size(); ++i) {
    if (!state.IsShown(batch.positions[i])) continue;
    const ViewPoint point = state.Project(batch, column, i);
    const double depth = Dot(state.camera.forward, batch.positions[i]);
    panel.buffer->Splat(
        panel.area.width / 2.0 + (point.u - center_u) * state.scale,
        panel.area.height / 2.0 - (point.v - center_v) * state.scale,
        (depth - panel.nearest) * state.scale,
        state.ColorOf(panel, point.value));
  }
  return absl::OkStatus();
}

absl::StatusOr<Image> Renderer::Compose() {
  MAPSIEVE_RETURN_IF_ERROR(state_->LayOut());
  Image image(state_->options.width, state_->height, state_->background);
  for (const Panel& panel : state_->panels) {
    panel.buffer->Resolve(state_->options.shading, panel.area.left,
                          panel.area.top, image);
  }
  if (state_->options.captions) state_->DrawCaptions(image);
  return image;
}

namespace {

absl::Status WritePicture(Renderer& renderer, OutputFile& file) {
  MAPSIEVE_ASSIGN_OR_RETURN(const Image image, renderer.Compose());
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> bytes,
                            EncodePng(image));
  MAPSIEVE_RETURN_IF_ERROR(file.Append(bytes));
  return file.Finish();
}

// Points that two passes read; 0 if a panel's count is unknown.
int64_t TotalPoints(const std::vector<std::optional<int64_t>>& counts) {
  int64_t total = 0;
  for (const auto& count : counts) {
    if (!count.has_value()) return 0;
    total += 2 * *count;
  }
  return total;
}

}  // namespace

absl::Status Renderer::WritePng(const std::filesystem::path& path) {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto file, OutputFile::Create(path));
  return WritePicture(*this, *file);
}

absl::Status RenderComparison(std::span<const RenderPanel> panels,
                              const std::filesystem::path& output,
                              const RenderOptions& options,
                              const ExecutionContext& context) {
  if (output.extension() != ".png") {
    return absl::InvalidArgumentError(absl::StrCat(
        output.string(), ": pictures are written as PNG: name a file *.png"));
  }
  std::vector<std::string> titles;
  for (const RenderPanel& panel : panels) {
    titles.push_back(panel.title.empty() ? panel.path.filename().string()
                                         : panel.title);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(Renderer renderer,
                            Renderer::Create(options, titles));
  MAPSIEVE_ASSIGN_OR_RETURN(const auto file, OutputFile::Create(output));

  using Pass = absl::Status (Renderer::*)(const PointCloud&, size_t);
  constexpr std::array<Pass, 2> kPasses = {&Renderer::Observe, &Renderer::Draw};
  std::vector<std::optional<int64_t>> counts;
  for (const RenderPanel& panel : panels) {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto reader, OpenPointFile(panel.path));
    counts.push_back(reader->info().point_count);
  }
  int64_t done = 0;
  for (const Pass pass : kPasses) {
    for (size_t i = 0; i < panels.size(); ++i) {
      MAPSIEVE_ASSIGN_OR_RETURN(const auto reader,
                                OpenPointFile(panels[i].path));
      int64_t count = 0;
      while (true) {
        MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
        MAPSIEVE_ASSIGN_OR_RETURN(const PointCloud batch,
                                  reader->ReadBatch(kBatchPoints));
        if (batch.size() == 0) break;
        MAPSIEVE_RETURN_IF_ERROR(
            Annotate((renderer.*pass)(batch, i), panels[i].path.string()));
        count += static_cast<int64_t>(batch.size());
        done += static_cast<int64_t>(batch.size());
        context.ReportProgress(done, TotalPoints(counts));
      }
      counts[i] = count;
    }
  }
  return WritePicture(renderer, *file);
}

absl::Status RenderFile(const std::filesystem::path& input,
                        const std::filesystem::path& output,
                        const RenderOptions& options,
                        const ExecutionContext& context) {
  const std::array<RenderPanel, 1> panels = {{{"", input}}};
  return RenderComparison(panels, output, options, context);
}

}  // namespace mapsieve::client
