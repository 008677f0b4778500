#include "server/engine/garbage_collector.h"

#include <chrono>

namespace mapsieve::engine {
namespace {

constexpr std::chrono::hours kInterval(1);

}  // namespace

GarbageCollector::GarbageCollector(storage::Store& store)
    : store_(store), thread_([this] { Run(); }) {}

GarbageCollector::~GarbageCollector() { Stop(); }

void GarbageCollector::Request() {
  {
    MutexLock lock(mutex_);
    is_requested_ = true;
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
  while (true) {
    {
      MutexLock lock(mutex_);
      const auto wake = std::chrono::steady_clock::now() + kInterval;
      while (!is_requested_ && !stop.stop_requested() &&
             changed_.wait_until(mutex_, wake) != std::cv_status::timeout) {
      }
      if (stop.stop_requested()) return;
      is_requested_ = false;
    }
    // What could not be removed now is tried again at the next collection.
    store_.CollectGarbage(stop).status().IgnoreError();
  }
}

}  // namespace mapsieve::engine
