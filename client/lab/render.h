#ifndef MAPSIEVE_CLIENT_LAB_RENDER_H_
#define MAPSIEVE_CLIENT_LAB_RENDER_H_

#include <cstddef>
#include <filesystem>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/lab/image.h"
#include "core/base/executor.h"
#include "core/cloud/point_cloud.h"
#include "core/geometry/lattice.h"

/// Pictures of point clouds of any size: two passes over the points, memory
/// bounded by the picture.
namespace mapsieve::client {

/// How a picture is drawn. The defaults suit a map of any size and density.
struct RenderOptions {
  enum class View { kTop, kOblique };
  enum class Background { kDark, kLight };
  static constexpr double kInfinite = std::numeric_limits<double>::infinity();

  /// Pixels, kMinSide to kMaxSide.
  int width = 1600;
  /// Pixels, kMinSide to kMaxSide; 0: what the extent of the points asks for.
  int height = 0;
  /// Both views are parallel projections: one scale holds everywhere. kTop has
  /// +y up.
  View view = View::kTop;
  /// Compass direction that the oblique view looks to, in degrees: 0 is +y, 90
  /// is +x. Any finite value.
  double azimuth_deg = 30;
  /// Height of the oblique view's eye over the horizon in degrees, 0 to 90.
  double elevation_deg = 35;
  /// Corners of a closed box: nothing outside it is drawn. Infinite, as by
  /// default: no limit on that side.
  core::Point3 box_min = {-kInfinite, -kInfinite, -kInfinite};
  core::Point3 box_max = {kInfinite, kInfinite, kInfinite};
  /// "height" (z), the name of an attribute, or "auto": the geometric label
  /// where a panel has one (attribute `label` of type uint8), else height.
  /// Whole numbers of at most kCategoryColorCount values are drawn as classes,
  /// everything else on a scale that leaves 2 % of the points beyond each end.
  std::string color_by = "auto";
  /// Diameter of a point in pixels, 0.5 to 64; 0: what closes the surfaces at
  /// the density of the points.
  double point_size_px = 0;
  /// Shading from depth, 0 (none) to 4; 1 is natural.
  double shading = 1;
  Background background = Background::kDark;
  /// Titles, point counts, legend and scale bar.
  bool captions = true;
  /// Headline; empty: the panel's title for a single panel, else none.
  std::string title;
  /// Unit of coordinates, written at the scale bar.
  std::string length_unit = "m";
  /// Font file of the captions; empty: the system's DejaVu Sans.
  std::filesystem::path font;

  static constexpr int kMinSide = 64;
  static constexpr int kMaxSide = 8192;
  /// Limit of width x height: 1 GiB of samples.
  static constexpr int kMaxPixels = 1 << 25;

  /// kInvalidArgument naming the field, its value and its limits.
  absl::Status Validate() const;

  friend bool operator==(const RenderOptions&, const RenderOptions&) = default;
};

/// Draws one or several clouds (panels, side by side, with the same bounds,
/// scale and colours) in two passes: all points through Observe, which finds
/// bounds and ranges, then all points through Draw.
///
/// Points with non-finite coordinates, and those outside the box, are left out.
/// Bounds are robust: a few far points (under 0.5 % on each side) are cut off
/// rather than shrink the rest. The picture depends neither on batch sizes nor
/// on the batches' order in a panel, as long as a panel has at most kSampleSize
/// points; beyond that bounds and ranges are estimated from a fixed sample by
/// position in the stream. Not thread-safe.
class Renderer {
 public:
  static constexpr size_t kSampleSize = size_t{1} << 17;
  static constexpr size_t kMaxPanels = 8;

  /// One panel for every title; a title may be empty. kInvalidArgument: the
  /// options, no panel or more than kMaxPanels; kNotFound: the font.
  static absl::StatusOr<Renderer> Create(
      const RenderOptions& options,
      const std::vector<std::string>& panel_titles = {""});

  Renderer(Renderer&& other) noexcept;
  Renderer& operator=(Renderer&& other) noexcept;
  ~Renderer();

  /// First pass. kNotFound: the attribute to colour by is not in the batch,
  /// with those that are; kFailedPrecondition: after a Draw;
  /// kInvalidArgument: no such panel.
  absl::Status Observe(const core::PointCloud& batch, size_t panel = 0);

  /// Second pass: the same points. kInvalidArgument: no such panel, or a panel
  /// without a point to draw, by name; kNotFound as in Observe.
  absl::Status Draw(const core::PointCloud& batch, size_t panel = 0);

  /// The picture of what was drawn. kInvalidArgument as in Draw.
  absl::StatusOr<Image> Compose();

  /// Compose, then a PNG file, which appears only when it is complete.
  /// kNotFound, kPermissionDenied: the folder; kResourceExhausted: the disk is
  /// full.
  absl::Status WritePng(const std::filesystem::path& path);

 private:
  struct State;
  explicit Renderer(std::unique_ptr<State> state);

  std::unique_ptr<State> state_;
};

/// A file of points as one panel of a picture.
struct RenderPanel {
  /// Empty: the file's name.
  std::string title;
  std::filesystem::path path;
};

/// Draws point files side by side, with the same bounds, scale and colours, as
/// the PNG `output`. Every file is read twice, in batches. Reports progress in
/// points read, of a total that is 0 while a file's count is unknown.
/// kInvalidArgument: the options, an output that is not named .png, a file
/// without points; kNotFound: a file, the output's folder, the font or the
/// attribute; kDataLoss: a damaged file; kResourceExhausted: the disk is full;
/// kCancelled.
absl::Status RenderComparison(std::span<const RenderPanel> panels,
                              const std::filesystem::path& output,
                              const RenderOptions& options,
                              const ExecutionContext& context = {});

/// RenderComparison of one file.
absl::Status RenderFile(const std::filesystem::path& input,
                        const std::filesystem::path& output,
                        const RenderOptions& options = {},
                        const ExecutionContext& context = {});

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_RENDER_H_
