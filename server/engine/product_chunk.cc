#include "server/engine/product_chunk.h"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "core/base/status.h"

namespace mapsieve::engine {
namespace {

using core::Column;
using core::LabelSpans;
using core::LatticeCloud;
using core::ScalarType;

template <typename T, typename Values>
Column MakeColumn(std::string_view name, const LabelSpans& labels,
                  const Values& value_of) {
  Column column({std::string(name), core::ScalarTypeOf<T>()}, labels.size());
  for (size_t i = 0; i < labels.size(); ++i) column.Set<T>(i, value_of(i));
  return column;
}

/// kDataLoss, for the first one, if any of a chunk's `numbers` is above
/// `largest`; `what` they are.
absl::Status CheckNumbers(std::string_view what,
                          std::span<const std::byte> numbers, size_t largest) {
  // Without an end before the last one, it takes many at a time.
  std::byte found{};
  for (const std::byte number : numbers) found = std::max(found, number);
  if (static_cast<size_t>(found) <= largest) return absl::OkStatus();
  const auto wrong = std::find_if(
      numbers.begin(), numbers.end(),
      [&](std::byte number) { return static_cast<size_t>(number) > largest; });
  return absl::DataLossError(
      absl::StrCat(ToAbsl(what), " of point ", wrong - numbers.begin(),
                   " of a product chunk: expected at most ", largest,
                   ", found ", static_cast<int>(*wrong)));
}

/// kLabelColumn; kDataLoss: not there, or a number in it that is no label.
absl::StatusOr<const Column*> FindLabels(const core::ColumnSet& columns) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const Column* const column,
      FindProductColumn(columns, kLabelColumn, ScalarType::kUint8));
  MAPSIEVE_RETURN_IF_ERROR(
      CheckNumbers("label", column->bytes(), core::kLabelCount - 1));
  return column;
}

}  // namespace

LatticeCloud MakeProductCloud(LatticeCloud points, const LabelSpans& labels) {
  std::vector<Column> columns;
  columns.push_back(MakeColumn<uint8_t>(kLabelColumn, labels, [&](size_t i) {
    return static_cast<uint8_t>(labels.label[i]);
  }));
  columns.push_back(
      MakeColumn<uint16_t>(kConfidenceColumn, labels,
                           [&](size_t i) { return labels.confidence[i]; }));
  for (size_t l = 0; l < kLambdaColumns.size(); ++l) {
    columns.push_back(
        MakeColumn<float>(kLambdaColumns[l], labels,
                          [&](size_t i) { return labels.lambda[i][l]; }));
  }
  columns.push_back(MakeColumn<uint32_t>(
      kNormalColumn, labels, [&](size_t i) { return labels.normal[i]; }));
  columns.push_back(MakeColumn<uint32_t>(
      kTangentColumn, labels, [&](size_t i) { return labels.tangent[i]; }));
  for (Column& column : points.attributes.columns()) {
    columns.push_back(std::move(column));
  }
  points.attributes.columns() = std::move(columns);
  return points;
}

size_t DepthGroupOf(int depth) {
  size_t group = 0;
  while (depth < kDepthGroups[group].min) ++group;
  return group;
}

std::array<LatticeCloud, kDepthGroups.size()> SplitByDepth(
    LatticeCloud product, std::span<const uint8_t> depths) {
  Column column({std::string(kDepthColumn), ScalarType::kUint8},
                product.size());
  for (size_t i = 0; i < product.size(); ++i) column.Set(i, depths[i]);
  std::vector<Column>& columns = product.attributes.columns();
  std::erase_if(columns,
                [](const Column& c) { return c.name() == kDepthColumn; });
  columns.insert(columns.begin(), std::move(column));
  std::array<LatticeCloud, kDepthGroups.size()> groups;
  for (size_t g = 0; g < groups.size(); ++g) {
    std::vector<uint32_t> rows;
    for (uint32_t row = 0; row < depths.size(); ++row) {
      if (DepthGroupOf(depths[row]) == g) rows.push_back(row);
    }
    groups[g] = product.Select(rows);
  }
  return groups;
}

