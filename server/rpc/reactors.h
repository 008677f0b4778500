#ifndef MAPSIEVE_SERVER_RPC_REACTORS_H_
#define MAPSIEVE_SERVER_RPC_REACTORS_H_

#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/mutex.h"
#include "core/base/status.h"
#include "grpcpp/server_context.h"
#include "grpcpp/support/server_callback.h"
#include "server/rpc/admission.h"
#include "server/rpc/status_adapter.h"
#include "server/rpc/worker_pool.h"

/// The three kinds of calls. gRPC calls a reactor on its own few threads, so a
/// reactor only hands over: work runs on a WorkerPool, one task a call at a
/// time. Each reactor finishes exactly once and lives until OnDone.
namespace mapsieve::rpc {

/// What the calls of all services run in. Outlives them.
struct CallContext {
  /// For short calls.
  WorkerPool* unary_workers = nullptr;
  /// For uploads and queries, whose tasks take longer.
  WorkerPool* stream_workers = nullptr;
  /// For the begin of answers, which may wait until others have given back
  /// their memory: one thread, so that they come to it in the order of calls.
  WorkerPool* opening_worker = nullptr;
  Admission* admission = nullptr;
  /// Hears of every call that ended. Thread-safe.
  std::function<void(const char* method, const absl::Status& status)> on_end;
};

/// Answers a unary call by `work`, an absl::Status() that fills the response
/// and runs on a worker. `method` is a literal, for the log.
template <typename Work>
grpc::ServerUnaryReactor* RunUnary(CallContext& calls, const char* method,
                                   grpc::CallbackServerContext* context,
                                   Work work) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  auto ticket = calls.admission->Admit(CallKind::kUnary);
  if (!ticket.ok()) {
    calls.on_end(method, ticket.status());
    reactor->Finish(ToGrpcStatus(ticket.status()));
    return reactor;
  }
  calls.unary_workers->Post([&calls, method, reactor, work = std::move(work),
                             ticket = *std::move(ticket)]() mutable {
    const absl::Status status = Guarded(work);
    calls.on_end(method, status);
    reactor->Finish(ToGrpcStatus(status));
  });
  return reactor;
}

/// A call that streams responses which are made one by one on a worker. While
/// one is being sent the next is being made, and no third: a client that reads
/// slowly costs two responses of memory and no thread.
template <typename Response>
class StreamReactor : public grpc::ServerWriteReactor<Response> {
 public:
  /// The first response is made by `opener`.
  StreamReactor(CallContext& calls, const char* method, WorkerPool& opener)
      : calls_(calls), method_(method), worker_(&opener) {}

  /// Begins the stream, or ends it at once without a ticket.
  void Start(absl::StatusOr<Admission::Ticket> ticket) {
    Step step;
    {
      MutexLock lock(mutex_);
      if (ticket.ok()) {
        ticket_.emplace(*std::move(ticket));
      } else {
        end_ = ticket.status();
      }
      step = NextStep();
    }
    Take(step);
  }

  void OnWriteDone(bool ok) final {
    Step step;
    {
      MutexLock lock(mutex_);
      sending_ = false;
      if (!ok) Abandon();
      step = NextStep();
    }
    Take(step);
  }
  void OnCancel() final {
    stop_.request_stop();
    Step step;
    {
      MutexLock lock(mutex_);
      Abandon();
      step = NextStep();
    }
    Take(step);
  }
  void OnDone() final { delete this; }

 protected:
  /// Fills the next response and returns true, or returns false after the last
  /// one. If there is none yet it calls Pause and returns true: then it is
  /// called again after Resume. Called on one worker at a time.
  virtual absl::StatusOr<bool> Next(Response& response) = 0;

  /// Stop is requested when the client cancels, disconnects or its deadline
  /// passes.
  std::stop_token stop_token() const { return stop_.get_token(); }

  /// Called by Next alone.
  void Pause() { paused_ = true; }

  /// There may be a response now: ends a pause that began or begins with the
  /// call of Next under way. Calls nobody; thread-safe.
  void Resume() {
    {
      MutexLock lock(mutex_);
      resumed_ = true;
      if (!idle_ || making_ || end_) return;
      making_ = true;
    }
    calls_.stream_workers->Post([this] { Make(); });
  }

 private:
  // What is to be done without the lock. After a step of nothing the reactor
  // may be gone: others do what is left.
  struct Step {
    WorkerPool* maker = nullptr;
    const Response* send = nullptr;
    std::optional<absl::Status> finish;

    bool is_empty() const {
      return maker == nullptr && send == nullptr && !finish;
    }
  };

