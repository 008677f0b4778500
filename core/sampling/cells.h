#ifndef MAPSIEVE_CORE_SAMPLING_CELLS_H_
#define MAPSIEVE_CORE_SAMPLING_CELLS_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <queue>
#include <span>
#include <stop_token>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/base/status.h"
#include "core/geometry/lattice.h"

/// What the samplers share that divide points into cells and keep one point of
/// each.
namespace mapsieve::core {

/// The points of a cell: a part [begin, end) of an order, at least one.
struct CellRange {
  uint32_t begin = 0;
  uint32_t end = 0;

  uint32_t size() const { return end - begin; }
  friend bool operator==(const CellRange&, const CellRange&) = default;
};

/// Which point stands for those of its cell.
enum class Representative : uint8_t {
  /// The first in Morton order, which is nearest to the cell's lowest corner.
  kFirst = 1,
  /// One drawn at random.
  kRandom,
  /// The mean of all, with the attributes of the point nearest to it: nominal
  /// attributes have no mean.
  kCentroid,
  /// The point nearest to the mean. It has the smallest sum of squared
  /// distances to the others: it is their medoid.
  kNearest,
};

/// Points chosen, one a cell.
struct CellSample {
  /// Rows of the input, ascending.
  std::vector<uint32_t> rows;
  /// For each row, the mean of the points that it stands for, in steps; only
  /// for kCentroid and kNearest.
  std::vector<Point3> centroids;
};

/// The representatives of `cells`, which are parts of `order`, an order of rows
/// of `positions`. The choice depends on the points of a cell alone, not on
/// their order, if rows are in Morton order; `seed` is that of kRandom. Ties
/// are broken by coordinate. kCancelled.
absl::StatusOr<CellSample> RepresentCells(
    std::span<const LatticePoint> positions, std::span<const uint32_t> order,
    std::span<const CellRange> cells, Representative kind, int64_t seed,
    const ExecutionContext& context);

/// Splits the points [0, size), at least one, in cells: the fullest cell, of
/// equal ones the first, again and again, until there are `max_cells` of them
/// or none has more than `max_points`. `split(cell)` gives the point where to
/// split a cell of two points or more, inside it. kCancelled.
template <typename Split>
absl::StatusOr<std::vector<CellRange>> SplitFullest(
    uint32_t size, int64_t max_cells, int64_t max_points, const Split& split,
    const std::stop_token& stop) {
  // Some milliseconds.
  constexpr size_t kSplitsBetweenStops = 4096;
  const auto is_split_later = [](const CellRange& a, const CellRange& b) {
    return a.size() != b.size() ? a.size() < b.size() : a.begin > b.begin;
  };
  std::priority_queue<CellRange, std::vector<CellRange>,
                      decltype(is_split_later)>
      queue(is_split_later);
  queue.push({0, size});
  while (static_cast<int64_t>(queue.size()) < max_cells &&
         queue.top().size() > std::max<int64_t>(max_points, 1)) {
    if (queue.size() % kSplitsBetweenStops == 0 && stop.stop_requested()) {
      return absl::CancelledError("cancelled");
    }
    const CellRange cell = queue.top();
    queue.pop();
    const uint32_t middle = split(cell);
    queue.push({cell.begin, middle});
    queue.push({middle, cell.end});
  }
  std::vector<CellRange> cells;
  cells.reserve(queue.size());
  for (; !queue.empty(); queue.pop()) cells.push_back(queue.top());
  return cells;
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_CELLS_H_
