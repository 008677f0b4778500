#include "server/rpc/status_adapter.h"

#include <exception>
#include <new>

#include "absl/strings/cord.h"
#include "core/base/status.h"
#include "server/engine/field_error.h"

namespace mapsieve::rpc {
namespace {

constexpr char kErrorInfoUrl[] = "type.googleapis.com/mapsieve.v1.ErrorInfo";
constexpr size_t kMaxMessageBytes = 1000;

// "NOT_FOUND" and the like.
std::string CodeName(absl::StatusCode code) {
  return absl::StatusCodeToString(code);
}

constexpr char kInvalidField[] = "INVALID_FIELD";

// `status` with the field that the engine says it is about.
absl::Status WithField(const absl::Status& status) {
  const auto field = engine::FieldOf(status);
  if (!field.has_value()) return status;
  return WithReason(status, kInvalidField, {{"field", *field}});
}

// Length of the valid UTF-8 sequence that `text` starts with, 0 if none.
size_t SequenceLength(std::string_view text) {
  const auto byte = [&](size_t i) {
    return i < text.size() ? static_cast<unsigned char>(text[i]) : 0U;
  };
  const auto continues = [&](size_t i, unsigned low = 0x80,
                             unsigned high = 0xBF) {
    return byte(i) >= low && byte(i) <= high;
  };
  const unsigned lead = byte(0);
  if (lead < 0x80) return 1;
  if (lead >= 0xC2 && lead <= 0xDF) return continues(1) ? 2 : 0;
  if (lead >= 0xE0 && lead <= 0xEF) {
    // No overlong forms, no surrogates.
    const bool second = lead == 0xE0   ? continues(1, 0xA0)
                        : lead == 0xED ? continues(1, 0x80, 0x9F)
                                       : continues(1);
    return second && continues(2) ? 3 : 0;
  }
  if (lead >= 0xF0 && lead <= 0xF4) {
    const bool second = lead == 0xF0   ? continues(1, 0x90)
                        : lead == 0xF4 ? continues(1, 0x80, 0x8F)
                                       : continues(1);
    return second && continues(2) && continues(3) ? 4 : 0;
  }
  return 0;
}

}  // namespace

absl::Status WithReason(
    absl::Status status, std::string_view reason,
    std::initializer_list<std::pair<std::string, std::string>> facts) {
  if (status.ok() || status.GetPayload(kErrorInfoUrl)) return status;
  v1::ErrorInfo info;
  info.set_reason(std::string(reason));
  info.set_domain("mapsieve");
  for (const auto& [name, value] : facts) {
    (*info.mutable_metadata())[name] = value;
  }
  status.SetPayload(kErrorInfoUrl, absl::Cord(info.SerializeAsString()));
  return status;
}

absl::Status InvalidField(std::string_view field, std::string_view message) {
  return WithReason(absl::InvalidArgumentError(
                        absl::StrCat(ToAbsl(field), ": ", ToAbsl(message))),
                    kInvalidField, {{"field", std::string(field)}});
}

v1::RpcStatus ToRpcStatus(const absl::Status& status) {
  const absl::Status explained =
      WithReason(WithField(status), CodeName(status.code()));
  v1::RpcStatus result;
  result.set_code(static_cast<int>(explained.code()));
  result.set_message(CleanText(ToStd(explained.message()), kMaxMessageBytes));
  if (const auto info = explained.GetPayload(kErrorInfoUrl)) {
    google::protobuf::Any* detail = result.add_details();
    detail->set_type_url(kErrorInfoUrl);
    detail->set_value(std::string(*info));
  }
  return result;
}

grpc::Status ToGrpcStatus(const absl::Status& status) {
  if (status.ok()) return grpc::Status::OK;
  const v1::RpcStatus wire = ToRpcStatus(status);
  return grpc::Status(static_cast<grpc::StatusCode>(wire.code()),
                      wire.message(), wire.SerializeAsString());
}

std::string CleanText(std::string_view text, size_t max_bytes) {
  std::string clean;
  while (!text.empty()) {
    const size_t length = SequenceLength(text);
    const bool control =
        static_cast<unsigned char>(text[0]) < 0x20 || text[0] == 0x7F;
    const std::string_view piece =
        length == 0 || control ? "?" : text.substr(0, length);
    if (clean.size() + piece.size() > max_bytes) break;
    clean += piece;
    text.remove_prefix(length == 0 ? 1 : length);
  }
  return clean;
}

absl::Status Guarded(absl::FunctionRef<absl::Status()> work) {
  try {
    return work();
  } catch (const std::bad_alloc&) {
    return absl::ResourceExhaustedError(
        "the server has no memory left for this call; try again later");
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("unexpected: ", error.what()));
  } catch (...) {
    return absl::InternalError("unexpected exception");
  }
}

}  // namespace mapsieve::rpc
