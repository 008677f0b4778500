#include "core/sampling/spatial_budget.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <queue>

#include "core/base/status.h"
#include "core/geometry/morton.h"

namespace mapsieve::core {
namespace {

/// Some milliseconds.
constexpr int64_t kStepsBetweenStops = 4096;

/// A cell, as the range of one label's points that it holds.
struct Cell {
  uint32_t begin;
  uint32_t end;
};

/// The fuller cell first, of equal ones the first in Morton order.
struct SplitsLater {
  bool operator()(const Cell& a, const Cell& b) const {
    const uint32_t size_a = a.end - a.begin;
    const uint32_t size_b = b.end - b.begin;
    return size_a != size_b ? size_a < size_b : a.begin > b.begin;
  }
};

/// Shares `budget` out to the labels in proportion to their points.
std::array<int64_t, kLabelCount> ShareBudget(const LabelCounts& counts,
                                             int64_t budget) {
  const int64_t total =
      std::accumulate(counts.begin(), counts.end(), int64_t{0});
  budget = std::min(budget, total);
  std::array<int64_t, kLabelCount> shares{};
  if (total == 0) return shares;
  int64_t left = budget;
  for (size_t l = 0; l < kLabelCount; ++l) {
    __extension__ using Wide = __int128;
    shares[l] = static_cast<int64_t>(Wide{budget} * counts[l] / total);
    left -= shares[l];
  }
  std::array<size_t, kLabelCount> by_size{};
  std::iota(by_size.begin(), by_size.end(), size_t{0});
  std::stable_sort(by_size.begin(), by_size.end(),
                   [&](size_t a, size_t b) { return counts[a] > counts[b]; });
  for (const size_t l : by_size) {
    const int64_t extra = std::min(left, counts[l] - shares[l]);
    shares[l] += extra;
    left -= extra;
  }
  return shares;
}

/// Shares `budget` out to the labels in proportion to `weights`, to none more
/// than its points.
std::array<int64_t, kLabelCount> ShareByWeights(const LabelCounts& counts,
                                                const LabelWeights& weights,
                                                int64_t budget) {
  std::array<int64_t, kLabelCount> shares{};
  LabelWeights open = weights;
  for (size_t l = 0; l < kLabelCount; ++l) {
    if (counts[l] == 0) open[l] = 0;
  }
  while (true) {
    const double total = std::accumulate(open.begin(), open.end(), 0.0);
    if (total == 0 || budget == 0) return shares;
    const auto share = [&](size_t l) {
      return static_cast<int64_t>(static_cast<double>(budget) * open[l] /
                                  total);
    };
    // A label that its share fills gives the others what is left.
    size_t filled = kLabelCount;
    for (size_t l = 0; l < kLabelCount; ++l) {
      if (open[l] > 0 && share(l) >= counts[l]) filled = l;
    }
    if (filled < kLabelCount) {
      shares[filled] = counts[filled];
      open[filled] = 0;
      budget -= counts[filled];
      continue;
    }
    int64_t left = budget;
    for (size_t l = 0; l < kLabelCount; ++l) {
      if (open[l] == 0) continue;
      shares[l] = share(l);
      left -= shares[l];
    }
    // Rounding left less than a point a label.
    for (size_t l = 0; l < kLabelCount; ++l) {
      const int64_t extra =
          open[l] > 0 ? std::min(left, counts[l] - shares[l]) : 0;
      shares[l] += extra;
      left -= extra;
    }
    return shares;
  }
}

/// The point of `cell` nearest to its centroid, the first of equals.
void TakeRepresentative(std::span<const LatticePoint> positions,
                        std::span<const uint32_t> rows, const Cell& cell,
                        BudgetSample& sample) {
  const LatticePoint& corner = positions[rows[cell.begin]];
  Point3 mean;
  for (uint32_t i = cell.begin; i < cell.end; ++i) {
    const LatticePoint& q = positions[rows[i]];
    mean.x += static_cast<double>(q.x - corner.x);
    mean.y += static_cast<double>(q.y - corner.y);
    mean.z += static_cast<double>(q.z - corner.z);
  }
  const auto count = static_cast<double>(cell.end - cell.begin);
  mean = {mean.x / count, mean.y / count, mean.z / count};
  double best = -1;
  uint32_t best_row = 0;
  for (uint32_t i = cell.begin; i < cell.end; ++i) {
    const LatticePoint& q = positions[rows[i]];
    const double dx = static_cast<double>(q.x - corner.x) - mean.x;
    const double dy = static_cast<double>(q.y - corner.y) - mean.y;
    const double dz = static_cast<double>(q.z - corner.z) - mean.z;
    const double d2 = dx * dx + dy * dy + dz * dz;
    if (best < 0 || d2 < best || (d2 == best && q < positions[best_row])) {
      best = d2;
      best_row = rows[i];
    }
  }
  sample.rows.push_back(best_row);
  sample.centroids.push_back({static_cast<double>(corner.x) + mean.x,
                              static_cast<double>(corner.y) + mean.y,
                              static_cast<double>(corner.z) + mean.z});
}

}  // namespace

absl::StatusOr<BudgetSample> SampleUnderBudget(
    std::span<const LatticePoint> positions, std::span<const Label> labels,
    int64_t budget, const std::optional<LabelWeights>& weights,
    std::stop_token stop) {
  if (positions.size() != labels.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat(positions.size(), " positions but ", labels.size(),
                     " labels; one label a point is needed"));
  }
  if (budget < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("the budget is ", budget, "; it must be 0 or above"));
  }
  LabelCounts counts{};
  for (const Label label : labels) ++counts[static_cast<size_t>(label)];
  const auto shares = weights.has_value()
                          ? ShareByWeights(counts, *weights, budget)
                          : ShareBudget(counts, budget);
  int64_t done = 0;
  const auto is_stopped = [&] {
    return ++done % kStepsBetweenStops == 0 && stop.stop_requested();
  };

  BudgetSample sample;
  for (size_t l = 0; l < kLabelCount; ++l) {
    if (shares[l] == 0) continue;
    std::vector<uint32_t> rows;
    rows.reserve(static_cast<size_t>(counts[l]));
    for (uint32_t i = 0; i < labels.size(); ++i) {
      if (static_cast<size_t>(labels[i]) == l) rows.push_back(i);
    }
    std::priority_queue<Cell, std::vector<Cell>, SplitsLater> cells;
    cells.push({0, static_cast<uint32_t>(rows.size())});
    while (static_cast<int64_t>(cells.size()) < shares[l]) {
      if (is_stopped()) return absl::CancelledError("cancelled");
      const Cell cell = cells.top();
      cells.pop();
      const uint32_t split = MortonSplit(
          cell.begin, cell.end, [&](uint32_t i) { return positions[rows[i]]; });
      cells.push({cell.begin, split});
      cells.push({split, cell.end});
    }
    for (; !cells.empty(); cells.pop()) {
      if (is_stopped()) return absl::CancelledError("cancelled");
      TakeRepresentative(positions, rows, cells.top(), sample);
    }
  }
  std::vector<uint32_t> order(sample.rows.size());
  std::iota(order.begin(), order.end(), uint32_t{0});
  std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) {
    return sample.rows[a] < sample.rows[b];
  });
  BudgetSample sorted;
  for (const uint32_t i : order) {
    sorted.rows.push_back(sample.rows[i]);
    sorted.centroids.push_back(sample.centroids[i]);
  }
  return sorted;
}

}  // namespace mapsieve::core
