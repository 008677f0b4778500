#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/time/time.h"
#include "client/api/map_client.h"
#include "client/cli/commands.h"
#include "client/cli/file_blocks.h"
#include "client/cli/local_frame.h"
#include "client/cli/output.h"
#include "client/cli/progress_bar.h"
#include "client/cli/revision_json.h"
#include "client/cli/upload_report.h"
#include "client/formats/coordinate_systems.h"
#include "client/formats/occupancy_file.h"
#include "client/formats/point_file.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

using Clock = std::chrono::steady_clock;

/// Newest revisions that `info` shows.
constexpr int64_t kRevisionsOfInfo = 20;

double SecondsSince(Clock::time_point start) {
  return RoundSeconds(
      std::chrono::duration<double>(Clock::now() - start).count());
}

ProgressCallback Show(ProgressBar& bar) {
  return [&bar](int64_t done, int64_t total) { bar.Report(done, total); };
}

double Step(const MapInfo& map) { return core::Lattice(map.step_nm).step(); }

Json ProcessJson(const std::string& map, const ProcessReport& report,
                 double seconds) {
  return {{"map", map},
          {"revision", report.revision},
          {"distinct_point_count", report.distinct_point_count},
          {"point_count", report.point_count},
          {"label_counts", LabelCountsJson(report.label_counts)},
          {"outlier_count", report.outlier_count},
          {"round_count", report.round_count},
          {"updated_tile_count", report.updated_tile_count},
          {"process_s", seconds}};
}

/// The lowest corner of a tile in map units.
std::array<double, 3> TileCorner(const MapInfo& map,
                                 const core::LatticePoint& tile) {
  const core::Lattice lattice(map.step_nm);
  const auto coordinate = [&](int64_t cell) {
    return lattice.Coordinate(cell * (int64_t{1} << map.tile_level));
  };
  return {coordinate(tile.x), coordinate(tile.y), coordinate(tile.z)};
}

/// A file of tiles that differ, a line each.
class TileFile {
 public:
  TileFile(std::string path, const MapInfo& map)
      : path_(std::move(path)), map_(map) {
    if (path_.empty()) return;
    file_.open(path_, std::ios::trunc);
    file_ << "x,y,z,raw,product,raw_points_before,raw_points_after";
    for (const char* when : {"before", "after"}) {
      for (const char* label : {"none", "junction", "curve", "surface"}) {
        file_ << ',' << label << '_' << when;
      }
    }
    file_ << '\n';
  }

  absl::Status Add(const TileChange& change) {
    if (path_.empty()) return absl::OkStatus();
    for (const double coordinate : TileCorner(map_, change.tile)) {
      file_ << absl::StrFormat("%.17g,", coordinate);
    }
    file_ << Name(change.raw) << ',' << Name(change.product) << ','
          << change.base_raw_point_count << ','
          << change.target_raw_point_count;
    for (const auto* counts :
         {&change.base_label_counts, &change.target_label_counts}) {
      for (const int64_t count : *counts) file_ << ',' << count;
    }
    file_ << '\n';
    return Check();
  }

  absl::Status Close() {
    if (path_.empty()) return absl::OkStatus();
    file_.close();
    return Check();
  }

 private:
  static const char* Name(TileChangeKind kind) {
    switch (kind) {
      case TileChangeKind::kNone:
        return "same";
      case TileChangeKind::kAdded:
        return "added";
      case TileChangeKind::kRemoved:
        return "removed";
      case TileChangeKind::kChanged:
        return "changed";
    }
    return "";
  }
  absl::Status Check() const {
    if (file_.good()) return absl::OkStatus();
    return absl::UnavailableError(absl::StrCat(
        path_, ": cannot be written; name a file in a folder with room"));
  }

  const std::string path_;
  const MapInfo map_;
  std::ofstream file_;
};

