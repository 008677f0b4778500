#include "core/sampling/surface_sample.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <numeric>
#include <utility>

#include "core/spdf/kernels.h"

namespace mapsieve::core {
namespace {

constexpr int64_t LatticePoint::*kAxes[] = {&LatticePoint::x, &LatticePoint::y,
                                            &LatticePoint::z};

/// Halves the rows at their median along the widest axis.
void SplitAtMedian(std::span<const LatticePoint> positions,
                   std::span<uint32_t> rows) {
  int64_t LatticePoint::*widest = nullptr;
  int64_t width = -1;
  for (const auto axis : kAxes) {
    int64_t low = positions[rows[0]].*axis;
    int64_t high = low;
    for (const uint32_t row : rows) {
      low = std::min(low, positions[row].*axis);
      high = std::max(high, positions[row].*axis);
    }
    if (high - low > width) {
      width = high - low;
      widest = axis;
    }
  }
  std::nth_element(rows.begin(),
                   rows.begin() + static_cast<ptrdiff_t>(rows.size() / 2),
                   rows.end(), [&](uint32_t a, uint32_t b) {
                     const LatticePoint& p = positions[a];
                     const LatticePoint& q = positions[b];
                     return std::pair(p.*widest, p) < std::pair(q.*widest, q);
                   });
}

/// Writes the covariance of some points, in steps², to place `lane`.
void SetCovariance(std::span<const LatticePoint> positions,
                   std::span<const uint32_t> rows, EigenBatch& batch,
                   size_t lane) {
  const LatticePoint& corner = positions[rows[0]];
  const auto relative = [&](uint32_t row) {
    const LatticePoint& q = positions[row];
    return Vector3{static_cast<double>(q.x - corner.x),
                   static_cast<double>(q.y - corner.y),
                   static_cast<double>(q.z - corner.z)};
  };
  const auto count = static_cast<double>(rows.size());
  Vector3 mean{};
  for (const uint32_t row : rows) {
    const Vector3 p = relative(row);
    for (size_t a = 0; a < 3; ++a) mean[a] += p[a];
  }
  for (double& m : mean) m /= count;
  std::array<double, 6> sum{};
  for (const uint32_t row : rows) {
    Vector3 p = relative(row);
    for (size_t a = 0; a < 3; ++a) p[a] -= mean[a];
    size_t entry = 0;
    for (size_t a = 0; a < 3; ++a) {
      for (size_t b = a; b < 3; ++b) sum[entry++] += p[a] * p[b];
    }
  }
  for (size_t e = 0; e < sum.size(); ++e) batch.entry[e][lane] = sum[e] / count;
}

/// The axis of the smallest eigenvalue, or zero if the next is as good as zero.
Vector3 NormalOf(const EigenBatch& batch, size_t lane) {
  std::array<size_t, 3> order = {0, 1, 2};
  std::sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return batch.value[a][lane] < batch.value[b][lane];
  });
  constexpr double kRankTolerance = 1e-12;
  if (!(batch.value[order[1]][lane] >
        kRankTolerance * batch.value[order[2]][lane])) {
    return {};
  }
  Vector3 normal;
  for (size_t a = 0; a < 3; ++a) normal[a] = batch.vector[order[0]][a][lane];
  return WithCanonicalSign(normal);
}

}  // namespace

absl::StatusOr<SurfaceSample> SampleSurfaces(
    std::span<const LatticePoint> positions, int64_t max_cells,
    int64_t max_points, Representative representative, int64_t seed,
    const ExecutionContext& context) {
  SurfaceSample sample;
  if (positions.empty()) return sample;
  std::vector<uint32_t> order(positions.size());
  std::iota(order.begin(), order.end(), uint32_t{0});
  const auto rows_of = [&](const CellRange& cell) {
    return std::span(order).subspan(cell.begin, cell.size());
  };
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<CellRange> cells,
      SplitFullest(
          static_cast<uint32_t>(positions.size()), max_cells, max_points,
          [&](const CellRange& cell) {
            SplitAtMedian(positions, rows_of(cell));
            return cell.begin + cell.size() / 2;
          },
          context.stop));
  // The order that nth_element leaves is the library's: sums do not see it.
  std::vector<uint32_t> cell_of(positions.size());
  for (uint32_t c = 0; c < cells.size(); ++c) {
    const std::span<uint32_t> rows = rows_of(cells[c]);
    std::sort(rows.begin(), rows.end());
    for (const uint32_t row : rows) cell_of[row] = c;
    sample.largest_cell =
        std::max<int64_t>(sample.largest_cell, cells[c].size());
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      sample.points,
      RepresentCells(positions, order, cells, representative, seed, context));
  const std::vector<uint32_t>& rows = sample.points.rows;
  sample.normals.resize(rows.size());
  ForEachPart(*context.executor, rows.size(), EigenBatch::kSize,
              [&](size_t, size_t begin, size_t end) {
                EigenBatch batch;
                for (size_t i = begin; i < end; ++i) {
                  SetCovariance(positions, rows_of(cells[cell_of[rows[i]]]),
                                batch, i - begin);
                }
                ActiveKernels().decompose(&batch);
                for (size_t i = begin; i < end; ++i) {
                  sample.normals[i] = NormalOf(batch, i - begin);
                }
              });
  return sample;
}

}  // namespace mapsieve::core
