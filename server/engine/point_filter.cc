#include "server/engine/point_filter.h"

#include <algorithm>
#include <cstddef>

#include "core/base/status.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/levels.h"
#include "server/engine/answer_columns.h"
#include "server/engine/field_error.h"
#include "server/engine/opaque_records.h"
#include "server/engine/product_chunk.h"

namespace mapsieve::engine {
namespace {

using core::Column;
using core::Label;
using core::LatticeCloud;
using storage::ChunkRef;

/// Rows tested between looks at a stop: some milliseconds at most.
constexpr uint32_t kRowsBetweenStops = 1024;

absl::Status CheckAttributes(const QuerySpec& spec,
                             std::span<const core::ColumnSpec> attributes) {
  for (size_t i = 0; i < spec.attribute_ranges.size(); ++i) {
    const std::string& name = spec.attribute_ranges[i].name;
    if (std::none_of(attributes.begin(), attributes.end(),
                     [&](const auto& a) { return a.name == name; })) {
      return FieldError(absl::StrCat("attribute_ranges[", i, "].name"),
                        UnknownAttribute(name, attributes));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<PointFilter> PointFilter::Make(
    const QuerySpec& spec, const storage::ReadSnapshot& snapshot) {
  const storage::RevisionSpec& revision = snapshot.revision().spec;
  MAPSIEVE_RETURN_IF_ERROR(CheckAttributes(spec, revision.attributes));
  PointFilter filter;
  if (spec.region.has_value()) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        filter.region_,
        Region::Make(*spec.region, core::Lattice(snapshot.map().spec.step_nm)));
  }
  filter.ranges_ = spec.attribute_ranges;
  for (const AttributeRange& range : filter.ranges_) {
    filter.stored_names_.push_back(range.name);
  }
  if (spec.raw) return filter;
  if (!revision.product.has_value()) {
    return absl::DataLossError(absl::StrCat("map ", spec.map_id, ", revision ",
                                            snapshot.revision().number,
                                            ": its product is not described"));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const core::SpdfOptions options,
                            ParseSpdfOptions(revision.product->options));
  filter.outliers_.emplace(revision.product->max_confidence,
                           options.outlier_share);
  filter.confidence_ = spec.confidence;
  for (const Label label : spec.labels) {
    filter.labels_[static_cast<size_t>(label)] = true;
  }
  if (spec.labels.empty()) filter.labels_.fill(true);
  filter.min_depth_ = spec.spacing_m > 0
                          ? core::LevelOfSpacing(options, spec.spacing_m)
                          : spec.depth;
  filter.stored_names_.emplace_back(kLabelColumn);
  filter.stored_names_.emplace_back(kConfidenceColumn);
  if (filter.min_depth_ > 0) filter.stored_names_.emplace_back(kDepthColumn);
  return filter;
}

bool PointFilter::PassesAllOf(const ChunkRef& chunk) const {
  return !outliers_.has_value() && ranges_.empty() &&
         (!region_.has_value() || region_->Encloses(chunk.bounds));
}

int64_t PointFilter::CountCandidates(const ChunkRef& chunk) const {
  if (!outliers_.has_value()) return chunk.point_count;
  int64_t count = 0;
  for (size_t l = 0; l < core::kLabelCount; ++l) {
    if (labels_[l]) count += chunk.label_counts[l];
  }
  return count;
}

bool PointFilter::HasAttributes(std::span<const Column* const> columns,
                                uint32_t row) const {
  for (size_t i = 0; i < columns.size(); ++i) {
    const Column& column = *columns[i];
    if (column.IsMissing(row) ||
        !ranges_[i].range.Contains(column.GetAsDouble(row))) {
      return false;
    }
  }
  return true;
}

absl::StatusOr<PointFilter::Passed> PointFilter::Select(
    const ChunkRef& chunk, const LatticeCloud& points,
    const std::stop_token& stop) const {
  Passed passed;
  std::vector<const Column*> columns;
  for (const AttributeRange& range : ranges_) {
    columns.push_back(points.attributes.Find(range.name));
    // No point of the chunk has a value.
    if (columns.back() == nullptr) return passed;
  }
  std::optional<LabelColumnView> labels;
  std::vector<uint8_t> depths;
  if (outliers_.has_value()) {
    MAPSIEVE_ASSIGN_OR_RETURN(labels, LabelColumnView::Of(points.attributes));
    if (min_depth_ > 0) {
      MAPSIEVE_ASSIGN_OR_RETURN(depths, DepthsOf(points.attributes));
    }
  }
  const bool is_within =
      !region_.has_value() || region_->Encloses(chunk.bounds);
  for (uint32_t row = 0; row < points.size(); ++row) {
    if (row % kRowsBetweenStops == 0 && stop.stop_requested()) {
      return absl::CancelledError("cancelled");
    }
    Label label = Label::kNone;
    if (outliers_.has_value()) {
      label = labels->label(row);
      if (!labels_[static_cast<size_t>(label)] ||
          !outliers_->Keeps(label, labels->confidence(row)) ||
          (confidence_.has_value() &&
           !confidence_->Contains(
               core::ConfidenceValue(labels->confidence(row)))) ||
          (min_depth_ > 0 && depths[row] < min_depth_)) {
        continue;
      }
    }
    if (!HasAttributes(columns, row) ||
        (!is_within && !region_->Contains(points.positions[row]))) {
      continue;
    }
    passed.rows.push_back(row);
    passed.labels.push_back(label);
  }
  return passed;
}

}  // namespace mapsieve::engine
