#include "client/api/convert.h"

namespace mapsieve::client {
namespace {

core::Point3 FromProto(const v1::Vector3& v) { return {v.x(), v.y(), v.z()}; }

void ToProto(const core::Point3& p, v1::Vector3* v) {
  v->set_x(p.x);
  v->set_y(p.y);
  v->set_z(p.z);
}

void ToProto(const Quaternion& q, v1::Quaternion* result) {
  result->set_x(q.x);
  result->set_y(q.y);
  result->set_z(q.z);
  result->set_w(q.w);
}

template <typename Shape, typename Message>
void SetHeights(const Shape& shape, Message& message) {
  if (shape.min_z) message.set_min_z(*shape.min_z);
  if (shape.max_z) message.set_max_z(*shape.max_z);
}

// The field `region` of a request, by shape.

template <typename Request>
void SetShape(std::monostate /*everywhere*/, Request& /*request*/) {}

template <typename Request>
void SetShape(const BoxRegion& box, Request& request) {
  ToProto(box.min, request.mutable_box()->mutable_min());
  ToProto(box.max, request.mutable_box()->mutable_max());
}

template <typename Request>
void SetShape(const SphereRegion& sphere, Request& request) {
  ToProto(sphere.center, request.mutable_sphere()->mutable_center());
  request.mutable_sphere()->set_radius(sphere.radius);
}

void SetShape(const OrientedBoxRegion& box, v1::QueryRegionRequest& request) {
  v1::OrientedBox& result = *request.mutable_oriented_box();
  ToProto(box.center, result.mutable_center());
  ToProto(box.orientation, result.mutable_orientation());
  ToProto(box.half_size, result.mutable_half_size());
}

void SetShape(const CylinderRegion& cylinder, v1::QueryRegionRequest& request) {
  v1::VerticalCylinder& result = *request.mutable_cylinder();
  result.set_center_x(cylinder.center_x);
  result.set_center_y(cylinder.center_y);
  result.set_radius(cylinder.radius);
  SetHeights(cylinder, result);
}

void SetShape(const PolygonRegion& polygon, v1::QueryRegionRequest& request) {
  v1::PolygonPrism& result = *request.mutable_polygon();
  for (const PolygonRegion::Vertex& vertex : polygon.vertices) {
    v1::Vector2* added = result.add_vertices();
    added->set_x(vertex.x);
    added->set_y(vertex.y);
  }
  SetHeights(polygon, result);
}

void SetShape(const FrustumRegion& frustum, v1::QueryRegionRequest& request) {
  v1::Frustum& result = *request.mutable_frustum();
  ToProto(frustum.position, result.mutable_position());
  ToProto(frustum.orientation, result.mutable_orientation());
  result.set_half_width(frustum.half_width);
  result.set_half_height(frustum.half_height);
  result.set_near(frustum.near);
  result.set_far(frustum.far);
}

void SetShape(const CorridorRegion& corridor, v1::QueryRegionRequest& request) {
  v1::Corridor& result = *request.mutable_corridor();
  for (const core::Point3& p : corridor.path) ToProto(p, result.add_path());
  result.set_radius(corridor.radius);
}

template <typename Shapes, typename Request>
void SetRegionOf(Request& request, const Shapes& region) {
  std::visit([&](const auto& shape) { SetShape(shape, request); }, region);
}

void ToProto(const ValueRange& range, v1::Range* result) {
  if (range.min) result->set_min(*range.min);
  if (range.max) result->set_max(*range.max);
}

RevisionKind FromProto(v1::Revision::Kind kind) {
  switch (kind) {
    case v1::Revision::KIND_CREATE:
      return RevisionKind::kCreate;
    case v1::Revision::KIND_UPLOAD:
      return RevisionKind::kUpload;
    case v1::Revision::KIND_PROCESS:
      return RevisionKind::kProcess;
    case v1::Revision::KIND_DELETE_REGION:
      return RevisionKind::kDeleteRegion;
    case v1::Revision::KIND_REPLACE_REGION:
      return RevisionKind::kReplaceRegion;
    case v1::Revision::KIND_ROLLBACK:
      return RevisionKind::kRollback;
    default:
      return RevisionKind::kUnknown;
  }
}

TileChangeKind FromProto(v1::TileChange::Change change) {
  switch (change) {
    case v1::TileChange::CHANGE_ADDED:
      return TileChangeKind::kAdded;
    case v1::TileChange::CHANGE_REMOVED:
      return TileChangeKind::kRemoved;
    case v1::TileChange::CHANGE_CHANGED:
      return TileChangeKind::kChanged;
    default:
      return TileChangeKind::kNone;
  }
}

core::LabelCounts FromProto(const v1::LabelCounts& counts) {
  return {counts.none(), counts.junction(), counts.curve(), counts.surface()};
}

Bounds FromProto(const v1::Box& box) {
  return {FromProto(box.min()), FromProto(box.max())};
}

ProcessOptions FromProto(const v1::SpdfOptions& options) {
  ProcessOptions result;
  if (options.has_vote_scale_m2()) {
    result.vote_scale_m2 = options.vote_scale_m2();
  }
  if (options.has_density_radius_m()) {
    result.density_radius_m = options.density_radius_m();
  }
  if (options.has_neighbor_count()) {
    result.neighbor_count = options.neighbor_count();
  }
  if (options.has_label_neighbor_count()) {
    result.label_neighbor_count = options.label_neighbor_count();
  }
  if (options.has_reach_m()) result.reach_m = options.reach_m();
  if (options.has_max_round_count()) {
    result.max_round_count = options.max_round_count();
  }
  if (options.has_rule()) {
    result.quota_rule = options.rule() == v1::DENSITY_RULE_QUOTA;
  }
  if (options.has_seed()) result.seed = options.seed();
  if (options.has_outlier_share()) {
    result.outlier_share = options.outlier_share();
  }
  return result;
}

}  // namespace

core::ColumnSpec FromProto(const v1::ColumnSpec& spec) {
  return {spec.name(), static_cast<core::ScalarType>(spec.type())};
}

absl::Status ToStatus(const grpc::Status& status) {
  // The server's own errors have details.
  if (status.error_code() == grpc::StatusCode::UNAVAILABLE &&
      status.error_details().empty()) {
    return absl::UnavailableError(absl::StrCat(
        "the server cannot be reached, or went away: ", status.error_message(),
        "; see that mapsieved runs there"));
  }
  return {static_cast<absl::StatusCode>(status.error_code()),
          status.error_message()};
}

absl::Status ToStatus(const v1::RpcStatus& status) {
  return {static_cast<absl::StatusCode>(status.code()), status.message()};
}

std::string MapName(const std::string& map_id) { return "maps/" + map_id; }

std::string LastSegment(const std::string& name) {
  return name.substr(name.rfind('/') + 1);
}

MapInfo FromProto(const v1::Map& map) {
  return {.id = LastSegment(map.name()),
          .uid = map.uid(),
          .display_name = map.display_name(),
          .step_nm = map.step_nm(),
          .tile_level = map.tile_level(),
          .crs_wkt = map.crs_wkt(),
          .frame_id = map.frame_id(),
          .revision = map.revision(),
          .processed_revision = map.processed_revision()};
}

MapStats FromProto(const v1::MapStats& stats) {
  MapStats result = {.revision = stats.revision(),
                     .processed_revision = stats.processed_revision(),
                     .raw_point_count = stats.raw_point_count(),
                     .point_count = stats.point_count(),
                     .label_counts = FromProto(stats.label_counts()),
                     .outlier_count = stats.outlier_count(),
                     .stored_bytes = stats.stored_bytes(),
                     .reclaimable_bytes = stats.reclaimable_bytes(),
                     .oldest_revision = stats.oldest_revision(),
                     .tile_count = stats.tile_count(),
                     .stale_tile_count = stats.stale_tile_count()};
  for (const v1::LabelCounts& counts : stats.level_counts()) {
    result.level_counts.push_back(FromProto(counts));
  }
  if (stats.has_bounds()) result.bounds = FromProto(stats.bounds());
  for (const v1::ColumnSpec& spec : stats.attributes()) {
    result.attributes.push_back(FromProto(spec));
  }
  if (stats.has_options()) result.options = FromProto(stats.options());
  return result;
}

UploadReport FromProto(const v1::UploadReport& report) {
  UploadReport result = {
      .revision = report.revision(),
      .added_point_count = report.added_point_count(),
      .refused_non_finite_count = report.refused_non_finite_count(),
      .refused_out_of_lattice_count = report.refused_out_of_lattice_count(),
      .removed_point_count = report.removed_point_count(),
      .tile_count = report.tile_count()};
  if (report.has_bounds()) result.bounds = FromProto(report.bounds());
  if (report.has_census()) {
    const v1::PointCensus& census = report.census();
    result.census =
        PointCensus{.duplicate_point_count = census.duplicate_point_count(),
                    .density_cell_level = census.density_cell_level(),
                    .density_histogram = {census.density_histogram().begin(),
                                          census.density_histogram().end()}};
    if (census.has_overlapping_point_count()) {
      result.census->overlapping_point_count = census.overlapping_point_count();
    }
  }
  for (const v1::UploadWarning& warning : report.warnings()) {
    result.warnings.push_back({warning.code(), warning.message()});
  }
  return result;
}

ProcessReport FromProto(const v1::ProcessMapResponse& response) {
  return {.revision = response.revision(),
          .distinct_point_count = response.distinct_point_count(),
          .point_count = response.point_count(),
          .label_counts = FromProto(response.label_counts()),
          .outlier_count = response.outlier_count(),
          .round_count = response.round_count(),
          .updated_tile_count = response.updated_tile_count()};
}

OperationInfo FromProto(const v1::Operation& operation) {
  OperationInfo result = {.id = LastSegment(operation.name()),
                          .done = operation.done()};
  v1::OperationMetadata metadata;
  if (operation.metadata().UnpackTo(&metadata)) {
    result.target = metadata.target();
    result.verb = metadata.verb();
    result.done_work = metadata.done_work();
    result.total_work = metadata.total_work();
  }
  return result;
}

RevisionInfo FromProto(const v1::Revision& revision) {
  RevisionInfo result = {
      .number = revision.number(),
      .kind = FromProto(revision.kind()),
      .create_time = absl::FromUnixSeconds(revision.create_time().seconds()) +
                     absl::Nanoseconds(revision.create_time().nanos()),
      .is_expired = revision.expired(),
      .restored_revision = revision.restored_revision(),
      .added_point_count = revision.added_point_count(),
      .removed_point_count = revision.removed_point_count(),
      .raw_point_count = revision.raw_point_count(),
      .processed_revision = revision.processed_revision(),
      .point_count = revision.point_count(),
      .label_counts = FromProto(revision.label_counts()),
      .stored_bytes = revision.stored_bytes(),
      .tile_count = revision.tile_count(),
      .stale_tile_count = revision.stale_tile_count()};
  if (!revision.upload().empty()) {
    result.upload_id = LastSegment(revision.upload());
  }
  if (revision.has_box()) {
    result.region = BoxRegion{FromProto(revision.box().min()),
                              FromProto(revision.box().max())};
  } else if (revision.has_sphere()) {
    result.region = SphereRegion{FromProto(revision.sphere().center()),
                                 revision.sphere().radius()};
  }
  if (revision.has_options()) result.options = FromProto(revision.options());
  return result;
}

DamagedChunk FromProto(const v1::DamagedChunk& chunk) {
  DamagedChunk result = {.tile = {chunk.x(), chunk.y(), chunk.z()},
                         .blob_id = chunk.blob_id(),
                         .problem = chunk.problem()};
  switch (chunk.content()) {
    case v1::DamagedChunk::CONTENT_RAW:
      result.content = "raw";
      break;
    case v1::DamagedChunk::CONTENT_PRODUCT:
      result.content = "product";
      break;
    case v1::DamagedChunk::CONTENT_HISTORY:
      result.content = "history";
      break;
    default:
      result.content = "unknown";
  }
  return result;
}

DifferingTile FromProto(const v1::DifferingTile& tile) {
  return {.tile = {tile.x(), tile.y(), tile.z()},
          .difference = tile.difference()};
}

TileChange FromProto(const v1::TileChange& change) {
  return {.tile = {change.x(), change.y(), change.z()},
          .raw = FromProto(change.raw()),
          .product = FromProto(change.product()),
          .base_raw_point_count = change.base_raw_point_count(),
          .target_raw_point_count = change.target_raw_point_count(),
          .base_label_counts = FromProto(change.base_label_counts()),
          .target_label_counts = FromProto(change.target_label_counts())};
}

void SetRegion(const Region& region, v1::FinalizeUploadRequest& request) {
  SetRegionOf(request, region);
}

void SetRegion(const Region& region, v1::DeleteRegionRequest& request) {
  SetRegionOf(request, region);
}

QueryHeader FromProto(const v1::QueryHeader& header) {
  QueryHeader result = {
      .revision = header.revision(),
      .step_nm = header.step_nm(),
      .candidate_point_count = header.candidate_point_count()};
  for (const v1::ColumnSpec& spec : header.columns()) {
    result.columns.push_back(FromProto(spec));
  }
  return result;
}

SyncSummary FromProto(const v1::SyncSummary& summary) {
  return {.revision = summary.revision(),
          .chunk_count = summary.chunk_count(),
          .dropped_chunk_ids = {summary.dropped_chunk_ids().begin(),
                                summary.dropped_chunk_ids().end()}};
}

QuerySummary FromProto(const v1::QuerySummary& summary) {
  QuerySummary result = {
      .point_count = summary.point_count(),
      .label_counts = FromProto(summary.label_counts()),
      .block_bytes = summary.block_bytes(),
      .available_point_count = summary.available_point_count(),
      .available_label_counts = FromProto(summary.available_label_counts()),
      .missing_chunk_count = summary.missing_chunk_count(),
      .missing_point_count = summary.missing_point_count()};
  for (const v1::DamagedChunk& chunk : summary.missing_chunks()) {
    result.missing_chunks.push_back(FromProto(chunk));
  }
  return result;
}

v1::SpdfOptions ToProto(const ProcessOptions& options) {
  v1::SpdfOptions result;
  if (options.vote_scale_m2) result.set_vote_scale_m2(*options.vote_scale_m2);
  if (options.density_radius_m) {
    result.set_density_radius_m(*options.density_radius_m);
  }
  if (options.neighbor_count) {
    result.set_neighbor_count(*options.neighbor_count);
  }
  if (options.label_neighbor_count) {
    result.set_label_neighbor_count(*options.label_neighbor_count);
  }
  if (options.reach_m) result.set_reach_m(*options.reach_m);
  if (options.max_round_count) {
    result.set_max_round_count(*options.max_round_count);
  }
  if (options.quota_rule) {
    result.set_rule(*options.quota_rule ? v1::DENSITY_RULE_QUOTA
                                        : v1::DENSITY_RULE_PAPER);
  }
  if (options.seed) result.set_seed(*options.seed);
  if (options.outlier_share) result.set_outlier_share(*options.outlier_share);
  return result;
}

v1::QueryRegionRequest ToProto(const QuerySpec& spec) {
  v1::QueryRegionRequest request;
  request.set_name(MapName(spec.map_id));
  request.set_revision(spec.revision);
  SetRegionOf(request, spec.region);
  for (const core::Label label : spec.labels) {
    request.add_labels(static_cast<v1::Label>(label));
  }
  request.set_depth(spec.depth);
  request.set_spacing_m(spec.spacing_m);
  request.set_max_point_count(spec.max_point_count);
  request.set_max_bytes(spec.max_bytes);
  if (spec.label_weights.has_value()) {
    v1::LabelWeights* weights = request.mutable_label_weights();
    weights->set_junction(spec.label_weights->junction);
    weights->set_curve(spec.label_weights->curve);
    weights->set_surface(spec.label_weights->surface);
  }
  if (spec.confidence.has_value()) {
    ToProto(*spec.confidence, request.mutable_confidence());
  }
  for (const AttributeRange& range : spec.attribute_ranges) {
    v1::AttributeRange* added = request.add_attribute_ranges();
    added->set_name(range.name);
    ToProto(range.range, added->mutable_range());
  }
  if (spec.columns.has_value()) {
    v1::ColumnSelection* columns = request.mutable_columns();
    for (const FilterColumn column : spec.columns->filter_columns) {
      columns->add_filter_columns(static_cast<v1::FilterColumn>(column));
    }
    for (const std::string& name : spec.columns->attributes) {
      columns->add_attributes(name);
    }
    columns->set_all_attributes(spec.columns->all_attributes);
  }
  request.set_raw(spec.raw);
  request.set_allow_partial(spec.allow_partial);
  request.set_plain_blocks(spec.plain_blocks);
  if (spec.centroids) {
    request.set_representative(v1::REPRESENTATIVE_CENTROID);
  }
  return request;
}

v1::SyncRegionRequest ToProto(const SyncSpec& spec) {
  v1::SyncRegionRequest request;
  *request.mutable_query() = ToProto(spec.query);
  for (const std::string& id : spec.held_chunk_ids) {
    request.add_held_chunk_ids(id);
  }
  return request;
}

}  // namespace mapsieve::client
