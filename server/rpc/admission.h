#ifndef MAPSIEVE_SERVER_RPC_ADMISSION_H_
#define MAPSIEVE_SERVER_RPC_ADMISSION_H_

#include <array>
#include <stop_token>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "core/base/mutex.h"

namespace mapsieve::rpc {

/// Calls that are limited separately.
enum class CallKind { kUnary, kWait, kUpload, kQuery, kWatch };

/// Calls of each kind at the same time.
struct AdmissionLimits {
  /// Each is short, and holds one message.
  int unary = 1024;
  /// WaitOperation: holds no thread.
  int wait = 1024;
  /// Each holds one message of 1 MiB.
  int upload = 64;
  /// Each holds two batches, and when its turn has come a chunk's points.
  int query = 256;
  /// WatchMap: holds no thread, and two messages of some hundred bytes.
  int watch = 1024;
};

/// Decides whether a call may begin: not when too many of its kind are going
/// on, and not once the server drains. Thread-safe.
class Admission {
 public:
  /// Keeps the place of a call in flight.
  class Ticket {
   public:
    Ticket(Ticket&& other) noexcept
        : admission_(std::exchange(other.admission_, nullptr)),
          kind_(other.kind_) {}
    Ticket& operator=(Ticket&&) = delete;
    ~Ticket() {
      if (admission_ != nullptr) admission_->Leave(kind_);
    }

   private:
    friend class Admission;
    Ticket(Admission* admission, CallKind kind)
        : admission_(admission), kind_(kind) {}

    Admission* admission_;
    CallKind kind_;
  };

  explicit Admission(const AdmissionLimits& limits = {});

  /// kUnavailable: the server drains; kResourceExhausted: the limit of `kind`.
  /// The ticket must not outlive this object.
  absl::StatusOr<Ticket> Admit(CallKind kind);

  /// Refuses every call from now on and requests the stop of `draining`.
  void Drain();

  /// Returns once no call is going on, or at `deadline`.
  void WaitUntilIdle(absl::Time deadline);

  /// Stop is requested once Drain was called: calls that only wait end then.
  std::stop_token draining() const { return draining_.get_token(); }

 private:
  void Leave(CallKind kind);
  bool IsIdle() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  std::array<int, 5> limits_{};
  Mutex mutex_;
  ConditionVariable left_;
  std::array<int, 5> count_ ABSL_GUARDED_BY(mutex_){};
  std::stop_source draining_;
};

/// kUnavailable: the answer to everybody while the server drains.
absl::Status DrainingError();

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_ADMISSION_H_
