#include "server/rpc/operations_service.h"

#include <algorithm>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <utility>

#include "absl/time/time.h"
#include "core/base/mutex.h"
#include "core/base/status.h"
#include "grpcpp/alarm.h"
#include "server/rpc/convert.h"

namespace mapsieve::rpc {
namespace {

constexpr absl::Duration kMaxWait = absl::Seconds(60);

absl::StatusOr<absl::Duration> WaitTimeout(
    const v1::WaitOperationRequest& request) {
  if (!request.has_timeout()) return kMaxWait;
  const absl::Duration timeout = absl::Seconds(request.timeout().seconds()) +
                                 absl::Nanoseconds(request.timeout().nanos());
  if (timeout < absl::ZeroDuration()) {
    return InvalidField("timeout", "must not be negative");
  }
  return std::min(timeout, kMaxWait);
}

// One call of WaitOperation. It waits without a thread: the end of the
// operation, the timeout, the client's cancellation or the server's shutdown
// wakes it, whichever comes first, and it answers.
class WaitReactor final : public grpc::ServerUnaryReactor {
 public:
  WaitReactor(CallContext& calls, engine::Engine& engine,
              const v1::WaitOperationRequest& request, v1::Operation& response)
      : calls_(calls),
        engine_(engine),
        request_(request),
        response_(response),
        waker_(std::make_shared<Waker>()) {}

  void Start(absl::StatusOr<Admission::Ticket> ticket) {
    if (!ticket.ok()) return End(ticket.status());
    ticket_.emplace(*std::move(ticket));
    calls_.unary_workers->Post([this] {
      const absl::Status status = Guarded([&] { return Wait(); });
      if (!status.ok()) return End(status);
      waker_->Arm([this] { calls_.unary_workers->Post([this] { Answer(); }); });
    });
  }

  void OnCancel() override { waker_->Wake(); }
  void OnDone() override { delete this; }

 private:
  // Calls a function once, after both Arm and the first Wake.
  class Waker {
   public:
    void Arm(std::function<void()> function) {
      {
        MutexLock lock(mutex_);
        if (!awake_) {
          function_ = std::move(function);
          return;
        }
      }
      function();
    }
    void Wake() {
      std::function<void()> function;
      {
        MutexLock lock(mutex_);
        awake_ = true;
        function.swap(function_);
      }
      if (function) function();
    }

   private:
    Mutex mutex_;
    bool awake_ ABSL_GUARDED_BY(mutex_) = false;
    std::function<void()> function_ ABSL_GUARDED_BY(mutex_);
  };

  // Sets up everything that wakes.
  absl::Status Wait() {
    MAPSIEVE_ASSIGN_OR_RETURN(operation_id_,
                              ParseOperationName("name", request_.name()));
    MAPSIEVE_ASSIGN_OR_RETURN(const absl::Duration timeout,
                              WaitTimeout(request_));
    const auto wake = [waker = waker_] { waker->Wake(); };
    MAPSIEVE_ASSIGN_OR_RETURN(watch_,
                              engine_.WatchOperation(operation_id_, wake));
    alarm_.Set(
        std::chrono::system_clock::now() + absl::ToChronoNanoseconds(timeout),
        [wake](bool /*expired*/) { wake(); });
    draining_.emplace(calls_.admission->draining(), wake);
    return absl::OkStatus();
  }

  void Answer() {
    draining_.reset();
    alarm_.Cancel();
    engine_.StopWatching(watch_);
    End(Guarded([&]() -> absl::Status {
      MAPSIEVE_ASSIGN_OR_RETURN(const auto operation,
                                engine_.GetOperation(operation_id_));
      if (!operation.done() && calls_.admission->draining().stop_requested()) {
        return DrainingError();
      }
      response_ = ToProto(operation);
      return absl::OkStatus();
    }));
  }

  void End(const absl::Status& status) {
    calls_.on_end("WaitOperation", status);
    Finish(ToGrpcStatus(status));
  }

  CallContext& calls_;
  engine::Engine& engine_;
  // gRPC keeps both until OnDone.
  const v1::WaitOperationRequest& request_;
  v1::Operation& response_;
  const std::shared_ptr<Waker> waker_;
  std::optional<Admission::Ticket> ticket_;
  std::string operation_id_;
  int64_t watch_ = 0;
  grpc::Alarm alarm_;
  std::optional<std::stop_callback<std::function<void()>>> draining_;
};

}  // namespace

grpc::ServerUnaryReactor* OperationsService::GetOperation(
    grpc::CallbackServerContext* context,
    const v1::GetOperationRequest* request, v1::Operation* response) {
  return RunUnary(calls_, "GetOperation", context, [=, this]() -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto operation_id,
                              ParseOperationName("name", request->name()));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto operation,
                              engine_.GetOperation(operation_id));
    *response = ToProto(operation);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* OperationsService::ListOperations(
    grpc::CallbackServerContext* context,
    const v1::ListOperationsRequest* request,
    v1::ListOperationsResponse* response) {
  return RunUnary(
      calls_, "ListOperations", context, [=, this]() -> absl::Status {
        std::string map_id;
        if (!request->target().empty()) {
          MAPSIEVE_ASSIGN_OR_RETURN(map_id,
                                    ParseMapName("target", request->target()));
        }
        MAPSIEVE_ASSIGN_OR_RETURN(
            auto page, engine_.ListOperations(map_id, ToPageRequest(*request)));
        for (const engine::Operation& operation : page.items) {
          *response->add_operations() = ToProto(operation);
        }
        response->set_next_page_token(std::move(page.next_page_token));
        return absl::OkStatus();
      });
}

grpc::ServerUnaryReactor* OperationsService::CancelOperation(
    grpc::CallbackServerContext* context,
    const v1::CancelOperationRequest* request,
    google::protobuf::Empty* /*response*/) {
  return RunUnary(
      calls_, "CancelOperation", context, [=, this]() -> absl::Status {
        MAPSIEVE_ASSIGN_OR_RETURN(const auto operation_id,
                                  ParseOperationName("name", request->name()));
        return engine_.CancelOperation(operation_id);
      });
}

grpc::ServerUnaryReactor* OperationsService::WaitOperation(
    grpc::CallbackServerContext* /*context*/,
    const v1::WaitOperationRequest* request, v1::Operation* response) {
  auto* reactor = new WaitReactor(calls_, engine_, *request, *response);
  reactor->Start(calls_.admission->Admit(CallKind::kWait));
  return reactor;
}

}  // namespace mapsieve::rpc
