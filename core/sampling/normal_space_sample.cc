#include "core/sampling/normal_space_sample.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include "core/geometry/point_hash.h"

namespace mapsieve::core {
namespace {

/// Odd: an axis, around which the normals of floors and walls scatter, is in
/// the midst of a cell.
constexpr int kFaceCells = 17;
static_assert(kAxisCellCount == 3 * kFaceCells * kFaceCells);

/// The number, below kFaceCells, of the cell of a coordinate -1 to 1 on a face.
size_t CellOnFace(double u) {
  // 4/π atan(u) to 0.002: equal steps of it are nearly equal angles.
  const double a = std::abs(u);
  const double share = a * (1 + (1 - a) * (0.3116 + 0.0844 * a));
  const double along = (u < 0 ? 1 - share : 1 + share) * (kFaceCells / 2.0);
  return static_cast<size_t>(
      std::clamp(static_cast<int>(along), 0, kFaceCells - 1));
}

struct Candidate {
  /// How many points of its cell come before it.
  uint32_t rank = 0;
  uint64_t hash = 0;
  uint32_t row = 0;
};

}  // namespace

size_t AxisCell(const std::array<float, 3>& normal) {
  size_t face = 0;
  for (size_t a = 1; a < 3; ++a) {
    if (std::abs(normal[a]) > std::abs(normal[face])) face = a;
  }
  const double length = normal[face];
  const size_t u = CellOnFace(normal[(face + 1) % 3] / length);
  const size_t v = CellOnFace(normal[(face + 2) % 3] / length);
  return (face * kFaceCells + u) * kFaceCells + v;
}

std::vector<uint32_t> SampleNormalSpace(
    std::span<const LatticePoint> positions,
    std::span<const std::array<float, 3>> normals, int64_t count,
    int64_t seed) {
  // Points without a normal are in a cell of their own.
  std::array<std::vector<Candidate>, kAxisCellCount + 1> cells;
  for (uint32_t row = 0; row < positions.size(); ++row) {
    const std::array<float, 3>& n = normals[row];
    const bool has_normal = n != std::array<float, 3>{};
    cells[has_normal ? AxisCell(n) : kAxisCellCount].push_back(
        {0, PointHash(positions[row], seed), row});
  }
  const auto is_before = [&](const Candidate& a, const Candidate& b) {
    return std::tie(a.rank, a.hash, positions[a.row]) <
           std::tie(b.rank, b.hash, positions[b.row]);
  };
  // The first of every cell, then the second of every cell, and so on.
  std::vector<Candidate> all;
  all.reserve(positions.size());
  for (size_t c = 0; c < cells.size(); ++c) {
    std::sort(cells[c].begin(), cells[c].end(), is_before);
    uint32_t rank = 0;
    for (Candidate candidate : cells[c]) {
      candidate.rank =
          c == kAxisCellCount ? std::numeric_limits<uint32_t>::max() : rank++;
      all.push_back(candidate);
    }
    cells[c] = {};
  }
  const size_t kept = std::min(static_cast<size_t>(count), all.size());
  std::nth_element(all.begin(), all.begin() + static_cast<ptrdiff_t>(kept),
                   all.end(), is_before);
  std::vector<uint32_t> rows;
  rows.reserve(kept);
  for (size_t i = 0; i < kept; ++i) rows.push_back(all[i].row);
  std::sort(rows.begin(), rows.end());
  return rows;
}

}  // namespace mapsieve::core
