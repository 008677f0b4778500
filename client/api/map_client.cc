#include "client/api/map_client.h"

#include <algorithm>
#include <atomic>
#include <functional>
#include <optional>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/api/answers.h"
#include "client/api/convert.h"
#include "client/api/resume_pauses.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/credentials.h"
#include "grpcpp/support/channel_arguments.h"
#include "mapsieve/v1/map_service.grpc.pb.h"
#include "mapsieve/v1/operations.grpc.pb.h"
#include "mapsieve/v1/processing_service.grpc.pb.h"
#include "mapsieve/v1/query_service.grpc.pb.h"
#include "mapsieve/v1/upload_service.grpc.pb.h"

namespace mapsieve::client {
namespace {

/// Bytes of one WriteUploadRequest.
constexpr size_t kPieceBytes = 1 << 20;
/// Seconds of one WaitOperation: how often progress is seen.
constexpr int kWaitSeconds = 1;
constexpr int64_t kRevisionsOfAPage = 1000;
constexpr int kTilesOfAPage = 1000;

/// Length and hash of all blocks of a source.
struct Digest {
  int64_t bytes = 0;
  std::string hash;
  core::RefusedCounts refused;
};

absl::StatusOr<Digest> DigestOf(BlockSource& source) {
  MAPSIEVE_RETURN_IF_ERROR(source.Rewind());
  Digest digest;
  ContentHasher hasher;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                              source.NextBlock());
    if (block.empty()) break;
    hasher.Update(block);
    digest.bytes += static_cast<int64_t>(block.size());
  }
  digest.hash = hasher.HexDigest();
  digest.refused = source.refused();
  return digest;
}

/// A call notices within half a minute that nothing arrives any more, and a new
/// one within seconds that the server is back.
grpc::ChannelArguments ChannelOptions() {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
  arguments.SetInt(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 5'000);
  return arguments;
}

/// Makes a call that may be repeated until it is answered, with a pause after
/// each that the server could not be reached with.
absl::Status Insist(ResumePauses& pauses,
                    const std::function<absl::Status()>& call) {
  while (true) {
    absl::Status status = call();
    if (status.ok() || !pauses.Wait(status)) return status;
  }
}

}  // namespace

struct MapClient::Connection {
  Connection(const std::string& server, absl::Duration its_patience)
      : patience(its_patience),
        channel(grpc::CreateCustomChannel(
            server, grpc::InsecureChannelCredentials(), ChannelOptions())),
        maps(v1::MapService::NewStub(channel)),
        uploads(v1::UploadService::NewStub(channel)),
        processing(v1::ProcessingService::NewStub(channel)),
        operations(v1::Operations::NewStub(channel)),
        queries(v1::QueryService::NewStub(channel)) {}

  /// Creates an upload, or returns the one there is; one that failed begins
  /// anew, since what the map refused it may take by now.
  absl::StatusOr<v1::Upload> OpenUpload(const v1::CreateUploadRequest& request);

  /// Sends the bytes of `source` from `offset` on; `sent` receives how many.
  absl::Status Write(const std::string& upload_name, BlockSource& source,
                     int64_t offset, int64_t total,
                     const ProgressCallback& progress, int64_t& sent);

  /// Waits until an operation is done and returns its result.
  absl::StatusOr<google::protobuf::Any> Wait(const std::string& name,
                                             const ProgressCallback& progress);

  const absl::Duration patience;
  std::shared_ptr<grpc::Channel> channel;
  std::unique_ptr<v1::MapService::Stub> maps;
  std::unique_ptr<v1::UploadService::Stub> uploads;
  std::unique_ptr<v1::ProcessingService::Stub> processing;
  std::unique_ptr<v1::Operations::Stub> operations;
  std::unique_ptr<v1::QueryService::Stub> queries;
};

MapClient::MapClient(const std::string& server, absl::Duration patience)
    : connection_(std::make_unique<Connection>(server, patience)) {}

MapClient::~MapClient() = default;

