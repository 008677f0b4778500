#ifndef MAPSIEVE_SERVER_ENGINE_JOB_MANAGER_H_
#define MAPSIEVE_SERVER_ENGINE_JOB_MANAGER_H_

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "core/base/executor.h"
#include "core/base/mutex.h"
#include "server/engine/opaque_records.h"
#include "server/engine/types.h"
#include "storage/catalogue.h"

namespace mapsieve::engine {

/// 32 hexadecimal digits that were never used before.
std::string NewRandomId();

struct JobLimits {
  int max_queued = 1000;
  int max_finished = 1000;
};

/// Runs operations: one that filters and one that changes points at a time,
/// each kind in the order of creation, but never two on one map. They are
/// recorded in the catalogue, so that those that are not done when the process
/// ends are run again by the next manager, with a stop request if they were to
/// be cancelled: what runs them must be idempotent, and find what it did before
/// it looks for a stop. Thread-safe.
class JobManager {
 public:
  /// Does the work of an operation on the map `map_id`: gets the executor and
  /// whatever else it needs by itself, stop token and progress from `context`.
  /// kCancelled after a stop request. Called from the manager's threads.
  using Runner = std::function<absl::StatusOr<JobResult>(
      const std::string& map_id, const JobSpec& spec,
      const ExecutionContext& context)>;

  /// Hears of an operation that ran and ended. Called from the manager's
  /// threads; quick, and calls no method of the manager.
  using EndListener = std::function<void(const Operation& operation)>;

  /// Loads the operations of the catalogue, which outlives the manager, and
  /// begins to run those that are not done.
  static absl::StatusOr<std::unique_ptr<JobManager>> Open(
      storage::Catalogue& catalogue, const JobLimits& limits, Runner runner,
      EndListener on_end = nullptr);
  ~JobManager();
  JobManager(const JobManager&) = delete;
  JobManager& operator=(const JobManager&) = delete;

  /// Stops the running operations and returns when none runs; they stay
  /// recorded as not done. Calls all watchers. Idempotent.
  void Shutdown();

  /// Records and queues an operation. kResourceExhausted: too many wait;
  /// kUnavailable: after Shutdown. With `is_unique`: kAborted, naming it, if
  /// an operation of this verb on this map is not done.
  absl::StatusOr<Operation> Start(const std::string& map_id,
                                  const JobSpec& spec, bool is_unique);
  /// Records an operation that succeeded before it began.
  absl::StatusOr<Operation> RecordSuccess(const std::string& map_id,
                                          const JobSpec& spec,
                                          const JobResult& result);

  /// kNotFound.
  absl::StatusOr<Operation> Get(const std::string& operation_id) const;
  /// Newest first, those created before the operation `before` (empty: from
  /// the newest). `map_id`: only those of this map; empty: all.
  /// kInvalidArgument if there is no operation `before`.
  absl::StatusOr<std::vector<Operation>> List(const std::string& map_id,
                                              const std::string& before,
                                              int64_t max_count) const;
  /// The newest operation that finalizes the upload of this uid.
  std::optional<Operation> FindFinalize(const std::string& upload_uid) const;
  /// Whether an operation on the map is not done.
  bool IsBusy(const std::string& map_uid) const;

  /// kNotFound.
  absl::Status Cancel(const std::string& operation_id);
  /// Cancels the map's operations, waits until all are done and forgets them.
  void CancelAndForget(const std::string& map_uid);

  absl::StatusOr<Operation> Wait(const std::string& operation_id,
                                 absl::Duration timeout) const;
  absl::StatusOr<int64_t> Watch(const std::string& operation_id,
                                std::function<void()> callback);
  void StopWatching(int64_t watch);

 private:
  struct Job;

  JobManager(storage::Catalogue& catalogue, const JobLimits& limits,
             Runner runner, EndListener on_end);
  absl::Status Load();
  /// `filters`: the lane of verbs that run the filter; else that of all others.
  /// Those of a lane share their memory.
  void RunLane(bool filters);
  std::shared_ptr<Job> NextJob(bool filters)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void RunJob(const std::shared_ptr<Job>& job);
  absl::StatusOr<JobResult> CallRunner(Job& job);
  void Finish(const std::shared_ptr<Job>& job,
              absl::StatusOr<JobResult> result);
  absl::Status CheckRoom(const JobSpec& spec, bool is_unique) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<std::shared_ptr<Job>> Record(const std::string& map_id,
                                              const JobSpec& spec);
  void ForgetOldest();
  std::shared_ptr<Job> Find(const std::string& operation_id) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  static void Call(std::map<int64_t, std::function<void()>> watchers);

  storage::Catalogue& catalogue_;
  const JobLimits limits_;
  const Runner runner_;
  const EndListener on_end_;

  // Orders the records of the catalogue; taken before mutex_, held while the
  // disk is waited for.
  Mutex record_mutex_;
  mutable Mutex mutex_;
  // Something that a waiting thread may care for has changed.
  mutable ConditionVariable changed_;
  // By the catalogue's number, which grows.
  std::map<int64_t, std::shared_ptr<Job>> jobs_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, int64_t> numbers_ ABSL_GUARDED_BY(mutex_);
  // Uids of maps that an operation runs on.
  std::set<std::string> busy_maps_ ABSL_GUARDED_BY(mutex_);
  int64_t next_watch_ ABSL_GUARDED_BY(mutex_) = 1;
  bool is_shut_down_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<std::thread> lanes_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_JOB_MANAGER_H_
