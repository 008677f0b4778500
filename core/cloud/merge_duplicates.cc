#include "core/cloud/merge_duplicates.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <numeric>
#include <unordered_set>
#include <utility>

#include "core/base/bulk_vector.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/morton.h"

namespace mapsieve::core {
namespace {

/// Rows of one parallel task.
constexpr size_t kTaskRows = 1 << 14;

/// Sort key of a row among those of one cell.
struct CodedRow {
  uint64_t code;
  uint32_t row;

  friend bool operator<(const CodedRow& a, const CodedRow& b) {
    return a.code != b.code ? a.code < b.code : a.row < b.row;
  }
};

/// A digit of codes: `bits` bits from `shift` on.
struct Digit {
  int shift = 0;
  int bits = 0;
  size_t Of(uint64_t code) const {
    return static_cast<size_t>(code >> shift & ((uint64_t{1} << bits) - 1));
  }
};

/// The `width` uppermost bits in which codes differ, given the bits in which
/// any two do.
Digit UpperDigit(uint64_t differing, int width) {
  const int top = 64 - std::countl_zero(differing);
  const int bits = std::min(width, top);
  return {top - bits, bits};
}

/// Sorts `rows` by digits from above; `room` is as large.
void SortRows(std::span<CodedRow> rows, std::span<CodedRow> room) {
  if (rows.size() <= 128) {
    std::sort(rows.begin(), rows.end());
    return;
  }
  uint64_t differing = 0;
  for (const CodedRow& r : rows) differing |= r.code ^ rows[0].code;
  if (differing == 0) return;  // rows ascend already
  constexpr int kBits = 8;
  const Digit digit = UpperDigit(differing, kBits);
  std::array<size_t, (1 << kBits) + 1> starts{};
  for (const CodedRow& r : rows) ++starts[digit.Of(r.code) + 1];
  for (size_t d = 1; d < starts.size(); ++d) starts[d] += starts[d - 1];
  std::array<size_t, (1 << kBits) + 1> next = starts;
  for (const CodedRow& r : rows) room[next[digit.Of(r.code)]++] = r;
  std::copy(room.begin(), room.end(), rows.begin());
  for (size_t d = 0; d + 1 < starts.size(); ++d) {
    const size_t count = starts[d + 1] - starts[d];
    if (count > 1) {
      SortRows(rows.subspan(starts[d], count), room.subspan(starts[d], count));
    }
  }
}

/// Moves `rows` to `sorted`, ordered by bucket_of, stable. Returns where each
/// bucket starts, and at the end where the last one ends.
template <typename BucketOf>
std::vector<size_t> Partition(Executor& executor,
                              std::span<const CodedRow> rows,
                              size_t bucket_count, const BucketOf& bucket_of,
                              std::span<CodedRow> sorted) {
  const size_t parts = PartCount(rows.size(), kTaskRows);
  std::vector<std::vector<size_t>> next(parts);
  ForEachPart(executor, rows.size(), kTaskRows,
              [&](size_t part, size_t begin, size_t end) {
                next[part].resize(bucket_count);
                for (size_t i = begin; i < end; ++i)
                  ++next[part][bucket_of(rows[i])];
              });
  std::vector<size_t> starts;
  starts.reserve(bucket_count + 1);
  size_t start = 0;
  for (size_t b = 0; b < bucket_count; ++b) {
    starts.push_back(start);
    for (std::vector<size_t>& counts : next) {
      const size_t count = counts[b];
      counts[b] = start;
      start += count;
    }
  }
  starts.push_back(start);
  ForEachPart(executor, rows.size(), kTaskRows,
              [&](size_t part, size_t begin, size_t end) {
                for (size_t i = begin; i < end; ++i) {
                  sorted[next[part][bucket_of(rows[i])]++] = rows[i];
                }
              });
  return starts;
}

/// The cells of the level whose points' codes fit 64 bits that hold any of
/// `positions`, in Morton order.
std::vector<CellKey> FindCells(Executor& executor,
                               std::span<const LatticePoint> positions) {
  const size_t parts = PartCount(positions.size(), kTaskRows);
  std::vector<std::unordered_set<CellKey, CellKeyHash>> found(parts);
  ForEachPart(executor, positions.size(), kTaskRows,
              [&](size_t part, size_t begin, size_t end) {
                CellKey last = {.level = -1};
                for (size_t i = begin; i < end; ++i) {
                  const CellKey cell = CellKey::Of(positions[i], kMaxTileLevel);
                  if (!(cell == last)) found[part].insert(cell);
                  last = cell;
                }
              });
  std::vector<CellKey> cells;
  for (const auto& part : found) {
    cells.insert(cells.end(), part.begin(), part.end());
  }
  std::sort(cells.begin(), cells.end(), CellKeyLess());
  cells.erase(std::unique(cells.begin(), cells.end()), cells.end());
  return cells;
}

uint64_t CodeInCell(const LatticePoint& q) {
  constexpr int64_t kMask = (int64_t{1} << kMaxTileLevel) - 1;
  return MortonCode(static_cast<uint64_t>(q.x & kMask),
                    static_cast<uint64_t>(q.y & kMask),
                    static_cast<uint64_t>(q.z & kMask));
}

/// Where each of the runs of ascending rows of `positions` starts, and at the
/// end where the last one ends; empty if there are more than `max_runs`.
std::vector<size_t> AscendingRuns(std::span<const LatticePoint> positions,
                                  size_t max_runs) {
  std::vector<size_t> starts = {0};
  for (size_t i = 1; i < positions.size(); ++i) {
    if (!MortonLess(positions[i], positions[i - 1])) continue;
    if (starts.size() == max_runs) return {};
    starts.push_back(i);
  }
  starts.push_back(positions.size());
  return starts;
}

/// Merges the rows [begin, middle) and [middle, end) of `from`, both in Morton
/// order, to the same place of `to`. False: `stop` was requested.
bool MergeTwoRuns(std::span<const LatticePoint> positions,
                  std::span<const uint32_t> from, size_t begin, size_t middle,
                  size_t end, std::span<uint32_t> to,
                  const std::stop_token& stop) {
  constexpr size_t kRowsBetweenStops = 65536;
  size_t a = begin;
  size_t b = middle;
  size_t next = begin;
  while (a < middle && b < end) {
    if (stop.stop_requested()) return false;
    const size_t last = std::min(next + kRowsBetweenStops, end);
    while (next < last && a < middle && b < end) {
      // Without a branch, which nothing could predict.
      const bool takes_b = MortonLess(positions[from[b]], positions[from[a]]);
      to[next++] = takes_b ? from[b] : from[a];
      b += takes_b ? 1 : 0;
      a += takes_b ? 0 : 1;
    }
  }
  std::copy(from.begin() + static_cast<ptrdiff_t>(b),
            from.begin() + static_cast<ptrdiff_t>(end),
            std::copy(from.begin() + static_cast<ptrdiff_t>(a),
                      from.begin() + static_cast<ptrdiff_t>(middle),
                      to.begin() + static_cast<ptrdiff_t>(next)));
  return true;
}

/// The rows in Morton order, of runs as AscendingRuns gives them. kCancelled:
/// `stop` was requested.
absl::StatusOr<std::vector<uint32_t>> MergeRuns(
    std::span<const LatticePoint> positions, std::vector<size_t> starts,
    const std::stop_token& stop = {}) {
  std::vector<uint32_t> order(positions.size());
  std::iota(order.begin(), order.end(), uint32_t{0});
  if (starts.size() <= 2) return order;
  std::vector<uint32_t> merged(positions.size());
  while (starts.size() > 2) {
    std::vector<size_t> merged_starts;
    for (size_t r = 0; r + 1 < starts.size(); r += 2) {
      const bool is_pair = r + 2 < starts.size();
      merged_starts.push_back(starts[r]);
      if (!MergeTwoRuns(positions, order, starts[r], starts[r + 1],
                        is_pair ? starts[r + 2] : starts[r + 1], merged,
                        stop)) {
        return absl::CancelledError("cancelled");
      }
    }
    merged_starts.push_back(starts.back());
    starts = std::move(merged_starts);
    order.swap(merged);
  }
  return order;
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

bool IsMortonSorted(std::span<const LatticePoint> positions) {
  return std::is_sorted(positions.begin(), positions.end(),
                        [](const LatticePoint& a, const LatticePoint& b) {
                          return MortonLess(a, b);
                        });
}

absl::StatusOr<std::vector<uint32_t>> MergeMortonRuns(
    std::span<const LatticePoint> positions, const std::stop_token& stop) {
  return MergeRuns(positions, AscendingRuns(positions, positions.size()), stop);
}

std::vector<uint32_t> MortonOrder(std::span<const LatticePoint> positions,
                                  Executor& executor) {
  constexpr size_t kMaxRuns = 8;
  std::vector<size_t> runs = AscendingRuns(positions, kMaxRuns);
  if (!runs.empty()) return *MergeRuns(positions, std::move(runs));
  // Codes of whole coordinates do not fit 64 bits: cells come first, then the
  // codes within each.
  const std::vector<CellKey> cells = FindCells(executor, positions);
  BulkVector<CodedRow> rows(positions.size());
  BulkVector<CodedRow> sorted(positions.size());
  const size_t parts = PartCount(positions.size(), kTaskRows);
  std::vector<uint64_t> differing_of(parts);
  ForEachPart(
      executor, positions.size(), kTaskRows,
      [&](size_t part, size_t begin, size_t end) {
        const uint64_t first = CodeInCell(positions[0]);
        for (size_t i = begin; i < end; ++i) {
          rows[i] = {CodeInCell(positions[i]), static_cast<uint32_t>(i)};
          differing_of[part] |= rows[i].code ^ first;
        }
      });
  uint64_t differing = 0;
  for (const uint64_t d : differing_of) differing |= d;
  // Some 2000 buckets: of cells, and within a cell by the uppermost bits.
  const Digit digit = UpperDigit(
      differing,
      std::max(11 - static_cast<int>(std::bit_width(cells.size())), 0));
  const auto cell_of = [&](const CodedRow& r) {
    if (cells.size() == 1) return size_t{0};
    const CellKey cell = CellKey::Of(positions[r.row], kMaxTileLevel);
    return static_cast<size_t>(
        std::lower_bound(cells.begin(), cells.end(), cell, CellKeyLess()) -
        cells.begin());
  };
  const std::vector<size_t> starts = Partition(
      executor, rows, cells.size() << digit.bits,
      [&](const CodedRow& r) {
        return cell_of(r) << digit.bits | digit.Of(r.code);
      },
      sorted);
  executor.ParallelFor(static_cast<int64_t>(starts.size()) - 1, [&](int64_t b) {
    const auto bucket = static_cast<size_t>(b);
    const size_t count = starts[bucket + 1] - starts[bucket];
    SortRows(std::span(sorted).subspan(starts[bucket], count),
             std::span(rows).subspan(starts[bucket], count));
  });
  rows = BulkVector<CodedRow>();
  std::vector<uint32_t> order;
  ReserveBulk(order, positions.size());
  order.resize(positions.size());
  ForEachPart(executor, positions.size(), kTaskRows,
              [&](size_t, size_t begin, size_t end) {
                for (size_t i = begin; i < end; ++i) order[i] = sorted[i].row;
              });
  return order;
}

std::vector<uint32_t> MergeDuplicates(const LatticeCloud& cloud,
                                      Executor& executor) {
  std::vector<const Column*> columns;
  for (const Column& column : cloud.attributes.columns()) {
    columns.push_back(&column);
  }
  std::sort(
      columns.begin(), columns.end(),
      [](const Column* a, const Column* b) { return a->name() < b->name(); });
  std::vector<uint32_t> rows = MortonOrder(cloud.positions, executor);
  const auto same_place = [&](size_t i, size_t j) {
    return cloud.positions[rows[i]] == cloud.positions[rows[j]];
  };
  // Parts that begin with a new place each; of its rows, a part keeps those
  // before `end`.
  struct Kept {
    size_t begin = 0;
    size_t end = 0;
  };
  std::vector<Kept> parts(PartCount(rows.size(), kTaskRows));
  executor.ParallelFor(static_cast<int64_t>(parts.size()), [&](int64_t p) {
    size_t& begin = parts[static_cast<size_t>(p)].begin;
    begin = static_cast<size_t>(p) * kTaskRows;
    while (begin > 0 && begin < rows.size() && same_place(begin - 1, begin)) {
      ++begin;
    }
  });
  executor.ParallelFor(static_cast<int64_t>(parts.size()), [&](int64_t p) {
    const auto part = static_cast<size_t>(p);
    const size_t begin = parts[part].begin;
    const size_t end =
        part + 1 < parts.size() ? parts[part + 1].begin : rows.size();
    size_t kept = begin;
    for (size_t i = begin; i < end; ++i) {
      if (kept > begin && same_place(kept - 1, i)) {
        if (CompareAttributes(columns, rows[i], rows[kept - 1]) < 0) {
          rows[kept - 1] = rows[i];
        }
        continue;
      }
      rows[kept++] = rows[i];
    }
    parts[part].end = kept;
  });
  auto kept = rows.begin();
  for (const Kept& part : parts) {
    kept = std::copy(rows.begin() + static_cast<ptrdiff_t>(part.begin),
                     rows.begin() + static_cast<ptrdiff_t>(part.end), kept);
  }
  rows.erase(kept, rows.end());
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
