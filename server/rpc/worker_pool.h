#ifndef MAPSIEVE_SERVER_RPC_WORKER_POOL_H_
#define MAPSIEVE_SERVER_RPC_WORKER_POOL_H_

#include <deque>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "core/base/mutex.h"

namespace mapsieve::rpc {

/// Threads that do what a reactor must not: everything that may block. Every
/// call has at most one task in the queue or on a thread, so that the admission
/// of calls bounds the queue. Thread-safe.
class WorkerPool {
 public:
  using Task = absl::AnyInvocable<void()>;

  /// `thread_count` is at least 1.
  explicit WorkerPool(int thread_count);
  /// Runs what is queued, then joins.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  /// Runs `task`, which does not throw, after those posted before it began.
  void Post(Task task);

 private:
  struct Worker {
    std::thread thread;
    ConditionVariable changed;
    /// Among idle_.
    bool is_idle = false;
  };

  void Work(Worker& worker);

  Mutex mutex_;
  std::deque<Task> tasks_ ABSL_GUARDED_BY(mutex_);
  bool closed_ ABSL_GUARDED_BY(mutex_) = false;
  /// Those that wait for tasks. The last one to come is woken first: what it
  /// used is still in the caches of a processor.
  std::vector<Worker*> idle_ ABSL_GUARDED_BY(mutex_);
  std::vector<Worker> workers_;
};

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_WORKER_POOL_H_
