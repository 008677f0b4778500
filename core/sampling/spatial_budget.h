#ifndef MAPSIEVE_CORE_SAMPLING_SPATIAL_BUDGET_H_
#define MAPSIEVE_CORE_SAMPLING_SPATIAL_BUDGET_H_

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <stop_token>

#include "absl/status/statusor.h"
#include "core/geometry/lattice.h"
#include "core/sampling/cells.h"
#include "core/spdf/labels.h"

namespace mapsieve::core {

/// Shares of a budget by label, in proportion. 0 to kMaxLabelWeight.
using LabelWeights = std::array<double, kLabelCount>;
inline constexpr double kMaxLabelWeight = 1e6;

/// Which of a label's cells is halved next.
enum class CellSplit : uint8_t {
  /// The one with most points.
  kFullest = 1,
  /// The one with most points times v^(2/3), v the volume of the smallest cell
  /// of the octree, or half or quarter of one, around them: but for a factor
  /// the sum of their squared distances from their centroid. So few points far
  /// apart get more of the budget: of a surface the sample has the square root
  /// of the density that the points have.
  kWidest,
  /// The one with most points times v^(1/3), between the two: of a surface the
  /// sample has the density that the points have to the power of 2/3.
  kMidway,
};

/// Spatial SpDF: at most `budget` of the points, spread evenly over each label.
/// Each label gets its share of the budget by its number of points (rounded
/// down, the rest to the largest label), or by `weights`: then a label with
/// fewer points than its share gives the others what it cannot fill, and only
/// labels of weight 0 get nothing. Its points are divided into cells of the
/// absolute octree, the cell that `split` says halved along its next Morton bit
/// again and again while the label's budget holds, and of each cell the point
/// nearest to its centroid stays, with `confidences`, one a point, the nearest
/// of its surest (Representative::kSurest). So exactly min(budget, N) points
/// come back, and the choice depends on the set of points alone: chunk and tile
/// borders never show. `positions`: distinct, in Morton order. `labels`: one a
/// point. kInvalidArgument: unequal lengths, a negative budget; kCancelled:
/// `stop`, looked at every few milliseconds. Cost O(N log N). Source:
/// Labussière et al. 2020, section on Spatial SpDF, for kFullest.
absl::StatusOr<CellSample> SampleUnderBudget(
    std::span<const LatticePoint> positions, std::span<const Label> labels,
    int64_t budget, const std::optional<LabelWeights>& weights = std::nullopt,
    std::stop_token stop = {}, CellSplit split = CellSplit::kFullest,
    std::span<const uint16_t> confidences = {});

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_SPATIAL_BUDGET_H_
