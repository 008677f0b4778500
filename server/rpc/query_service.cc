#include "server/rpc/query_service.h"

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "server/rpc/batch_message.h"
#include "server/rpc/convert.h"
#include "server/rpc/convert_query.h"

namespace mapsieve::rpc {
namespace {

// What several blocks of one message have at most. For a client that reads
// slowly two messages are kept, a block that the second had no room for, and
// what the cursor made ahead: together two batches.
constexpr size_t kGatheredBytes = engine::kMaxBatchBytes / 2;
// The same of stored chunks, of which the cursor has no other.
constexpr size_t kGatheredStoredBytes = engine::kMaxBatchBytes / 8 * 7;

// One call of QueryRegion: a header, batches, a summary.
class QueryReactor final : public StreamReactor<grpc::ByteBuffer> {
 public:
  QueryReactor(CallContext& calls, engine::Engine& engine,
               const grpc::ByteBuffer& request)
      : StreamReactor(calls, "QueryRegion", *calls.opening_worker),
        engine_(engine),
        request_(request) {}

 protected:
  absl::StatusOr<bool> Next(grpc::ByteBuffer& message) override {
    v1::QueryRegionResponse response;
    if (cursor_ == nullptr) {
      if (complete_) return false;
      MAPSIEVE_RETURN_IF_ERROR(Begin());
      SetHeader(*response.mutable_header());
      message = ToBytes(response);
      return true;
    }
    MAPSIEVE_ASSIGN_OR_RETURN(Blocks blocks, NextBlocks());
    if (!blocks.empty()) {
      message = MakeBatchMessage(std::move(blocks), resume_token_);
      return true;
    }
    *response.mutable_summary() = ToProto(cursor_->summary());
    message = ToBytes(response);
    complete_ = true;
    cursor_.reset();
    return true;
  }

 private:
  using Blocks = std::vector<std::vector<std::byte>>;

  absl::Status Begin() {
    v1::QueryRegionRequest request;
    // The parser takes what it parses.
    grpc::ByteBuffer bytes = request_;
    const grpc::Status parsed =
        grpc::SerializationTraits<v1::QueryRegionRequest>::Deserialize(
            &bytes, &request);
    if (!parsed.ok()) {
      return absl::InvalidArgumentError(absl::StrCat(
          "the bytes of the request are no ", request.GetTypeName()));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const auto spec, ToQuerySpec(request));
    MAPSIEVE_ASSIGN_OR_RETURN(cursor_, engine_.Query(spec, stop_token()));
    may_gather_ = !spec.plain_blocks;
    return absl::OkStatus();
  }

  // The blocks of the next message, and the token behind them: one at first,
  // which is not to wait for others, then as many as a message holds.
  absl::StatusOr<Blocks> NextBlocks() {
    Blocks blocks;
    size_t bytes = 0;
    bool are_stored = true;
    while (true) {
      if (!ahead_.has_value()) {
        MAPSIEVE_ASSIGN_OR_RETURN(ahead_, cursor_->NextBatch());
        if (!ahead_.has_value()) return blocks;
      }
      bytes += ahead_->size();
      // It is the cursor's last one.
      are_stored = are_stored && cursor_->gave_stored_chunk();
      if (!blocks.empty() &&
          bytes > (are_stored ? kGatheredStoredBytes : kGatheredBytes)) {
        return blocks;
      }
      blocks.push_back(*std::exchange(ahead_, std::nullopt));
      resume_token_ = cursor_->resume_token();
      if (!std::exchange(gathers_, may_gather_)) return blocks;
    }
  }

  static grpc::ByteBuffer ToBytes(const v1::QueryRegionResponse& response) {
    const grpc::Slice slice(response.SerializeAsString());
    return {&slice, 1};
  }

  void SetHeader(v1::QueryHeader& header) const {
    const engine::QueryHeader& from = cursor_->header();
    header.set_revision(from.revision);
    header.set_step_nm(from.step_nm);
    for (const core::ColumnSpec& column : from.columns) {
      *header.add_columns() = ToProto(column);
    }
    header.set_candidate_point_count(from.candidate_point_count);
  }

  engine::Engine& engine_;
  // gRPC keeps it until OnDone.
  const grpc::ByteBuffer& request_;
  std::unique_ptr<engine::QueryCursor> cursor_;
  // Messages of more than one block: not of plain ones, nor the first.
  bool may_gather_ = false;
  bool gathers_ = false;
  // A block that the last message had no room for.
  std::optional<std::vector<std::byte>> ahead_;
  // Behind the last message.
  std::string resume_token_;
  bool complete_ = false;
};

// One call of SyncRegion: a header and parts of chunks, if any; a summary.
class SyncReactor final : public StreamReactor<v1::SyncRegionResponse> {
 public:
  SyncReactor(CallContext& calls, engine::Engine& engine,
              const v1::SyncRegionRequest& request)
      : StreamReactor(calls, "SyncRegion", *calls.opening_worker),
        engine_(engine),
        request_(request) {}

 protected:
  absl::StatusOr<bool> Next(v1::SyncRegionResponse& response) override {
    if (cursor_ == nullptr) {
      if (complete_) return false;
      MAPSIEVE_ASSIGN_OR_RETURN(const auto spec, ToSyncSpec(request_));
      MAPSIEVE_ASSIGN_OR_RETURN(cursor_, engine_.Sync(spec, stop_token()));
      if (cursor_->has_parts()) {
        *response.mutable_header() = ToProto(cursor_->header());
        return true;
      }
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const auto part, cursor_->Next());
    if (part.has_value()) {
      *response.mutable_part() = ToProto(*part);
      return true;
    }
    v1::SyncSummary& summary = *response.mutable_summary();
    summary = ToProto(cursor_->summary());
    summary.set_revision(cursor_->header().revision);
    complete_ = true;
    cursor_.reset();
    return true;
  }

 private:
  engine::Engine& engine_;
  // gRPC keeps it until OnDone.
  const v1::SyncRegionRequest& request_;
  std::unique_ptr<engine::SyncCursor> cursor_;
  bool complete_ = false;
};

}  // namespace

grpc::ServerWriteReactor<grpc::ByteBuffer>* QueryService::QueryRegion(
    grpc::CallbackServerContext* /*context*/, const grpc::ByteBuffer* request) {
  auto* reactor = new QueryReactor(calls_, engine_, *request);
  reactor->Start(calls_.admission->Admit(CallKind::kQuery));
  return reactor;
}

grpc::ServerWriteReactor<v1::SyncRegionResponse>* QueryService::SyncRegion(
    grpc::CallbackServerContext* /*context*/,
    const v1::SyncRegionRequest* request) {
  auto* reactor = new SyncReactor(calls_, engine_, *request);
  reactor->Start(calls_.admission->Admit(CallKind::kQuery));
  return reactor;
}

}  // namespace mapsieve::rpc