absl::StatusOr<MapInfo> MapClient::CreateMap(const MapSpec& spec) {
  grpc::ClientContext context;
  v1::CreateMapRequest request;
  request.set_map_id(spec.id);
  request.set_step_nm(spec.step_nm);
  request.set_tile_edge(spec.tile_edge);
  request.set_display_name(spec.display_name);
  request.set_crs_wkt(spec.crs_wkt);
  request.set_frame_id(spec.frame_id);
  v1::Map map;
  MAPSIEVE_RETURN_IF_ERROR(
      ToStatus(connection_->maps->CreateMap(&context, request, &map)));
  return FromProto(map);
}

absl::StatusOr<MapInfo> MapClient::GetMap(const std::string& map_id) {
  grpc::ClientContext context;
  v1::GetMapRequest request;
  request.set_name(MapName(map_id));
  v1::Map map;
  MAPSIEVE_RETURN_IF_ERROR(
      ToStatus(connection_->maps->GetMap(&context, request, &map)));
  return FromProto(map);
}

absl::StatusOr<std::vector<MapInfo>> MapClient::ListMaps() {
  std::vector<MapInfo> maps;
  v1::ListMapsRequest request;
  do {
    grpc::ClientContext context;
    v1::ListMapsResponse response;
    MAPSIEVE_RETURN_IF_ERROR(
        ToStatus(connection_->maps->ListMaps(&context, request, &response)));
    for (const v1::Map& map : response.maps()) maps.push_back(FromProto(map));
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  return maps;
}

absl::Status MapClient::DeleteMap(const std::string& map_id, bool force) {
  grpc::ClientContext context;
  v1::DeleteMapRequest request;
  request.set_name(MapName(map_id));
  request.set_force(force);
  google::protobuf::Empty empty;
  return ToStatus(connection_->maps->DeleteMap(&context, request, &empty));
}

absl::StatusOr<MapStats> MapClient::GetMapStats(const std::string& map_id) {
  grpc::ClientContext context;
  v1::GetMapStatsRequest request;
  request.set_name(MapName(map_id) + "/stats");
  v1::MapStats stats;
  MAPSIEVE_RETURN_IF_ERROR(
      ToStatus(connection_->maps->GetMapStats(&context, request, &stats)));
  return FromProto(stats);
}

absl::StatusOr<v1::Upload> MapClient::Connection::OpenUpload(
    const v1::CreateUploadRequest& request) {
  v1::Upload upload;
  const auto create = [&] {
    grpc::ClientContext context;
    return ToStatus(uploads->CreateUpload(&context, request, &upload));
  };
  MAPSIEVE_RETURN_IF_ERROR(create());
  if (upload.state() == v1::Upload::STATE_FAILED) {
    grpc::ClientContext context;
    v1::DeleteUploadRequest failed;
    failed.set_name(upload.name());
    google::protobuf::Empty empty;
    MAPSIEVE_RETURN_IF_ERROR(
        ToStatus(uploads->DeleteUpload(&context, failed, &empty)));
    MAPSIEVE_RETURN_IF_ERROR(create());
  }
  return upload;
}

absl::Status MapClient::Connection::Write(const std::string& upload_name,
                                          BlockSource& source, int64_t offset,
                                          int64_t total,
                                          const ProgressCallback& progress,
                                          int64_t& sent) {
  MAPSIEVE_RETURN_IF_ERROR(source.Rewind());
  grpc::ClientContext context;
  const auto stream = uploads->WriteUpload(&context);
  // Acknowledgements come while requests still go out.
  std::thread acknowledgements([&] {
    v1::WriteUploadResponse response;
    while (stream->Read(&response)) {
      if (progress) progress(response.committed_bytes(), total);
    }
  });
  const auto send_all = [&]() -> absl::Status {
    int64_t position = 0;
    v1::WriteUploadRequest request;
    request.set_name(upload_name);
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                                source.NextBlock());
      if (block.empty()) return absl::OkStatus();
      const auto size = static_cast<int64_t>(block.size());
      auto begin =
          static_cast<size_t>(std::clamp<int64_t>(offset - position, 0, size));
      for (; begin < block.size(); begin += kPieceBytes) {
        const auto piece = std::span(block).subspan(
            begin, std::min(kPieceBytes, block.size() - begin));
        request.set_write_offset(position + static_cast<int64_t>(begin));
        request.mutable_data()->set_content(piece.data(), piece.size());
        request.mutable_data()->set_xxh3_64(Hash64(piece));
        // A refused write means that the stream is over: Finish says why.
        if (!stream->Write(request)) return absl::OkStatus();
        request.clear_name();
        sent += static_cast<int64_t>(piece.size());
      }
      position += size;
    }
  };
  const absl::Status read = send_all();
  if (read.ok()) {
    stream->WritesDone();
  } else {
    context.TryCancel();
  }
  acknowledgements.join();
  const absl::Status written = ToStatus(stream->Finish());
  return read.ok() ? written : read;
}

