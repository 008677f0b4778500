#include "server/engine/job_manager.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <exception>
#include <new>
#include <random>
#include <stop_token>
#include <string_view>
#include <utility>
#include <variant>

#include "core/base/status.h"
#include "storage/names.h"

namespace mapsieve::engine {
namespace {

/// Catalogue rows read at a time.
constexpr int64_t kPageSize = 1000;
constexpr std::string_view kTargetPrefix = "maps/";

std::string_view VerbName(OperationVerb verb) {
  switch (verb) {
    case OperationVerb::kFinalizeUpload:
      return "FinalizeUpload";
    case OperationVerb::kProcessMap:
      return "ProcessMap";
    case OperationVerb::kDeleteRegion:
      return "DeleteRegion";
    case OperationVerb::kRepairMap:
      return "RepairMap";
  }
  return "";
}

/// Whether an operation runs the filter.
bool Filters(OperationVerb verb) {
  return verb == OperationVerb::kProcessMap ||
         verb == OperationVerb::kRepairMap;
}

/// Work done so far, written by the job's thread and read by others.
class Progress final : public ProgressSink {
 public:
  void Report(int64_t done, int64_t total) override {
    total_ = total;
    done_ = std::max(done_.load(), std::min(done, total));
  }
  void CopyTo(Operation& operation) const {
    operation.done_work = done_;
    operation.total_work = total_;
  }

 private:
  std::atomic<int64_t> total_ = 0;
  std::atomic<int64_t> done_ = 0;
};

void SetResult(const JobResult& result, Operation& operation) {
  if (const auto* upload = std::get_if<UploadReport>(&result)) {
    operation.upload_report = *upload;
  } else if (const auto* process = std::get_if<ProcessReport>(&result)) {
    operation.process_report = *process;
  } else if (const auto* deletion = std::get_if<DeleteReport>(&result)) {
    operation.delete_report = *deletion;
  } else if (const auto* repair = std::get_if<RepairReport>(&result)) {
    operation.repair_report = *repair;
  }
}

JobResult ResultOf(const Operation& operation) {
  if (operation.upload_report.has_value()) return *operation.upload_report;
  if (operation.process_report.has_value()) return *operation.process_report;
  if (operation.delete_report.has_value()) return *operation.delete_report;
  if (operation.repair_report.has_value()) return *operation.repair_report;
  return std::monostate();
}

}  // namespace

std::string NewRandomId() {
  std::random_device random;
  std::string id;
  for (int i = 0; i < 4; ++i) {
    std::array<char, 9> digits{};
    std::snprintf(digits.data(), digits.size(), "%08x", random());
    id.append(digits.data());
  }
  return id;
}

struct JobManager::Job {
  int64_t number = 0;
  JobSpec spec;
  /// Without the progress while it runs.
  Operation operation;
  Progress progress;
  std::stop_source stop;
  /// Not to be started although it is queued: it is being cancelled.
  bool is_held = false;
  std::map<int64_t, std::function<void()>> watchers;

  static std::shared_ptr<Job> FromRecord(
      const storage::OperationRecord& record) {
    auto job = std::make_shared<Job>();
    job->number = record.number;
    Operation& operation = job->operation;
    operation.operation_id = record.id;
    operation.map_id = record.target.starts_with(kTargetPrefix)
                           ? record.target.substr(kTargetPrefix.size())
                           : record.target;
    operation.create_time = record.create_time;
    operation.done_work = record.done_count;
    operation.total_work = record.total_count;
    operation.cancel_requested = record.cancel_requested;
    absl::Status damage;
    if (auto spec = ParseJobSpec(record.request); spec.ok()) {
      job->spec = *std::move(spec);
      operation.verb = job->spec.verb;
      operation.upload_id = job->spec.upload_id;
    } else {
      damage = spec.status();
    }
    if (storage::IsDone(record.state)) {
      operation.end_time = record.update_time;
      if (auto outcome = ParseJobOutcome(record.response); outcome.ok()) {
        operation.start_time = outcome->start_time;
        SetResult(outcome->result, operation);
      } else {
        damage = outcome.status();
      }
    }
    switch (record.state) {
      case storage::OperationState::kQueued:
      case storage::OperationState::kRunning:
        operation.state = OperationState::kQueued;
        break;
      case storage::OperationState::kSucceeded:
        operation.state = OperationState::kSucceeded;
        break;
      case storage::OperationState::kFailed:
        operation.state = OperationState::kFailed;
        break;
      case storage::OperationState::kCancelled:
        operation.state = OperationState::kCancelled;
        break;
    }
    if (record.error_code != 0) {
      operation.error =
          absl::Status(static_cast<absl::StatusCode>(record.error_code),
                       record.error_message);
    }
    if (!damage.ok()) {
      operation.state = OperationState::kFailed;
      operation.error = damage;
    }
    return job;
  }

