#include "server/engine/garbage_collector.h"

#include <algorithm>
#include <chrono>
#include <utility>

namespace mapsieve::engine {
namespace {

constexpr std::chrono::hours kInterval(1);

}  // namespace

GarbageCollector::GarbageCollector(storage::Store& store,
                                   FailureListener on_failure)
    : store_(store),
      on_failure_(std::move(on_failure)),
      thread_([this] { Run(); }) {}

GarbageCollector::~GarbageCollector() { Stop(); }

void GarbageCollector::Request() { Request(Work::kCollection); }

void GarbageCollector::RequestExpiry() { Request(Work::kExpiry); }

void GarbageCollector::Request(Work work) {
  {
    MutexLock lock(mutex_);
    requested_ = std::max(requested_, work);
  }
  changed_.notify_all();
}

void GarbageCollector::Stop() {
  std::thread thread;
  {
    MutexLock lock(mutex_);
    stop_.request_stop();
    thread.swap(thread_);
  }
  changed_.notify_all();
  if (thread.joinable()) thread.join();
}

void GarbageCollector::Run() {
  const std::stop_token stop = stop_.get_token();
  auto wake = std::chrono::steady_clock::now();
  while (true) {
    Work work = Work::kNone;
    {
      MutexLock lock(mutex_);
      while (requested_ == Work::kNone && !stop.stop_requested() &&
             changed_.wait_until(mutex_, wake) != std::cv_status::timeout) {
      }
      if (stop.stop_requested()) return;
      work = std::exchange(requested_, Work::kNone);
    }
    // What could not be removed now is tried again at the next collection.
    absl::Status done;
    if (work == Work::kExpiry) {
      done = store_.ExpireRevisions(stop).status();
    } else {
      done = store_.CollectGarbage(stop).status();
      wake = std::chrono::steady_clock::now() + kInterval;
    }
    if (!done.ok() && !absl::IsCancelled(done) && on_failure_) {
      on_failure_(done);
    }
  }
}

}  // namespace mapsieve::engine
