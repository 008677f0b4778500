#ifndef MAPSIEVE_SERVER_ENGINE_PRODUCT_CHUNK_H_
#define MAPSIEVE_SERVER_ENGINE_PRODUCT_CHUNK_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/cloud/packed_columns.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/labels.h"
#include "core/spdf/levels.h"

/// How the filter's answer lies in the blocks of product chunks: columns whose
/// names begin with kReservedAttributePrefix, then the input's attributes
/// under their own names.
namespace mapsieve::engine {

inline constexpr std::string_view kLabelColumn = "spdf.label";
inline constexpr std::string_view kConfidenceColumn = core::kPackedConfidence;
inline constexpr std::array<std::string_view, 3> kLambdaColumns = {
    "spdf.lambda1", "spdf.lambda2", "spdf.lambda3"};
inline constexpr std::string_view kNormalColumn = core::kPackedNormal;
inline constexpr std::string_view kTangentColumn = core::kPackedTangent;

/// Depth of the point: uint8, 0 to core::kMaxDepth.
inline constexpr std::string_view kDepthColumn = "spdf.depth";

/// Depths from min to max.
struct DepthRange {
  int min = 0;
  int max = core::kMaxDepth;
};
/// The points of a tile are divided into chunks of these depths, the coarse
/// ones first: few points are as deep as the last levels, and a chunk for each
/// would be mostly head.
inline constexpr std::array<DepthRange, 4> kDepthGroups = {
    DepthRange{3, core::kMaxDepth}, DepthRange{2, 2}, DepthRange{1, 1},
    DepthRange{0, 0}};

/// The index in kDepthGroups of a depth.
size_t DepthGroupOf(int depth);

/// The points of a product cloud by kDepthGroups, each in their order, with
/// `depths`, one entry a point, as column kDepthColumn.
std::array<core::LatticeCloud, kDepthGroups.size()> SplitByDepth(
    core::LatticeCloud product, std::span<const uint8_t> depths);

/// kDepthColumn of product points; kDataLoss: not there, or a number in it that
/// is no depth.
absl::StatusOr<std::vector<uint8_t>> DepthsOf(const core::ColumnSet& columns);

/// An upper bound of the memory of a decoded point of a product whose points
/// have `attributes`.
int64_t ProductPointBytes(std::span<const core::ColumnSpec> attributes);

/// `points` with `labels`, one entry a point, as columns before their own.
core::LatticeCloud MakeProductCloud(core::LatticeCloud points,
                                    const core::LabelSpans& labels);

/// The column of product points named `name`; kDataLoss if it is not there or
/// not of type `type`.
absl::StatusOr<const core::Column*> FindProductColumn(
    const core::ColumnSet& columns, std::string_view name,
    core::ScalarType type);

/// kLabelColumn, kConfidenceColumn, kLambdaColumns, kNormalColumn and
/// kTangentColumn of product points; kDataLoss: one is missing, or a number in
/// it is no label.
absl::StatusOr<core::LabelColumns> LabelColumnsOf(
    const core::LatticeCloud& points);

/// Labels and confidences of product points, whose columns outlive it.
class LabelColumnView {
 public:
  /// kDataLoss: a column is missing, or a number in it is no label.
  static absl::StatusOr<LabelColumnView> Of(const core::ColumnSet& columns);

  size_t size() const { return label_->size(); }
  core::Label label(size_t i) const {
    return static_cast<core::Label>(label_->Get<uint8_t>(i));
  }
  uint16_t confidence(size_t i) const { return confidence_->Get<uint16_t>(i); }

 private:
  LabelColumnView(const core::Column& label, const core::Column& confidence)
      : label_(&label), confidence_(&confidence) {}

  const core::Column* label_;
  const core::Column* confidence_;
};

/// How many of the product points have each label. kDataLoss: no label column,
/// or a number in it that is no label.
absl::StatusOr<core::LabelCounts> CountLabels(const core::ColumnSet& columns);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_PRODUCT_CHUNK_H_