  storage::OperationRecord ToRecord(const Operation& op) const {
    storage::OperationRecord record = {
        .id = op.operation_id,
        .number = number,
        .target = std::string(kTargetPrefix) + op.map_id,
        .verb = std::string(VerbName(op.verb)),
        .request = FormatJobSpec(spec),
        .cancel_requested = op.cancel_requested,
        .done_count = op.done_work,
        .total_count = op.total_work,
        .error_code = static_cast<int>(op.error.code()),
        .error_message = std::string(ToStd(op.error.message())),
        .response = FormatJobOutcome(
            {op.start_time.value_or(op.create_time), ResultOf(op)})};
    switch (op.state) {
      case OperationState::kQueued:
        record.state = storage::OperationState::kQueued;
        break;
      case OperationState::kRunning:
        record.state = storage::OperationState::kRunning;
        break;
      case OperationState::kSucceeded:
        record.state = storage::OperationState::kSucceeded;
        break;
      case OperationState::kFailed:
        record.state = storage::OperationState::kFailed;
        break;
      case OperationState::kCancelled:
        record.state = storage::OperationState::kCancelled;
        break;
    }
    return record;
  }

  Operation View() const {
    Operation view = operation;
    if (view.state == OperationState::kRunning) progress.CopyTo(view);
    return view;
  }

  void MarkCancelled(Operation& op) const {
    op.cancel_requested = true;
    op.state = OperationState::kCancelled;
    op.error = absl::CancelledError("cancelled by request");
    op.end_time = absl::Now();
  }
};

JobManager::JobManager(storage::Catalogue& catalogue, const JobLimits& limits,
                       Runner runner, EndListener on_end)
    : catalogue_(catalogue),
      limits_(limits),
      runner_(std::move(runner)),
      on_end_(std::move(on_end)) {}

absl::StatusOr<std::unique_ptr<JobManager>> JobManager::Open(
    storage::Catalogue& catalogue, const JobLimits& limits, Runner runner,
    EndListener on_end) {
  std::unique_ptr<JobManager> manager(
      new JobManager(catalogue, limits, std::move(runner), std::move(on_end)));
  MAPSIEVE_RETURN_IF_ERROR(manager->Load());
  for (const bool filters : {false, true}) {
    manager->lanes_.emplace_back(
        [&m = *manager, filters] { m.RunLane(filters); });
  }
  return manager;
}

JobManager::~JobManager() { Shutdown(); }

absl::Status JobManager::Load() {
  MutexLock record_lock(record_mutex_);
  MutexLock lock(mutex_);
  int64_t after = 0;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<storage::OperationRecord> page,
        catalogue_.ListOperations("", /*unfinished_only=*/false, after,
                                  kPageSize));
    if (page.empty()) return absl::OkStatus();
    for (const storage::OperationRecord& record : page) {
      std::shared_ptr<Job> job = Job::FromRecord(record);
      Operation& operation = job->operation;
      // It may have done its work before the process ended: its runner tells.
      if (!operation.done() && operation.cancel_requested) {
        job->stop.request_stop();
      }
      if (operation.done() && !storage::IsDone(record.state)) {
        MAPSIEVE_RETURN_IF_ERROR(
            catalogue_.UpdateOperation(job->ToRecord(operation)));
      }
      numbers_[record.id] = record.number;
      jobs_[record.number] = std::move(job);
    }
    after = page.back().number;
  }
}

void JobManager::Shutdown() {
  std::vector<std::thread> lanes;
  std::map<int64_t, std::function<void()>> watchers;
  {
    MutexLock lock(mutex_);
    is_shut_down_ = true;
    lanes = std::exchange(lanes_, {});
    for (const auto& [number, job] : jobs_) {
      if (!job->operation.done()) job->stop.request_stop();
      watchers.merge(job->watchers);
    }
  }
  changed_.notify_all();
  for (std::thread& lane : lanes) lane.join();
  Call(std::move(watchers));
}

