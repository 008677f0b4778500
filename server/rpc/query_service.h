#ifndef MAPSIEVE_SERVER_RPC_QUERY_SERVICE_H_
#define MAPSIEVE_SERVER_RPC_QUERY_SERVICE_H_

#include "mapsieve/v1/query_service.grpc.pb.h"
#include "server/engine/engine.h"
#include "server/rpc/reactors.h"

namespace mapsieve::rpc {

/// mapsieve.v1.QueryService over an engine. Thread-safe.
class QueryService final
    : public v1::QueryService::WithRawCallbackMethod_QueryRegion<
          v1::QueryService::CallbackService> {
 public:
  /// Both outlive the service.
  QueryService(CallContext& calls, engine::Engine& engine)
      : calls_(calls), engine_(engine) {}

  /// Messages as bytes: those of blocks are not copied into any other.
  grpc::ServerWriteReactor<grpc::ByteBuffer>* QueryRegion(
      grpc::CallbackServerContext* context,
      const grpc::ByteBuffer* request) override;
  grpc::ServerWriteReactor<v1::SyncRegionResponse>* SyncRegion(
      grpc::CallbackServerContext* context,
      const v1::SyncRegionRequest* request) override;

 private:
  CallContext& calls_;
  engine::Engine& engine_;
};

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_QUERY_SERVICE_H_