absl::StatusOr<google::protobuf::Any> MapClient::Connection::Wait(
    const std::string& name, const ProgressCallback& progress) {
  ResumePauses pauses(patience, channel);
  v1::WaitOperationRequest request;
  request.set_name(name);
  request.mutable_timeout()->set_seconds(kWaitSeconds);
  while (true) {
    v1::Operation operation;
    MAPSIEVE_RETURN_IF_ERROR(Insist(pauses, [&] {
      grpc::ClientContext context;
      return ToStatus(operations->WaitOperation(&context, request, &operation));
    }));
    pauses.Reset();
    const OperationInfo info = FromProto(operation);
    if (progress) progress(info.done_work, info.total_work);
    if (!operation.done()) continue;
    if (operation.has_error()) return ToStatus(operation.error());
    return operation.response();
  }
}

absl::StatusOr<UploadReport> MapClient::Upload(const std::string& map_id,
                                               BlockSource& source,
                                               const ProgressCallback& progress,
                                               const Region& region,
                                               bool again) {
  v1::FinalizeUploadRequest finalize;
  SetRegion(region, finalize);
  const std::string region_bytes = finalize.SerializeAsString();
  MAPSIEVE_ASSIGN_OR_RETURN(const MapInfo map, GetMap(map_id));
  KeptBlocks blocks(source);
  MAPSIEVE_ASSIGN_OR_RETURN(const Digest digest, DigestOf(blocks));
  v1::CreateUploadRequest request;
  request.set_parent(MapName(map_id));
  // The same bytes for the same region of the same map are the same upload.
  request.set_upload_id(
      ContentHash(TextBytes(map.uid + digest.hash + region_bytes)));
  request.mutable_upload()->set_expected_bytes(digest.bytes);
  request.mutable_upload()->set_content_hash(digest.hash);
  request.mutable_upload()->set_refused_non_finite_count(
      digest.refused.non_finite);
  request.mutable_upload()->set_refused_out_of_lattice_count(
      digest.refused.out_of_lattice);
  const UploadSource from = blocks.source();
  v1::UploadSource& told = *request.mutable_upload()->mutable_source();
  told.set_crs_wkt(from.crs_wkt);
  told.set_frame_id(from.frame_id);
  told.set_unit(from.unit);
  told.set_coordinate_step(from.coordinate_step);
  ResumePauses pauses(connection_->patience, connection_->channel);
  v1::Upload upload;
  const auto open = [&]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(upload, connection_->OpenUpload(request));
    return absl::OkStatus();
  };
  MAPSIEVE_RETURN_IF_ERROR(Insist(pauses, open));
  while (again && upload.state() == v1::Upload::STATE_FINALIZED) {
    // The next one of these bytes is named after the last one: a call that
    // breaks off is gone on with too.
    request.set_upload_id(ContentHash(TextBytes(
        absl::StrCat(request.upload_id(), " ", upload.report().revision()))));
    MAPSIEVE_RETURN_IF_ERROR(Insist(pauses, open));
  }
  if (upload.state() == v1::Upload::STATE_FINALIZED) {
    UploadReport report = FromProto(upload.report());
    report.already_there = true;
    report.upload_bytes = digest.bytes;
    return report;
  }
  int64_t sent = 0;
  bool is_resumed = false;
  while (upload.state() == v1::Upload::STATE_ACTIVE &&
         upload.committed_bytes() < digest.bytes) {
    const int64_t begin = upload.committed_bytes();
    const absl::Status written = connection_->Write(
        upload.name(), blocks, begin, digest.bytes, progress, sent);
    if (written.ok()) break;
    // The other writer is this one, as long as the server has not seen that
    // the call before is over.
    const bool goes_on = is_resumed && absl::IsAborted(written)
                             ? pauses.Pause()
                             : pauses.Wait(written);
    if (!goes_on) return written;
    is_resumed = true;
    MAPSIEVE_RETURN_IF_ERROR(Insist(pauses, open));
    if (upload.committed_bytes() > begin) pauses.Reset();
  }
  v1::Operation operation;
  finalize.set_name(upload.name());
  MAPSIEVE_RETURN_IF_ERROR(Insist(pauses, [&] {
    grpc::ClientContext context;
    return ToStatus(
        connection_->uploads->FinalizeUpload(&context, finalize, &operation));
  }));
  MAPSIEVE_ASSIGN_OR_RETURN(const google::protobuf::Any result,
                            connection_->Wait(operation.name(), {}));
  v1::FinalizeUploadResponse response;
  if (!result.UnpackTo(&response)) {
    return absl::InternalError("the server's result is of another type");
  }
  UploadReport report = FromProto(response.report());
  report.upload_bytes = digest.bytes;
  report.sent_bytes = sent;
  return report;
}

