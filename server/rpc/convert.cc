#include "server/rpc/convert.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "absl/time/time.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "mapsieve/v1/processing_service.pb.h"
#include "server/rpc/status_adapter.h"

namespace mapsieve::rpc {
namespace {

constexpr size_t kMaxDataBytes = size_t{1} << 20;
constexpr size_t kMaxQuotedBytes = 80;
constexpr size_t kMaxColumnNameBytes = 255;

// The segments of `name` between slashes, if there are `count` of them and the
// even ones are those of `pattern`; nothing otherwise.
template <size_t count>
std::optional<std::array<std::string_view, count>> Match(
    std::string_view name, const std::array<std::string_view, count>& pattern) {
  std::array<std::string_view, count> segments;
  for (size_t i = 0; i < count; ++i) {
    const size_t slash = i + 1 < count ? name.find('/') : name.size();
    if (slash == std::string_view::npos) return std::nullopt;
    segments[i] = name.substr(0, slash);
    if (segments[i].empty() || segments[i].find('/') != segments[i].npos ||
        (!pattern[i].empty() && segments[i] != pattern[i])) {
      return std::nullopt;
    }
    name.remove_prefix(std::min(name.size(), slash + 1));
  }
  return segments;
}

absl::Status WrongName(std::string_view field, std::string_view name,
                       const char* form) {
  return InvalidField(field,
                      absl::StrCat("expected \"", form, "\", have \"",
                                   CleanText(name, kMaxQuotedBytes), "\""));
}

google::protobuf::Timestamp ToTimestamp(absl::Time time) {
  const int64_t seconds = absl::ToUnixSeconds(time);
  google::protobuf::Timestamp result;
  result.set_seconds(seconds);
  result.set_nanos(static_cast<int32_t>(
      absl::ToInt64Nanoseconds(time - absl::FromUnixSeconds(seconds))));
  return result;
}

v1::Vector3 ToVector(const core::Point3& point) {
  v1::Vector3 result;
  result.set_x(point.x);
  result.set_y(point.y);
  result.set_z(point.z);
  return result;
}

v1::Box ToBox(const engine::Bounds& bounds) {
  v1::Box result;
  *result.mutable_min() = ToVector(bounds.min);
  *result.mutable_max() = ToVector(bounds.max);
  return result;
}

std::string UploadNameOf(std::string_view map_id,
                         const std::string& upload_id) {
  return absl::StrCat("maps/", ToAbsl(map_id), "/uploads/", upload_id);
}

v1::TileChange::Change ToChange(engine::TileChangeKind kind) {
  switch (kind) {
    case engine::TileChangeKind::kNone:
      return v1::TileChange::CHANGE_NONE;
    case engine::TileChangeKind::kAdded:
      return v1::TileChange::CHANGE_ADDED;
    case engine::TileChangeKind::kRemoved:
      return v1::TileChange::CHANGE_REMOVED;
    case engine::TileChangeKind::kChanged:
      return v1::TileChange::CHANGE_CHANGED;
  }
  return v1::TileChange::CHANGE_UNSPECIFIED;
}

}  // namespace

absl::StatusOr<std::string> ParseMapName(std::string_view field,
                                         std::string_view name) {
  const auto segments = Match<2>(name, {"maps", ""});
  if (!segments) return WrongName(field, name, "maps/{map}");
  return std::string((*segments)[1]);
}

absl::StatusOr<std::string> ParseStatsName(std::string_view field,
                                           std::string_view name) {
  const auto segments = Match<3>(name, {"maps", "", "stats"});
  if (!segments) return WrongName(field, name, "maps/{map}/stats");
  return std::string((*segments)[1]);
}

absl::StatusOr<std::string> ParseOperationName(std::string_view field,
                                               std::string_view name) {
  const auto segments = Match<2>(name, {"operations", ""});
  if (!segments) return WrongName(field, name, "operations/{operation}");
  return std::string((*segments)[1]);
}

absl::StatusOr<UploadName> ParseUploadName(std::string_view field,
                                           std::string_view name) {
  const auto segments = Match<4>(name, {"maps", "", "uploads", ""});
  if (!segments) return WrongName(field, name, "maps/{map}/uploads/{upload}");
  return UploadName{std::string((*segments)[1]), std::string((*segments)[3])};
}

engine::MapSpec ToMapSpec(const v1::CreateMapRequest& request) {
  return {
      .map_id = request.map_id(),
      .step_nm =
          request.step_nm() == 0 ? core::kDefaultStepNm : request.step_nm(),
      .tile_edge = request.tile_edge(),
      .display_name = request.display_name(),
      .crs_wkt = request.crs_wkt(),
      .frame_id = request.frame_id(),
  };
}

absl::StatusOr<engine::UploadSpec> ToUploadSpec(
    const v1::CreateUploadRequest& request) {
  if (!request.has_upload()) return InvalidField("upload", "missing");
  const v1::Upload& upload = request.upload();
  return engine::UploadSpec{
      .upload_id = request.upload_id(),
      .expected_bytes = upload.expected_bytes(),
      .content_hash = upload.content_hash(),
      .refused = {.non_finite = upload.refused_non_finite_count(),
                  .out_of_lattice = upload.refused_out_of_lattice_count()},
      .source = {.crs_wkt = upload.source().crs_wkt(),
                 .frame_id = upload.source().frame_id(),
                 .unit = upload.source().unit(),
                 .coordinate_step = upload.source().coordinate_step()},
  };
}

absl::StatusOr<core::SpdfOptions> ToSpdfOptions(
    const v1::SpdfOptions& options) {
  core::SpdfOptions result;
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
    switch (options.rule()) {
      case v1::DENSITY_RULE_PAPER:
        result.rule = core::DensityRule::kPaper;
        break;
      case v1::DENSITY_RULE_QUOTA:
        result.rule = core::DensityRule::kQuota;
        break;
      default:
        return InvalidField("options.rule",
                            absl::StrCat("no rule has the number ",
                                         static_cast<int>(options.rule())));
    }
  }
  if (options.has_seed()) result.seed = options.seed();
  if (options.has_outlier_share()) {
    result.outlier_share = options.outlier_share();
  }
  return result;
}

