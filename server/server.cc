#include "server/server.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <initializer_list>
#include <string>
#include <string_view>
#include <thread>
#include <utility>

#include "absl/time/clock.h"
#include "core/base/status.h"
#include "grpcpp/ext/proto_server_reflection_plugin.h"
#include "grpcpp/health_check_service_interface.h"
#include "grpcpp/resource_quota.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server.h"
#include "grpcpp/server_builder.h"
#include "server/engine/engine.h"
#include "server/rpc/admission.h"
#include "server/rpc/convert.h"
#include "server/rpc/map_service.h"
#include "server/rpc/operations_service.h"
#include "server/rpc/processing_service.h"
#include "server/rpc/query_service.h"
#include "server/rpc/reactors.h"
#include "server/rpc/upload_service.h"
#include "server/rpc/worker_pool.h"
#include "server/space_watch.h"
#include "spdlog/logger.h"

namespace mapsieve::rpc {
namespace {

constexpr int kUnaryWorkers = 4;
constexpr int kMinStreamWorkers = 8;

// A client that vanished without a word is noticed after their sum, and its
// upload can be written by another.
constexpr int kKeepaliveTimeMs = 20'000;
constexpr int kKeepaliveTimeoutMs = 10'000;
// Clients may ask for signs of life themselves, this often.
constexpr int kMinClientPingMs = 10'000;

// The last bytes of answered calls leave within this.
constexpr absl::Duration kFlushTime = absl::Milliseconds(500);

int ThreadCount(const ServerOptions& options) {
  if (options.thread_count > 0) return options.thread_count;
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

// `what`: a method, or work in the background, of which no caller may hear: its
// errors are told from level `least` on.
void LogEnd(spdlog::logger& logger, std::string_view what,
            const absl::Status& status,
            spdlog::level::level_enum least = spdlog::level::debug) {
  auto level = spdlog::level::debug;
  switch (status.code()) {
    case absl::StatusCode::kInternal:
    case absl::StatusCode::kDataLoss:
    case absl::StatusCode::kUnknown:
      level = spdlog::level::err;
      break;
    case absl::StatusCode::kResourceExhausted:
      level = spdlog::level::warn;
      break;
    default:
      break;
  }
  const bool is_failure = !status.ok() && !absl::IsCancelled(status);
  logger.log(is_failure ? std::max(level, least) : level, "{}: {}", what,
             status.ToString());
}

void LogOperation(spdlog::logger& logger, const engine::Operation& operation) {
  v1::OperationMetadata metadata;
  ToProto(operation).metadata().UnpackTo(&metadata);
  LogEnd(logger,
         absl::StrCat(metadata.verb(), " of ", metadata.target(),
                      ", operation ", operation.operation_id),
         operation.error, spdlog::level::warn);
}

class GrpcServer final : public Server {
 public:
  GrpcServer(const ServerOptions& options, spdlog::logger& logger,
             std::unique_ptr<engine::Engine> engine)
      : logger_(logger),
        engine_(std::move(engine)),
        unary_workers_(kUnaryWorkers),
        stream_workers_(std::max(kMinStreamWorkers, ThreadCount(options))),
        calls_{&unary_workers_, &stream_workers_, &opening_worker_, &admission_,
               [&logger](const char* method, const absl::Status& status) {
                 LogEnd(logger, method, status);
               }},
        maps_(calls_, *engine_),
        uploads_(calls_, *engine_),
        processing_(calls_, *engine_),
        queries_(calls_, *engine_),
        operations_(calls_, *engine_) {}

  ~GrpcServer() override { Shutdown(absl::ZeroDuration()); }

  absl::Status Listen(const ServerOptions& options) {
    address_ = options.listen;
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    grpc::ServerBuilder builder;
    // Without this a second server would share the port and take every other
    // call.
    builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, kKeepaliveTimeMs);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS,
                               kKeepaliveTimeoutMs);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
    builder.AddChannelArgument(
        GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS,
        kMinClientPingMs);
    builder.SetResourceQuota(
        grpc::ResourceQuota("calls").Resize(static_cast<size_t>(
            std::max(int64_t{64} << 20, options.memory_bytes / 16))));
    for (grpc::Service* service : Services()) builder.RegisterService(service);
    int port = 0;
    builder.AddListeningPort(address_.ToString(),
                             grpc::InsecureServerCredentials(), &port);
    server_ = builder.BuildAndStart();
    if (server_ == nullptr || port == 0) {
      return absl::UnavailableError(
          absl::StrCat("cannot listen on ", address_.ToString(),
                       ": is the port taken, the address of this machine?"));
    }
    address_.port = port;
    SetHealth({v1::MapService::service_full_name(),
               v1::UploadService::service_full_name(),
               v1::ProcessingService::service_full_name(),
               v1::QueryService::service_full_name(),
               v1::Operations::service_full_name()},
              true);
    space_watch_ = std::make_unique<SpaceWatch>(
        [this] { return engine_->CheckSpace(); },
        [this](const absl::Status& space) { ReportSpace(space); });
    return absl::OkStatus();
  }

