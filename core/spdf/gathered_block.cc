#include "core/spdf/gathered_block.h"

#include <algorithm>

#include "core/spdf/integer_root.h"

namespace mapsieve::core {

void GatheredBlock::Gather(const IndexBox& box, int64_t radius) {
  GatherSource source = index_.source();
  IndexBox near;
  int64_t half2 = 0;
  for (size_t a = 0; a < 3; ++a) {
    center_[a] = box.min[a] + (box.max[a] - box.min[a]) / 2;
    const int64_t half = box.max[a] - center_[a];
    half2 += half * half;
    source.center[a] = center_[a];
    source.half[a] = static_cast<int32_t>(half + radius);
    near.min[a] = center_[a] - source.half[a];
    near.max[a] = center_[a] + source.half[a];
  }
  half_diagonal_ = CeilRoot(half2);
  radius_ = radius;
  nearest_radius_ = kUnbounded;
  index_.FindRanges(near, ranges_);
  size_t total = 2 * kKernelPadding;
  for (const auto& [begin, end] : ranges_) total += end - begin;
  if (xy_.size() < total) {
    xy_.resize(total + total / 2);
    z_.resize(xy_.size());
    ids_.resize(xy_.size());
  }
  const Kernels& kernels = ActiveKernels();
  const BlockArrays arrays = {xy_.data(), z_.data(), ids_.data()};
  count_ = 0;
  for (const auto& [begin, end] : ranges_) {
    count_ = kernels.gather(source, begin, end, arrays, count_);
  }
  Pad();
}

void GatheredBlock::GatherNearest(const IndexBox& box, int64_t radius,
                                  int neighbor_count) {
  if (nearest_radius_ != kUnbounded) {
    // What is within the last centre's radius is within this far of any point
    // of the box.
    int64_t farthest2 = 0;
    for (size_t a = 0; a < 3; ++a) {
      // Capped so that the square fits.
      const int64_t far = std::min(std::max(int64_t{center_[a]} - box.min[a],
                                            int64_t{box.max[a]} - center_[a]),
                                   int64_t{1} << 30);
      farthest2 += far * far;
    }
    radius = std::min(radius, nearest_radius_ + CeilRoot(farthest2));
  }
  Gather(box, radius);
  const Kernels& kernels = ActiveKernels();
  const KernelScratch room = scratch();
  kernels.distances(block(), 0, 0, 0, room.d2);
  const int64_t bound = radius_ + half_diagonal_;
  const auto bound2 = static_cast<int32_t>(bound * bound);
  const int32_t nearest2 =
      kernels.select(room.d2, count_, neighbor_count + 1, bound2);
  if (nearest2 == bound2) return;
  // A point p of the box sees neighbor_count + 1 points (itself among them)
  // within the centre's radius + |p|, so nothing farther from the centre than
  // that + |p| can be a neighbour.
  nearest_radius_ = CeilRoot(nearest2);
  const int64_t keep = nearest_radius_ + 2 * half_diagonal_;
  const auto keep2 = static_cast<int32_t>(std::min(keep * keep, bound * bound));
  count_ = kernels.keep_within({xy_.data(), z_.data(), ids_.data()}, room.d2,
                               count_, keep2);
  Pad();
}

int32_t GatheredBlock::CompleteWithin(int32_t x, int32_t y, int32_t z,
                                      int32_t limit_d2) const {
  const int64_t from_center =
      CeilRoot(int64_t{x} * x + int64_t{y} * y + int64_t{z} * z);
  const int64_t complete = std::min(radius_, nearest_radius_ + from_center);
  return static_cast<int32_t>(std::min<int64_t>(limit_d2, complete * complete));
}

KernelScratch GatheredBlock::scratch() {
  const size_t size = static_cast<size_t>(count_) + 2 * kKernelPadding;
  if (scratch_.size() < 3 * size) scratch_.resize(3 * size + size);
  return {scratch_.data(), scratch_.data() + size, scratch_.data() + 2 * size};
}

void GatheredBlock::Pad() {
  const auto begin = static_cast<ptrdiff_t>(count_);
  std::fill_n(xy_.begin() + begin, kKernelPadding, 0);
  std::fill_n(z_.begin() + begin, kKernelPadding, PackZ(kFarAway));
}

}  // namespace mapsieve::core