/// Runs the filter and waits.
absl::StatusOr<Json> Process(MapClient& client, const std::string& map,
                             const std::optional<ProcessOptions>& options) {
  const Clock::time_point start = Clock::now();
  MAPSIEVE_ASSIGN_OR_RETURN(const std::string operation,
                            client.StartProcess(map, options));
  absl::StatusOr<ProcessReport> report;
  {
    ProgressBar bar("process " + map, "tiles");
    report = client.WaitForProcess(operation, Show(bar));
  }
  if (absl::IsUnavailable(report.status())) {
    std::fprintf(
        stderr,
        "mapsieve: hint: if the server went away, it goes on with this "
        "once it is back; mapsieve operation %s waits for it\n",
        operation.c_str());
  }
  MAPSIEVE_RETURN_IF_ERROR(report.status());
  if (report->outlier_count > 9 * report->point_count) {
    std::fprintf(stderr,
                 "mapsieve: hint: nine of ten points were taken for outliers; "
                 "where points lie far apart, choose a larger --rho, --sigma "
                 "and --reach\n");
  }
  return ProcessJson(map, *report, SecondsSince(start));
}

/// Ends a command that uploads and has printed its texts for people: runs the
/// filter if `command` says so, and prints its result, or all as JSON.
absl::Status ProcessAndPrint(const CommonOptions& common, MapClient& client,
                             const UploadCommand& command, Json result) {
  if (command.process) {
    MAPSIEVE_ASSIGN_OR_RETURN(result["process"],
                              Process(client, command.map, std::nullopt));
  }
  if (common.json) {
    PrintResult(true, result);
  } else if (command.process) {
    std::printf("\n");
    PrintResult(false, result["process"]);
  }
  return absl::OkStatus();
}

/// The query that a command's arguments describe.
absl::StatusOr<QuerySpec> MakeQuerySpec(const QueryCommand& command) {
  QuerySpec spec = command.spec;
  MAPSIEVE_ASSIGN_OR_RETURN(spec.region, MakeQueryRegion(command.region));
  MAPSIEVE_ASSIGN_OR_RETURN(spec.attribute_ranges,
                            MakeAttributeRanges(command.ranges));
  spec.columns = MakeColumnSelection(command.columns);
  if (const auto& c = command.confidence; !c.empty()) {
    spec.confidence = ValueRange{c[0], c[1]};
  }
  if (const auto& w = command.weights; !w.empty()) {
    spec.label_weights = LabelWeights{w[0], w[1], w[2]};
  }
  return spec;
}

/// A line for each chunk that a partial answer leaves out.
void TellMissing(const QuerySummary& summary) {
  for (const DamagedChunk& chunk : summary.missing_chunks) {
    std::fprintf(stderr, "mapsieve: left out: %s\n", chunk.problem.c_str());
  }
  const int64_t untold = summary.missing_chunk_count -
                         static_cast<int64_t>(summary.missing_chunks.size());
  if (untold > 0) {
    std::fprintf(stderr, "mapsieve: left out: %lld more chunks\n",
                 static_cast<long long>(untold));
  }
}

/// About the damaged chunks of `report`.
std::string WhatToDo(const VerifyCommand& command, const VerifyReport& report) {
  const auto raw_count =
      std::count_if(report.damaged_chunks.begin(), report.damaged_chunks.end(),
                    [](const DamagedChunk& c) { return c.content == "raw"; });
  if (raw_count > 0) {
    return absl::StrCat(
        "of these, raw: ", raw_count,
        ": restore their blobs from a backup, or delete their regions and "
        "upload the scans with --again");
  }
  if (!command.repair) return "verify with --repair makes them again";
  return "restore their blobs from a backup";
}

}  // namespace

absl::Status RunCreate(const CommonOptions& common,
                       const CreateCommand& command) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MapSpec spec = {.id = command.map,
                  .tile_edge = command.tile_edge,
                  .crs_wkt = command.crs,
                  .frame_id = command.frame_id};
  if (command.step > 0) {
    const double step_nm = std::nearbyint(command.step * 1e9);
    if (!(step_nm >= 1 && step_nm <= static_cast<double>(core::kMaxStepNm))) {
      return absl::InvalidArgumentError(
          absl::StrCat("--step is ", command.step, "; it must be 1e-9 to 1"));
    }
    spec.step_nm = static_cast<int64_t>(step_nm);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const MapInfo map, client.CreateMap(spec));
  if (!command.crs.empty()) {
    // A newer database may know it: the map keeps the text.
    if (const absl::Status known = WktOfCrs(command.crs).status();
        absl::IsNotFound(known)) {
      std::fprintf(stderr, "mapsieve: warning: --crs: %s\n",
                   std::string(known.message()).c_str());
    }
  }
  PrintResult(common.json,
              {{"map", map.id},
               {"step", Step(map)},
               {"tile_edge", std::ldexp(Step(map), map.tile_level)},
               {"crs", map.crs_wkt},
               {"frame_id", map.frame_id}});
  return absl::OkStatus();
}