absl::StatusOr<std::vector<RevisionInfo>> MapClient::ListRevisions(
    const std::string& map_id, int64_t max_count) {
  std::vector<RevisionInfo> revisions;
  v1::ListRevisionsRequest request;
  request.set_parent(MapName(map_id));
  do {
    const int64_t missing = max_count - static_cast<int64_t>(revisions.size());
    if (missing <= 0) break;
    request.set_page_size(
        static_cast<int32_t>(std::min(missing, kRevisionsOfAPage)));
    grpc::ClientContext context;
    v1::ListRevisionsResponse response;
    MAPSIEVE_RETURN_IF_ERROR(ToStatus(
        connection_->maps->ListRevisions(&context, request, &response)));
    for (const v1::Revision& revision : response.revisions()) {
      revisions.push_back(FromProto(revision));
    }
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  return revisions;
}

absl::StatusOr<ComparedRevisions> MapClient::CompareRevisions(
    const std::string& map_id, int64_t base, int64_t target,
    const std::function<absl::Status(const TileChange&)>& visit) {
  ComparedRevisions compared;
  v1::CompareRevisionsRequest request;
  request.set_name(MapName(map_id));
  request.set_base_revision(base);
  request.set_target_revision(target);
  request.set_page_size(kTilesOfAPage);
  do {
    grpc::ClientContext context;
    v1::CompareRevisionsResponse response;
    MAPSIEVE_RETURN_IF_ERROR(ToStatus(
        connection_->maps->CompareRevisions(&context, request, &response)));
    compared = {FromProto(response.base()), FromProto(response.target())};
    for (const v1::TileChange& change : response.tiles()) {
      MAPSIEVE_RETURN_IF_ERROR(visit(FromProto(change)));
    }
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  return compared;
}

absl::StatusOr<DeleteReport> MapClient::DeleteRegion(
    const std::string& map_id, const Region& region,
    const ProgressCallback& progress) {
  v1::Operation operation;
  {
    grpc::ClientContext context;
    v1::DeleteRegionRequest request;
    request.set_name(MapName(map_id));
    SetRegion(region, request);
    MAPSIEVE_RETURN_IF_ERROR(ToStatus(
        connection_->maps->DeleteRegion(&context, request, &operation)));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const google::protobuf::Any result,
                            connection_->Wait(operation.name(), progress));
  v1::DeleteRegionResponse response;
  if (!result.UnpackTo(&response)) {
    return absl::InternalError("the server's result is of another type");
  }
  return DeleteReport{.revision = response.revision(),
                      .removed_point_count = response.removed_point_count(),
                      .tile_count = response.tile_count()};
}

absl::StatusOr<RevisionInfo> MapClient::RollBack(const std::string& map_id,
                                                 int64_t revision) {
  grpc::ClientContext context;
  v1::RollBackMapRequest request;
  request.set_name(MapName(map_id));
  request.set_revision(revision);
  v1::Revision made;
  MAPSIEVE_RETURN_IF_ERROR(
      ToStatus(connection_->maps->RollBackMap(&context, request, &made)));
  return FromProto(made);
}

absl::StatusOr<std::string> MapClient::StartProcess(
    const std::string& map_id, const std::optional<ProcessOptions>& options) {
  grpc::ClientContext context;
  v1::ProcessMapRequest request;
  request.set_name(MapName(map_id));
  if (options.has_value()) *request.mutable_options() = ToProto(*options);
  v1::Operation operation;
  MAPSIEVE_RETURN_IF_ERROR(ToStatus(
      connection_->processing->ProcessMap(&context, request, &operation)));
  return LastSegment(operation.name());
}

absl::StatusOr<ProcessReport> MapClient::WaitForProcess(
    const std::string& operation_id, const ProgressCallback& progress) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const google::protobuf::Any result,
      connection_->Wait("operations/" + operation_id, progress));
  v1::ProcessMapResponse response;
  if (!result.UnpackTo(&response)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "operation \"", operation_id, "\" is no run of the filter"));
  }
  return FromProto(response);
}