absl::StatusOr<std::vector<uint8_t>> DepthsOf(const core::ColumnSet& columns) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const Column* const column,
      FindProductColumn(columns, kDepthColumn, ScalarType::kUint8));
  MAPSIEVE_RETURN_IF_ERROR(
      CheckNumbers("depth", column->bytes(), core::kMaxDepth));
  std::vector<uint8_t> depths(column->size());
  std::memcpy(depths.data(), column->bytes().data(), depths.size());
  return depths;
}

int64_t ProductPointBytes(std::span<const core::ColumnSpec> attributes) {
  // Position, depth, label, confidence, lambdas, normal and tangent.
  int64_t bytes = sizeof(core::LatticePoint) + 1 + 1 + 2 + 3 * 4 + 4 + 4;
  for (const core::ColumnSpec& spec : attributes) {
    // A byte more for the flag of a missing value.
    bytes += static_cast<int64_t>(core::ScalarSize(spec.type)) + 1;
  }
  return bytes;
}

absl::StatusOr<const Column*> FindProductColumn(const core::ColumnSet& columns,
                                                std::string_view name,
                                                ScalarType type) {
  const Column* column = columns.Find(name);
  if (column == nullptr || column->type() != type) {
    return absl::DataLossError(absl::StrCat(
        "column ", ToAbsl(name), " of a product chunk: expected ",
        ToAbsl(core::ScalarTypeName(type)), ", found ",
        column == nullptr ? "none"
                          : ToAbsl(core::ScalarTypeName(column->type()))));
  }
  return column;
}

absl::StatusOr<core::LabelColumns> LabelColumnsOf(const LatticeCloud& points) {
  MAPSIEVE_ASSIGN_OR_RETURN(const LabelColumnView view,
                            LabelColumnView::Of(points.attributes));
  std::array<const Column*, kLambdaColumns.size()> lambda;
  for (size_t l = 0; l < lambda.size(); ++l) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        lambda[l], FindProductColumn(points.attributes, kLambdaColumns[l],
                                     ScalarType::kFloat32));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      const Column* const normal,
      FindProductColumn(points.attributes, kNormalColumn, ScalarType::kUint32));
  MAPSIEVE_ASSIGN_OR_RETURN(const Column* const tangent,
                            FindProductColumn(points.attributes, kTangentColumn,
                                              ScalarType::kUint32));
  core::LabelColumns columns;
  columns.Resize(points.size());
  for (size_t i = 0; i < points.size(); ++i) {
    columns.label[i] = view.label(i);
    columns.confidence[i] = view.confidence(i);
    for (size_t l = 0; l < lambda.size(); ++l) {
      columns.lambda[i][l] = lambda[l]->Get<float>(i);
    }
    columns.normal[i] = normal->Get<uint32_t>(i);
    columns.tangent[i] = tangent->Get<uint32_t>(i);
  }
  return columns;
}

absl::StatusOr<LabelColumnView> LabelColumnView::Of(
    const core::ColumnSet& columns) {
  MAPSIEVE_ASSIGN_OR_RETURN(const Column* const label, FindLabels(columns));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const Column* const confidence,
      FindProductColumn(columns, kConfidenceColumn, ScalarType::kUint16));
  return LabelColumnView(*label, *confidence);
}

absl::StatusOr<core::LabelCounts> CountLabels(const core::ColumnSet& columns) {
  MAPSIEVE_ASSIGN_OR_RETURN(const Column* const column, FindLabels(columns));
  core::LabelCounts counts{};
  for (size_t i = 0; i < column->size(); ++i) ++counts[column->Get<uint8_t>(i)];
  return counts;
}

}  // namespace mapsieve::engine
