#ifndef MAPSIEVE_SERVER_RPC_PROCESSING_SERVICE_H_
#define MAPSIEVE_SERVER_RPC_PROCESSING_SERVICE_H_

#include "mapsieve/v1/processing_service.grpc.pb.h"
#include "server/engine/engine.h"
#include "server/rpc/reactors.h"

namespace mapsieve::rpc {

/// mapsieve.v1.ProcessingService over an engine. Thread-safe.
class ProcessingService final : public v1::ProcessingService::CallbackService {
 public:
  /// Both outlive the service.
  ProcessingService(CallContext& calls, engine::Engine& engine)
      : calls_(calls), engine_(engine) {}

  grpc::ServerUnaryReactor* ProcessMap(grpc::CallbackServerContext* context,
                                       const v1::ProcessMapRequest* request,
                                       v1::Operation* response) override;

 private:
  CallContext& calls_;
  engine::Engine& engine_;
};

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_PROCESSING_SERVICE_H_
