#include "server/rpc/convert_query.h"

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <utility>

#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "google/protobuf/message.h"
#include "google/protobuf/unknown_field_set.h"
#include "server/rpc/convert.h"
#include "server/rpc/status_adapter.h"

namespace mapsieve::rpc {
namespace {

core::Point3 FromVector(const v1::Vector3& vector) {
  return {vector.x(), vector.y(), vector.z()};
}

absl::StatusOr<engine::Box> FromProto(const v1::Box& box) {
  if (!box.has_min()) return InvalidField("box.min", "missing");
  if (!box.has_max()) return InvalidField("box.max", "missing");
  return engine::Box{FromVector(box.min()), FromVector(box.max())};
}

absl::StatusOr<engine::Sphere> FromProto(const v1::Sphere& sphere) {
  if (!sphere.has_center()) return InvalidField("sphere.center", "missing");
  return engine::Sphere{FromVector(sphere.center()), sphere.radius()};
}

engine::Quaternion FromProto(const v1::Quaternion& q) {
  return {q.x(), q.y(), q.z(), q.w()};
}

absl::StatusOr<engine::OrientedBox> FromProto(const v1::OrientedBox& box) {
  if (!box.has_center()) return InvalidField("oriented_box.center", "missing");
  if (!box.has_orientation()) {
    return InvalidField("oriented_box.orientation", "missing");
  }
  if (!box.has_half_size()) {
    return InvalidField("oriented_box.half_size", "missing");
  }
  return engine::OrientedBox{FromVector(box.center()),
                             FromProto(box.orientation()),
                             FromVector(box.half_size())};
}

// An optional field of numbers.
template <typename Message>
std::optional<double> MinZ(const Message& shape) {
  return shape.has_min_z() ? std::optional(shape.min_z()) : std::nullopt;
}
template <typename Message>
std::optional<double> MaxZ(const Message& shape) {
  return shape.has_max_z() ? std::optional(shape.max_z()) : std::nullopt;
}

engine::VerticalCylinder FromProto(const v1::VerticalCylinder& cylinder) {
  return {.center_x = cylinder.center_x(),
          .center_y = cylinder.center_y(),
          .radius = cylinder.radius(),
          .min_z = MinZ(cylinder),
          .max_z = MaxZ(cylinder)};
}

engine::PolygonPrism FromProto(const v1::PolygonPrism& prism) {
  engine::PolygonPrism result{.min_z = MinZ(prism), .max_z = MaxZ(prism)};
  for (const v1::Vector2& v : prism.vertices()) {
    result.vertices.push_back({v.x(), v.y()});
  }
  return result;
}

absl::StatusOr<engine::Frustum> FromProto(const v1::Frustum& frustum) {
  if (!frustum.has_position()) {
    return InvalidField("frustum.position", "missing");
  }
  if (!frustum.has_orientation()) {
    return InvalidField("frustum.orientation", "missing");
  }
  return engine::Frustum{.position = FromVector(frustum.position()),
                         .orientation = FromProto(frustum.orientation()),
                         .half_width = frustum.half_width(),
                         .half_height = frustum.half_height(),
                         .near = frustum.near(),
                         .far = frustum.far()};
}

engine::Corridor FromProto(const v1::Corridor& corridor) {
  engine::Corridor result{.radius = corridor.radius()};
  for (const v1::Vector3& p : corridor.path()) {
    result.path.push_back(FromVector(p));
  }
  return result;
}

// The region of any request of an edit.
template <typename Request>
absl::StatusOr<std::optional<engine::RegionShape>> RegionOf(
    const Request& request) {
  switch (request.region_case()) {
    case Request::kBox:
      return FromProto(request.box());
    case Request::kSphere:
      return FromProto(request.sphere());
    case Request::REGION_NOT_SET:
      break;
  }
  return std::nullopt;
}

absl::StatusOr<std::optional<engine::QueryShape>> RegionOf(
    const v1::QueryRegionRequest& request) {
  using Request = v1::QueryRegionRequest;
  switch (request.region_case()) {
    case Request::kBox:
      return FromProto(request.box());
    case Request::kSphere:
      return FromProto(request.sphere());
    case Request::kOrientedBox:
      return FromProto(request.oriented_box());
    case Request::kCylinder:
      return FromProto(request.cylinder());
    case Request::kPolygon:
      return FromProto(request.polygon());
    case Request::kFrustum:
      return FromProto(request.frustum());
    case Request::kCorridor:
      return FromProto(request.corridor());
    case Request::REGION_NOT_SET:
      break;
  }
  return std::nullopt;
}

engine::Range FromProto(const v1::Range& range) {
  engine::Range result;
  if (range.has_min()) result.min = range.min();
  if (range.has_max()) result.max = range.max();
  return result;
}

// The filters and the budget of a query.
absl::Status SetLimits(const v1::QueryRegionRequest& request,
                       engine::QuerySpec& spec) {
  spec.max_points = request.max_point_count();
  spec.max_bytes = request.max_bytes();
  if (request.has_label_weights()) {
    const v1::LabelWeights& weights = request.label_weights();
    spec.label_weights = {0, weights.junction(), weights.curve(),
                          weights.surface()};
  }
  if (request.has_confidence()) {
    spec.confidence = FromProto(request.confidence());
  }
  for (int i = 0; i < request.attribute_ranges_size(); ++i) {
    const v1::AttributeRange& range = request.attribute_ranges(i);
    if (!range.has_range()) {
      return InvalidField(absl::StrCat("attribute_ranges[", i, "].range"),
                          "missing");
    }
    spec.attribute_ranges.push_back({range.name(), FromProto(range.range())});
  }
  return absl::OkStatus();
}

// Of all that an answer depends on.
uint64_t ResumeKey(v1::QueryRegionRequest request) {
  request.clear_resume_token();
  return Hash64(TextBytes(request.SerializeAsString()));
}

absl::StatusOr<engine::ColumnSelection> ToColumnSelection(
    const v1::ColumnSelection& columns) {
  engine::ColumnSelection result;
  for (int i = 0; i < columns.filter_columns_size(); ++i) {
    switch (columns.filter_columns(i)) {
      case v1::FILTER_COLUMN_LABEL:
        result.label = true;
        break;
      case v1::FILTER_COLUMN_CONFIDENCE:
        result.confidence = true;
        break;
      case v1::FILTER_COLUMN_NORMAL:
        result.normal = true;
        break;
      case v1::FILTER_COLUMN_TANGENT:
        result.tangent = true;
        break;
      case v1::FILTER_COLUMN_EIGENVALUES:
        result.eigenvalues = true;
        break;
      case v1::FILTER_COLUMN_SALIENCIES:
        result.saliencies = true;
        break;
      case v1::FILTER_COLUMN_COVARIANCE:
        result.covariance = true;
        break;
      default:
        return InvalidField(
            absl::StrCat("columns.filter_columns[", i, "]"),
            absl::StrCat("no column has the number ",
                         static_cast<int>(columns.filter_columns(i))));
    }
  }
  result.attributes.assign(columns.attributes().begin(),
                           columns.attributes().end());
  result.all_attributes = columns.all_attributes();
  return result;
}

}  // namespace

absl::StatusOr<engine::QuerySpec> ToQuerySpec(
    const v1::QueryRegionRequest& request) {
  engine::QuerySpec spec;
  MAPSIEVE_ASSIGN_OR_RETURN(spec.map_id, ParseMapName("name", request.name()));
  spec.revision = request.revision();
  MAPSIEVE_ASSIGN_OR_RETURN(spec.region, RegionOf(request));
  for (int i = 0; i < request.labels_size(); ++i) {
    const v1::Label label = request.labels(i);
    if (label < v1::LABEL_JUNCTION || label > v1::LABEL_SURFACE) {
      return InvalidField(
          absl::StrCat("labels[", i, "]"),
          absl::StrCat("no label has the number ", static_cast<int>(label)));
    }
    const auto wanted = static_cast<core::Label>(label);
    if (std::find(spec.labels.begin(), spec.labels.end(), wanted) ==
        spec.labels.end()) {
      spec.labels.push_back(wanted);
    }
  }
  spec.depth = request.depth();
  spec.spacing_m = request.spacing_m();
  MAPSIEVE_RETURN_IF_ERROR(SetLimits(request, spec));
  if (request.has_columns()) {
    MAPSIEVE_ASSIGN_OR_RETURN(spec.columns,
                              ToColumnSelection(request.columns()));
  }
  spec.raw = request.raw();
  spec.allow_partial = request.allow_partial();
  spec.plain_blocks = request.plain_blocks();
  spec.packed_columns = request.packed_columns();
  spec.resume_token = request.resume_token();
  spec.resume_key = ResumeKey(request);
  switch (request.representative()) {
    case v1::REPRESENTATIVE_UNSPECIFIED:
    case v1::REPRESENTATIVE_NEAREST:
      break;
    case v1::REPRESENTATIVE_CENTROID:
      spec.representative = engine::Representative::kCentroid;
      break;
    default:
      return InvalidField(
          "representative",
          absl::StrCat("no choice has the number ",
                       static_cast<int>(request.representative())));
  }
  return spec;
}

absl::StatusOr<engine::SyncSpec> ToSyncSpec(
    const v1::SyncRegionRequest& request) {
  engine::SyncSpec spec;
  MAPSIEVE_ASSIGN_OR_RETURN(spec.query, ToQuerySpec(request.query()));
  v1::QueryRegionRequest of_any_tile = request.query();
  of_any_tile.clear_name();
  of_any_tile.clear_revision();
  of_any_tile.clear_region();
  of_any_tile.clear_plain_blocks();
  of_any_tile.clear_packed_columns();
  spec.query_key = of_any_tile.SerializeAsString();
  spec.held_chunk_ids.assign(request.held_chunk_ids().begin(),
                             request.held_chunk_ids().end());
  return spec;
}

absl::StatusOr<std::optional<engine::RegionShape>> ToRegion(
    const v1::FinalizeUploadRequest& request) {
  // A newer client's region may be of a kind that is not known here. Without it
  // points would be added to those that they are to replace.
  if (!request.GetReflection()->GetUnknownFields(request).empty()) {
    return InvalidField("region",
                        "or another field is of a kind that this server does "
                        "not know; update the server");
  }
  return RegionOf(request);
}

absl::StatusOr<engine::RegionShape> ToRegion(
    const v1::DeleteRegionRequest& request) {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto region, RegionOf(request));
  if (region.has_value()) return *region;
  return InvalidField("region", "missing: give a box or a sphere");
}

