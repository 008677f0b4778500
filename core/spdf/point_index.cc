#include "core/spdf/point_index.h"

#include <algorithm>
#include <numeric>

#include "core/geometry/morton.h"

namespace mapsieve::core {
namespace {

bool IsInside(const IndexBox& inner, const IndexBox& outer) {
  bool is_inside = true;
  for (size_t a = 0; a < 3; ++a) {
    is_inside &= outer.min[a] <= inner.min[a] && inner.max[a] <= outer.max[a];
  }
  return is_inside;
}

}  // namespace

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

void PointIndex::Resize(size_t size) {
  x_.resize(size + kKernelPadding);
  y_.resize(size + kKernelPadding);
  z_.resize(size + kKernelPadding);
  numbers_.resize(size);
}

void PointIndex::Reserve(size_t size) {
  x_.reserve(size + kKernelPadding);
  y_.reserve(size + kKernelPadding);
  z_.reserve(size + kKernelPadding);
  numbers_.reserve(size);
}

void PointIndex::Grow(size_t count, uint32_t first_number) {
  const size_t begin = numbers_.size();
  Resize(begin + count);
  std::iota(numbers_.begin() + static_cast<ptrdiff_t>(begin), numbers_.end(),
            first_number);
}

void PointIndex::Set(size_t begin, std::span<const LatticePoint> points) {
  for (const LatticePoint& point : points) {
    x_[begin] = static_cast<int32_t>(point.x - origin_.x);
    y_[begin] = static_cast<int32_t>(point.y - origin_.y);
    z_[begin] = static_cast<int32_t>(point.z - origin_.z);
    ++begin;
  }
}

void PointIndex::Append(int32_t x, int32_t y, int32_t z, uint32_t number) {
  const size_t i = numbers_.size();
  Resize(i + 1);
  x_[i] = x;
  y_[i] = y;
  z_[i] = z;
  numbers_[i] = number;
}

void PointIndex::Remove(uint32_t i) {
  x_[i] = kNowhere;
  uint32_t n = 0;
  while (true) {
    Node& node = nodes_[n];
    ++node.removed;
    if (node.is_leaf()) return;
    n = i < nodes_[node.right].begin ? n + 1 : node.right;
  }
}

uint32_t PointIndex::Split(uint32_t begin, uint32_t end) const {
  return MortonSplit(begin, end, [this](uint32_t i) { return Position(i); });
}

IndexBox PointIndex::BoxOf(uint32_t begin, uint32_t end) const {
  IndexBox box = PointBox(begin);
  // Axis by axis, several points at a time.
  size_t a = 0;
  for (const int32_t* const along : {x_.data(), y_.data(), z_.data()}) {
    int32_t min = along[begin];
    int32_t max = min;
    for (uint32_t i = begin + 1; i < end; ++i) {
      min = std::min(min, along[i]);
      max = std::max(max, along[i]);
    }
    box.min[a] = min;
    box.max[a++] = max;
  }
  return box;
}

IndexBox PointIndex::BoxOf(std::span<const uint32_t> points) const {
  if (points.back() - points.front() + 1 == points.size()) {
    return BoxOf(points.front(), points.back() + 1);
  }
  IndexBox box = PointBox(points[0]);
  for (const uint32_t i : points.subspan(1)) box.Extend(PointBox(i));
  return box;
}

void PointIndex::AppendTree(uint32_t begin, uint32_t end,
                            std::vector<Node>& nodes) const {
  const size_t n = nodes.size();
  nodes.push_back({.begin = begin, .end = end});
  if (end - begin <= kLeafSize) {
    nodes[n].box = BoxOf(begin, end);
    return;
  }
  const uint32_t split = Split(begin, end);
  AppendTree(begin, split, nodes);
  const size_t right = nodes.size();
  AppendTree(split, end, nodes);
  nodes[n].right = static_cast<uint32_t>(right);
  nodes[n].box = nodes[n + 1].box;
  nodes[n].box.Extend(nodes[right].box);
}

void PointIndex::Build(Executor& executor) {
  const auto size = static_cast<uint32_t>(numbers_.size());
  nodes_.clear();
  built_size_ = size;
  if (size == 0) return;
  // The upper tree down to parts that are built in parallel.
  constexpr uint32_t kPartSize = 1 << 15;
  struct Part {
    uint32_t begin;
    uint32_t end;
    std::vector<Node> nodes;
  };
  std::vector<Part> parts;
  const auto make_parts = [&](const auto& self, uint32_t begin,
                              uint32_t end) -> void {
    if (end - begin <= kPartSize) {
      parts.push_back({begin, end, {}});
      return;
    }
    const uint32_t split = Split(begin, end);
    self(self, begin, split);
    self(self, split, end);
  };
  make_parts(make_parts, 0, size);
  executor.ParallelFor(static_cast<int64_t>(parts.size()), [&](int64_t p) {
    Part& part = parts[static_cast<size_t>(p)];
    AppendTree(part.begin, part.end, part.nodes);
  });
  size_t node_count = 2 * parts.size();
  for (const Part& part : parts) node_count += part.nodes.size();
  nodes_.reserve(node_count);
  size_t next_part = 0;
  const auto append = [&](const auto& self, uint32_t begin,
                          uint32_t end) -> void {
    const auto n = static_cast<uint32_t>(nodes_.size());
    if (parts[next_part].begin == begin && parts[next_part].end == end) {
      for (Node node : parts[next_part].nodes) {
        if (node.right != 0) node.right += n;
        nodes_.push_back(node);
      }
      ++next_part;
      return;
    }
    nodes_.push_back({.begin = begin, .end = end});
    const uint32_t split = Split(begin, end);
    self(self, begin, split);
    const auto right = static_cast<uint32_t>(nodes_.size());
    self(self, split, end);
    nodes_[n].right = right;
    nodes_[n].box = nodes_[n + 1].box;
    nodes_[n].box.Extend(nodes_[right].box);
  };
  append(append, 0, size);
}

void PointIndex::FindRanges(const IndexBox& box,
                            std::vector<Range>& ranges) const {
  ranges.clear();
  if (nodes_.empty()) return;
  // Depth is at most one level per coordinate bit.
  std::array<uint32_t, 3 * 64 + 8> stack;
  size_t depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const uint32_t n = stack[--depth];
    const Node& node = nodes_[n];
    if (!node.box.Touches(box)) continue;
    if (!node.is_leaf() && !IsInside(node.box, box)) {
      stack[depth++] = node.right;
      stack[depth++] = n + 1;
      continue;
    }
    if (!ranges.empty() && ranges.back().second == node.begin) {
      ranges.back().second = node.end;
    } else {
      ranges.emplace_back(node.begin, node.end);
    }
  }
}

}  // namespace mapsieve::core