void JobManager::Call(std::map<int64_t, std::function<void()>> watchers) {
  for (const auto& [watch, callback] : watchers) callback();
}

// Running.

std::shared_ptr<JobManager::Job> JobManager::NextJob(bool filters) {
  for (const auto& [number, job] : jobs_) {
    if (job->operation.state == OperationState::kQueued &&
        Filters(job->operation.verb) == filters && !job->is_held &&
        !busy_maps_.contains(job->spec.map_uid)) {
      return job;
    }
  }
  return nullptr;
}

void JobManager::RunLane(bool filters) {
  while (true) {
    std::shared_ptr<Job> job;
    {
      MutexLock lock(mutex_);
      while (!is_shut_down_ && (job = NextJob(filters)) == nullptr) {
        changed_.wait(mutex_);
      }
      if (is_shut_down_) return;
      busy_maps_.insert(job->spec.map_uid);
      job->operation.state = OperationState::kRunning;
      job->operation.start_time = absl::Now();
    }
    RunJob(job);
  }
}

void JobManager::RunJob(const std::shared_ptr<Job>& job) {
  {
    MutexLock record_lock(record_mutex_);
    storage::OperationRecord record;
    {
      MutexLock lock(mutex_);
      record = job->ToRecord(job->operation);
    }
    // An operation recorded as queued is run again after a crash just the same.
    catalogue_.UpdateOperation(record).IgnoreError();
  }
  Finish(job, CallRunner(*job));
}

absl::StatusOr<JobResult> JobManager::CallRunner(Job& job) {
  const ExecutionContext context = {.stop = job.stop.get_token(),
                                    .progress = &job.progress};
  try {
    return runner_(job.operation.map_id, job.spec, context);
  } catch (const std::bad_alloc&) {
    return absl::ResourceExhaustedError(
        "the server ran out of memory; give it more or less to do at a time");
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("exception: ", error.what()));
  }
}

void JobManager::Finish(const std::shared_ptr<Job>& job,
                        absl::StatusOr<JobResult> result) {
  std::map<int64_t, std::function<void()>> watchers;
  {
    MutexLock record_lock(record_mutex_);
    Operation operation;
    {
      MutexLock lock(mutex_);
      job->progress.CopyTo(job->operation);
      operation = job->operation;
      if (absl::IsCancelled(result.status()) && !operation.cancel_requested &&
          is_shut_down_) {
        job->operation.state = OperationState::kQueued;
        busy_maps_.erase(job->spec.map_uid);
        return;
      }
    }
    operation.end_time = absl::Now();
    if (result.ok()) {
      operation.state = OperationState::kSucceeded;
      operation.done_work = operation.total_work;
      SetResult(*result, operation);
    } else if (absl::IsCancelled(result.status()) &&
               operation.cancel_requested) {
      job->MarkCancelled(operation);
    } else {
      operation.state = OperationState::kFailed;
      operation.error = result.status();
    }
    // What the operation did is recorded with the map; without this record it
    // is run again after a restart and finds that.
    catalogue_.UpdateOperation(job->ToRecord(operation)).IgnoreError();
    if (on_end_) on_end_(operation);
    {
      MutexLock lock(mutex_);
      job->operation = std::move(operation);
      busy_maps_.erase(job->spec.map_uid);
      watchers = std::exchange(job->watchers, {});
    }
    ForgetOldest();
  }
  changed_.notify_all();
  Call(std::move(watchers));
}

void JobManager::ForgetOldest() {
  std::vector<std::string> forgotten;
  {
    MutexLock lock(mutex_);
    auto excess = std::count_if(jobs_.begin(), jobs_.end(),
                                [](const auto& j) {
                                  return j.second->operation.done();
                                }) -
                  limits_.max_finished;
    for (auto it = jobs_.begin(); it != jobs_.end() && excess > 0;) {
      if (!it->second->operation.done()) {
        ++it;
        continue;
      }
      forgotten.push_back(it->second->operation.operation_id);
      numbers_.erase(forgotten.back());
      it = jobs_.erase(it);
      --excess;
    }
  }
  // One that stays in the catalogue is forgotten after the next restart.
  for (const std::string& id : forgotten) {
    catalogue_.DeleteOperation(id).IgnoreError();
  }
}

