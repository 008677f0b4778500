#ifndef MAPSIEVE_CORE_BASE_EXECUTOR_H_
#define MAPSIEVE_CORE_BASE_EXECUTOR_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <stop_token>

#include "absl/status/status.h"

namespace mapsieve {

/// Runs indexed tasks. Algorithms own no threads: they receive an executor and
/// write each task's result to a slot of its own, so that results do not
/// depend on the number of workers.
class Executor {
 public:
  virtual ~Executor() = default;

  /// How many tasks may run at the same time, at least 1.
  virtual int worker_count() const = 0;

  /// Calls task(i) once for every i in [0, count), in any order and on any
  /// worker, and returns when all calls have returned. The calling thread
  /// takes part. An exception leaves through this call after all tasks ended.
  /// Not to be called from inside a task.
  virtual void ParallelFor(int64_t count,
                           const std::function<void(int64_t)>& task) = 0;
};

/// Runs every task on the calling thread, in index order. Thread-safe.
Executor& InlineExecutor();

/// Makes an executor of `worker_count` workers (the caller of ParallelFor is
/// one of them). One ParallelFor runs at a time; others wait. Thread-safe.
std::unique_ptr<Executor> MakeWorkerPool(int worker_count);

/// ParallelFor for tasks that can fail. Returns the error of the smallest i
/// that has one; tasks that have not begun when one fails may be left out.
absl::Status TryParallelFor(Executor& executor, int64_t count,
                            const std::function<absl::Status(int64_t)>& task);

/// How many parts ForEachPart makes.
inline size_t PartCount(size_t size, size_t part_size) {
  return (size + part_size - 1) / part_size;
}

/// Calls task(part, begin, end) for parts [begin, end) of [0, size), each of
/// `part_size` but the last, as tasks of `executor`; `part` counts them.
template <typename Task>
void ForEachPart(Executor& executor, size_t size, size_t part_size,
                 const Task& task) {
  executor.ParallelFor(
      static_cast<int64_t>(PartCount(size, part_size)), [&](int64_t p) {
        const auto part = static_cast<size_t>(p);
        task(part, part * part_size, std::min(size, (part + 1) * part_size));
      });
}

/// Receives progress as counts that never decrease.
class ProgressSink {
 public:
  virtual ~ProgressSink() = default;
  /// `done` of `total` units of work are finished. One call at a time.
  virtual void Report(int64_t done, int64_t total) = 0;
};

/// What a long computation runs in.
struct ExecutionContext {
  Executor* executor = &InlineExecutor();
  std::stop_token stop;
  ProgressSink* progress = nullptr;

  /// kCancelled once a stop was requested, else OK.
  absl::Status CheckStop() const;
  void ReportProgress(int64_t done, int64_t total) const {
    if (progress != nullptr) progress->Report(done, total);
  }
};

}  // namespace mapsieve

#endif  // MAPSIEVE_CORE_BASE_EXECUTOR_H_
