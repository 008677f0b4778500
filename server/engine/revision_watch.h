#ifndef MAPSIEVE_SERVER_ENGINE_REVISION_WATCH_H_
#define MAPSIEVE_SERVER_ENGINE_REVISION_WATCH_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>

#include "absl/status/statusor.h"
#include "core/base/mutex.h"
#include "server/engine/engine.h"
#include "storage/catalogue.h"

namespace mapsieve::engine {

/// Those who want to know of new revisions. Thread-safe.
class RevisionWatchers {
 public:
  /// Calls of `wake` from its construction on until its destruction, which
  /// waits for a call under way.
  class Watcher {
   public:
    Watcher(RevisionWatchers& watchers, std::string map_uid,
            std::function<void()> wake);
    ~Watcher();
    Watcher(const Watcher&) = delete;
    Watcher& operator=(const Watcher&) = delete;

   private:
    friend class RevisionWatchers;

    RevisionWatchers& watchers_;
    const std::string map_uid_;
    const std::function<void()> wake_;
    // Calls of wake_ under way; guarded by the mutex of watchers_.
    int call_count_ = 0;
  };

  /// Wakes all watchers of a map; called after a commit and after its deletion.
  void Notify(const std::string& map_uid);

 private:
  Mutex mutex_;
  ConditionVariable returned_;
  std::set<Watcher*> watchers_ ABSL_GUARDED_BY(mutex_);
};

/// Engine::WatchRevisions. The catalogue and the watchers outlive the cursor.
absl::StatusOr<std::unique_ptr<RevisionCursor>> WatchRevisions(
    const storage::Catalogue& catalogue, RevisionWatchers& watchers,
    const std::string& map_id, int64_t from_revision,
    std::function<void()> wake);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_REVISION_WATCH_H_