absl::Status RunProcess(const CommonOptions& common,
                        const ProcessCommand& command) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  std::optional<ProcessOptions> options;
  if (!(command.options == ProcessOptions())) options = command.options;
  if (command.no_wait) {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::string operation,
                              client.StartProcess(command.map, options));
    PrintResult(common.json, {{"map", command.map}, {"operation", operation}});
    return absl::OkStatus();
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const Json result,
                            Process(client, command.map, options));
  PrintResult(common.json, result);
  return absl::OkStatus();
}

absl::Status RunUpload(const CommonOptions& common,
                       const UploadCommand& command) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapInfo map, client.GetMap(command.map));
  Json files = Json::array();
  for (const std::string& file : command.files) {
    const Clock::time_point start = Clock::now();
    FileBlocks blocks(file, {.column_names = command.column_names},
                      core::Lattice(map.step_nm));
    absl::StatusOr<UploadReport> report;
    {
      ProgressBar bar("upload " + file, "B");
      report = client.Upload(command.map, blocks, Show(bar), {}, command.again);
    }
    if (!report.ok()) return Annotate(report.status(), file);
    if (!blocks.crs_problem().empty()) {
      report->warnings.push_back(CrsWarning(blocks.crs_problem()));
    }
    Json result = {{"file", file}};
    result.update(UploadJson(*report, Step(map), SecondsSince(start)));
    files.push_back(std::move(result));
    if (!common.json) {
      std::printf("%s", UploadText(file, *report, Step(map)).c_str());
    }
  }
  Json result = {{"map", command.map}, {"files", std::move(files)}};
  return ProcessAndPrint(common, client, command, std::move(result));
}

/// Writes a whole answer and returns how many points it has; chunks that it
/// lacks are lines on stderr.
absl::StatusOr<int64_t> WriteAnswer(
    const std::string& title, QueryStream& stream, PointWriter& writer,
    const std::optional<core::Point3>& origin = std::nullopt) {
  int64_t count = 0;
  {
    ProgressBar bar(title, "points");
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(const core::LatticeCloud batch, stream.Next());
      if (batch.size() == 0) break;
      core::PointCloud points = core::ToPointCloud(batch);
      if (origin.has_value()) {
        MAPSIEVE_RETURN_IF_ERROR(MoveToLocalFrame(*origin, points));
      }
      MAPSIEVE_RETURN_IF_ERROR(writer.Write(points));
      count += static_cast<int64_t>(batch.size());
      bar.Report(count, stream.header().candidate_point_count);
    }
  }
  MAPSIEVE_RETURN_IF_ERROR(writer.Finish());
  TellMissing(stream.summary());
  return count;
}

