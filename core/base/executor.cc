#include "core/base/executor.h"

#include <algorithm>
#include <atomic>
#include <exception>
#include <thread>
#include <vector>

#include "core/base/mutex.h"

namespace mapsieve {
namespace {

class Inline final : public Executor {
 public:
  int worker_count() const override { return 1; }
  void ParallelFor(int64_t count,
                   const std::function<void(int64_t)>& task) override {
    for (int64_t i = 0; i < count; ++i) task(i);
  }
};

class WorkerPool final : public Executor {
 public:
  explicit WorkerPool(int worker_count) {
    threads_.reserve(static_cast<size_t>(worker_count) - 1);
    for (int i = 1; i < worker_count; ++i) {
      threads_.emplace_back([this] { Work(); });
    }
  }

  ~WorkerPool() override {
    {
      MutexLock lock(mutex_);
      stopping_ = true;
    }
    work_available_.notify_all();
    for (std::thread& thread : threads_) thread.join();
  }

  int worker_count() const override {
    return static_cast<int>(threads_.size()) + 1;
  }

  void ParallelFor(int64_t count,
                   const std::function<void(int64_t)>& task) override {
    if (count <= 0) return;
    if (count == 1) return task(0);
    MutexLock one_at_a_time(run_mutex_);
    {
      MutexLock lock(mutex_);
      task_ = &task;
      count_ = count;
      next_.store(0, std::memory_order_relaxed);
      error_ = nullptr;
      ++generation_;
    }
    work_available_.notify_all();
    RunTasks(task, count);
    std::exception_ptr error;
    {
      MutexLock lock(mutex_);
      // A worker that has not woken up by now finds nothing to do; only those
      // inside a task are waited for.
      task_ = nullptr;
      while (busy_ > 0) work_done_.wait(mutex_);
      error = error_;
    }
    if (error) std::rethrow_exception(error);
  }

 private:
  void Work() {
    uint64_t seen_generation = 0;
    while (true) {
      const std::function<void(int64_t)>* task = nullptr;
      int64_t count = 0;
      {
        MutexLock lock(mutex_);
        while (!stopping_ &&
               (task_ == nullptr || generation_ == seen_generation)) {
          work_available_.wait(mutex_);
        }
        if (stopping_) return;
        seen_generation = generation_;
        task = task_;
        count = count_;
        ++busy_;
      }
      RunTasks(*task, count);
      MutexLock lock(mutex_);
      if (--busy_ == 0) work_done_.notify_all();
    }
  }

  void RunTasks(const std::function<void(int64_t)>& task, int64_t count) {
    try {
      while (true) {
        const int64_t i = next_.fetch_add(1, std::memory_order_relaxed);
        if (i >= count) return;
        task(i);
      }
    } catch (...) {
      next_.store(count, std::memory_order_relaxed);
      MutexLock lock(mutex_);
      if (!error_) error_ = std::current_exception();
    }
  }

  Mutex run_mutex_;
  Mutex mutex_;
  ConditionVariable work_available_;
  ConditionVariable work_done_;
  const std::function<void(int64_t)>* task_ ABSL_GUARDED_BY(mutex_) = nullptr;
  int64_t count_ ABSL_GUARDED_BY(mutex_) = 0;
  std::atomic<int64_t> next_ = 0;
  int busy_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t generation_ ABSL_GUARDED_BY(mutex_) = 0;
  bool stopping_ ABSL_GUARDED_BY(mutex_) = false;
  std::exception_ptr error_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::thread> threads_;
};

}  // namespace

Executor& InlineExecutor() {
  static Inline executor;
  return executor;
}

std::unique_ptr<Executor> MakeWorkerPool(int worker_count) {
  return std::make_unique<WorkerPool>(std::max(worker_count, 1));
}

absl::Status TryParallelFor(Executor& executor, int64_t count,
                            const std::function<absl::Status(int64_t)>& task) {
  std::vector<absl::Status> statuses(static_cast<size_t>(count));
  std::atomic<bool> failed = false;
  executor.ParallelFor(count, [&](int64_t i) {
    if (failed.load(std::memory_order_relaxed)) return;
    absl::Status& status = statuses[static_cast<size_t>(i)];
    status = task(i);
    if (!status.ok()) failed.store(true, std::memory_order_relaxed);
  });
  const auto error =
      std::find_if(statuses.begin(), statuses.end(),
                   [](const absl::Status& status) { return !status.ok(); });
  return error == statuses.end() ? absl::OkStatus() : *error;
}

absl::Status ExecutionContext::CheckStop() const {
  if (stop.stop_requested()) return absl::CancelledError("cancelled");
  return absl::OkStatus();
}

}  // namespace mapsieve