  // No more responses leave.
  void Abandon() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    ready_.reset();
    if (!end_) end_ = absl::CancelledError("the client went away");
  }

  void Make() {
    {
      MutexLock lock(mutex_);
      resumed_ = idle_ = false;
    }
    paused_ = false;
    auto response = std::make_unique<Response>();
    bool more = false;
    const absl::Status status = Guarded([&]() -> absl::Status {
      MAPSIEVE_ASSIGN_OR_RETURN(more, Next(*response));
      return absl::OkStatus();
    });
    Step step;
    {
      MutexLock lock(mutex_);
      making_ = false;
      if (!end_) {
        if (!more) {
          end_ = status;
        } else if (paused_) {
          idle_ = !resumed_;
        } else {
          ready_ = std::move(response);
        }
      }
      // With the lock still held: once nothing is being made, another thread
      // may end the call, and this is gone.
      step = NextStep();
    }
    if (!step.is_empty()) Take(step);
  }

  // Whatever can be done now.
  Step NextStep() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    Step step;
    if (finished_) return step;
    if (!sending_ && ready_ != nullptr) {
      sent_ = std::move(ready_);
      step.send = sent_.get();
      sending_ = true;
    }
    if (!making_ && ready_ == nullptr && !idle_ && !end_) {
      making_ = true;
      step.maker = std::exchange(worker_, calls_.stream_workers);
    }
    if (!making_ && !sending_ && end_) {
      finished_ = true;
      step.finish = end_;
    }
    return step;
  }

  // Does it; then the reactor may be gone.
  void Take(const Step& step) {
    if (step.maker != nullptr) step.maker->Post([this] { Make(); });
    if (step.send != nullptr) this->StartWrite(step.send);
    if (step.finish) {
      calls_.on_end(method_, *step.finish);
      this->Finish(ToGrpcStatus(*step.finish));
    }
  }

  CallContext& calls_;
  const char* const method_;
  std::stop_source stop_;
  Mutex mutex_;
  // Makes the next response.
  WorkerPool* worker_ ABSL_GUARDED_BY(mutex_);
  // Goes with the reactor: until then the call is going on.
  std::optional<Admission::Ticket> ticket_ ABSL_GUARDED_BY(mutex_);
  // Being sent; made and waiting to be sent.
  std::unique_ptr<Response> sent_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<Response> ready_ ABSL_GUARDED_BY(mutex_);
  bool sending_ ABSL_GUARDED_BY(mutex_) = false;
  bool making_ ABSL_GUARDED_BY(mutex_) = false;
  // Next paused, and nobody resumed since it was called.
  bool idle_ ABSL_GUARDED_BY(mutex_) = false;
  bool resumed_ ABSL_GUARDED_BY(mutex_) = false;
  // Of the call of Next under way.
  bool paused_ = false;
  bool finished_ ABSL_GUARDED_BY(mutex_) = false;
  // How the call ends once nothing is being made or sent.
  std::optional<absl::Status> end_ ABSL_GUARDED_BY(mutex_);
};

/// A call that takes a stream of requests, one at a time, and now and then
/// answers. An answer that waits to be sent is replaced by the next one.
template <typename Request, typename Response>
class ExchangeReactor : public grpc::ServerBidiReactor<Request, Response> {
 public:
  ExchangeReactor(CallContext& calls, const char* method)
      : calls_(calls), method_(method) {}

  /// Begins the stream, or ends it at once without a ticket.
  void Start(absl::StatusOr<Admission::Ticket> ticket) {
    const bool begin = ticket.ok();
    Step step;
    {
      MutexLock lock(mutex_);
      if (begin) {
        ticket_.emplace(*std::move(ticket));
      } else {
        end_ = ticket.status();
        step = NextStep();
      }
    }
    if (begin) {
      this->StartRead(&request_);
    } else {
      Take(step);
    }
  }

  void OnReadDone(bool ok) final {
    calls_.stream_workers->Post([this, ok] { TakeNext(ok); });
  }
  void OnWriteDone(bool ok) final {
    Step step;
    {
      MutexLock lock(mutex_);
      sending_ = false;
      // The read going on fails too and ends the call.
      if (!ok) broken_ = true;
      step = NextStep();
    }
    Take(step);
  }
  void OnDone() final { delete this; }

 protected:
  /// Takes the next request; sets `response` to answer. An error ends the call
  /// after the answer. Called on one worker at a time.
  virtual absl::Status TakeRequest(const Request& request,
                                   std::optional<Response>& response) = 0;
  /// The client sent its last request, or it went away.
  virtual absl::Status TakeEnd(std::optional<Response>& response) = 0;

 private:
  // As those of StreamReactor.
  struct Step {
    const Response* send = nullptr;
    std::optional<absl::Status> finish;

    bool is_empty() const { return send == nullptr && !finish; }
  };

  void TakeNext(bool ok) {
    std::optional<Response> response;
    const absl::Status status = Guarded([&] {
      return ok ? TakeRequest(request_, response) : TakeEnd(response);
    });
    const bool more = ok && status.ok();
    Step step;
    {
      MutexLock lock(mutex_);
      if (response) waiting_ = std::move(response);
      if (!more) end_ = status;
      step = NextStep();
    }
    if (!step.is_empty()) Take(step);
    if (more) this->StartRead(&request_);
  }

  // While a read is going on, end_ is not set.
  Step NextStep() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    Step step;
    if (finished_ || sending_) return step;
    if (waiting_ && !broken_) {
      sent_ = *std::move(waiting_);
      waiting_.reset();
      step.send = &sent_;
      sending_ = true;
    } else if (end_) {
      finished_ = true;
      step.finish = end_;
    }
    return step;
  }

  void Take(const Step& step) {
    if (step.send != nullptr) this->StartWrite(step.send);
    if (step.finish) {
      calls_.on_end(method_, *step.finish);
      this->Finish(ToGrpcStatus(*step.finish));
    }
  }

  CallContext& calls_;
  const char* const method_;
  // Written by gRPC during a read, read by a worker after it.
  Request request_;
  Mutex mutex_;
  // Goes with the reactor: until then the call is going on.
  std::optional<Admission::Ticket> ticket_ ABSL_GUARDED_BY(mutex_);
  Response sent_ ABSL_GUARDED_BY(mutex_);
  std::optional<Response> waiting_ ABSL_GUARDED_BY(mutex_);
  bool sending_ ABSL_GUARDED_BY(mutex_) = false;
  bool broken_ ABSL_GUARDED_BY(mutex_) = false;
  bool finished_ ABSL_GUARDED_BY(mutex_) = false;
  std::optional<absl::Status> end_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_REACTORS_H_