  const ListenAddress& address() const override { return address_; }

  void Shutdown(absl::Duration grace) override {
    if (shut_down_.exchange(true) || server_ == nullptr) return;
    const absl::Time deadline = absl::Now() + grace;
    space_watch_.reset();
    server_->GetHealthCheckService()->Shutdown();
    admission_.Drain();
    engine_->Shutdown();
    admission_.WaitUntilIdle(deadline);
    // gRPC waits for connections too, even those that nobody uses.
    server_->Shutdown(absl::ToChronoTime(
        std::max(absl::Now(), std::min(deadline, absl::Now() + kFlushTime))));
    server_->Wait();
  }

 private:
  std::array<grpc::Service*, 5> Services() {
    return {&maps_, &uploads_, &processing_, &queries_, &operations_};
  }

  void SetHealth(std::initializer_list<const char*> services, bool is_serving) {
    for (const char* service : services) {
      server_->GetHealthCheckService()->SetServingStatus(service, is_serving);
    }
  }

  void ReportSpace(const absl::Status& space) {
    if (space.ok()) {
      logger_.info("the disk has space again: uploads are taken");
    } else {
      logger_.warn("uploads and processing are refused: {}", space.ToString());
    }
    SetHealth({v1::UploadService::service_full_name(),
               v1::ProcessingService::service_full_name()},
              space.ok());
  }

  // Members go in reverse order: first the calls, then the workers that they
  // need to end, then the engine.
  spdlog::logger& logger_;
  std::unique_ptr<engine::Engine> engine_;
  Admission admission_;
  WorkerPool unary_workers_;
  WorkerPool stream_workers_;
  WorkerPool opening_worker_{1};
  CallContext calls_;
  MapService maps_;
  UploadService uploads_;
  ProcessingService processing_;
  QueryService queries_;
  OperationsService operations_;
  ListenAddress address_;
  std::atomic<bool> shut_down_ = false;
  std::unique_ptr<grpc::Server> server_;
  // Null while nothing is served.
  std::unique_ptr<SpaceWatch> space_watch_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Server>> Server::Start(
    const ServerOptions& options, spdlog::logger& logger,
    storage::FileSystem* file_system) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  MAPSIEVE_ASSIGN_OR_RETURN(
      auto engine, engine::Engine::Open({
                       .data_dir = options.data_dir,
                       .memory_bytes = options.memory_bytes,
                       .worker_count = ThreadCount(options),
                       .file_system = file_system,
                       .kept_revision_count = options.kept_revision_count,
                       .on_operation_end =
                           [&logger](const engine::Operation& operation) {
                             LogOperation(logger, operation);
                           },
                       .on_collection_failure =
                           [&logger](const absl::Status& error) {
                             LogEnd(logger, "collection of garbage", error,
                                    spdlog::level::warn);
                           },
                   }));
  auto server =
      std::make_unique<GrpcServer>(options, logger, std::move(engine));
  MAPSIEVE_RETURN_IF_ERROR(server->Listen(options));
  return server;
}

}  // namespace mapsieve::rpc
