#include "server/rpc/worker_pool.h"

#include <utility>

namespace mapsieve::rpc {

WorkerPool::WorkerPool(int thread_count)
    : workers_(static_cast<size_t>(thread_count)) {
  for (Worker& worker : workers_) {
    worker.thread = std::thread([this, &worker] { Work(worker); });
  }
}

WorkerPool::~WorkerPool() {
  {
    MutexLock lock(mutex_);
    closed_ = true;
  }
  for (Worker& worker : workers_) {
    worker.changed.notify_one();
    worker.thread.join();
  }
}

void WorkerPool::Post(Task task) {
  Worker* woken = nullptr;
  {
    MutexLock lock(mutex_);
    tasks_.push_back(std::move(task));
    if (idle_.empty()) return;
    woken = idle_.back();
    idle_.pop_back();
    woken->is_idle = false;
  }
  woken->changed.notify_one();
}

void WorkerPool::Work(Worker& worker) {
  for (;;) {
    Task task;
    {
      MutexLock lock(mutex_);
      while (tasks_.empty() && !closed_) {
        worker.is_idle = true;
        idle_.push_back(&worker);
        while (worker.is_idle && !closed_) worker.changed.wait(mutex_);
      }
      if (tasks_.empty()) return;
      task = std::move(tasks_.front());
      tasks_.pop_front();
    }
    task();
  }
}

}  // namespace mapsieve::rpc
