#ifndef MAPSIEVE_SERVER_RPC_STATUS_ADAPTER_H_
#define MAPSIEVE_SERVER_RPC_STATUS_ADAPTER_H_

#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "grpcpp/support/status.h"
#include "mapsieve/v1/types.pb.h"

/// The one place where an error of ours becomes an error of gRPC. All functions
/// are thread-safe.
namespace mapsieve::rpc {

/// Attaches the cause for programs: `reason` (UPPER_SNAKE_CASE) and facts by
/// name. An OK status, or one that has a cause, stays as it is.
absl::Status WithReason(
    absl::Status status, std::string_view reason,
    std::initializer_list<std::pair<std::string, std::string>> facts = {});

/// kInvalidArgument, reason INVALID_FIELD: "`field`: `message`".
absl::Status InvalidField(std::string_view field, std::string_view message);

/// The wire form: code, message and exactly one ErrorInfo, whose reason is the
/// name of the code where nothing better was attached. The message is at most
/// 1000 bytes of valid UTF-8: it travels in a header.
v1::RpcStatus ToRpcStatus(const absl::Status& status);

/// ToRpcStatus as gRPC returns it, in the binary details too.
grpc::Status ToGrpcStatus(const absl::Status& status);

/// `text` as valid UTF-8 without control characters, at most `max_bytes` of it;
/// other bytes become '?'. For text that came out of a file.
std::string CleanText(std::string_view text, size_t max_bytes);

/// The exception barrier of the service: calls `work` and turns an exception
/// into kResourceExhausted (no memory) or kInternal.
absl::Status Guarded(absl::FunctionRef<absl::Status()> work);

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_STATUS_ADAPTER_H_