absl::StatusOr<std::string_view> CheckedContent(
    std::string_view field, const v1::ChecksummedData& data) {
  const std::string& content = data.content();
  if (content.empty() || content.size() > kMaxDataBytes) {
    return InvalidField(absl::StrCat(ToAbsl(field), ".content"),
                        absl::StrCat("expected 1 to ", kMaxDataBytes,
                                     " bytes, have ", content.size()));
  }
  if (!data.has_xxh3_64()) {
    return InvalidField(absl::StrCat(ToAbsl(field), ".xxh3_64"), "missing");
  }
  const uint64_t actual = Hash64(TextBytes(content));
  if (actual != data.xxh3_64()) {
    return WithReason(
        absl::DataLossError(absl::StrCat(
            ToAbsl(field), ".content: expected the checksum ",
            absl::Hex(data.xxh3_64(), absl::kZeroPad16), ", have ",
            absl::Hex(actual, absl::kZeroPad16),
            "; the bytes were damaged on the way: send them again")),
        "CHECKSUM_MISMATCH", {{"field", std::string(field)}});
  }
  return content;
}

v1::Map ToProto(const engine::MapInfo& map) {
  v1::Map result;
  result.set_name(absl::StrCat("maps/", map.map_id));
  result.set_uid(map.uid);
  result.set_display_name(map.display_name);
  result.set_step_nm(map.step_nm);
  result.set_tile_level(map.tile_level);
  result.set_crs_wkt(map.crs_wkt);
  result.set_revision(map.revision);
  result.set_processed_revision(map.processed_revision);
  *result.mutable_create_time() = ToTimestamp(map.create_time);
  *result.mutable_update_time() = ToTimestamp(map.update_time);
  result.set_frame_id(map.frame_id);
  return result;
}

