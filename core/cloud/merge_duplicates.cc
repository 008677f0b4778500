#include "core/cloud/merge_duplicates.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <numeric>
#include <utility>

#include "core/geometry/cell_key.h"
#include "core/geometry/morton.h"

namespace mapsieve::core {
namespace {

struct CodedRow {
  uint64_t code;
  uint32_t row;
};

/// Stable sort by code, byte by byte; bytes that all codes share are skipped.
void RadixSort(std::vector<CodedRow>& rows) {
  std::vector<CodedRow> other(rows.size());
  for (int shift = 0; shift < 64; shift += 8) {
    std::array<size_t, 257> starts{};
    for (const CodedRow& r : rows) ++starts[(r.code >> shift & 0xff) + 1];
    if (std::find(starts.begin(), starts.end(), rows.size()) != starts.end()) {
      continue;
    }
    for (size_t b = 1; b < starts.size(); ++b) starts[b] += starts[b - 1];
    for (const CodedRow& r : rows) {
      other[starts[r.code >> shift & 0xff]++] = r;
    }
    rows.swap(other);
  }
}

/// Negative, zero or positive as row `a` orders before, equal to or after `b`.
int CompareAttributes(std::span<const Column* const> columns, uint32_t a,
                      uint32_t b) {
  for (const Column* column : columns) {
    const bool missing_a = column->IsMissing(a);
    const bool missing_b = column->IsMissing(b);
    if (missing_a != missing_b) return missing_a ? -1 : 1;
    const size_t width = column->value_size();
    const int order = std::memcmp(column->bytes().data() + a * width,
                                  column->bytes().data() + b * width, width);
    if (order != 0) return order;
  }
  return 0;
}

}  // namespace

std::vector<uint32_t> MortonOrder(std::span<const LatticePoint> positions) {
  if (positions.empty()) return {};
  // Codes of whole coordinates do not fit 64 bits: cells of the level whose
  // points' codes do come first, then the codes within each cell.
  const auto cell_of = [&](size_t i) {
    return CellKey::Of(positions[i], kMaxTileLevel);
  };
  std::vector<CellKey> cells;
  for (size_t i = 0; i < positions.size(); ++i) {
    const CellKey cell = cell_of(i);
    if (cells.empty() || !(cell == cells.back())) cells.push_back(cell);
  }
  std::sort(cells.begin(), cells.end(), CellKeyLess());
  cells.erase(std::unique(cells.begin(), cells.end()), cells.end());
  std::vector<std::vector<CodedRow>> by_cell(cells.size());
  if (cells.size() == 1) by_cell[0].reserve(positions.size());
  size_t last = 0;
  for (size_t i = 0; i < positions.size(); ++i) {
    const CellKey cell = cell_of(i);
    if (!(cells[last] == cell)) {
      last = static_cast<size_t>(
          std::lower_bound(cells.begin(), cells.end(), cell, CellKeyLess()) -
          cells.begin());
    }
    constexpr int64_t kMask = (int64_t{1} << kMaxTileLevel) - 1;
    const LatticePoint& q = positions[i];
    by_cell[last].push_back({MortonCode(static_cast<uint64_t>(q.x & kMask),
                                        static_cast<uint64_t>(q.y & kMask),
                                        static_cast<uint64_t>(q.z & kMask)),
                             static_cast<uint32_t>(i)});
  }
  std::vector<uint32_t> order;
  order.reserve(positions.size());
  for (std::vector<CodedRow>& rows : by_cell) {
    RadixSort(rows);
    for (const CodedRow& r : rows) order.push_back(r.row);
    rows = {};
  }
  return order;
}

std::vector<uint32_t> MergeDuplicates(const LatticeCloud& cloud) {
  std::vector<const Column*> columns;
  for (const Column& column : cloud.attributes.columns()) {
    columns.push_back(&column);
  }
  std::sort(
      columns.begin(), columns.end(),
      [](const Column* a, const Column* b) { return a->name() < b->name(); });
  std::vector<uint32_t> rows = MortonOrder(cloud.positions);
  size_t kept = 0;
  for (size_t i = 0; i < rows.size(); ++i) {
    if (kept > 0 &&
        cloud.positions[rows[kept - 1]] == cloud.positions[rows[i]]) {
      if (CompareAttributes(columns, rows[i], rows[kept - 1]) < 0) {
        rows[kept - 1] = rows[i];
      }
      continue;
    }
    rows[kept++] = rows[i];
  }
  rows.resize(kept);
  return rows;
}

std::vector<LatticePoint> DistinctPoints(
    std::span<const LatticePoint> positions) {
  std::vector<LatticePoint> result;
  result.reserve(positions.size());
  for (const uint32_t row : MortonOrder(positions)) {
    if (result.empty() || !(result.back() == positions[row])) {
      result.push_back(positions[row]);
    }
  }
  return result;
}

}  // namespace mapsieve::core
