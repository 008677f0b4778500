#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/api/map_client.h"
#include "client/cli/commands.h"
#include "client/cli/local_frame.h"
#include "client/cli/output.h"
#include "client/cli/progress_bar.h"
#include "client/cli/sync_folder.h"
#include "client/formats/point_file.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

/// What the points of a window depend on besides its revision.
std::string SourceOf(const SyncCommand& command, const MapInfo& map) {
  const core::Point3& o = command.origin;
  Json source = {{"map_uid", map.uid},
                 {"depth", command.query.depth},
                 {"origin", {o.x, o.y, o.z}}};
  if (!map.frame_id.empty()) source["frame_id"] = map.frame_id;
  return source.dump();
}

/// Writes the points of a chunk; nothing for none.
absl::StatusOr<HeldChunk> WriteChunk(const std::filesystem::path& folder,
                                     const SyncChunk& chunk, const MapInfo& map,
                                     const core::Point3& origin) {
  const core::Point3 corner =
      chunk.points.lattice.Position(chunk.tile.corner());
  HeldChunk held{
      .id = chunk.id,
      .corner = {corner.x - origin.x, corner.y - origin.y, corner.z - origin.z},
      .point_count = static_cast<int64_t>(chunk.points.size())};
  if (held.point_count == 0) return held;
  // The id makes another file of a chunk that changed, for readers that know
  // files by their names.
  held.file = absl::StrCat(chunk.tile.x, "_", chunk.tile.y, "_", chunk.tile.z,
                           "-", chunk.id.substr(0, 8), ".pcd");
  core::PointCloud points = core::ToPointCloud(chunk.points);
  MAPSIEVE_RETURN_IF_ERROR(MoveToLocalFrame(origin, points));
  MAPSIEVE_RETURN_IF_ERROR(WritePointFile(folder / held.file, points,
                                          OptionsOfLocalFrame(map, origin)));
  return held;
}

}  // namespace

absl::Status RunSync(const CommonOptions& common, const SyncCommand& command) {
  const auto start = std::chrono::steady_clock::now();
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapInfo map,
                            client.GetMap(command.query.map_id));
  MAPSIEVE_ASSIGN_OR_RETURN(const auto folder,
                            SyncFolder::Open(command.folder));
  SyncWindow next{
      .source = SourceOf(command, map),
      .tile_edge = static_cast<double>(map.step_nm) / 1e9 *
                   static_cast<double>(int64_t{1} << map.tile_level)};
  std::vector<HeldChunk> held;
  if (folder->current().source == next.source) held = folder->current().chunks;
  SyncSpec spec{.query = command.query};
  for (const HeldChunk& chunk : held) spec.held_chunk_ids.push_back(chunk.id);

  std::optional<std::filesystem::path> path;
  int64_t received_points = 0;
  absl::StatusOr<SyncSummary> answer;
  {
    ProgressBar bar("sync " + map.id, "points");
    answer = client.Sync(spec, [&](const SyncChunk& chunk) -> absl::Status {
      if (!path.has_value()) {
        MAPSIEVE_ASSIGN_OR_RETURN(path, folder->BeginWindow());
      }
      MAPSIEVE_ASSIGN_OR_RETURN(HeldChunk written,
                                WriteChunk(*path, chunk, map, command.origin));
      received_points += written.point_count;
      next.chunks.push_back(std::move(written));
      bar.Report(received_points, 0);
      return absl::OkStatus();
    });
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const SyncSummary summary, std::move(answer));
  const size_t received = next.chunks.size();
  next.revision = summary.revision;
  const bool has_changed = path.has_value() ||
                           !summary.dropped_chunk_ids.empty() ||
                           folder->current().source != next.source;
  if (has_changed) {
    if (!path.has_value()) {
      MAPSIEVE_RETURN_IF_ERROR(folder->BeginWindow().status());
    }
    const std::set<std::string> dropped(summary.dropped_chunk_ids.begin(),
                                        summary.dropped_chunk_ids.end());
    for (HeldChunk& chunk : held) {
      if (dropped.contains(chunk.id)) continue;
      MAPSIEVE_RETURN_IF_ERROR(folder->Keep(chunk));
      next.chunks.push_back(std::move(chunk));
    }
    MAPSIEVE_RETURN_IF_ERROR(folder->Finish(next));
  }
  int64_t point_count = 0;
  for (const HeldChunk& chunk : folder->current().chunks) {
    point_count += chunk.point_count;
  }
  PrintResult(
      common.json,
      {{"map", map.id},
       {"revision", summary.revision},
       {"chunk_count", summary.chunk_count},
       {"received_chunk_count", received},
       {"dropped_chunk_count", summary.dropped_chunk_ids.size()},
       {"point_count", point_count},
       {"received_point_count", received_points},
       {"sync_s", RoundSeconds(std::chrono::duration<double>(
                                   std::chrono::steady_clock::now() - start)
                                   .count())},
       {"folder",
        (std::filesystem::path(command.folder) / "current").string()}});
  return absl::OkStatus();
}

}  // namespace mapsieve::client
