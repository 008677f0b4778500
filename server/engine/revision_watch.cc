#include "server/engine/revision_watch.h"

#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "server/engine/revision_report.h"

namespace mapsieve::engine {
namespace {

class CatalogueCursor final : public RevisionCursor {
 public:
  CatalogueCursor(const storage::Catalogue& catalogue,
                  RevisionWatchers& watchers, const storage::MapRecord& map,
                  std::function<void()> wake)
      : catalogue_(catalogue),
        map_id_(map.spec.id),
        map_uid_(map.uid),
        watcher_(watchers, map.uid, std::move(wake)) {}

  void Begin(int64_t revision) { next_ = revision; }

  absl::StatusOr<std::optional<RevisionInfo>> Next() override {
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              catalogue_.GetMap(map_id_));
    if (map.uid != map_uid_) {
      return absl::NotFoundError(
          absl::StrCat("map ", map_id_, " was deleted meanwhile"));
    }
    if (next_ > map.newest_revision) return std::nullopt;
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::RevisionRecord record,
                              catalogue_.GetRevision(map_uid_, next_));
    MAPSIEVE_ASSIGN_OR_RETURN(RevisionInfo info,
                              DescribeRevision(catalogue_, map_uid_, record));
    ++next_;
    return info;
  }

 private:
  const storage::Catalogue& catalogue_;
  const std::string map_id_;
  const std::string map_uid_;
  int64_t next_ = 0;
  RevisionWatchers::Watcher watcher_;
};

}  // namespace

RevisionWatchers::Watcher::Watcher(RevisionWatchers& watchers,
                                   std::string map_uid,
                                   std::function<void()> wake)
    : watchers_(watchers),
      map_uid_(std::move(map_uid)),
      wake_(std::move(wake)) {
  MutexLock lock(watchers_.mutex_);
  watchers_.watchers_.insert(this);
}

RevisionWatchers::Watcher::~Watcher() {
  MutexLock lock(watchers_.mutex_);
  watchers_.watchers_.erase(this);
  while (call_count_ > 0) watchers_.returned_.wait(watchers_.mutex_);
}

void RevisionWatchers::Notify(const std::string& map_uid) {
  std::vector<Watcher*> called;
  {
    MutexLock lock(mutex_);
    for (Watcher* watcher : watchers_) {
      if (watcher->map_uid_ != map_uid) continue;
      ++watcher->call_count_;
      called.push_back(watcher);
    }
  }
  for (Watcher* watcher : called) watcher->wake_();
  MutexLock lock(mutex_);
  for (Watcher* watcher : called) --watcher->call_count_;
  returned_.notify_all();
}

absl::StatusOr<std::unique_ptr<RevisionCursor>> WatchRevisions(
    const storage::Catalogue& catalogue, RevisionWatchers& watchers,
    const std::string& map_id, int64_t from_revision,
    std::function<void()> wake) {
  if (from_revision < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("from_revision is ", from_revision,
                     "; it must be 0 (the newest) or above"));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                            catalogue.GetMap(map_id));
  if (from_revision > map.newest_revision + 1) {
    return absl::OutOfRangeError(absl::StrCat(
        "from_revision is ", from_revision, "; the newest revision of map ",
        map_id, " is ", map.newest_revision));
  }
  auto cursor = std::make_unique<CatalogueCursor>(catalogue, watchers, map,
                                                  std::move(wake));
  cursor->Begin(from_revision == 0 ? map.newest_revision : from_revision);
  return cursor;
}

}  // namespace mapsieve::engine