absl::Status RunQuery(const CommonOptions& common,
                      const QueryCommand& command) {
  const Clock::time_point start = Clock::now();
  MAPSIEVE_ASSIGN_OR_RETURN(const QuerySpec spec, MakeQuerySpec(command));
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapInfo map, client.GetMap(spec.map_id));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::unique_ptr<QueryStream> stream,
                            client.Query(spec));
  const double first_s = SecondsSince(start);
  WriteOptions options =
      command.origin.has_value()
          ? OptionsOfLocalFrame(map, *command.origin)
          : WriteOptions{.crs_wkt = map.crs_wkt, .frame_id = map.frame_id};
  options.attributes = stream->header().columns;
  options.coordinate_step = Step(map);
  MAPSIEVE_ASSIGN_OR_RETURN(const std::unique_ptr<PointWriter> writer,
                            CreatePointFile(command.output, options));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const int64_t count,
      WriteAnswer("query " + map.id, *stream, *writer, command.origin));
  const QuerySummary& summary = stream->summary();
  PrintResult(common.json,
              {{"map", map.id},
               {"revision", stream->header().revision},
               {"point_count", count},
               {"label_counts", LabelCountsJson(summary.label_counts)},
               {"block_bytes", summary.block_bytes},
               {"available_point_count", summary.available_point_count},
               {"available_label_counts",
                LabelCountsJson(summary.available_label_counts)},
               {"missing_chunk_count", summary.missing_chunk_count},
               {"missing_point_count", summary.missing_point_count},
               {"header_s", first_s},
               {"query_s", SecondsSince(start)},
               {"output", command.output}});
  return absl::OkStatus();
}

absl::Status RunExport(const CommonOptions& common,
                       const ExportCommand& command) {
  const Clock::time_point start = Clock::now();
  QuerySpec spec = command.spec;
  MAPSIEVE_ASSIGN_OR_RETURN(spec.region, MakeQueryRegion(command.region));
  MapClient client(common.server, absl::Seconds(common.retry_s));
  // An answer may take long: what cannot be written is refused before.
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::unique_ptr<PointWriter> writer,
      CreateOccupancyFile(command.output, command.occupancy));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::unique_ptr<QueryStream> stream,
                            client.Query(spec));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const int64_t count,
      WriteAnswer("export " + spec.map_id, *stream, *writer));
  PrintResult(common.json, {{"map", spec.map_id},
                            {"revision", stream->header().revision},
                            {"point_count", count},
                            {"export_s", SecondsSince(start)},
                            {"output", command.output}});
  return absl::OkStatus();
}

absl::Status RunDeleteRegion(const CommonOptions& common,
                             const DeleteRegionCommand& command) {
  const Clock::time_point start = Clock::now();
  MapClient client(common.server, absl::Seconds(common.retry_s));
  absl::StatusOr<DeleteReport> report;
  {
    ProgressBar bar("delete-region " + command.map, "chunks");
    report = client.DeleteRegion(command.map, command.region, Show(bar));
  }
  MAPSIEVE_RETURN_IF_ERROR(report.status());
  PrintResult(common.json,
              {{"map", command.map},
               {"revision", report->revision},
               {"removed_point_count", report->removed_point_count},
               {"tile_count", report->tile_count},
               {"delete_s", SecondsSince(start)}});
  return absl::OkStatus();
}

absl::Status RunReplaceRegion(const CommonOptions& common,
                              const ReplaceRegionCommand& command) {
  const Clock::time_point start = Clock::now();
  const UploadCommand& upload = command.upload;
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapInfo map, client.GetMap(upload.map));
  FileListBlocks blocks(upload.files, {.column_names = upload.column_names},
                        core::Lattice(map.step_nm));
  absl::StatusOr<UploadReport> report;
  {
    ProgressBar bar("replace-region " + upload.map, "B");
    report = client.Upload(upload.map, blocks, Show(bar), command.region,
                           upload.again);
  }
  MAPSIEVE_RETURN_IF_ERROR(report.status());
  for (const std::string& what : blocks.differences()) {
    report->warnings.push_back(
        {"files_differ", absl::StrCat("the files differ in their ", what,
                                      ", which the map was not told")});
  }
  for (const std::string& problem : blocks.crs_problems()) {
    report->warnings.push_back(CrsWarning(problem));
  }
  Json result = {{"map", upload.map},
                 {"removed_point_count",
                  report->already_there ? 0 : report->removed_point_count}};
  result.update(UploadJson(*report, Step(map), SecondsSince(start)));
  if (!common.json) {
    std::printf("%s", UploadText(upload.map, *report, Step(map)).c_str());
  }
  return ProcessAndPrint(common, client, upload, std::move(result));
}

absl::Status RunRollback(const CommonOptions& common,
                         const RollbackCommand& command) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MAPSIEVE_ASSIGN_OR_RETURN(const RevisionInfo revision,
                            client.RollBack(command.map, command.revision));
  Json result = {{"map", command.map}};
  result.update(RevisionJson(revision));
  PrintResult(common.json, result);
  return absl::OkStatus();
}