v1::MapStats ToProto(std::string_view map_id, const engine::MapStats& stats) {
  v1::MapStats result;
  result.set_name(absl::StrCat("maps/", ToAbsl(map_id), "/stats"));
  result.set_revision(stats.revision);
  result.set_processed_revision(stats.processed_revision);
  result.set_raw_point_count(stats.raw_point_count);
  result.set_point_count(stats.point_count);
  *result.mutable_label_counts() = ToProto(stats.label_counts);
  for (const core::LabelCounts& counts : stats.level_counts) {
    *result.add_level_counts() = ToProto(counts);
  }
  result.set_outlier_count(stats.outlier_count);
  result.set_oldest_revision(stats.oldest_revision);
  result.set_stored_bytes(stats.stored_bytes);
  result.set_reclaimable_bytes(stats.reclaimable_bytes);
  result.set_tile_count(stats.tile_count);
  result.set_stale_tile_count(stats.stale_tile_count);
  if (stats.bounds) *result.mutable_bounds() = ToBox(*stats.bounds);
  for (const core::ColumnSpec& column : stats.attributes) {
    *result.add_attributes() = ToProto(column);
  }
  if (stats.options) *result.mutable_options() = ToProto(*stats.options);
  return result;
}

v1::Revision ToProto(std::string_view map_id,
                     const engine::RevisionInfo& revision) {
  v1::Revision result;
  result.set_number(revision.number);
  switch (revision.kind) {
    case engine::RevisionKind::kCreate:
      result.set_kind(v1::Revision::KIND_CREATE);
      break;
    case engine::RevisionKind::kUpload:
      result.set_kind(v1::Revision::KIND_UPLOAD);
      break;
    case engine::RevisionKind::kProcess:
      result.set_kind(v1::Revision::KIND_PROCESS);
      break;
    case engine::RevisionKind::kDeleteRegion:
      result.set_kind(v1::Revision::KIND_DELETE_REGION);
      break;
    case engine::RevisionKind::kReplaceRegion:
      result.set_kind(v1::Revision::KIND_REPLACE_REGION);
      break;
    case engine::RevisionKind::kRollback:
      result.set_kind(v1::Revision::KIND_ROLLBACK);
      break;
  }
  *result.mutable_create_time() = ToTimestamp(revision.create_time);
  result.set_expired(revision.is_expired);
  result.set_raw_point_count(revision.raw_point_count);
  result.set_processed_revision(revision.processed_revision);
  if (!revision.upload_id.empty()) {
    result.set_upload(UploadNameOf(map_id, revision.upload_id));
  }
  if (revision.region) {
    if (const auto* box = std::get_if<engine::Box>(&*revision.region)) {
      *result.mutable_box()->mutable_min() = ToVector(box->min);
      *result.mutable_box()->mutable_max() = ToVector(box->max);
    } else {
      const auto& sphere = std::get<engine::Sphere>(*revision.region);
      *result.mutable_sphere()->mutable_center() = ToVector(sphere.center);
      result.mutable_sphere()->set_radius(sphere.radius);
    }
  }
  if (revision.options) *result.mutable_options() = ToProto(*revision.options);
  result.set_restored_revision(revision.restored_revision);
  result.set_added_point_count(revision.added_point_count);
  result.set_removed_point_count(revision.removed_point_count);
  result.set_point_count(revision.point_count);
  *result.mutable_label_counts() = ToProto(revision.label_counts);
  result.set_stored_bytes(revision.stored_bytes);
  result.set_tile_count(revision.tile_count);
  result.set_stale_tile_count(revision.stale_tile_count);
  return result;
}

v1::TileChange ToProto(const engine::TileChange& change) {
  v1::TileChange result;
  result.set_x(change.tile.x);
  result.set_y(change.tile.y);
  result.set_z(change.tile.z);
  result.set_raw(ToChange(change.raw));
  result.set_product(ToChange(change.product));
  result.set_base_raw_point_count(change.base_raw_point_count);
  result.set_target_raw_point_count(change.target_raw_point_count);
  *result.mutable_base_label_counts() = ToProto(change.base_label_counts);
  *result.mutable_target_label_counts() = ToProto(change.target_label_counts);
  return result;
}

v1::DamagedChunk ToProto(const engine::DamagedChunk& chunk) {
  v1::DamagedChunk result;
  // The numbers are the same.
  result.set_content(static_cast<v1::DamagedChunk::Content>(chunk.content));
  result.set_x(chunk.tile.x);
  result.set_y(chunk.tile.y);
  result.set_z(chunk.tile.z);
  result.set_blob_id(chunk.blob_id);
  result.set_problem(chunk.problem);
  return result;
}

