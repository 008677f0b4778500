#ifndef MAPSIEVE_CORE_REGISTRATION_KD_TREE_H_
#define MAPSIEVE_CORE_REGISTRATION_KD_TREE_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "core/geometry/vector3.h"

namespace mapsieve::core {

/// Nearest neighbours among points anywhere in space, as clouds under
/// registration are; the filter's neighbours are found on the lattice.
/// Thread-safe.
class KdTree {
 public:
  struct Neighbor {
    uint32_t row = 0;
    double squared_distance = 0;
  };

  /// Most neighbours of one query.
  static constexpr size_t kMaxNeighborCount = 32;

  /// `points`: finite, fewer than 2^32, not copied: they must outlive the
  /// tree.
  explicit KdTree(std::span<const Vector3> points);
  ~KdTree();
  KdTree(const KdTree&) = delete;
  KdTree& operator=(const KdTree&) = delete;

  /// Writes the points nearest to `query`, ascending by distance, to
  /// `neighbors` (at most kMaxNeighborCount) and returns how many: fewer than
  /// its size only if there are no more. Which of several points at the same
  /// distance come is a function of the sequence of points.
  size_t FindNearest(const Vector3& query, std::span<Neighbor> neighbors) const;

 private:
  class Index;
  std::unique_ptr<const Index> index_;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_REGISTRATION_KD_TREE_H_
