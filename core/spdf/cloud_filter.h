#ifndef MAPSIEVE_CORE_SPDF_CLOUD_FILTER_H_
#define MAPSIEVE_CORE_SPDF_CLOUD_FILTER_H_

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/labels.h"
#include "core/spdf/spdf_options.h"
#include "core/spdf/tile_filter.h"

namespace mapsieve::core {

/// The filter's answer for a cloud in memory.
struct FilteredCloud {
  /// Rows of the survivors of the rounds in the input, outliers included; the
  /// points are in Morton order. Of several points in one lattice cell the one
  /// with the smallest attributes stands for all.
  std::vector<uint32_t> rows;
  LabelColumns columns;
  SpdfSummary summary;

  /// Numbers (into `rows`) of the points that are no outliers; with a share, by
  /// the largest confidences of the cloud.
  std::vector<uint32_t> Inliers(const OutlierTest& test) const;
  std::vector<uint32_t> Inliers(double outlier_share) const;
  /// The same without the outliers; `summary` stays that of the filter.
  FilteredCloud WithoutOutliers(const OutlierTest& test) const;
  FilteredCloud WithoutOutliers(double outlier_share) const;
};

/// FilterTiles over one tile that holds the whole of `cloud`.
/// Errors: kInvalidArgument (options), kCancelled.
absl::StatusOr<FilteredCloud> FilterCloud(const LatticeCloud& cloud,
                                          const SpdfOptions& options,
                                          const ExecutionContext& context = {});

/// Names of the columns that MakeLabeledCloud adds.
inline constexpr std::array<std::string_view, 5> kLabelColumnNames = {
    "label", "confidence", "nx", "ny", "nz"};

/// The name of an input's attribute beside columns named `taken`:
/// input_<name> if that is, without any "input_" before it, one of them; else
/// the name itself. So different attributes never get the same name.
std::string NameBeside(std::string_view name,
                       std::span<const std::string_view> taken);

/// The points of `cloud` at `rows` with what the filter says of them as
/// attributes: label (uint8), confidence, nx, ny, nz (float32). Attributes of
/// the input are named by NameBeside. `columns` has one entry for each of
/// `rows`.
LatticeCloud MakeLabeledCloud(const LatticeCloud& cloud,
                              std::span<const uint32_t> rows,
                              const LabelColumns& columns);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_CLOUD_FILTER_H_
