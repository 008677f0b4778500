#ifndef MAPSIEVE_SERVER_ENGINE_GARBAGE_COLLECTOR_H_
#define MAPSIEVE_SERVER_ENGINE_GARBAGE_COLLECTOR_H_

#include <stop_token>
#include <thread>

#include "core/base/mutex.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Runs Store::CollectGarbage on a thread of its own: at once, when asked to,
/// and every hour (uploads that nobody goes on with grow old). Thread-safe.
class GarbageCollector {
 public:
  /// `store` outlives the collector.
  explicit GarbageCollector(storage::Store& store);
  ~GarbageCollector();
  GarbageCollector(const GarbageCollector&) = delete;
  GarbageCollector& operator=(const GarbageCollector&) = delete;

  /// Collects soon.
  void Request();

  /// Ends the thread, within one blob of a collection. Idempotent.
  void Stop();

 private:
  void Run();

  storage::Store& store_;
  std::stop_source stop_;
  Mutex mutex_;
  ConditionVariable changed_;
  bool is_requested_ ABSL_GUARDED_BY(mutex_) = true;
  std::thread thread_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_GARBAGE_COLLECTOR_H_
