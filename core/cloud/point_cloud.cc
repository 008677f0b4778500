#include "core/cloud/point_cloud.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/base/bulk_vector.h"

namespace mapsieve::core {

LatticeCloud LatticeCloud::Select(std::span<const uint32_t> rows) const {
  LatticeCloud result{.lattice = lattice};
  result.positions.reserve(rows.size());
  for (const uint32_t row : rows) result.positions.push_back(positions[row]);
  result.attributes = attributes.Select(rows);
  return result;
}

LatticeCloud Quantize(PointCloud cloud, const Lattice& lattice,
                      RefusedCounts& refused, Executor& executor) {
  constexpr size_t kTaskRows = 1 << 14;
  const size_t size = cloud.size();
  LatticeCloud result{.lattice = lattice};
  ReserveBulk(result.positions, size);
  result.positions.resize(size);
  // Rows that were refused, of each part.
  std::vector<std::vector<uint32_t>> refused_rows(PartCount(size, kTaskRows));
  ForEachPart(executor, size, kTaskRows,
              [&](size_t part, size_t begin, size_t end) {
                for (size_t i = begin; i < end; ++i) {
                  const auto q = lattice.Quantize(cloud.positions[i]);
                  if (q.has_value()) {
                    result.positions[i] = *q;
                  } else {
                    refused_rows[part].push_back(static_cast<uint32_t>(i));
                  }
                }
              });
  std::vector<uint32_t> kept;
  uint32_t next = 0;
  for (const std::vector<uint32_t>& rows : refused_rows) {
    for (const uint32_t row : rows) {
      for (; next < row; ++next) kept.push_back(next);
      ++next;
      const Point3& p = cloud.positions[row];
      if (std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z)) {
        ++refused.out_of_lattice;
      } else {
        ++refused.non_finite;
      }
    }
  }
  result.attributes = std::move(cloud.attributes);
  if (next == 0) return result;
  for (; next < size; ++next) kept.push_back(next);
  return result.Select(kept);
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
