#include "tests/bench/nanoflann_pass.h"

#include <cstddef>
#include <cstdint>
#include <nanoflann.hpp>

namespace mapsieve::bench {
namespace {

struct Points {
  const std::vector<std::array<float, 3>>& points;

  size_t kdtree_get_point_count() const { return points.size(); }
  float kdtree_get_pt(size_t i, size_t axis) const { return points[i][axis]; }
  template <typename Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};

}  // namespace

double NanoflannPass(const std::vector<std::array<float, 3>>& points,
                     int neighbor_count) {
  using Tree = nanoflann::KDTreeSingleIndexAdaptor<
      nanoflann::L2_Simple_Adaptor<float, Points>, Points, 3, uint32_t>;
  const Points adaptor{points};
  const Tree tree(3, adaptor, {16});
  const auto wanted = static_cast<size_t>(neighbor_count);
  std::vector<uint32_t> ids(wanted);
  std::vector<float> d2(wanted);
  double sum = 0;
  for (const std::array<float, 3>& point : points) {
    const size_t found =
        tree.knnSearch(point.data(), wanted, ids.data(), d2.data());
    if (found > 0) sum += static_cast<double>(d2[found - 1]);
  }
  return sum;
}

}  // namespace mapsieve::bench
