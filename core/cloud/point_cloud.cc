#include "core/cloud/point_cloud.h"

#include <cmath>
#include <optional>
#include <utility>

namespace mapsieve::core {

LatticeCloud LatticeCloud::Select(std::span<const uint32_t> rows) const {
  LatticeCloud result{.lattice = lattice};
  result.positions.reserve(rows.size());
  for (const uint32_t row : rows) result.positions.push_back(positions[row]);
  result.attributes = attributes.Select(rows);
  return result;
}

LatticeCloud Quantize(const PointCloud& cloud, const Lattice& lattice,
                      RefusedCounts& refused) {
  LatticeCloud result{.lattice = lattice};
  std::vector<uint32_t> rows;
  rows.reserve(cloud.size());
  result.positions.reserve(cloud.size());
  for (size_t i = 0; i < cloud.size(); ++i) {
    const Point3& p = cloud.positions[i];
    const std::optional<LatticePoint> q = lattice.Quantize(p);
    if (q.has_value()) {
      result.positions.push_back(*q);
      rows.push_back(static_cast<uint32_t>(i));
    } else if (std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z)) {
      ++refused.out_of_lattice;
    } else {
      ++refused.non_finite;
    }
  }
  result.attributes = rows.size() == cloud.size()
                          ? cloud.attributes
                          : cloud.attributes.Select(rows);
  return result;
}

PointCloud ToPointCloud(const LatticeCloud& cloud) {
  PointCloud result;
  result.positions.reserve(cloud.size());
  for (const LatticePoint& q : cloud.positions) {
    result.positions.push_back(cloud.lattice.Position(q));
  }
  result.attributes = cloud.attributes;
  return result;
}

}  // namespace mapsieve::core
