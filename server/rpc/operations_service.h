#ifndef MAPSIEVE_SERVER_RPC_OPERATIONS_SERVICE_H_
#define MAPSIEVE_SERVER_RPC_OPERATIONS_SERVICE_H_

#include "mapsieve/v1/operations.grpc.pb.h"
#include "server/engine/engine.h"
#include "server/rpc/reactors.h"

namespace mapsieve::rpc {

/// mapsieve.v1.Operations over an engine. Thread-safe.
class OperationsService final : public v1::Operations::CallbackService {
 public:
  /// Both outlive the service.
  OperationsService(CallContext& calls, engine::Engine& engine)
      : calls_(calls), engine_(engine) {}

  grpc::ServerUnaryReactor* GetOperation(grpc::CallbackServerContext* context,
                                         const v1::GetOperationRequest* request,
                                         v1::Operation* response) override;
  grpc::ServerUnaryReactor* ListOperations(
      grpc::CallbackServerContext* context,
      const v1::ListOperationsRequest* request,
      v1::ListOperationsResponse* response) override;
  grpc::ServerUnaryReactor* CancelOperation(
      grpc::CallbackServerContext* context,
      const v1::CancelOperationRequest* request,
      google::protobuf::Empty* response) override;
  grpc::ServerUnaryReactor* WaitOperation(
      grpc::CallbackServerContext* context,
      const v1::WaitOperationRequest* request,
      v1::Operation* response) override;

 private:
  CallContext& calls_;
  engine::Engine& engine_;
};

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_OPERATIONS_SERVICE_H_