// Starting.

absl::Status JobManager::CheckRoom(const JobSpec& spec, bool is_unique) const {
  if (is_shut_down_) {
    return absl::UnavailableError("the server is shutting down; try again");
  }
  int waiting = 0;
  for (const auto& [number, job] : jobs_) {
    if (job->operation.done()) continue;
    ++waiting;
    if (is_unique && job->spec.verb == spec.verb &&
        job->spec.map_uid == spec.map_uid) {
      return absl::AbortedError(absl::StrCat(
          ToAbsl(VerbName(spec.verb)), " of map ", job->operation.map_id,
          " is going on already as operation ", job->operation.operation_id,
          "; wait for it or cancel it"));
    }
  }
  if (waiting >= limits_.max_queued) {
    return absl::ResourceExhaustedError(
        absl::StrCat(waiting,
                     " operations wait, which is the limit; try again "
                     "later"));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<JobManager::Job>> JobManager::Record(
    const std::string& map_id, const JobSpec& spec) {
  Job draft;
  draft.spec = spec;
  draft.operation = {.operation_id = NewRandomId(),
                     .verb = spec.verb,
                     .map_id = map_id,
                     .create_time = absl::Now()};
  MAPSIEVE_ASSIGN_OR_RETURN(
      const storage::OperationRecord record,
      catalogue_.CreateOperation(draft.ToRecord(draft.operation)));
  return Job::FromRecord(record);
}

absl::StatusOr<Operation> JobManager::Start(const std::string& map_id,
                                            const JobSpec& spec,
                                            bool is_unique) {
  Operation operation;
  {
    MutexLock record_lock(record_mutex_);
    {
      MutexLock lock(mutex_);
      MAPSIEVE_RETURN_IF_ERROR(CheckRoom(spec, is_unique));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(std::shared_ptr<Job> job, Record(map_id, spec));
    MutexLock lock(mutex_);
    operation = job->View();
    numbers_[operation.operation_id] = job->number;
    jobs_[job->number] = std::move(job);
  }
  changed_.notify_all();
  return operation;
}

absl::StatusOr<Operation> JobManager::RecordSuccess(const std::string& map_id,
                                                    const JobSpec& spec,
                                                    const JobResult& result) {
  MutexLock record_lock(record_mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(std::shared_ptr<Job> job, Record(map_id, spec));
  Operation operation = job->operation;
  operation.state = OperationState::kSucceeded;
  operation.start_time = operation.create_time;
  operation.end_time = absl::Now();
  SetResult(result, operation);
  MAPSIEVE_RETURN_IF_ERROR(
      catalogue_.UpdateOperation(job->ToRecord(operation)));
  {
    MutexLock lock(mutex_);
    job->operation = operation;
    numbers_[operation.operation_id] = job->number;
    jobs_[job->number] = std::move(job);
  }
  ForgetOldest();
  return operation;
}

// Looking.

std::shared_ptr<JobManager::Job> JobManager::Find(
    const std::string& operation_id) const {
  const auto number = numbers_.find(operation_id);
  return number == numbers_.end() ? nullptr : jobs_.at(number->second);
}

namespace {

absl::Status NoOperation(const std::string& operation_id) {
  return absl::NotFoundError(
      absl::StrCat("there is no operation ", storage::Quoted(operation_id),
                   "; finished ones are forgotten in time"));
}

}  // namespace

absl::StatusOr<Operation> JobManager::Get(
    const std::string& operation_id) const {
  MutexLock lock(mutex_);
  const std::shared_ptr<Job> job = Find(operation_id);
  if (job == nullptr) return NoOperation(operation_id);
  return job->View();
}

absl::StatusOr<std::vector<Operation>> JobManager::List(
    const std::string& map_id, const std::string& before,
    int64_t max_count) const {
  MutexLock lock(mutex_);
  auto end = jobs_.end();
  if (!before.empty()) {
    const auto number = numbers_.find(before);
    if (number == numbers_.end()) {
      return absl::InvalidArgumentError(
          "the page token names no operation; list from the first page");
    }
    end = jobs_.find(number->second);
  }
  std::vector<Operation> operations;
  while (end != jobs_.begin() &&
         static_cast<int64_t>(operations.size()) < max_count) {
    --end;
    if (map_id.empty() || end->second->operation.map_id == map_id) {
      operations.push_back(end->second->View());
    }
  }
  return operations;
}

std::optional<Operation> JobManager::FindFinalize(
    const std::string& upload_uid) const {
  MutexLock lock(mutex_);
  for (auto it = jobs_.rbegin(); it != jobs_.rend(); ++it) {
    if (it->second->spec.verb == OperationVerb::kFinalizeUpload &&
        it->second->spec.upload_uid == upload_uid) {
      return it->second->View();
    }
  }
  return std::nullopt;
}

bool JobManager::IsBusy(const std::string& map_uid) const {
  MutexLock lock(mutex_);
  return std::any_of(jobs_.begin(), jobs_.end(), [&](const auto& entry) {
    return !entry.second->operation.done() &&
           entry.second->spec.map_uid == map_uid;
  });
}

// Cancelling.

absl::Status JobManager::Cancel(const std::string& operation_id) {
  std::map<int64_t, std::function<void()>> watchers;
  {
    MutexLock record_lock(record_mutex_);
    std::shared_ptr<Job> job;
    Operation operation;
    {
      MutexLock lock(mutex_);
      job = Find(operation_id);
      if (job == nullptr) return NoOperation(operation_id);
      if (job->operation.done()) return absl::OkStatus();
      operation = job->View();
      if (operation.state == OperationState::kQueued) {
        job->is_held = true;
        job->MarkCancelled(operation);
      } else {
        operation.cancel_requested = true;
        job->operation.cancel_requested = true;
        job->stop.request_stop();
      }
    }
    const absl::Status recorded =
        catalogue_.UpdateOperation(job->ToRecord(operation));
    MutexLock lock(mutex_);
    if (!operation.done()) return recorded;
    job->is_held = false;
    if (!recorded.ok()) return recorded;
    job->operation = std::move(operation);
    watchers = std::exchange(job->watchers, {});
  }
  changed_.notify_all();
  Call(std::move(watchers));
  return absl::OkStatus();
}

void JobManager::CancelAndForget(const std::string& map_uid) {
  std::vector<std::string> ids;
  {
    MutexLock lock(mutex_);
    for (const auto& [number, job] : jobs_) {
      if (job->spec.map_uid == map_uid) {
        ids.push_back(job->operation.operation_id);
      }
    }
  }
  // One whose cancellation cannot be recorded ends by itself: its map is gone.
  for (const std::string& id : ids) Cancel(id).IgnoreError();
  for (const std::string& id : ids)
    Wait(id, absl::InfiniteDuration()).status().IgnoreError();
  MutexLock record_lock(record_mutex_);
  {
    MutexLock lock(mutex_);
    for (const std::string& id : ids) {
      const std::shared_ptr<Job> job = Find(id);
      if (job == nullptr || !job->operation.done()) continue;
      jobs_.erase(job->number);
      numbers_.erase(id);
    }
  }
  for (const std::string& id : ids) {
    catalogue_.DeleteOperation(id).IgnoreError();
  }
}

// Waiting.

absl::StatusOr<Operation> JobManager::Wait(const std::string& operation_id,
                                           absl::Duration timeout) const {
  const auto deadline =
      std::chrono::steady_clock::now() +
      absl::ToChronoMicroseconds(
          std::clamp(timeout, absl::ZeroDuration(), absl::Hours(24 * 365)));
  MutexLock lock(mutex_);
  const std::shared_ptr<Job> job = Find(operation_id);
  if (job == nullptr) return NoOperation(operation_id);
  while (!job->operation.done() && !is_shut_down_ &&
         changed_.wait_until(mutex_, deadline) != std::cv_status::timeout) {
  }
  return job->View();
}

absl::StatusOr<int64_t> JobManager::Watch(const std::string& operation_id,
                                          std::function<void()> callback) {
  int64_t watch = 0;
  {
    MutexLock lock(mutex_);
    const std::shared_ptr<Job> job = Find(operation_id);
    if (job == nullptr) return NoOperation(operation_id);
    watch = next_watch_++;
    if (!job->operation.done() && !is_shut_down_) {
      job->watchers[watch] = std::move(callback);
      return watch;
    }
  }
  callback();
  return watch;
}

void JobManager::StopWatching(int64_t watch) {
  MutexLock lock(mutex_);
  for (const auto& [number, job] : jobs_) job->watchers.erase(watch);
}

}  // namespace mapsieve::engine
