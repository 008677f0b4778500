#include "core/spdf/point_index.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/geometry/morton.h"

namespace mapsieve::core {
namespace {

int64_t CeilRoot(int64_t square) {
  return static_cast<int64_t>(
      std::ceil(std::sqrt(static_cast<double>(square))));
}

}  // namespace

int64_t IndexBox::SquaredDistance(const IndexBox& other) const {
  int64_t sum = 0;
  for (size_t a = 0; a < 3; ++a) {
    const int64_t below = int64_t{min[a]} - other.max[a];
    const int64_t above = int64_t{other.min[a]} - max[a];
    const int64_t gap = std::max({below, above, int64_t{0}});
    sum += gap * gap;
  }
  return sum;
}

void IndexBox::Extend(const IndexBox& other) {
  for (size_t a = 0; a < 3; ++a) {
    min[a] = std::min(min[a], other.min[a]);
    max[a] = std::max(max[a], other.max[a]);
  }
}

int64_t IndexBox::Extent() const {
  int64_t extent = 0;
  for (size_t a = 0; a < 3; ++a) {
    extent = std::max(extent, int64_t{max[a]} - min[a]);
  }
  return extent;
}

PointIndex::PointIndex(const LatticePoint& origin, std::vector<int32_t> x,
                       std::vector<int32_t> y, std::vector<int32_t> z)
    : origin_(origin), x_(std::move(x)), y_(std::move(y)), z_(std::move(z)) {
  Build();
}

void PointIndex::Build() {
  const auto size = static_cast<uint32_t>(x_.size());
  if (size == 0) return;
  nodes_.reserve(size / 8 + 1);
  nodes_.push_back({.begin = 0, .end = size});
  for (uint32_t n = 0; n < nodes_.size(); ++n) {
    const uint32_t begin = nodes_[n].begin;
    const uint32_t end = nodes_[n].end;
    if (end - begin <= kLeafSize) continue;
    const uint32_t split = MortonSplit(begin, end, [this](uint32_t i) {
      return LatticePoint{origin_.x + x_[i], origin_.y + y_[i],
                          origin_.z + z_[i]};
    });
    nodes_[n].left = static_cast<uint32_t>(nodes_.size());
    nodes_.push_back({.begin = begin, .end = split, .parent = n});
    nodes_.push_back({.begin = split, .end = end, .parent = n});
  }
  for (uint32_t n = static_cast<uint32_t>(nodes_.size()); n-- > 0;) {
    Node& node = nodes_[n];
    if (node.left != 0) {
      node.box = nodes_[node.left].box;
      node.box.Extend(nodes_[node.left + 1].box);
      continue;
    }
    node.box = PointBox(node.begin);
    for (uint32_t i = node.begin + 1; i < node.end; ++i) {
      node.box.Extend(PointBox(i));
    }
    leaves_.push_back(n);
  }
  std::sort(leaves_.begin(), leaves_.end(), [this](uint32_t a, uint32_t b) {
    return nodes_[a].begin < nodes_[b].begin;
  });
}

void PointIndex::FindRanges(const IndexBox& box, int64_t radius,
                            std::vector<Range>& ranges) const {
  ranges.clear();
  if (nodes_.empty()) return;
  // Depth is at most one level per coordinate bit.
  std::array<uint32_t, 3 * 64 + 8> stack;
  size_t depth = 0;
  stack[depth++] = 0;
  const int64_t radius2 = radius * radius;
  while (depth > 0) {
    const Node& node = nodes_[stack[--depth]];
    if (node.box.SquaredDistance(box) > radius2) continue;
    if (node.left != 0) {
      stack[depth++] = node.left + 1;
      stack[depth++] = node.left;
      continue;
    }
    if (!ranges.empty() && ranges.back().second == node.begin) {
      ranges.back().second = node.end;
    } else {
      ranges.emplace_back(node.begin, node.end);
    }
  }
}

int64_t PointIndex::NeighborDistanceBound(uint32_t leaf, int count) const {
  uint32_t n = leaf;
  while (nodes_[n].end - nodes_[n].begin <= static_cast<uint32_t>(count)) {
    if (n == 0) return std::numeric_limits<int32_t>::max();
    n = nodes_[n].parent;
  }
  int64_t square = 0;
  for (size_t a = 0; a < 3; ++a) {
    // Capped so that the square fits; the bound is only used below it.
    const int64_t edge = std::min<int64_t>(
        int64_t{nodes_[n].box.max[a]} - nodes_[n].box.min[a], int64_t{1} << 30);
    square += edge * edge;
  }
  return CeilRoot(square);
}

void GatheredBlock::Gather(const PointIndex& index, const IndexBox& box,
                           int64_t radius) {
  int64_t half2 = 0;
  for (size_t a = 0; a < 3; ++a) {
    center_[a] = box.min[a] + (box.max[a] - box.min[a]) / 2;
    const int64_t half = box.max[a] - center_[a];
    half2 += half * half;
  }
  half_diagonal_ = CeilRoot(half2);
  radius_ = radius;
  nearest_radius_ = radius;
  index.FindRanges(box, radius, ranges_);
  size_t total = 0;
  for (const auto& [begin, end] : ranges_) total += end - begin;
  x_.resize(total);
  y_.resize(total);
  z_.resize(total);
  ids_.resize(total);
  std::array<int64_t, 3> low;
  std::array<int64_t, 3> high;
  for (size_t a = 0; a < 3; ++a) {
    low[a] = box.min[a] - radius;
    high[a] = box.max[a] + radius;
  }
  // Branch-free: a point outside the grown box is overwritten by the next.
  size_t count = 0;
  for (const auto& [begin, end] : ranges_) {
    for (uint32_t i = begin; i < end; ++i) {
      const int32_t px = index.x()[i];
      const int32_t py = index.y()[i];
      const int32_t pz = index.z()[i];
      x_[count] = px - center_[0];
      y_[count] = py - center_[1];
      z_[count] = pz - center_[2];
      ids_[count] = i;
      count += static_cast<size_t>((px >= low[0]) & (px <= high[0]) &
                                   (py >= low[1]) & (py <= high[1]) &
                                   (pz >= low[2]) & (pz <= high[2]));
    }
  }
  x_.resize(count);
  y_.resize(count);
  z_.resize(count);
  ids_.resize(count);
}

int32_t GatheredBlock::CompleteWithin(int32_t x, int32_t y, int32_t z,
                                      int32_t limit_d2) const {
  const int64_t from_center =
      CeilRoot(int64_t{x} * x + int64_t{y} * y + int64_t{z} * z);
  const int64_t complete = std::min(radius_, nearest_radius_ + from_center);
  return static_cast<int32_t>(std::min<int64_t>(limit_d2, complete * complete));
}

KernelScratch GatheredBlock::scratch() {
  if (d2_.size() < ids_.size() + 1) {
    d2_.resize(ids_.size() + 1);
    members_.resize(ids_.size() + 1);
  }
  return {d2_.data(), members_.data()};
}

void GatheredBlock::KeepNearest(int neighbor_count) {
  const Kernels& kernels = ActiveKernels();
  const int count = static_cast<int>(ids_.size());
  const KernelScratch room = scratch();
  kernels.distances(block(), 0, 0, 0, room.d2);
  const int64_t bound = radius_ + half_diagonal_;
  const int32_t nearest2 = kernels.select(room.d2, count, neighbor_count + 1,
                                          static_cast<int32_t>(bound * bound));
  if (nearest2 == bound * bound) return;
  // A point p of the box sees neighbor_count + 1 points (itself among them)
  // within the centre's radius + |p|, so nothing farther from the centre than
  // that + |p| can be a neighbour.
  nearest_radius_ = CeilRoot(nearest2);
  const int64_t keep = nearest_radius_ + 2 * half_diagonal_;
  const int64_t keep2 = keep * keep;
  size_t kept = 0;
  for (size_t i = 0; i < ids_.size(); ++i) {
    x_[kept] = x_[i];
    y_[kept] = y_[i];
    z_[kept] = z_[i];
    ids_[kept] = ids_[i];
    kept += room.d2[i] <= keep2 ? 1 : 0;
  }
  x_.resize(kept);
  y_.resize(kept);
  z_.resize(kept);
  ids_.resize(kept);
}

}  // namespace mapsieve::core
