#include "client/api/answers.h"

#include <cstddef>
#include <deque>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/api/convert.h"
#include "client/api/resume_pauses.h"
#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/cloud/packed_columns.h"
#include "core/codec/points_codec.h"

namespace mapsieve::client {
namespace {

/// The columns that packed ones of an answer stand for, and the others.
std::vector<core::ColumnSpec> Unpacked(
    const std::vector<core::ColumnSpec>& columns) {
  std::vector<core::ColumnSpec> unpacked;
  for (const core::ColumnSpec& spec : columns) {
    for (core::ColumnSpec& plain : core::UnpackedSpecs(spec)) {
      unpacked.push_back(std::move(plain));
    }
  }
  return unpacked;
}

/// Unpacks the columns of a block.
absl::Status Unpack(core::LatticeCloud& cloud) {
  core::ColumnSet unpacked;
  for (core::Column& column : cloud.attributes.columns()) {
    std::vector<core::Column> plain;
    core::Unpack(std::move(column), plain);
    for (core::Column& one : plain) {
      MAPSIEVE_RETURN_IF_ERROR(unpacked.Add(std::move(one)));
    }
  }
  cloud.attributes = std::move(unpacked);
  return absl::OkStatus();
}

/// Gives the points of a block every one of `columns`, in that order.
absl::Status CompleteColumns(const std::vector<core::ColumnSpec>& columns,
                             core::LatticeCloud& cloud) {
  core::ColumnSet complete;
  for (const core::ColumnSpec& spec : columns) {
    core::Column* found = cloud.attributes.Find(spec.name);
    if (found == nullptr) {
      core::Column missing(spec);
      missing.AppendMissing(cloud.size());
      MAPSIEVE_RETURN_IF_ERROR(complete.Add(std::move(missing)));
      continue;
    }
    if (!(found->spec() == spec)) {
      return absl::DataLossError(
          absl::StrCat("column \"", spec.name,
                       "\" of a batch has another type than the header says"));
    }
    MAPSIEVE_RETURN_IF_ERROR(complete.Add(std::move(*found)));
  }
  cloud.attributes = std::move(complete);
  return absl::OkStatus();
}

/// Puts the parts of a synchronisation together.
class SyncReader {
 public:
  explicit SyncReader(
      const std::function<absl::Status(const SyncChunk&)>& visit)
      : visit_(visit) {}

  const std::optional<SyncSummary>& summary() const { return summary_; }

  absl::Status Take(const v1::SyncRegionResponse& response) {
    if (response.has_header()) {
      const v1::SyncHeader& header = response.header();
      lattice_ = core::Lattice(header.step_nm());
      tile_level_ = header.tile_level();
      for (const v1::ColumnSpec& column : header.columns()) {
        columns_.push_back(FromProto(column));
      }
      return absl::OkStatus();
    }
    if (response.has_part()) return TakePart(response.part());
    if (response.has_summary()) {
      summary_ = FromProto(response.summary());
      return absl::OkStatus();
    }
    return absl::DataLossError("a message of the answer holds nothing");
  }

 private:
  absl::Status TakePart(const v1::SyncPart& part) {
    if (chunk_.id.empty()) {
      chunk_.id = part.chunk_id();
      chunk_.tile = {tile_level_, part.x(), part.y(), part.z()};
      chunk_.points.lattice = lattice_;
      MAPSIEVE_RETURN_IF_ERROR(CompleteColumns(columns_, chunk_.points));
    } else if (chunk_.id != part.chunk_id()) {
      return absl::DataLossError(
          absl::StrCat("chunk ", chunk_.id, " of the answer is not complete"));
    }
    if (!part.block().empty()) {
      MAPSIEVE_ASSIGN_OR_RETURN(core::LatticeCloud block,
                                core::DecodePoints(TextBytes(part.block())));
      MAPSIEVE_RETURN_IF_ERROR(CompleteColumns(columns_, block));
      core::LatticeCloud& points = chunk_.points;
      MAPSIEVE_RETURN_IF_ERROR(points.attributes.AppendAll(
          points.size(), block.attributes, block.size()));
      points.positions.insert(points.positions.end(), block.positions.begin(),
                              block.positions.end());
    }
    if (!part.is_last()) return absl::OkStatus();
    const SyncChunk whole = std::exchange(chunk_, SyncChunk());
    return visit_(whole);
  }

  const std::function<absl::Status(const SyncChunk&)>& visit_;
  core::Lattice lattice_;
  int tile_level_ = 0;
  std::vector<core::ColumnSpec> columns_;
  /// Not complete; without an id there is none.
  SyncChunk chunk_;
  std::optional<SyncSummary> summary_;
};

class GrpcQueryStream final : public QueryStream {
 public:
  GrpcQueryStream(const std::shared_ptr<grpc::Channel>& channel,
                  const QuerySpec& spec)
      : channel_(channel),
        stub_(v1::QueryService::NewStub(channel)),
        request_(ToProto(spec)) {
    request_.set_packed_columns(true);
    Open();
  }