absl::StatusOr<OperationInfo> MapClient::GetOperation(
    const std::string& operation_id) {
  grpc::ClientContext context;
  v1::GetOperationRequest request;
  request.set_name("operations/" + operation_id);
  v1::Operation operation;
  MAPSIEVE_RETURN_IF_ERROR(ToStatus(
      connection_->operations->GetOperation(&context, request, &operation)));
  return FromProto(operation);
}

absl::Status MapClient::CancelOperation(const std::string& operation_id) {
  grpc::ClientContext context;
  v1::CancelOperationRequest request;
  request.set_name("operations/" + operation_id);
  google::protobuf::Empty empty;
  return ToStatus(
      connection_->operations->CancelOperation(&context, request, &empty));
}

absl::Status MapClient::WaitForOperation(const std::string& operation_id,
                                         const ProgressCallback& progress) {
  return connection_->Wait("operations/" + operation_id, progress).status();
}

absl::StatusOr<VerifyReport> MapClient::Verify(
    const std::string& map_id, int64_t compared_tile_count,
    const ProgressCallback& progress) {
  v1::VerifyMapRequest request;
  request.set_name(MapName(map_id));
  request.set_compared_tile_count(compared_tile_count);
  grpc::ClientContext context;
  const auto reader = connection_->maps->VerifyMap(&context, request);
  VerifyReport report;
  bool is_complete = false;
  v1::VerifyMapResponse response;
  while (reader->Read(&response)) {
    if (response.has_progress() && progress) {
      progress(response.progress().done_count(),
               response.progress().total_count());
    } else if (response.has_damaged_chunk()) {
      report.damaged_chunks.push_back(FromProto(response.damaged_chunk()));
    } else if (response.has_differing_tile()) {
      report.differing_tiles.push_back(FromProto(response.differing_tile()));
    } else if (response.has_summary()) {
      const v1::VerifySummary& summary = response.summary();
      report.chunk_count = summary.chunk_count();
      report.stored_bytes = summary.stored_bytes();
      report.compared_tile_count = summary.compared_tile_count();
      report.compared_point_count = summary.compared_point_count();
      report.skipped_tile_count = summary.skipped_tile_count();
      is_complete = true;
    }
  }
  MAPSIEVE_RETURN_IF_ERROR(ToStatus(reader->Finish()));
  if (!is_complete) {
    return absl::DataLossError("the answer ends without its summary");
  }
  return report;
}

