#include "server/rpc/upload_service.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "core/base/bytes.h"
#include "core/base/status.h"
#include "server/rpc/convert.h"
#include "server/rpc/convert_query.h"

namespace mapsieve::rpc {
namespace {

// Bytes that become durable by one flush of the disk.
constexpr int64_t kFlushBytes = int64_t{8} << 20;

// One call of WriteUpload.
class WriteReactor final
    : public ExchangeReactor<v1::WriteUploadRequest, v1::WriteUploadResponse> {
 public:
  WriteReactor(CallContext& calls, engine::Engine& engine)
      : ExchangeReactor(calls, "WriteUpload"),
        engine_(engine),
        draining_(calls.admission->draining()) {}

 protected:
  absl::Status TakeRequest(
      const v1::WriteUploadRequest& request,
      std::optional<v1::WriteUploadResponse>& response) override {
    absl::Status status = Append(request);
    if (status.ok() && draining_.stop_requested()) status = DrainingError();
    if (!status.ok() || request.flush() || unflushed_bytes_ >= kFlushBytes) {
      // What came before the error counts.
      const absl::Status flushed = Flush(response);
      if (status.ok()) status = flushed;
    }
    if (!status.ok()) writer_.reset();
    return status;
  }

  absl::Status TakeEnd(
      std::optional<v1::WriteUploadResponse>& response) override {
    if (writer_ == nullptr) {
      return InvalidField("name", "missing: there was no request");
    }
    const absl::Status status = Flush(response);
    writer_.reset();
    return status;
  }

 private:
  absl::Status Append(const v1::WriteUploadRequest& request) {
    if (writer_ == nullptr) {
      MAPSIEVE_ASSIGN_OR_RETURN(const UploadName name,
                                ParseUploadName("name", request.name()));
      MAPSIEVE_ASSIGN_OR_RETURN(
          writer_, engine_.OpenUploadWriter(name.map_id, name.upload_id));
      name_ = request.name();
    } else if (!request.name().empty() && request.name() != name_) {
      return InvalidField("name", "differs from that of the first request");
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const std::string_view content,
                              CheckedContent("data", request.data()));
    MAPSIEVE_RETURN_IF_ERROR(
        writer_->Append(request.write_offset(), TextBytes(content)));
    unflushed_bytes_ += static_cast<int64_t>(content.size());
    return absl::OkStatus();
  }

  absl::Status Flush(std::optional<v1::WriteUploadResponse>& response) {
    if (writer_ == nullptr) return absl::OkStatus();
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t committed_bytes, writer_->Commit());
    unflushed_bytes_ = 0;
    response.emplace().set_committed_bytes(committed_bytes);
    return absl::OkStatus();
  }

  engine::Engine& engine_;
  const std::stop_token draining_;
  // Of the first request.
  std::string name_;
  std::unique_ptr<engine::UploadWriter> writer_;
  int64_t unflushed_bytes_ = 0;
};

}  // namespace

grpc::ServerUnaryReactor* UploadService::CreateUpload(
    grpc::CallbackServerContext* context,
    const v1::CreateUploadRequest* request, v1::Upload* response) {
  return RunUnary(calls_, "CreateUpload", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                              ParseMapName("parent", request->parent()));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto spec, ToUploadSpec(*request));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto upload,
                              engine_.CreateUpload(map_id, spec));
    *response = ToProto(map_id, upload);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* UploadService::GetUpload(
    grpc::CallbackServerContext* context, const v1::GetUploadRequest* request,
    v1::Upload* response) {
  return RunUnary(calls_, "GetUpload", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const UploadName name,
                              ParseUploadName("name", request->name()));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto upload,
                              engine_.GetUpload(name.map_id, name.upload_id));
    *response = ToProto(name.map_id, upload);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* UploadService::ListUploads(
    grpc::CallbackServerContext* context, const v1::ListUploadsRequest* request,
    v1::ListUploadsResponse* response) {
  return RunUnary(calls_, "ListUploads", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto map_id,
                              ParseMapName("parent", request->parent()));
    MAPSIEVE_ASSIGN_OR_RETURN(
        auto page, engine_.ListUploads(map_id, ToPageRequest(*request)));
    for (const engine::UploadInfo& upload : page.items) {
      v1::Upload& item = *response->add_uploads();
      item = ToProto(map_id, upload);
      // A page of them could exceed what a client receives.
      if (item.has_source()) item.mutable_source()->clear_crs_wkt();
    }
    response->set_next_page_token(std::move(page.next_page_token));
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* UploadService::DeleteUpload(
    grpc::CallbackServerContext* context,
    const v1::DeleteUploadRequest* request,
    google::protobuf::Empty* /*response*/) {
  return RunUnary(calls_, "DeleteUpload", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const UploadName name,
                              ParseUploadName("name", request->name()));
    return engine_.DeleteUpload(name.map_id, name.upload_id);
  });
}

grpc::ServerBidiReactor<v1::WriteUploadRequest, v1::WriteUploadResponse>*
UploadService::WriteUpload(grpc::CallbackServerContext* /*context*/) {
  auto* reactor = new WriteReactor(calls_, engine_);
  reactor->Start(calls_.admission->Admit(CallKind::kUpload));
  return reactor;
}

grpc::ServerUnaryReactor* UploadService::FinalizeUpload(
    grpc::CallbackServerContext* context,
    const v1::FinalizeUploadRequest* request, v1::Operation* response) {
  return RunUnary(
      calls_, "FinalizeUpload", context, [=, this]() -> absl::Status {
        MAPSIEVE_ASSIGN_OR_RETURN(const UploadName name,
                                  ParseUploadName("name", request->name()));
        MAPSIEVE_ASSIGN_OR_RETURN(const auto region, ToRegion(*request));
        MAPSIEVE_ASSIGN_OR_RETURN(
            const auto operation,
            engine_.FinalizeUpload(name.map_id, name.upload_id, region));
        *response = ToProto(operation);
        return absl::OkStatus();
      });
}

}  // namespace mapsieve::rpc
