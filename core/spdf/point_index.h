#ifndef MAPSIEVE_CORE_SPDF_POINT_INDEX_H_
#define MAPSIEVE_CORE_SPDF_POINT_INDEX_H_

#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "core/base/bulk_vector.h"
#include "core/base/executor.h"
#include "core/geometry/lattice.h"
#include "core/spdf/kernels.h"

namespace mapsieve::core {

/// Closed box of coordinates relative to an index's origin.
struct IndexBox {
  std::array<int32_t, 3> min;
  std::array<int32_t, 3> max;

  bool Touches(const IndexBox& other) const {
    bool touches = true;
    for (size_t a = 0; a < 3; ++a) {
      touches &= min[a] <= other.max[a] && other.min[a] <= max[a];
    }
    return touches;
  }
  void Extend(const IndexBox& other);
  /// Longest edge.
  int64_t Extent() const;
};

/// Points in Morton order, each with a number that the caller knows it by, and
/// a binary tree over them: a node is a range of points, split where the
/// highest differing bit of their coordinates changes, with their tight box.
/// Const methods are thread-safe.
class PointIndex {
 public:
  static constexpr uint32_t kLeafSize = 32;

  struct Node {
    IndexBox box;
    uint32_t begin = 0;
    uint32_t end = 0;
    /// The left child follows its parent; 0 for a leaf.
    uint32_t right = 0;

    /// How many of them were removed.
    uint32_t removed = 0;

    uint32_t size() const { return end - begin - removed; }
    bool is_leaf() const { return right == 0; }
  };

  /// Coordinates are at most so far from the origin.
  static constexpr int32_t kMaxCoordinate = (1 << 29) + (1 << 24);

  explicit PointIndex(const LatticePoint& origin) : origin_(origin) {}

  void Reserve(size_t size);
  /// Adds `count` points without coordinates, numbered from `first_number` on.
  void Grow(size_t count, uint32_t first_number);
  /// Sets points [begin, begin + points.size()): distinct from the others and
  /// in Morton order, coordinates up to kMaxCoordinate. Different
  /// points may be set at once from several threads. To be followed by Build.
  void Set(size_t begin, std::span<const LatticePoint> points);
  /// Adds a point after the others in Morton order. To be followed by Build.
  void Append(int32_t x, int32_t y, int32_t z, uint32_t number);

  /// Builds the tree; the same for any executor.
  void Build(Executor& executor);

  /// Makes a point one that no gathering finds and no node counts; its place
  /// stays until the next Filter.
  void Remove(uint32_t i);
  size_t removed_count() const {
    return nodes_.empty() ? 0 : nodes_[0].removed;
  }

  /// Keeps the points with keep(number); the others, but not those that were
  /// removed before, go to removed(x, y, z, number), coordinates relative to
  /// the origin. The tree is built anew only when much is gone: a node may be
  /// empty, and its box wider than its points ask for. To be preceded by Build.
  template <typename Keep, typename Removed>
  void Filter(Executor& executor, const Keep& keep, const Removed& removed);

  /// Places of points, removed ones included.
  size_t size() const { return numbers_.size(); }
  const LatticePoint& origin() const { return origin_; }
  /// The caller's number of each point.
  std::span<const uint32_t> numbers() const { return numbers_; }
  LatticePoint Position(uint32_t i) const {
    return {origin_.x + x_[i], origin_.y + y_[i], origin_.z + z_[i]};
  }
  std::array<int32_t, 3> Coordinates(uint32_t i) const {
    return {x_[i], y_[i], z_[i]};
  }
  IndexBox PointBox(uint32_t i) const {
    return {{x_[i], y_[i], z_[i]}, {x_[i], y_[i], z_[i]}};
  }
  /// The tight box of some points, at least one, in ascending order.
  IndexBox BoxOf(std::span<const uint32_t> points) const;
  /// Coordinates of all points, padded for kernels.
  GatherSource source() const { return {x_.data(), y_.data(), z_.data()}; }

  /// Every node before its children, left before right; the first is the root.
  /// Empty for no points.
  std::span<const Node> nodes() const { return nodes_; }

  using Range = std::pair<uint32_t, uint32_t>;
  /// Ranges [first, second), ascending and disjoint, that hold every point
  /// of `box`, and others of the same leaves. Replaces the content of `ranges`.
  void FindRanges(const IndexBox& box, std::vector<Range>& ranges) const;

 private:
  /// x of a removed point: farther from any other than a block reaches, with
  /// differences that fit int32.
  static constexpr int32_t kNowhere = 5 * (kMaxCoordinate / 2);

  void Resize(size_t size);
  uint32_t Split(uint32_t begin, uint32_t end) const;
  IndexBox BoxOf(uint32_t begin, uint32_t end) const;
  /// Appends the tree over [begin, end) to `nodes`.
  void AppendTree(uint32_t begin, uint32_t end, std::vector<Node>& nodes) const;

  LatticePoint origin_;
  /// Points at the last Build.
  size_t built_size_ = 0;
  // Coordinates hold kKernelPadding values more than there are points.
  BulkVector<int32_t> x_;
  BulkVector<int32_t> y_;
  BulkVector<int32_t> z_;
  BulkVector<uint32_t> numbers_;
  BulkVector<Node> nodes_;
};

template <typename Keep, typename Removed>
void PointIndex::Filter(Executor& executor, const Keep& keep,
                        const Removed& removed) {
  uint32_t kept = 0;
  for (Node& node : nodes_) {
    const uint32_t begin = node.begin;
    node.begin = kept;
    node.removed = 0;
    if (!node.is_leaf()) continue;
    for (uint32_t i = begin; i < node.end; ++i) {
      if (x_[i] == kNowhere) continue;
      if (!keep(numbers_[i])) {
        removed(x_[i], y_[i], z_[i], numbers_[i]);
        continue;
      }
      x_[kept] = x_[i];
      y_[kept] = y_[i];
      z_[kept] = z_[i];
      numbers_[kept++] = numbers_[i];
    }
    node.end = kept;
  }
  for (auto node = nodes_.rbegin(); node != nodes_.rend(); ++node) {
    if (!node->is_leaf()) node->end = nodes_[node->right].end;
  }
  Resize(kept);
  if (kept < built_size_ / 4 * 3) Build(executor);
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_POINT_INDEX_H_