  ~GrpcQueryStream() override {
    if (finished_) return;
    context_->TryCancel();
    reader_->Finish();
  }

  absl::Status ReadHeader() {
    v1::QueryRegionResponse response;
    if (!reader_->Read(&response)) return Broken();
    if (!response.has_header()) {
      return absl::DataLossError("the answer does not start with a header");
    }
    header_ = FromProto(response.header());
    header_.columns = Unpacked(header_.columns);
    return absl::OkStatus();
  }

  const QueryHeader& header() const override { return header_; }
  const QuerySummary& summary() const override { return summary_; }

  absl::StatusOr<core::LatticeCloud> Next() override {
    core::LatticeCloud end{.lattice = core::Lattice(header_.step_nm)};
    if (finished_) return end;
    while (true) {
      if (!blocks_.empty()) {
        MAPSIEVE_ASSIGN_OR_RETURN(core::LatticeCloud cloud,
                                  core::DecodePoints(blocks_.front()));
        blocks_.pop_front();
        MAPSIEVE_RETURN_IF_ERROR(Unpack(cloud));
        MAPSIEVE_RETURN_IF_ERROR(CompleteColumns(header_.columns, cloud));
        if (cloud.size() > 0) return cloud;
        continue;
      }
      if (!reader_->Read(&response_)) {
        MAPSIEVE_RETURN_IF_ERROR(Resume(Broken()));
        continue;
      }
      if (response_.has_summary()) {
        summary_ = FromProto(response_.summary());
        finished_ = true;
        MAPSIEVE_RETURN_IF_ERROR(ToStatus(reader_->Finish()));
        return end;
      }
      if (!response_.has_batch()) {
        return absl::DataLossError(
            "a message of the answer is neither batch "
            "nor summary");
      }
      MAPSIEVE_ASSIGN_OR_RETURN(
          const auto blocks,
          core::SplitBlocks(TextBytes(response_.batch().block())));
      blocks_.assign(blocks.begin(), blocks.end());
      request_.set_resume_token(response_.batch().resume_token());
    }
  }

 private:
  void Open() {
    reader_.reset();
    context_ = std::make_unique<grpc::ClientContext>();
    reader_ = stub_->QueryRegion(context_.get(), request_);
    finished_ = false;
  }

  /// The end of a call that gave no summary; an error.
  absl::Status Broken() {
    finished_ = true;
    const absl::Status status = ToStatus(reader_->Finish());
    if (!status.ok()) return status;
    return absl::DataLossError("the answer ended without its summary");
  }

  /// Goes on behind the last batch after a call that ended with `status`; that
  /// status if it is not one that a new call can help, the last one if none
  /// does.
  absl::Status Resume(absl::Status status) {
    if (request_.resume_token().empty()) return status;
    ResumePauses pauses(ResumePauses::kStreamPatience, channel_);
    while (pauses.Wait(status)) {
      Open();
      status = ReadHeader();
    }
    return status;
  }

  const std::shared_ptr<grpc::Channel> channel_;
  const std::unique_ptr<v1::QueryService::Stub> stub_;
  /// With the token of the last batch.
  v1::QueryRegionRequest request_;
  /// The last message, and its blocks that were not given yet.
  v1::QueryRegionResponse response_;
  std::deque<std::span<const std::byte>> blocks_;
  std::unique_ptr<grpc::ClientContext> context_;
  std::unique_ptr<grpc::ClientReader<v1::QueryRegionResponse>> reader_;
  QueryHeader header_;
  QuerySummary summary_;
  bool finished_ = false;
};

}  // namespace

absl::StatusOr<std::unique_ptr<QueryStream>> OpenQueryStream(
    const std::shared_ptr<grpc::Channel>& channel, const QuerySpec& spec) {
  auto stream = std::make_unique<GrpcQueryStream>(channel, spec);
  MAPSIEVE_RETURN_IF_ERROR(stream->ReadHeader());
  return stream;
}

absl::StatusOr<SyncSummary> ReadSync(
    v1::QueryService::Stub& stub, const SyncSpec& spec,
    const std::function<absl::Status(const SyncChunk&)>& visit) {
  grpc::ClientContext context;
  const auto stream = stub.SyncRegion(&context, ToProto(spec));
  SyncReader reader(visit);
  v1::SyncRegionResponse response;
  absl::Status taken;
  while (taken.ok() && stream->Read(&response)) taken = reader.Take(response);
  if (!taken.ok()) context.TryCancel();
  const absl::Status finished = ToStatus(stream->Finish());
  MAPSIEVE_RETURN_IF_ERROR(taken);
  MAPSIEVE_RETURN_IF_ERROR(finished);
  if (reader.summary().has_value()) return *reader.summary();
  return absl::DataLossError("the answer ended without its summary");
}

}  // namespace mapsieve::client
