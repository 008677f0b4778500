#include "core/cloud/row_runs.h"

#include <cstddef>
#include <cstring>
#include <utility>

namespace mapsieve::core {
namespace {

Column SelectRuns(const Column& column, std::span<const RowRun> runs,
                  size_t row_count) {
  Column result(column.spec(), row_count);
  const size_t width = column.value_size();
  const std::byte* from = column.bytes().data();
  std::byte* to = result.mutable_bytes().data();
  for (const RowRun& run : runs) {
    if (run.count == 0) continue;
    std::memcpy(to, from + run.begin * width, run.count * width);
    to += run.count * width;
  }
  if (!column.has_missing()) return result;
  size_t row = 0;
  for (const RowRun& run : runs) {
    for (uint32_t i = 0; i < run.count; ++i, ++row) {
      if (column.IsMissing(run.begin + i)) result.SetMissing(row);
    }
  }
  return result;
}

}  // namespace

LatticeCloud SelectRuns(const LatticeCloud& cloud,
                        std::span<const RowRun> runs) {
  LatticeCloud result{.lattice = cloud.lattice};
  size_t row_count = 0;
  for (const RowRun& run : runs) row_count += run.count;
  result.positions.reserve(row_count);
  for (const RowRun& run : runs) {
    const auto from = std::span(cloud.positions).subspan(run.begin, run.count);
    result.positions.insert(result.positions.end(), from.begin(), from.end());
  }
  std::vector<Column>& columns = result.attributes.columns();
  columns.reserve(cloud.attributes.columns().size());
  for (const Column& column : cloud.attributes.columns()) {
    columns.push_back(SelectRuns(column, runs, row_count));
  }
  return result;
}

}  // namespace mapsieve::core
