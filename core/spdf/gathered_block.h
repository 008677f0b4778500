#ifndef MAPSIEVE_CORE_SPDF_GATHERED_BLOCK_H_
#define MAPSIEVE_CORE_SPDF_GATHERED_BLOCK_H_

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/spdf/kernels.h"
#include "core/spdf/point_index.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::core {

/// A radius without a bound.
inline constexpr int64_t kUnbounded = int64_t{1} << 40;

/// Longest edge of a box whose points are to share a block that reaches
/// `radius` steps beyond it: wide enough to be shared, with coordinates that
/// fit.
inline int64_t GroupExtent(int64_t radius) {
  return std::min<int64_t>(2 * radius, kMaxRadiusSteps);
}

/// Calls use(box, points) for `points`, or for halves of halves of them until
/// each part's box is at most `extent` wide.
template <typename Use>
void SplitWide(const PointIndex& index, std::span<const uint32_t> points,
               int64_t extent, const Use& use) {
  const IndexBox box = index.BoxOf(points);
  if (points.size() == 1 || box.Extent() <= extent) {
    use(box, points);
    return;
  }
  const size_t half = points.size() / 2;
  SplitWide(index, points.first(half), extent, use);
  SplitWide(index, points.subspan(half), extent, use);
}

/// Candidates copied out of an index around a box of query points, relative to
/// its centre. Reused from one box to the next. Not thread-safe.
class GatheredBlock {
 public:
  explicit GatheredBlock(const PointIndex& index) : index_(index) {}

  /// Gathers every point within `radius` steps of `box`. Box extents are at
  /// most kMaxRadiusSteps, the radius too.
  void Gather(const IndexBox& box, int64_t radius);

  /// Gathers, for every point of `box`, its `neighbor_count` nearest others
  /// within `radius`, and perhaps more. The box holds at least one point of
  /// the index. Successive calls have the same neighbor_count: what one finds
  /// bounds the search of the next.
  void GatherNearest(const IndexBox& box, int64_t radius, int neighbor_count);

  /// A squared distance from the point at (x, y, z), relative to the centre,
  /// within which the block holds every point, and after GatherNearest
  /// neighbor_count others of it if its radius does; at most `limit_d2`.
  int32_t CompleteWithin(int32_t x, int32_t y, int32_t z,
                         int32_t limit_d2) const;

  CandidateBlock block() const { return {xy_.data(), z_.data(), count_}; }
  /// Index positions of the candidates, ascending.
  std::span<const int32_t> ids() const {
    return {ids_.data(), static_cast<size_t>(count_)};
  }
  /// Room for a query; without entries.
  KernelScratch scratch();
  /// Coordinates of index point `i` relative to the block's centre.
  std::array<int32_t, 3> Relative(uint32_t i) const {
    return RelativeOf(index_, i);
  }
  /// The same of a point of another index that has the same origin.
  std::array<int32_t, 3> RelativeOf(const PointIndex& index, uint32_t i) const {
    const auto [x, y, z] = index.Coordinates(i);
    return {x - center_[0], y - center_[1], z - center_[2]};
  }

 private:
  void Pad();

  const PointIndex& index_;
  std::array<int32_t, 3> center_{};
  /// No point of the box is farther from the centre.
  int64_t half_diagonal_ = 0;
  int64_t radius_ = 0;
  /// As many points as GatherNearest wants lie within it around the centre;
  /// kUnbounded if they are not known.
  int64_t nearest_radius_ = kUnbounded;

  // As kernels want them; count_ of the elements are in use.
  std::vector<int32_t> xy_;
  std::vector<int32_t> z_;
  std::vector<int32_t> ids_;
  int count_ = 0;
  std::vector<PointIndex::Range> ranges_;
  std::vector<int32_t> scratch_;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_GATHERED_BLOCK_H_
