#ifndef MAPSIEVE_SERVER_RPC_MAP_SERVICE_H_
#define MAPSIEVE_SERVER_RPC_MAP_SERVICE_H_

#include "mapsieve/v1/map_service.grpc.pb.h"
#include "server/engine/engine.h"
#include "server/rpc/reactors.h"

namespace mapsieve::rpc {

/// mapsieve.v1.MapService over an engine. Thread-safe.
class MapService final : public v1::MapService::CallbackService {
 public:
  /// Both outlive the service.
  MapService(CallContext& calls, engine::Engine& engine)
      : calls_(calls), engine_(engine) {}

  grpc::ServerUnaryReactor* CreateMap(grpc::CallbackServerContext* context,
                                      const v1::CreateMapRequest* request,
                                      v1::Map* response) override;
  grpc::ServerUnaryReactor* GetMap(grpc::CallbackServerContext* context,
                                   const v1::GetMapRequest* request,
                                   v1::Map* response) override;
  grpc::ServerUnaryReactor* ListMaps(grpc::CallbackServerContext* context,
                                     const v1::ListMapsRequest* request,
                                     v1::ListMapsResponse* response) override;
  grpc::ServerUnaryReactor* DeleteMap(
      grpc::CallbackServerContext* context, const v1::DeleteMapRequest* request,
      google::protobuf::Empty* response) override;
  grpc::ServerUnaryReactor* GetMapStats(grpc::CallbackServerContext* context,
                                        const v1::GetMapStatsRequest* request,
                                        v1::MapStats* response) override;
  grpc::ServerUnaryReactor* ListRevisions(
      grpc::CallbackServerContext* context,
      const v1::ListRevisionsRequest* request,
      v1::ListRevisionsResponse* response) override;
  grpc::ServerUnaryReactor* CompareRevisions(
      grpc::CallbackServerContext* context,
      const v1::CompareRevisionsRequest* request,
      v1::CompareRevisionsResponse* response) override;
  grpc::ServerUnaryReactor* DeleteRegion(grpc::CallbackServerContext* context,
                                         const v1::DeleteRegionRequest* request,
                                         v1::Operation* response) override;
  grpc::ServerUnaryReactor* RollBackMap(grpc::CallbackServerContext* context,
                                        const v1::RollBackMapRequest* request,
                                        v1::Revision* response) override;
  grpc::ServerWriteReactor<v1::VerifyMapResponse>* VerifyMap(
      grpc::CallbackServerContext* context,
      const v1::VerifyMapRequest* request) override;
  grpc::ServerWriteReactor<v1::WatchMapResponse>* WatchMap(
      grpc::CallbackServerContext* context,
      const v1::WatchMapRequest* request) override;
  grpc::ServerUnaryReactor* RepairMap(grpc::CallbackServerContext* context,
                                      const v1::RepairMapRequest* request,
                                      v1::Operation* response) override;

 private:
  CallContext& calls_;
  engine::Engine& engine_;
};

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_MAP_SERVICE_H_
