#include "core/sampling/spatial_budget.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <utility>
#include <vector>

#include "core/base/status.h"
#include "core/geometry/morton.h"

namespace mapsieve::core {
namespace {

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

/// log2 of the volume of the smallest octree cell, or half or quarter of one,
/// around a range in Morton order with these ends.
int LogVolume(const LatticePoint& first, const LatticePoint& last) {
  const MortonBit highest = HighestMortonBit(first, last);
  return 3 * highest.bit + (highest.axis == &LatticePoint::x   ? 1
                            : highest.axis == &LatticePoint::y ? 2
                                                               : 3);
}

}  // namespace

absl::StatusOr<CellSample> SampleUnderBudget(
    std::span<const LatticePoint> positions, std::span<const Label> labels,
    int64_t budget, const std::optional<LabelWeights>& weights,
    std::stop_token stop, CellSplit split,
    std::span<const uint16_t> confidences) {
  if (positions.size() != labels.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat(positions.size(), " positions but ", labels.size(),
                     " labels; one label a point is needed"));
  }
  if (!confidences.empty() && confidences.size() != positions.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat(positions.size(), " positions but ", confidences.size(),
                     " confidences; one a point is needed, or none"));
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
  // Cells of all labels, as parts of `order`.
  std::vector<uint32_t> order;
  std::vector<CellRange> cells;
  order.reserve(positions.size());
  for (size_t l = 0; l < kLabelCount; ++l) {
    if (shares[l] == 0) continue;
    const auto first = static_cast<uint32_t>(order.size());
    for (uint32_t i = 0; i < labels.size(); ++i) {
      if (static_cast<size_t>(labels[i]) == l) order.push_back(i);
    }
    const std::span<const uint32_t> rows = std::span(order).subspan(first);
    const auto point = [&](uint32_t i) { return positions[rows[i]]; };
    const auto measure = [&](const CellRange& cell) {
      if (cell.size() == 1) return 0.0;
      const auto count = static_cast<double>(cell.size());
      if (split == CellSplit::kFullest) return count;
      // Its cube: no root is needed, and a power of two rounds nothing.
      const int volume_power = split == CellSplit::kWidest ? 2 : 1;
      return std::ldexp(
          count * count * count,
          volume_power * LogVolume(point(cell.begin), point(cell.end - 1)));
    };
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<CellRange> of_label,
        SplitLargest(
            static_cast<uint32_t>(rows.size()), shares[l], 0.0, measure,
            [&](const CellRange& cell) {
              return MortonSplit(cell.begin, cell.end, point);
            },
            stop));
    for (const CellRange& cell : of_label) {
      cells.push_back({first + cell.begin, first + cell.end});
    }
  }
  return RepresentCells(
      positions, order, cells,
      confidences.empty() ? Representative::kNearest : Representative::kSurest,
      0, {.stop = std::move(stop)}, confidences);
}

}  // namespace mapsieve::core