v1::VerifyMapResponse ToProto(const engine::VerifyEvent& event) {
  v1::VerifyMapResponse result;
  if (const auto* progress = std::get_if<engine::VerifyProgress>(&event)) {
    result.mutable_progress()->set_done_count(progress->done_count);
    result.mutable_progress()->set_total_count(progress->total_count);
  } else if (const auto* damaged = std::get_if<engine::DamagedChunk>(&event)) {
    *result.mutable_damaged_chunk() = ToProto(*damaged);
  } else {
    const auto& differing = std::get<engine::DifferingTile>(event);
    v1::DifferingTile& tile = *result.mutable_differing_tile();
    tile.set_x(differing.tile.x);
    tile.set_y(differing.tile.y);
    tile.set_z(differing.tile.z);
    tile.set_difference(differing.difference);
  }
  return result;
}

v1::VerifySummary ToProto(const engine::VerifySummary& summary) {
  v1::VerifySummary result;
  result.set_chunk_count(summary.chunk_count);
  result.set_stored_bytes(summary.stored_bytes);
  result.set_damaged_chunk_count(summary.damaged_chunk_count);
  result.set_compared_tile_count(summary.compared_tile_count);
  result.set_compared_point_count(summary.compared_point_count);
  result.set_differing_tile_count(summary.differing_tile_count);
  result.set_skipped_tile_count(summary.skipped_tile_count);
  return result;
}

v1::Upload ToProto(std::string_view map_id, const engine::UploadInfo& upload) {
  v1::Upload result;
  result.set_name(UploadNameOf(map_id, upload.spec.upload_id));
  switch (upload.state) {
    case engine::UploadState::kActive:
      result.set_state(v1::Upload::STATE_ACTIVE);
      break;
    case engine::UploadState::kFinalizing:
      result.set_state(v1::Upload::STATE_FINALIZING);
      break;
    case engine::UploadState::kFinalized:
      result.set_state(v1::Upload::STATE_FINALIZED);
      break;
    case engine::UploadState::kFailed:
      result.set_state(v1::Upload::STATE_FAILED);
      break;
  }
  result.set_expected_bytes(upload.spec.expected_bytes);
  result.set_content_hash(upload.spec.content_hash);
  result.set_refused_non_finite_count(upload.spec.refused.non_finite);
  result.set_refused_out_of_lattice_count(upload.spec.refused.out_of_lattice);
  result.set_committed_bytes(upload.committed_bytes);
  *result.mutable_create_time() = ToTimestamp(upload.create_time);
  if (upload.report) *result.mutable_report() = ToProto(*upload.report);
  const engine::UploadSource& source = upload.spec.source;
  if (source == engine::UploadSource()) return result;
  result.mutable_source()->set_crs_wkt(source.crs_wkt);
  result.mutable_source()->set_frame_id(source.frame_id);
  result.mutable_source()->set_unit(source.unit);
  result.mutable_source()->set_coordinate_step(source.coordinate_step);
  return result;
}

v1::PointCensus ToProto(const engine::PointCensus& census) {
  v1::PointCensus result;
  result.set_duplicate_point_count(census.duplicate_point_count);
  if (census.overlapping_point_count) {
    result.set_overlapping_point_count(*census.overlapping_point_count);
  }
  result.set_density_cell_level(census.density_cell_level);
  for (const int64_t count : census.density_histogram) {
    result.add_density_histogram(count);
  }
  return result;
}

v1::UploadReport ToProto(const engine::UploadReport& report) {
  v1::UploadReport result;
  result.set_revision(report.revision);
  result.set_added_point_count(report.added_point_count);
  result.set_refused_non_finite_count(report.refused.non_finite);
  result.set_refused_out_of_lattice_count(report.refused.out_of_lattice);
  result.set_removed_point_count(report.removed_point_count);
  result.set_block_count(report.block_count);
  result.set_tile_count(report.tile_count);
  if (report.bounds) *result.mutable_bounds() = ToBox(*report.bounds);
  if (report.census) *result.mutable_census() = ToProto(*report.census);
  for (const engine::UploadWarning& warning : report.warnings) {
    v1::UploadWarning& added = *result.add_warnings();
    added.set_code(warning.code);
    added.set_message(warning.message);
  }
  return result;
}

