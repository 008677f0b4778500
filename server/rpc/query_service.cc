#include "server/rpc/query_service.h"

#include <memory>
#include <optional>
#include <utility>

#include "core/base/status.h"
#include "server/rpc/convert.h"
#include "server/rpc/convert_query.h"

namespace mapsieve::rpc {
namespace {

// One call of QueryRegion: a header, batches, a summary.
class QueryReactor final : public StreamReactor<v1::QueryRegionResponse> {
 public:
  QueryReactor(CallContext& calls, engine::Engine& engine,
               const v1::QueryRegionRequest& request)
      : StreamReactor(calls, "QueryRegion", *calls.opening_worker),
        engine_(engine),
        request_(request) {}

 protected:
  absl::StatusOr<bool> Next(v1::QueryRegionResponse& response) override {
    if (cursor_ == nullptr) {
      if (complete_) return false;
      MAPSIEVE_ASSIGN_OR_RETURN(const auto spec, ToQuerySpec(request_));
      MAPSIEVE_ASSIGN_OR_RETURN(cursor_, engine_.Query(spec, stop_token()));
      SetHeader(*response.mutable_header());
      return true;
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const auto block, cursor_->NextBatch());
    if (block) {
      response.mutable_batch()->set_block(block->data(), block->size());
      response.mutable_batch()->set_resume_token(cursor_->resume_token());
      return true;
    }
    *response.mutable_summary() = ToProto(cursor_->summary());
    complete_ = true;
    cursor_.reset();
    return true;
  }

 private:
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
  const v1::QueryRegionRequest& request_;
  std::unique_ptr<engine::QueryCursor> cursor_;
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

grpc::ServerWriteReactor<v1::QueryRegionResponse>* QueryService::QueryRegion(
    grpc::CallbackServerContext* /*context*/,
    const v1::QueryRegionRequest* request) {
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
