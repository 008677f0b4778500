#ifndef MAPSIEVE_SERVER_ENGINE_PRODUCT_CHUNK_H_
#define MAPSIEVE_SERVER_ENGINE_PRODUCT_CHUNK_H_

#include <array>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/labels.h"

/// How the filter's answer lies in the blocks of product chunks: columns whose
/// names begin with kReservedAttributePrefix, then the input's attributes
/// under their own names.
namespace mapsieve::engine {

inline constexpr std::string_view kLabelColumn = "spdf.label";
inline constexpr std::string_view kConfidenceColumn = "spdf.confidence";
inline constexpr std::array<std::string_view, 3> kLambdaColumns = {
    "spdf.lambda1", "spdf.lambda2", "spdf.lambda3"};
inline constexpr std::string_view kNormalColumn = "spdf.normal";
inline constexpr std::string_view kTangentColumn = "spdf.tangent";

/// `points` with `labels`, one entry a point, as columns before their own.
core::LatticeCloud MakeProductCloud(core::LatticeCloud points,
                                    const core::LabelSpans& labels);

/// The column of product points named `name`; kDataLoss if it is not there or
/// not of type `type`.
absl::StatusOr<const core::Column*> FindProductColumn(
    const core::LatticeCloud& points, std::string_view name,
    core::ScalarType type);

/// How many of the product points have each label. kDataLoss: no label column,
/// or a number in it that is no label.
absl::StatusOr<core::LabelCounts> CountLabels(const core::LatticeCloud& points);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_PRODUCT_CHUNK_H_