absl::Status RunWatch(const CommonOptions& common,
                      const WatchCommand& command) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  int64_t seen = 0;
  const absl::Status status = client.WatchMap(
      command.map, command.from, [&](const RevisionInfo& revision) {
        const Json json = RevisionJson(revision);
        if (common.json) {
          std::printf("%s\n", json.dump().c_str());
        } else {
          std::printf("%s revision %lld: %s, %lld raw points, %lld points%s\n",
                      json["time"].get<std::string>().c_str(),
                      static_cast<long long>(revision.number),
                      json["kind"].get<std::string>().c_str(),
                      static_cast<long long>(revision.raw_point_count),
                      static_cast<long long>(revision.point_count),
                      revision.is_expired ? ", expired" : "");
        }
        std::fflush(stdout);
        return ++seen == command.count ? absl::CancelledError()
                                       : absl::OkStatus();
      });
  return command.count > 0 && seen == command.count ? absl::OkStatus() : status;
}

absl::Status RunRevisions(const CommonOptions& common,
                          const RevisionsCommand& command) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  if (command.compared.empty()) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<RevisionInfo> revisions,
        client.ListRevisions(command.map, std::numeric_limits<int64_t>::max()));
    Json list = Json::array();
    for (const RevisionInfo& revision : revisions) {
      list.push_back(RevisionJson(revision));
    }
    PrintResult(common.json,
                {{"map", command.map}, {"revisions", std::move(list)}});
    return absl::OkStatus();
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const MapInfo map, client.GetMap(command.map));
  TileFile tiles(command.tiles, map);
  int64_t added = 0;
  int64_t removed = 0;
  int64_t raw_changed = 0;
  int64_t product_changed = 0;
  MAPSIEVE_ASSIGN_OR_RETURN(
      const ComparedRevisions compared,
      client.CompareRevisions(
          command.map, command.compared[0], command.compared[1],
          [&](const TileChange& change) {
            added += change.raw == TileChangeKind::kAdded;
            removed += change.raw == TileChangeKind::kRemoved;
            raw_changed += change.raw == TileChangeKind::kChanged;
            product_changed += change.product != TileChangeKind::kNone;
            return tiles.Add(change);
          }));
  MAPSIEVE_RETURN_IF_ERROR(tiles.Close());
  const auto& [base, target] = compared;
  PrintResult(common.json,
              {{"map", command.map},
               {"tiles_added", added},
               {"tiles_removed", removed},
               {"tiles_changed_raw", raw_changed},
               {"tiles_changed_product", product_changed},
               {"raw_point_count_before", base.raw_point_count},
               {"raw_point_count_after", target.raw_point_count},
               {"label_counts_before", LabelCountsJson(base.label_counts)},
               {"label_counts_after", LabelCountsJson(target.label_counts)},
               {"compared", {RevisionJson(base), RevisionJson(target)}}});
  return absl::OkStatus();
}

