#ifndef MAPSIEVE_SERVER_ENGINE_GARBAGE_COLLECTOR_H_
#define MAPSIEVE_SERVER_ENGINE_GARBAGE_COLLECTOR_H_

#include <functional>
#include <stop_token>
#include <thread>

#include "absl/status/status.h"
#include "core/base/mutex.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Runs Store::CollectGarbage on a thread of its own: at once, when asked to,
/// and every hour (uploads that nobody goes on with grow old); and
/// Store::ExpireRevisions when asked to. Thread-safe.
class GarbageCollector {
 public:
  using FailureListener = std::function<void(const absl::Status& error)>;

  /// `store` outlives the collector. `on_failure` hears of each failure, on the
  /// collector's thread; null: nobody does.
  explicit GarbageCollector(storage::Store& store,
                            FailureListener on_failure = nullptr);
  ~GarbageCollector();
  GarbageCollector(const GarbageCollector&) = delete;
  GarbageCollector& operator=(const GarbageCollector&) = delete;

  /// Collects soon.
  void Request();
  /// Expires revisions soon.
  void RequestExpiry();

  /// Ends the thread, within one blob of a collection. Idempotent.
  void Stop();

 private:
  enum class Work { kNone, kExpiry, kCollection };
  void Request(Work work);
  void Run();

  storage::Store& store_;
  const FailureListener on_failure_;
  std::stop_source stop_;
  Mutex mutex_;
  ConditionVariable changed_;
  Work requested_ ABSL_GUARDED_BY(mutex_) = Work::kCollection;
  std::thread thread_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_GARBAGE_COLLECTOR_H_
