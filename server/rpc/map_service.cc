#include "server/rpc/map_service.h"

#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <utility>

#include "core/base/status.h"
#include "server/rpc/convert.h"
#include "server/rpc/convert_query.h"

namespace mapsieve::rpc {
namespace {

// One call of VerifyMap: findings and progress, then a summary.
class VerifyReactor final : public StreamReactor<v1::VerifyMapResponse> {
 public:
  VerifyReactor(CallContext& calls, engine::Engine& engine,
                const v1::VerifyMapRequest& request)
      : StreamReactor(calls, "VerifyMap", *calls.stream_workers),
        engine_(engine),
        request_(request) {}

 protected:
  absl::StatusOr<bool> Next(v1::VerifyMapResponse& response) override {
    if (complete_) return false;
    if (cursor_ == nullptr) {
      MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                                ParseMapName("name", request_.name()));
      MAPSIEVE_ASSIGN_OR_RETURN(
          cursor_, engine_.Verify(
                       {.map_id = map_id,
                        .compared_tile_count = request_.compared_tile_count()},
                       stop_token()));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const auto event, cursor_->Next());
    if (event.has_value()) {
      response = ToProto(*event);
      return true;
    }
    *response.mutable_summary() = ToProto(cursor_->summary());
    cursor_.reset();
    complete_ = true;
    return true;
  }

 private:
  engine::Engine& engine_;
  // gRPC keeps it until OnDone.
  const v1::VerifyMapRequest& request_;
  std::unique_ptr<engine::VerifyCursor> cursor_;
  bool complete_ = false;
};

// One call of WatchMap. It waits without a thread: a commit to the map, its
// deletion or the server's shutdown wakes it.
class WatchReactor final : public StreamReactor<v1::WatchMapResponse> {
 public:
  WatchReactor(CallContext& calls, engine::Engine& engine,
               const v1::WatchMapRequest& request)
      : StreamReactor(calls, "WatchMap", *calls.stream_workers),
        engine_(engine),
        request_(request),
        draining_(calls.admission->draining()) {}

 protected:
  absl::StatusOr<bool> Next(v1::WatchMapResponse& response) override {
    if (cursor_ == nullptr) {
      MAPSIEVE_ASSIGN_OR_RETURN(map_id_, ParseMapName("name", request_.name()));
      MAPSIEVE_ASSIGN_OR_RETURN(
          cursor_, engine_.WatchRevisions(map_id_, request_.from_revision(),
                                          [this] { Resume(); }));
      wake_to_drain_.emplace(draining_, [this] { Resume(); });
    }
    if (draining_.stop_requested()) return DrainingError();
    MAPSIEVE_ASSIGN_OR_RETURN(const auto revision, cursor_->Next());
    if (revision.has_value()) {
      *response.mutable_revision() = ToProto(map_id_, *revision);
    } else {
      Pause();
    }
    return true;
  }

 private:
  engine::Engine& engine_;
  // gRPC keeps it until OnDone.
  const v1::WatchMapRequest& request_;
  const std::stop_token draining_;
  std::string map_id_;
  // Their ends wait for a Resume under way.
  std::unique_ptr<engine::RevisionCursor> cursor_;
  std::optional<std::stop_callback<std::function<void()>>> wake_to_drain_;
};

}  // namespace