absl::Status RunVerify(const CommonOptions& common,
                       const VerifyCommand& command) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapInfo map, client.GetMap(command.map));
  const auto start = Clock::now();
  RepairReport repair;
  if (command.repair) {
    ProgressBar bar("repair " + map.id, "chunks");
    MAPSIEVE_ASSIGN_OR_RETURN(repair, client.Repair(map.id, Show(bar)));
  }
  absl::StatusOr<VerifyReport> report;
  {
    ProgressBar bar("verify " + map.id, "chunks and tiles");
    report = client.Verify(map.id, command.compared_tile_count, Show(bar));
  }
  MAPSIEVE_RETURN_IF_ERROR(report.status());
  Json damaged = Json::array();
  for (const DamagedChunk& chunk : report->damaged_chunks) {
    damaged.push_back({{"content", chunk.content},
                       {"tile_corner", TileCorner(map, chunk.tile)},
                       {"blob", chunk.blob_id},
                       {"problem", chunk.problem}});
  }
  Json differing = Json::array();
  for (const DifferingTile& tile : report->differing_tiles) {
    differing.push_back({{"tile_corner", TileCorner(map, tile.tile)},
                         {"difference", tile.difference}});
  }
  Json result = {{"map", map.id}};
  if (command.repair) {
    result["repaired_chunk_count"] = repair.repaired_chunk_count;
    if (!repair.obstacle.empty()) {
      result["repair_obstacle"] = repair.obstacle;
    }
  }
  result.update({{"chunk_count", report->chunk_count},
                 {"stored_bytes", report->stored_bytes},
                 {"damaged_chunks", std::move(damaged)},
                 {"compared_tile_count", report->compared_tile_count},
                 {"compared_point_count", report->compared_point_count},
                 {"differing_tiles", std::move(differing)},
                 {"skipped_tile_count", report->skipped_tile_count},
                 {"verify_s", SecondsSince(start)}});
  PrintResult(common.json, result);
  if (!report->damaged_chunks.empty()) {
    return absl::DataLossError(absl::StrCat(
        "map ", map.id, ": damaged chunks: ", report->damaged_chunks.size(),
        ", listed above; ", WhatToDo(command, *report)));
  }
  if (!report->differing_tiles.empty()) {
    return absl::DataLossError(absl::StrCat(
        "map ", map.id,
        ": tiles that are not what the filter makes of their "
        "points: ",
        report->differing_tiles.size(),
        ", listed above; this is a defect of mapsieve: please report it"));
  }
  return absl::OkStatus();
}

absl::Status RunInfo(const CommonOptions& common, const std::string& map_id) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapInfo map, client.GetMap(map_id));
  MAPSIEVE_ASSIGN_OR_RETURN(const MapStats stats, client.GetMapStats(map_id));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<RevisionInfo> newest,
                            client.ListRevisions(map_id, kRevisionsOfInfo));
  Json revisions = Json::array();
  for (const RevisionInfo& revision : newest) {
    revisions.push_back(RevisionJson(revision));
  }
  Json attributes = Json::object();
  for (const core::ColumnSpec& spec : stats.attributes) {
    attributes[spec.name] = std::string(core::ScalarTypeName(spec.type));
  }
  Json levels = Json::array();
  for (const core::LabelCounts& counts : stats.level_counts) {
    levels.push_back(LabelCountsJson(counts));
  }
  PrintResult(common.json,
              {{"map", map.id},
               {"uid", map.uid},
               {"crs", map.crs_wkt},
               {"frame_id", map.frame_id},
               {"step", Step(map)},
               {"tile_edge", std::ldexp(Step(map), map.tile_level)},
               {"revision", stats.revision},
               {"processed_revision", stats.processed_revision},
               {"raw_point_count", stats.raw_point_count},
               {"point_count", stats.point_count},
               {"label_counts", LabelCountsJson(stats.label_counts)},
               {"level_label_counts", levels},
               {"outlier_count", stats.outlier_count},
               {"stored_bytes", stats.stored_bytes},
               {"reclaimable_bytes", stats.reclaimable_bytes},
               {"oldest_revision", stats.oldest_revision},
               {"tile_count", stats.tile_count},
               {"stale_tile_count", stats.stale_tile_count},
               {"bounds", BoundsJson(stats.bounds)},
               {"attributes", attributes},
               {"revisions", revisions}});
  return absl::OkStatus();
}

absl::Status RunList(const CommonOptions& common) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<MapInfo> maps, client.ListMaps());
  Json list = Json::array();
  for (const MapInfo& map : maps) {
    list.push_back({{"map", map.id},
                    {"revision", map.revision},
                    {"processed_revision", map.processed_revision},
                    {"step", Step(map)}});
  }
  PrintResult(common.json, {{"maps", std::move(list)}});
  return absl::OkStatus();
}

absl::Status RunDelete(const CommonOptions& common, const std::string& map,
                       bool force) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  MAPSIEVE_RETURN_IF_ERROR(client.DeleteMap(map, force));
  PrintResult(common.json, {{"deleted", map}});
  return absl::OkStatus();
}

}  // namespace mapsieve::client
