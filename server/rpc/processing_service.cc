#include "server/rpc/processing_service.h"

#include <optional>

#include "core/base/status.h"
#include "server/rpc/convert.h"

namespace mapsieve::rpc {

grpc::ServerUnaryReactor* ProcessingService::ProcessMap(
    grpc::CallbackServerContext* context, const v1::ProcessMapRequest* request,
    v1::Operation* response) {
  return RunUnary(calls_, "ProcessMap", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                              ParseMapName("name", request->name()));
    std::optional<core::SpdfOptions> options;
    if (request->has_options()) {
      MAPSIEVE_ASSIGN_OR_RETURN(options, ToSpdfOptions(request->options()));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const auto operation,
                              engine_.ProcessMap(map_id, options));
    *response = ToProto(operation);
    return absl::OkStatus();
  });
}

}  // namespace mapsieve::rpc