absl::Status MapClient::WatchMap(
    const std::string& map_id, int64_t from_revision,
    const std::function<absl::Status(const RevisionInfo&)>& visit) {
  v1::WatchMapRequest request;
  request.set_name(MapName(map_id));
  request.set_from_revision(from_revision);
  std::optional<RevisionInfo> last;
  ResumePauses pauses(ResumePauses::kStreamPatience, connection_->channel);
  while (true) {
    grpc::ClientContext context;
    const auto reader = connection_->maps->WatchMap(&context, request);
    v1::WatchMapResponse response;
    absl::Status visited;
    // A call that goes on begins with the last revision, by which the map is
    // told from another one of its name.
    bool is_known = last.has_value();
    while (visited.ok() && reader->Read(&response)) {
      const RevisionInfo revision = FromProto(response.revision());
      pauses.Reset();
      if (!std::exchange(is_known, false)) {
        visited = visit(revision);
      } else if (revision.create_time != last->create_time) {
        visited = absl::NotFoundError(absl::StrCat(
            "map ", map_id, " was deleted, and there is another one now"));
      }
      request.set_from_revision(revision.number);
      last = revision;
    }
    if (!visited.ok()) context.TryCancel();
    const absl::Status finished = ToStatus(reader->Finish());
    if (!visited.ok()) return visited;
    if (!last.has_value() || !pauses.Wait(finished)) return finished;
  }
}

absl::StatusOr<RepairReport> MapClient::Repair(
    const std::string& map_id, const ProgressCallback& progress) {
  v1::Operation operation;
  {
    grpc::ClientContext context;
    v1::RepairMapRequest request;
    request.set_name(MapName(map_id));
    MAPSIEVE_RETURN_IF_ERROR(
        ToStatus(connection_->maps->RepairMap(&context, request, &operation)));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const google::protobuf::Any result,
                            connection_->Wait(operation.name(), progress));
  v1::RepairMapResponse response;
  if (!result.UnpackTo(&response)) {
    return absl::InternalError("the server's result is of another type");
  }
  return RepairReport{.damaged_chunk_count = response.damaged_chunk_count(),
                      .repaired_chunk_count = response.repaired_chunk_count(),
                      .raw_chunk_count = response.raw_chunk_count(),
                      .obstacle = response.obstacle()};
}

absl::StatusOr<std::unique_ptr<QueryStream>> MapClient::Query(
    const QuerySpec& spec) {
  return OpenQueryStream(connection_->channel, spec);
}

absl::StatusOr<SyncSummary> MapClient::Sync(
    const SyncSpec& spec,
    const std::function<absl::Status(const SyncChunk&)>& visit) {
  return ReadSync(*connection_->queries, spec, visit);
}

absl::StatusOr<core::LatticeCloud> MapClient::QueryAll(const QuerySpec& spec) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::unique_ptr<QueryStream> stream,
                            Query(spec));
  core::LatticeCloud all{.lattice = core::Lattice(stream->header().step_nm)};
  for (const core::ColumnSpec& column : stream->header().columns) {
    MAPSIEVE_RETURN_IF_ERROR(all.attributes.Add(core::Column(column)));
  }
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const core::LatticeCloud batch, stream->Next());
    if (batch.size() == 0) return all;
    MAPSIEVE_RETURN_IF_ERROR(
        all.attributes.AppendAll(all.size(), batch.attributes, batch.size()));
    all.positions.insert(all.positions.end(), batch.positions.begin(),
                         batch.positions.end());
  }
}

}  // namespace mapsieve::client
