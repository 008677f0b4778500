#include "client/lab/view_sample.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/base/hash.h"

namespace mapsieve::client {
namespace {

// The range without the `cut` lowest and the `cut` highest values.
Range CutRange(std::vector<double>& values, size_t cut) {
  const auto low = values.begin() + static_cast<ptrdiff_t>(cut);
  const auto high = values.end() - 1 - static_cast<ptrdiff_t>(cut);
  std::nth_element(values.begin(), low, values.end());
  const double min = *low;
  std::nth_element(values.begin(), high, values.end());
  return {min, *high};
}

}  // namespace

Range Range::Union(const Range& other) const {
  return {std::min(min, other.min), std::max(max, other.max)};
}

Range RobustRange(std::vector<double>& values) {
  constexpr size_t kFewest = 16;
  constexpr size_t kOneOf = 200;
  if (values.size() < kFewest) return CutRange(values, 0);
  const size_t cut = std::max<size_t>(values.size() / kOneOf, 1);
  const Range bulk = CutRange(values, cut);
  const double margin = bulk.length() / 2;
  const Range near = {bulk.min - margin, bulk.max + margin};
  Range range = bulk;
  for (const double value : values) {
    if (near.Contains(value)) range = range.Union({value, value});
  }
  return range;
}

Range TrimmedRange(std::vector<double>& values, double fraction) {
  return CutRange(values, static_cast<size_t>(
                              fraction * static_cast<double>(values.size())));
}

void ViewSample::Add(const ViewPoint& point) {
  const std::array<int64_t, 1> key = {point_count_++};
  const uint64_t hash = HashIntegers(key);
  if ((hash & mask_) != 0) return;
  if (points_.size() == capacity_) {
    mask_ = mask_ << 1 | 1;
    size_t kept = 0;
    for (size_t i = 0; i < points_.size(); ++i) {
      if ((hashes_[i] & mask_) != 0) continue;
      points_[kept] = points_[i];
      hashes_[kept++] = hashes_[i];
    }
    points_.resize(kept);
    hashes_.resize(kept);
    if ((hash & mask_) != 0) return;
  }
  points_.push_back(point);
  hashes_.push_back(hash);
}

double ViewSample::CoveredArea(const Range& u, const Range& v) const {
  // Cells that hold this many points on average are rarely empty by chance
  // where there is a surface, and still follow its outline.
  constexpr double kPointsPerCell = 8;
  const double area = u.length() * v.length();
  if (!(area > 0)) return 0;
  const double cell_count =
      std::max(static_cast<double>(points_.size()) / kPointsPerCell, 1.0);
  const double edge = std::sqrt(area / cell_count);
  // A strip much narrower than its length has one row of long cells.
  const auto cells = [&](const Range& range) {
    return std::clamp(std::floor(range.length() / edge), 1.0, cell_count);
  };
  const double columns = cells(u);
  const double rows = cells(v);
  std::vector<bool> occupied(static_cast<size_t>(columns * rows));
  const auto cell = [](double x, const Range& range, double count) {
    return std::min(std::floor((x - range.min) / range.length() * count),
                    count - 1);
  };
  for (const ViewPoint& point : points_) {
    if (!u.Contains(point.u) || !v.Contains(point.v)) continue;
    occupied[static_cast<size_t>(cell(point.v, v, rows) * columns +
                                 cell(point.u, u, columns))] = true;
  }
  const auto count = std::count(occupied.begin(), occupied.end(), true);
  return area * static_cast<double>(count) / (columns * rows);
}

}  // namespace mapsieve::client
