#include "core/registration/kd_tree.h"

#include <algorithm>
#include <array>
#include <nanoflann.hpp>

namespace mapsieve::core {
namespace {

struct Points {
  std::span<const Vector3> points;

  size_t kdtree_get_point_count() const { return points.size(); }
  double kdtree_get_pt(size_t i, size_t axis) const { return points[i][axis]; }
  template <typename Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};

using Tree = nanoflann::KDTreeSingleIndexAdaptor<
    nanoflann::L2_Simple_Adaptor<double, Points>, Points, 3, uint32_t>;

}  // namespace

class KdTree::Index {
 public:
  explicit Index(std::span<const Vector3> points)
      : points_{points}, tree_(3, points_) {}

  const Tree& tree() const { return tree_; }

 private:
  Points points_;
  Tree tree_;
};

KdTree::KdTree(std::span<const Vector3> points)
    : index_(std::make_unique<Index>(points)) {}

KdTree::~KdTree() = default;

size_t KdTree::FindNearest(const Vector3& query,
                           std::span<Neighbor> neighbors) const {
  std::array<uint32_t, kMaxNeighborCount> rows;
  std::array<double, kMaxNeighborCount> squared_distances;
  const size_t found = index_->tree().knnSearch(
      query.data(), std::min(neighbors.size(), kMaxNeighborCount), rows.data(),
      squared_distances.data());
  for (size_t i = 0; i < found; ++i) {
    neighbors[i] = {rows[i], squared_distances[i]};
  }
  return found;
}

}  // namespace mapsieve::core
