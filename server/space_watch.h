#ifndef MAPSIEVE_SERVER_SPACE_WATCH_H_
#define MAPSIEVE_SERVER_SPACE_WATCH_H_

#include <functional>
#include <thread>

#include "absl/status/status.h"
#include "core/base/mutex.h"

namespace mapsieve::rpc {

/// Looks every second whether the disk has space for uploads, on a thread of
/// its own. Thread-safe.
class SpaceWatch {
 public:
  /// `check`: Engine::CheckSpace. `report` gets its answer where that becomes
  /// an error, or OK again; the first one before the constructor returns,
  /// unless it is OK.
  SpaceWatch(std::function<absl::Status()> check,
             std::function<void(const absl::Status&)> report);
  /// Returns when `report` will not be called any more.
  ~SpaceWatch();
  SpaceWatch(const SpaceWatch&) = delete;
  SpaceWatch& operator=(const SpaceWatch&) = delete;

 private:
  void Look();
  void Run();

  const std::function<absl::Status()> check_;
  const std::function<void(const absl::Status&)> report_;
  // Of the constructor, then of the thread.
  bool has_space_ = true;
  Mutex mutex_;
  ConditionVariable stopped_;
  bool is_stopped_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_SPACE_WATCH_H_