grpc::ServerUnaryReactor* MapService::CreateMap(
    grpc::CallbackServerContext* context, const v1::CreateMapRequest* request,
    v1::Map* response) {
  return RunUnary(calls_, "CreateMap", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map,
                              engine_.CreateMap(ToMapSpec(*request)));
    *response = ToProto(map);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* MapService::GetMap(
    grpc::CallbackServerContext* context, const v1::GetMapRequest* request,
    v1::Map* response) {
  return RunUnary(calls_, "GetMap", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                              ParseMapName("name", request->name()));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map, engine_.GetMap(map_id));
    *response = ToProto(map);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* MapService::ListMaps(
    grpc::CallbackServerContext* context, const v1::ListMapsRequest* request,
    v1::ListMapsResponse* response) {
  return RunUnary(calls_, "ListMaps", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(auto page,
                              engine_.ListMaps(ToPageRequest(*request)));
    for (const engine::MapInfo& map : page.items) {
      v1::Map& item = *response->add_maps();
      item = ToProto(map);
      // A page of them could exceed what a client receives.
      item.clear_crs_wkt();
    }
    response->set_next_page_token(std::move(page.next_page_token));
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* MapService::DeleteMap(
    grpc::CallbackServerContext* context, const v1::DeleteMapRequest* request,
    google::protobuf::Empty* /*response*/) {
  return RunUnary(calls_, "DeleteMap", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                              ParseMapName("name", request->name()));
    return engine_.DeleteMap(map_id, request->force());
  });
}

grpc::ServerUnaryReactor* MapService::GetMapStats(
    grpc::CallbackServerContext* context, const v1::GetMapStatsRequest* request,
    v1::MapStats* response) {
  return RunUnary(calls_, "GetMapStats", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                              ParseStatsName("name", request->name()));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto stats, engine_.GetMapStats(map_id));
    *response = ToProto(map_id, stats);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* MapService::ListRevisions(
    grpc::CallbackServerContext* context,
    const v1::ListRevisionsRequest* request,
    v1::ListRevisionsResponse* response) {
  return RunUnary(
      calls_, "ListRevisions", context, [=, this]() -> absl::Status {
        MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                                  ParseMapName("parent", request->parent()));
        MAPSIEVE_ASSIGN_OR_RETURN(
            auto page, engine_.ListRevisions(map_id, ToPageRequest(*request)));
        for (const engine::RevisionInfo& revision : page.items) {
          *response->add_revisions() = ToProto(map_id, revision);
        }
        response->set_next_page_token(std::move(page.next_page_token));
        return absl::OkStatus();
      });
}

grpc::ServerUnaryReactor* MapService::CompareRevisions(
    grpc::CallbackServerContext* context,
    const v1::CompareRevisionsRequest* request,
    v1::CompareRevisionsResponse* response) {
  return RunUnary(
      calls_, "CompareRevisions", context, [=, this]() -> absl::Status {
        MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                                  ParseMapName("name", request->name()));
        MAPSIEVE_ASSIGN_OR_RETURN(
            auto comparison,
            engine_.CompareRevisions(map_id, request->base_revision(),
                                     request->target_revision(),
                                     ToPageRequest(*request)));
        *response->mutable_base() = ToProto(map_id, comparison.base);
        *response->mutable_target() = ToProto(map_id, comparison.target);
        for (const engine::TileChange& change : comparison.tiles.items) {
          *response->add_tiles() = ToProto(change);
        }
        response->set_next_page_token(
            std::move(comparison.tiles.next_page_token));
        return absl::OkStatus();
      });
}

grpc::ServerUnaryReactor* MapService::DeleteRegion(
    grpc::CallbackServerContext* context,
    const v1::DeleteRegionRequest* request, v1::Operation* response) {
  return RunUnary(calls_, "DeleteRegion", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                              ParseMapName("name", request->name()));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto region, ToRegion(*request));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto operation,
                              engine_.DeleteRegion(map_id, region));
    *response = ToProto(operation);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* MapService::RollBackMap(
    grpc::CallbackServerContext* context, const v1::RollBackMapRequest* request,
    v1::Revision* response) {
  return RunUnary(calls_, "RollBackMap", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                              ParseMapName("name", request->name()));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto revision,
                              engine_.RollBack(map_id, request->revision()));
    *response = ToProto(map_id, revision);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* MapService::RepairMap(
    grpc::CallbackServerContext* context, const v1::RepairMapRequest* request,
    v1::Operation* response) {
  return RunUnary(calls_, "RepairMap", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                              ParseMapName("name", request->name()));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto operation, engine_.RepairMap(map_id));
    *response = ToProto(operation);
    return absl::OkStatus();
  });
}

grpc::ServerWriteReactor<v1::VerifyMapResponse>* MapService::VerifyMap(
    grpc::CallbackServerContext* /*context*/,
    const v1::VerifyMapRequest* request) {
  auto* reactor = new VerifyReactor(calls_, engine_, *request);
  reactor->Start(calls_.admission->Admit(CallKind::kQuery));
  return reactor;
}

grpc::ServerWriteReactor<v1::WatchMapResponse>* MapService::WatchMap(
    grpc::CallbackServerContext* /*context*/,
    const v1::WatchMapRequest* request) {
  auto* reactor = new WatchReactor(calls_, engine_, *request);
  reactor->Start(calls_.admission->Admit(CallKind::kWatch));
  return reactor;
}

}  // namespace mapsieve::rpc
