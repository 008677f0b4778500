#include "client/cli/revision_json.h"

#include <variant>

namespace mapsieve::client {
namespace {

const char* KindName(RevisionKind kind) {
  switch (kind) {
    case RevisionKind::kUnknown:
      return "unknown";
    case RevisionKind::kCreate:
      return "create";
    case RevisionKind::kUpload:
      return "upload";
    case RevisionKind::kProcess:
      return "process";
    case RevisionKind::kDeleteRegion:
      return "delete-region";
    case RevisionKind::kReplaceRegion:
      return "replace-region";
    case RevisionKind::kRollback:
      return "rollback";
  }
  return "unknown";
}

/// The options by their names on the command line.
Json OptionsJson(const ProcessOptions& options) {
  Json result = Json::object();
  const auto add = [&](const char* name, const auto& value) {
    if (value.has_value()) result[name] = *value;
  };
  add("rho", options.density_radius_m);
  add("sigma", options.vote_scale_m2);
  add("neighbors", options.neighbor_count);
  add("label_neighbors", options.label_neighbor_count);
  add("reach", options.reach_m);
  add("rounds", options.max_round_count);
  if (options.quota_rule.has_value()) {
    result["rule"] = *options.quota_rule ? "quota" : "paper";
  }
  add("seed", options.seed);
  add("outlier_share", options.outlier_share);
  return result;
}

}  // namespace

Json RevisionJson(const RevisionInfo& revision) {
  Json result = {
      {"revision", revision.number},
      {"kind", KindName(revision.kind)},
      {"time", absl::FormatTime("%Y-%m-%dT%H:%M:%SZ", revision.create_time,
                                absl::UTCTimeZone())}};
  if (revision.is_expired) result["expired"] = true;
  if (!revision.upload_id.empty()) result["upload"] = revision.upload_id;
  if (const auto* box = std::get_if<BoxRegion>(&revision.region)) {
    result["box"] = {box->min.x, box->min.y, box->min.z,
                     box->max.x, box->max.y, box->max.z};
  } else if (const auto* ball = std::get_if<SphereRegion>(&revision.region)) {
    result["sphere"] = {ball->center.x, ball->center.y, ball->center.z,
                        ball->radius};
  }
  if (revision.options.has_value()) {
    result["options"] = OptionsJson(*revision.options);
  }
  if (revision.restored_revision != 0) {
    result["restored_revision"] = revision.restored_revision;
  }
  result["added_point_count"] = revision.added_point_count;
  result["removed_point_count"] = revision.removed_point_count;
  result["raw_point_count"] = revision.raw_point_count;
  result["processed_revision"] = revision.processed_revision;
  result["point_count"] = revision.point_count;
  result["label_counts"] = LabelCountsJson(revision.label_counts);
  result["stored_bytes"] = revision.stored_bytes;
  result["tile_count"] = revision.tile_count;
  result["stale_tile_count"] = revision.stale_tile_count;
  return result;
}

}  // namespace mapsieve::client
