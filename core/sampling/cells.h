#ifndef MAPSIEVE_CORE_SAMPLING_CELLS_H_
#define MAPSIEVE_CORE_SAMPLING_CELLS_H_

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <queue>
#include <span>
#include <stop_token>
#include <type_traits>
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
  /// Of the surest points the one nearest to the mean of all. The surest are
  /// the quarter, rounded up, with the largest confidences, and those that have
  /// the least of these.
  kSurest,
};

/// `length_m` map units in lattice steps, to a nanometre: whole numbers of
/// steps come out whole.
inline double LengthInSteps(double length_m, const Lattice& lattice) {
  return std::nearbyint(length_m * 1e9) /
         static_cast<double>(lattice.step_nm());
}

/// Points chosen, one a cell.
struct CellSample {
  /// Rows of the input, ascending.
  std::vector<uint32_t> rows;
  /// For each row, the mean of the points that it stands for, in steps; only
  /// for kCentroid, kNearest and kSurest.
  std::vector<Point3> centroids;
};

/// The representatives of `cells`, which are parts of `order`, an order of rows
/// of `positions`. The choice depends on the points of a cell alone, not on
/// their order, if rows are in Morton order; `seed` is that of kRandom. Ties
/// are broken by coordinate. kSurest needs `confidences`, one a row (of
/// LabelColumns). kCancelled.
absl::StatusOr<CellSample> RepresentCells(
    std::span<const LatticePoint> positions, std::span<const uint32_t> order,
    std::span<const CellRange> cells, Representative kind, int64_t seed,
    const ExecutionContext& context,
    std::span<const uint16_t> confidences = {});

/// Splits the points [0, size), at least one, in cells: the cell of largest
/// `measure`, of equal ones the first, again and again, until there are
/// `max_cells` of them or no measure is above `max_measure`.
/// `measure(cell)` gives a number that is above max_measure only for cells of
/// two points or more, `split(cell)` the point where to split such a cell,
/// inside it. kCancelled.
template <typename Measure, typename Split>
absl::StatusOr<std::vector<CellRange>> SplitLargest(
    uint32_t size, int64_t max_cells,
    std::invoke_result_t<Measure, CellRange> max_measure,
    const Measure& measure, const Split& split, const std::stop_token& stop) {
  // Some milliseconds.
  constexpr size_t kSplitsBetweenStops = 4096;
  struct Measured {
    std::invoke_result_t<Measure, CellRange> measure;
    CellRange cell;
    bool operator<(const Measured& other) const {
      return measure != other.measure ? measure < other.measure
                                      : cell.begin > other.cell.begin;
    }
  };
  std::priority_queue<Measured> queue;
  const auto push = [&](const CellRange& cell) {
    queue.push({measure(cell), cell});
  };
  push({0, size});
  while (static_cast<int64_t>(queue.size()) < max_cells &&
         queue.top().measure > max_measure) {
    if (queue.size() % kSplitsBetweenStops == 0 && stop.stop_requested()) {
      return absl::CancelledError("cancelled");
    }
    const CellRange cell = queue.top().cell;
    queue.pop();
    const uint32_t middle = split(cell);
    push({cell.begin, middle});
    push({middle, cell.end});
  }
  std::vector<CellRange> cells;
  cells.reserve(queue.size());
  for (; !queue.empty(); queue.pop()) cells.push_back(queue.top().cell);
  return cells;
}

/// The same for the fullest cell, until none has more than `max_points`.
template <typename Split>
absl::StatusOr<std::vector<CellRange>> SplitFullest(
    uint32_t size, int64_t max_cells, int64_t max_points, const Split& split,
    const std::stop_token& stop) {
  return SplitLargest(
      size, max_cells, std::max<int64_t>(max_points, 1),
      [](const CellRange& cell) { return int64_t{cell.size()}; }, split, stop);
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_CELLS_H_
