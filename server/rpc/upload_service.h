#ifndef MAPSIEVE_SERVER_RPC_UPLOAD_SERVICE_H_
#define MAPSIEVE_SERVER_RPC_UPLOAD_SERVICE_H_

#include "mapsieve/v1/upload_service.grpc.pb.h"
#include "server/engine/engine.h"
#include "server/rpc/reactors.h"

namespace mapsieve::rpc {

/// mapsieve.v1.UploadService over an engine. Thread-safe.
class UploadService final : public v1::UploadService::CallbackService {
 public:
  /// Both outlive the service.
  UploadService(CallContext& calls, engine::Engine& engine)
      : calls_(calls), engine_(engine) {}

  grpc::ServerUnaryReactor* CreateUpload(grpc::CallbackServerContext* context,
                                         const v1::CreateUploadRequest* request,
                                         v1::Upload* response) override;
  grpc::ServerUnaryReactor* GetUpload(grpc::CallbackServerContext* context,
                                      const v1::GetUploadRequest* request,
                                      v1::Upload* response) override;
  grpc::ServerUnaryReactor* ListUploads(
      grpc::CallbackServerContext* context,
      const v1::ListUploadsRequest* request,
      v1::ListUploadsResponse* response) override;
  grpc::ServerUnaryReactor* DeleteUpload(
      grpc::CallbackServerContext* context,
      const v1::DeleteUploadRequest* request,
      google::protobuf::Empty* response) override;
  grpc::ServerBidiReactor<v1::WriteUploadRequest, v1::WriteUploadResponse>*
  WriteUpload(grpc::CallbackServerContext* context) override;
  grpc::ServerUnaryReactor* FinalizeUpload(
      grpc::CallbackServerContext* context,
      const v1::FinalizeUploadRequest* request,
      v1::Operation* response) override;

 private:
  CallContext& calls_;
  engine::Engine& engine_;
};

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_UPLOAD_SERVICE_H_