v1::Operation ToProto(const engine::Operation& operation) {
  v1::OperationMetadata metadata;
  std::string target = absl::StrCat("maps/", operation.map_id);
  switch (operation.verb) {
    case engine::OperationVerb::kFinalizeUpload:
      absl::StrAppend(&target, "/uploads/", operation.upload_id);
      metadata.set_verb("FinalizeUpload");
      break;
    case engine::OperationVerb::kProcessMap:
      metadata.set_verb("ProcessMap");
      break;
    case engine::OperationVerb::kDeleteRegion:
      metadata.set_verb("DeleteRegion");
      break;
    case engine::OperationVerb::kRepairMap:
      metadata.set_verb("RepairMap");
      break;
  }
  metadata.set_target(std::move(target));
  *metadata.mutable_create_time() = ToTimestamp(operation.create_time);
  if (operation.start_time) {
    *metadata.mutable_start_time() = ToTimestamp(*operation.start_time);
  }
  if (operation.end_time) {
    *metadata.mutable_end_time() = ToTimestamp(*operation.end_time);
  }
  metadata.set_done_work(operation.done_work);
  metadata.set_total_work(operation.total_work);
  metadata.set_cancel_requested(operation.cancel_requested);

  v1::Operation result;
  result.set_name(absl::StrCat("operations/", operation.operation_id));
  result.mutable_metadata()->PackFrom(metadata);
  result.set_done(operation.done());
  if (!operation.done()) return result;
  if (operation.upload_report) {
    v1::FinalizeUploadResponse response;
    *response.mutable_report() = ToProto(*operation.upload_report);
    result.mutable_response()->PackFrom(response);
  } else if (operation.process_report) {
    const engine::ProcessReport& report = *operation.process_report;
    v1::ProcessMapResponse response;
    response.set_revision(report.revision);
    response.set_distinct_point_count(report.distinct_point_count);
    response.set_point_count(report.point_count);
    *response.mutable_label_counts() = ToProto(report.label_counts);
    response.set_outlier_count(report.outlier_count);
    response.set_round_count(report.round_count);
    response.set_updated_tile_count(report.updated_tile_count);
    result.mutable_response()->PackFrom(response);
  } else if (operation.delete_report) {
    v1::DeleteRegionResponse response;
    response.set_revision(operation.delete_report->revision);
    response.set_removed_point_count(
        operation.delete_report->removed_point_count);
    response.set_tile_count(operation.delete_report->tile_count);
    result.mutable_response()->PackFrom(response);
  } else if (operation.repair_report) {
    const engine::RepairReport& report = *operation.repair_report;
    v1::RepairMapResponse response;
    response.set_damaged_chunk_count(report.damaged_chunk_count);
    response.set_repaired_chunk_count(report.repaired_chunk_count);
    response.set_raw_chunk_count(report.raw_chunk_count);
    response.set_obstacle(report.obstacle);
    result.mutable_response()->PackFrom(response);
  } else {
    *result.mutable_error() = ToRpcStatus(operation.error);
  }
  return result;
}

v1::SpdfOptions ToProto(const core::SpdfOptions& options) {
  v1::SpdfOptions result;
  result.set_vote_scale_m2(options.vote_scale_m2);
  result.set_density_radius_m(options.density_radius_m);
  result.set_neighbor_count(options.neighbor_count);
  result.set_label_neighbor_count(options.label_neighbor_count);
  result.set_reach_m(options.reach_m);
  result.set_max_round_count(options.max_round_count);
  switch (options.rule) {
    case core::DensityRule::kPaper:
      result.set_rule(v1::DENSITY_RULE_PAPER);
      break;
    case core::DensityRule::kQuota:
      result.set_rule(v1::DENSITY_RULE_QUOTA);
      break;
  }
  result.set_seed(options.seed);
  result.set_outlier_share(options.outlier_share);
  return result;
}

v1::LabelCounts ToProto(const core::LabelCounts& counts) {
  const auto count = [&](core::Label label) {
    return counts[static_cast<size_t>(label)];
  };
  v1::LabelCounts result;
  result.set_none(count(core::Label::kNone));
  result.set_junction(count(core::Label::kJunction));
  result.set_curve(count(core::Label::kCurve));
  result.set_surface(count(core::Label::kSurface));
  return result;
}

v1::ColumnSpec ToProto(const core::ColumnSpec& column) {
  v1::ColumnSpec result;
  result.set_name(CleanText(column.name, kMaxColumnNameBytes));
  result.set_type(static_cast<v1::ScalarType>(column.type));
  return result;
}

}  // namespace mapsieve::rpc