v1::QuerySummary ToProto(const engine::QuerySummary& summary) {
  v1::QuerySummary result;
  result.set_point_count(summary.point_count);
  *result.mutable_label_counts() = ToProto(summary.label_counts);
  result.set_block_bytes(summary.block_bytes);
  result.set_available_point_count(
      std::accumulate(summary.available_label_counts.begin(),
                      summary.available_label_counts.end(), int64_t{0}));
  *result.mutable_available_label_counts() =
      ToProto(summary.available_label_counts);
  result.set_missing_chunk_count(summary.missing_chunk_count);
  result.set_missing_point_count(summary.missing_point_count);
  for (const engine::DamagedChunk& chunk : summary.missing_chunks) {
    *result.add_missing_chunks() = ToProto(chunk);
  }
  return result;
}

v1::SyncHeader ToProto(const engine::SyncHeader& header) {
  v1::SyncHeader result;
  result.set_revision(header.revision);
  result.set_step_nm(header.step_nm);
  result.set_tile_level(header.tile_level);
  for (const core::ColumnSpec& column : header.columns) {
    *result.add_columns() = ToProto(column);
  }
  return result;
}

v1::SyncPart ToProto(const engine::SyncPart& part) {
  v1::SyncPart result;
  result.set_chunk_id(part.chunk_id);
  result.set_x(part.tile.x);
  result.set_y(part.tile.y);
  result.set_z(part.tile.z);
  result.set_block(part.block.data(), part.block.size());
  result.set_is_last(part.is_last);
  return result;
}

v1::SyncSummary ToProto(const engine::SyncSummary& summary) {
  v1::SyncSummary result;
  result.set_chunk_count(summary.chunk_count);
  result.set_sent_chunk_count(summary.sent_chunk_count);
  for (const std::string& id : summary.dropped_chunk_ids) {
    result.add_dropped_chunk_ids(id);
  }
  return result;
}

}  // namespace mapsieve::rpc
