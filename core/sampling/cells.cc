#include "core/sampling/cells.h"

#include <algorithm>

#include "core/geometry/point_hash.h"

namespace mapsieve::core {
namespace {

struct Choice {
  uint32_t row = 0;
  Point3 centroid;
};

/// The row of `rows` with the smallest key(row), of equals that of the first
/// point by coordinate.
template <typename Key>
uint32_t SmallestBy(std::span<const LatticePoint> positions,
                    std::span<const uint32_t> rows, const Key& key) {
  uint32_t best_row = rows[0];
  auto best = key(best_row);
  for (const uint32_t row : rows.subspan(1)) {
    const auto value = key(row);
    if (value < best ||
        (value == best && positions[row] < positions[best_row])) {
      best = value;
      best_row = row;
    }
  }
  return best_row;
}

/// Of `candidates`, some of `rows`, the one nearest to the mean of all.
Choice Nearest(std::span<const LatticePoint> positions,
               std::span<const uint32_t> rows,
               std::span<const uint32_t> candidates) {
  const LatticePoint& corner = positions[rows[0]];
  const auto relative = [&](uint32_t row) {
    const LatticePoint& q = positions[row];
    return Point3{static_cast<double>(q.x - corner.x),
                  static_cast<double>(q.y - corner.y),
                  static_cast<double>(q.z - corner.z)};
  };
  Point3 mean;
  for (const uint32_t row : rows) {
    const Point3 p = relative(row);
    mean.x += p.x;
    mean.y += p.y;
    mean.z += p.z;
  }
  const auto count = static_cast<double>(rows.size());
  mean = {mean.x / count, mean.y / count, mean.z / count};
  const uint32_t row = SmallestBy(positions, candidates, [&](uint32_t r) {
    const Point3 p = relative(r);
    const double dx = p.x - mean.x;
    const double dy = p.y - mean.y;
    const double dz = p.z - mean.z;
    return dx * dx + dy * dy + dz * dz;
  });
  return {row,
          {static_cast<double>(corner.x) + mean.x,
           static_cast<double>(corner.y) + mean.y,
           static_cast<double>(corner.z) + mean.z}};
}

std::vector<uint32_t> Surest(std::span<const uint16_t> confidences,
                             std::span<const uint32_t> rows) {
  std::vector<uint16_t> values;
  values.reserve(rows.size());
  for (const uint32_t row : rows) values.push_back(confidences[row]);
  const auto least =
      values.begin() + static_cast<ptrdiff_t>(3 * values.size() / 4);
  std::nth_element(values.begin(), least, values.end());
  std::vector<uint32_t> surest;
  for (const uint32_t row : rows) {
    if (confidences[row] >= *least) surest.push_back(row);
  }
  return surest;
}

}  // namespace

absl::StatusOr<CellSample> RepresentCells(
    std::span<const LatticePoint> positions, std::span<const uint32_t> order,
    std::span<const CellRange> cells, Representative kind, int64_t seed,
    const ExecutionContext& context, std::span<const uint16_t> confidences) {
  constexpr size_t kTaskCells = 4096;
  std::vector<Choice> choices(cells.size());
  ForEachPart(
      *context.executor, cells.size(), kTaskCells,
      [&](size_t, size_t begin, size_t end) {
        if (context.stop.stop_requested()) return;
        for (size_t i = begin; i < end; ++i) {
          const auto rows = order.subspan(cells[i].begin, cells[i].size());
          switch (kind) {
            case Representative::kFirst:
              choices[i].row = *std::min_element(rows.begin(), rows.end());
              break;
            case Representative::kRandom:
              choices[i].row = SmallestBy(positions, rows, [&](uint32_t row) {
                return PointHash(positions[row], seed);
              });
              break;
            case Representative::kCentroid:
            case Representative::kNearest:
              choices[i] = Nearest(positions, rows, rows);
              break;
            case Representative::kSurest:
              choices[i] = Nearest(positions, rows, Surest(confidences, rows));
              break;
          }
        }
      });
  MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
  std::sort(choices.begin(), choices.end(),
            [](const Choice& a, const Choice& b) { return a.row < b.row; });
  const bool has_centroids =
      kind != Representative::kFirst && kind != Representative::kRandom;
  CellSample sample;
  sample.rows.reserve(choices.size());
  if (has_centroids) sample.centroids.reserve(choices.size());
  for (const Choice& choice : choices) {
    sample.rows.push_back(choice.row);
    if (has_centroids) sample.centroids.push_back(choice.centroid);
  }
  return sample;
}

}  // namespace mapsieve::core
