#ifndef MAPSIEVE_CORE_SPDF_POINT_INDEX_H_
#define MAPSIEVE_CORE_SPDF_POINT_INDEX_H_

#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "core/geometry/lattice.h"
#include "core/spdf/kernels.h"

namespace mapsieve::core {

/// Closed box of coordinates relative to an index's origin.
struct IndexBox {
  std::array<int32_t, 3> min;
  std::array<int32_t, 3> max;

  /// Squared distance of the two boxes; 0 if they touch.
  int64_t SquaredDistance(const IndexBox& other) const;
  void Extend(const IndexBox& other);
  /// Longest edge.
  int64_t Extent() const;
};

/// A binary tree over points that are sorted in Morton order: a node is a range
/// of points, split where the highest differing bit of their coordinates
/// changes, with their tight box. Immutable; thread-safe.
class PointIndex {
 public:
  static constexpr uint32_t kLeafSize = 32;

  struct Node {
    IndexBox box;
    uint32_t begin = 0;
    uint32_t end = 0;
    /// The right child follows the left one; 0 for a leaf.
    uint32_t left = 0;
    uint32_t parent = 0;
  };

  PointIndex() = default;
  /// Distinct points in Morton order, relative to `origin`.
  PointIndex(const LatticePoint& origin, std::vector<int32_t> x,
             std::vector<int32_t> y, std::vector<int32_t> z);

  size_t size() const { return x_.size(); }
  std::span<const Node> nodes() const { return nodes_; }
  /// Node numbers of the leaves, in point order.
  std::span<const uint32_t> leaves() const { return leaves_; }

  const std::vector<int32_t>& x() const { return x_; }
  const std::vector<int32_t>& y() const { return y_; }
  const std::vector<int32_t>& z() const { return z_; }
  IndexBox PointBox(uint32_t i) const {
    return {{x_[i], y_[i], z_[i]}, {x_[i], y_[i], z_[i]}};
  }

  using Range = std::pair<uint32_t, uint32_t>;
  /// Ranges [first, second), ascending and disjoint, that hold every point
  /// within `radius` steps of `box`, and others of the same leaves. Replaces
  /// the content of `ranges`.
  void FindRanges(const IndexBox& box, int64_t radius,
                  std::vector<Range>& ranges) const;

  /// An upper bound of the distance from any point of node `leaf` to its
  /// `count`-th nearest other point: the diagonal of the smallest ancestor
  /// with more than `count` points. INT32_MAX if the whole index has fewer.
  int64_t NeighborDistanceBound(uint32_t leaf, int count) const;

 private:
  void Build();

  LatticePoint origin_;
  std::vector<int32_t> x_;
  std::vector<int32_t> y_;
  std::vector<int32_t> z_;
  std::vector<Node> nodes_;
  std::vector<uint32_t> leaves_;
};

/// Candidates copied out of an index around a box of query points, relative to
/// its centre. Reused from one leaf to the next.
class GatheredBlock {
 public:
  /// Gathers every point within `radius` steps of `box`. Box extents are at
  /// most kMaxRadiusSteps.
  void Gather(const PointIndex& index, const IndexBox& box, int64_t radius);

  /// Drops candidates that cannot be among the `neighbor_count` nearest others
  /// of any point of the box, which hold at least one point of the index.
  void KeepNearest(int neighbor_count);

  /// A squared distance from the point at (x, y, z), relative to the centre,
  /// within which the block holds every point, and after KeepNearest
  /// neighbor_count others of it if `radius` does; at most `limit_d2`.
  int32_t CompleteWithin(int32_t x, int32_t y, int32_t z,
                         int32_t limit_d2) const;

  CandidateBlock block() const {
    return {x_.data(), y_.data(), z_.data(), static_cast<int>(ids_.size())};
  }
  /// Index positions of the candidates, ascending.
  const std::vector<uint32_t>& ids() const { return ids_; }
  KernelScratch scratch();
  /// Coordinates of index point `i` relative to the block's centre.
  std::array<int32_t, 3> Relative(const PointIndex& index, uint32_t i) const {
    return {index.x()[i] - center_[0], index.y()[i] - center_[1],
            index.z()[i] - center_[2]};
  }

 private:
  std::array<int32_t, 3> center_{};
  /// No point of the box is farther from the centre.
  int64_t half_diagonal_ = 0;
  int64_t radius_ = 0;
  /// As many points as KeepNearest keeps for the centre lie within it.
  int64_t nearest_radius_ = 0;
  std::vector<int32_t> x_;
  std::vector<int32_t> y_;
  std::vector<int32_t> z_;
  std::vector<uint32_t> ids_;
  std::vector<PointIndex::Range> ranges_;
  std::vector<int32_t> d2_;
  std::vector<int32_t> members_;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_POINT_INDEX_H_
