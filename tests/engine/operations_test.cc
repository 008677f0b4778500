#include <atomic>
#include <functional>
#include <new>
#include <stdexcept>
#include <string>
#include <vector>

#include "gtest/gtest.h"
#include "server/engine/job_manager.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::LatticeCloud;
using mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

constexpr absl::Duration kLong = absl::Minutes(1);
constexpr absl::Duration kShort = absl::Milliseconds(20);
constexpr ProcessLimits kProcessLimits = {.unit_points = 2000,
                                          .tile_points = 1 << 26,
                                          .pending_bytes = 1 << 20,
                                          .chunk_bytes = 30'000};

/// A job manager over a catalogue, whose jobs do what the test says.
class JobManagerTest : public ::testing::Test {
 protected:
  JobManagerTest() { OpenStore(); }
  ~JobManagerTest() override { jobs_.reset(); }

  void OpenStore() {
    jobs_.reset();
    store_.reset();
    auto store =
        storage::Store::Open(storage::PosixFileSystem(), dir_ / "data");
    EXPECT_TRUE(store.ok()) << store.status();
    store_ = *std::move(store);
  }

  void Open(JobManager::Runner runner, const JobLimits& limits = {}) {
    jobs_.reset();
    auto jobs =
        JobManager::Open(store_->catalogue(), limits, std::move(runner));
    EXPECT_TRUE(jobs.ok()) << jobs.status();
    jobs_ = *std::move(jobs);
  }

  static JobSpec Run(const std::string& map_uid) {
    return {.verb = OperationVerb::kProcessMap, .map_uid = map_uid};
  }
  static JobSpec Finalize(const std::string& map_uid,
                          const std::string& upload) {
    return {.verb = OperationVerb::kFinalizeUpload,
            .map_uid = map_uid,
            .upload_id = upload,
            .upload_uid = upload};
  }

  /// Runs until it is stopped or released.
  absl::StatusOr<JobResult> Block(const ExecutionContext& context) {
    ++running_;
    while (!released_) {
      if (context.stop.stop_requested()) {
        --running_;
        return absl::CancelledError("stopped");
      }
      absl::SleepFor(absl::Milliseconds(1));
    }
    --running_;
    return JobResult(ProcessReport{.revision = 7});
  }
  JobManager::Runner Blocker() {
    return [this](const std::string&, const JobSpec&,
                  const ExecutionContext& context) { return Block(context); };
  }
  Operation Start(const JobSpec& spec) {
    const auto operation =
        jobs_->Start("map-" + spec.map_uid, spec, /*is_unique=*/false);
    EXPECT_TRUE(operation.ok()) << operation.status();
    return *operation;
  }
  void WaitUntilRunning(const Operation& operation) {
    while (jobs_->Get(operation.operation_id)->state !=
           OperationState::kRunning) {
      absl::SleepFor(absl::Milliseconds(1));
    }
  }

  storage::TemporaryDirectory dir_;
  std::unique_ptr<storage::Store> store_;
  std::atomic<bool> released_ = false;
  std::atomic<int> running_ = 0;
  std::unique_ptr<JobManager> jobs_;
};

TEST_F(JobManagerTest, TellsHowAJobFares) {
  std::atomic<int> step = 0;
  Open([&](const std::string& map_id, const JobSpec& spec,
           const ExecutionContext& context) -> absl::StatusOr<JobResult> {
    EXPECT_EQ(map_id, "map-a");
    EXPECT_EQ(spec.options.seed, 5);
    context.ReportProgress(3, 10);
    context.ReportProgress(2, 10);
    step = 1;
    while (step == 1) absl::SleepFor(absl::Milliseconds(1));
    return JobResult(ProcessReport{.revision = 4, .point_count = 9});
  });
  JobSpec spec = Run("a");
  spec.options.seed = 5;
  const Operation started = Start(spec);
  EXPECT_EQ(started.state, OperationState::kQueued);
  EXPECT_FALSE(started.start_time.has_value());
  while (step == 0) absl::SleepFor(absl::Milliseconds(1));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Operation operation,
                                jobs_->Wait(started.operation_id, kShort));
  EXPECT_EQ(operation.state, OperationState::kRunning);
  EXPECT_TRUE(operation.start_time.has_value());
  EXPECT_EQ(operation.done_work, 3);
  EXPECT_EQ(operation.total_work, 10);
  step = 2;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(operation,
                                jobs_->Wait(started.operation_id, kLong));
  EXPECT_EQ(operation.state, OperationState::kSucceeded);
  EXPECT_EQ(operation.process_report->point_count, 9);
  EXPECT_FALSE(operation.upload_report.has_value());
  EXPECT_EQ(operation.done_work, 10);
  EXPECT_TRUE(operation.end_time.has_value());
  MAPSIEVE_EXPECT_OK(operation.error);
  // All of it survives.
  OpenStore();
  Open(Blocker());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation read,
                                jobs_->Get(started.operation_id));
  EXPECT_EQ(read.state, OperationState::kSucceeded);
  EXPECT_EQ(read.map_id, "map-a");
  EXPECT_EQ(read.process_report, operation.process_report);
  EXPECT_EQ(read.done_work, 10);
  EXPECT_LT(absl::AbsDuration(*read.start_time - *operation.start_time),
            absl::Milliseconds(1));
}

TEST_F(JobManagerTest, OneJobAMapAndOneOfEachVerb) {
  std::atomic<int> on_a = 0;
  std::atomic<int> runs = 0;
  std::atomic<int> finalizes = 0;
  std::atomic<bool> overlapped = false;
  Open([&](const std::string&, const JobSpec& spec,
           const ExecutionContext&) -> absl::StatusOr<JobResult> {
    const bool is_run = spec.verb == OperationVerb::kProcessMap;
    std::atomic<int>& kind = is_run ? runs : finalizes;
    if (++kind > 1) overlapped = true;
    if (spec.map_uid == "a" && ++on_a > 1) overlapped = true;
    absl::SleepFor(absl::Milliseconds(2));
    if (spec.map_uid == "a") --on_a;
    --kind;
    return JobResult(UploadReport{});
  });
  std::vector<Operation> started;
  for (int i = 0; i < 10; ++i) {
    started.push_back(Start(Finalize("a", "u")));
    started.push_back(Start(Run("a")));
    started.push_back(Start(Run("b")));
  }
  for (const Operation& operation : started) {
    EXPECT_EQ(jobs_->Wait(operation.operation_id, kLong)->state,
              OperationState::kSucceeded);
  }
  EXPECT_FALSE(overlapped);
}

TEST_F(JobManagerTest, AMapAtWorkDoesNotHoldUpOthers) {
  Open(Blocker());
  const Operation run = Start(Run("a"));
  WaitUntilRunning(run);
  const Operation same_map = Start(Finalize("a", "u"));
  const Operation other_map = Start(Finalize("b", "u"));
  WaitUntilRunning(other_map);
  EXPECT_EQ(jobs_->Get(same_map.operation_id)->state, OperationState::kQueued);
  EXPECT_TRUE(jobs_->IsBusy("a"));
  EXPECT_FALSE(jobs_->IsBusy("c"));
  released_ = true;
  MAPSIEVE_EXPECT_OK(jobs_->Wait(same_map.operation_id, kLong));
}

TEST_F(JobManagerTest, UniqueOperationsRefuseASecond) {
  Open(Blocker());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation first,
                                jobs_->Start("map-a", Run("a"), true));
  EXPECT_THAT(
      jobs_->Start("map-a", Run("a"), true),
      StatusIs(absl::StatusCode::kAborted, HasSubstr(first.operation_id)));
  MAPSIEVE_EXPECT_OK(jobs_->Start("map-b", Run("b"), true));
  released_ = true;
  MAPSIEVE_EXPECT_OK(jobs_->Wait(first.operation_id, kLong));
  MAPSIEVE_EXPECT_OK(jobs_->Start("map-a", Run("a"), true));
}

TEST_F(JobManagerTest, CancelEndsWhatWaitsAndWhatRuns) {
  Open(Blocker());
  const Operation running = Start(Run("a"));
  WaitUntilRunning(running);
  const Operation waiting = Start(Run("b"));
  MAPSIEVE_ASSERT_OK(jobs_->Cancel(waiting.operation_id));
  EXPECT_EQ(jobs_->Get(waiting.operation_id)->state,
            OperationState::kCancelled);
  MAPSIEVE_ASSERT_OK(jobs_->Cancel(running.operation_id));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation ended,
                                jobs_->Wait(running.operation_id, kLong));
  EXPECT_EQ(ended.state, OperationState::kCancelled);
  EXPECT_TRUE(ended.cancel_requested);
  EXPECT_THAT(ended.error,
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("request")));
  MAPSIEVE_EXPECT_OK(jobs_->Cancel(running.operation_id));
  EXPECT_THAT(jobs_->Cancel("nothing"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("nothing")));
  // Neither is run again.
  OpenStore();
  Open(Blocker());
  EXPECT_FALSE(jobs_->IsBusy("a"));
  EXPECT_FALSE(jobs_->IsBusy("b"));
}

TEST_F(JobManagerTest, WhatARestartInterruptsIsRunAgain) {
  Open(Blocker());
  const Operation running = Start(Run("a"));
  WaitUntilRunning(running);
  const Operation waiting = Start(Finalize("a", "u"));
  jobs_->Shutdown();
  EXPECT_EQ(running_, 0);
  EXPECT_FALSE(jobs_->Get(running.operation_id)->done());
  EXPECT_THAT(jobs_->Start("map-a", Run("a"), false),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("")));
  OpenStore();
  released_ = true;
  Open(Blocker());
  for (const Operation& operation : {running, waiting}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation ended,
                                  jobs_->Wait(operation.operation_id, kLong));
    EXPECT_EQ(ended.state, OperationState::kSucceeded);
    EXPECT_EQ(ended.upload_id, operation.upload_id);
  }
}

TEST_F(JobManagerTest, WhatWasToBeCancelledTellsWhatItHadDone) {
  const auto record = [&](const std::string& id) {
    auto operation = store_->catalogue().CreateOperation(
        {.id = id,
         .target = "maps/map-a",
         .verb = "FinalizeUpload",
         .request = FormatJobSpec(Finalize("a", id))});
    ASSERT_TRUE(operation.ok()) << operation.status();
    operation->state = storage::OperationState::kRunning;
    operation->cancel_requested = true;
    MAPSIEVE_ASSERT_OK(store_->catalogue().UpdateOperation(*operation));
  };
  record("committed");
  record("begun");
  Open([](const std::string&, const JobSpec& spec,
          const ExecutionContext& context) -> absl::StatusOr<JobResult> {
    if (spec.upload_id == "committed") {
      return JobResult(UploadReport{.revision = 5});
    }
    MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
    return JobResult(UploadReport{.revision = 6});
  });
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation committed,
                                jobs_->Wait("committed", kLong));
  EXPECT_EQ(committed.state, OperationState::kSucceeded);
  EXPECT_EQ(committed.upload_report->revision, 5);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation begun,
                                jobs_->Wait("begun", kLong));
  EXPECT_EQ(begun.state, OperationState::kCancelled);
}

TEST_F(JobManagerTest, ErrorsAndExceptionsEndTheJobAlone) {
  Open([](const std::string&, const JobSpec& spec,
          const ExecutionContext&) -> absl::StatusOr<JobResult> {
    if (spec.map_uid == "memory") throw std::bad_alloc();
    if (spec.map_uid == "throw") throw std::runtime_error("surprise");
    return absl::DataLossError("a damaged chunk");
  });
  const auto error_of = [&](const std::string& map_uid) {
    const Operation operation = Start(Run(map_uid));
    const auto ended = jobs_->Wait(operation.operation_id, kLong);
    EXPECT_EQ(ended->state, OperationState::kFailed);
    return ended->error;
  };
  EXPECT_THAT(error_of("memory"),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("")));
  EXPECT_THAT(error_of("throw"),
              StatusIs(absl::StatusCode::kInternal, HasSubstr("surprise")));
  EXPECT_THAT(error_of("other"),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("damaged")));
}

TEST_F(JobManagerTest, QueueAndMemoryOfOperationsAreBounded) {
  released_ = true;
  Open(Blocker(), {.max_queued = 3, .max_finished = 4});
  std::vector<std::string> ids;
  for (int i = 0; i < 9; ++i) {
    const Operation operation = Start(Run("a"));
    ids.push_back(operation.operation_id);
    MAPSIEVE_ASSERT_OK(jobs_->Wait(operation.operation_id, kLong));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto kept, jobs_->List("", "", 100));
  ASSERT_EQ(kept.size(), 4U);
  // Newest first.
  for (size_t i = 0; i < kept.size(); ++i) {
    EXPECT_EQ(kept[i].operation_id, ids[ids.size() - 1 - i]);
  }
  EXPECT_THAT(jobs_->Get(ids[0]),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr(ids[0])));
  released_ = false;
  for (int i = 0; i < 3; ++i) Start(Run("a"));
  EXPECT_THAT(jobs_->Start("map-a", Run("a"), false),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("3 operations wait")));
}

TEST_F(JobManagerTest, ListsPagesOfOneMapOrAll) {
  released_ = true;
  Open(Blocker());
  for (int i = 0; i < 6; ++i) Start(Run(i % 2 == 0 ? "a" : "b"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto two, jobs_->List("", "", 2));
  ASSERT_EQ(two.size(), 2U);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto rest,
                                jobs_->List("", two[1].operation_id, 100));
  EXPECT_EQ(rest.size(), 4U);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto of_a, jobs_->List("map-a", "", 100));
  EXPECT_EQ(of_a.size(), 3U);
  EXPECT_THAT(
      jobs_->List("", "nothing", 100),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("page token")));
}

TEST_F(JobManagerTest, WatchersAreCalledOnce) {
  Open(Blocker());
  std::atomic<int> calls = 0;
  std::atomic<int> stopped_calls = 0;
  const Operation operation = Start(Run("a"));
  MAPSIEVE_ASSERT_OK(jobs_->Watch(operation.operation_id, [&] { ++calls; }));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const int64_t watch,
      jobs_->Watch(operation.operation_id, [&] { ++stopped_calls; }));
  jobs_->StopWatching(watch);
  jobs_->StopWatching(12345);
  EXPECT_EQ(calls, 0);
  released_ = true;
  MAPSIEVE_ASSERT_OK(jobs_->Wait(operation.operation_id, kLong));
  while (calls == 0) absl::SleepFor(absl::Milliseconds(1));
  // One that is done calls back at once.
  MAPSIEVE_ASSERT_OK(jobs_->Watch(operation.operation_id, [&] { ++calls; }));
  EXPECT_EQ(calls, 2);
  EXPECT_EQ(stopped_calls, 0);
  EXPECT_THAT(jobs_->Watch("nothing", [] {}),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("nothing")));
  // Closing calls those that wait still.
  released_ = false;
  const Operation endless = Start(Run("b"));
  MAPSIEVE_ASSERT_OK(jobs_->Watch(endless.operation_id, [&] { ++calls; }));
  jobs_->Shutdown();
  EXPECT_EQ(calls, 3);
}

TEST_F(JobManagerTest, ForgetsTheOperationsOfAMap) {
  Open(Blocker());
  const Operation run = Start(Run("a"));
  WaitUntilRunning(run);
  Start(Finalize("a", "u"));
  const Operation other = Start(Finalize("b", "u"));
  jobs_->CancelAndForget("a");
  EXPECT_EQ(jobs_->List("map-a", "", 10)->size(), 0U);
  MAPSIEVE_EXPECT_OK(jobs_->Get(other.operation_id));
  OpenStore();
  Open(Blocker());
  EXPECT_EQ(jobs_->List("map-a", "", 10)->size(), 0U);
}

// The filter itself.

TEST(ProcessMap, CancelledAtAnyVisitLeavesTheMapAsItWas) {
  const LatticeCloud scene = MakeScene(41);
  const core::SpdfOptions old_options = SceneOptions(core::DensityRule::kQuota);
  const core::SpdfOptions options = SceneOptions(core::DensityRule::kPaper);
  Workshop workshop(13);
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, IngestLimits::Of(1 << 25)));
  MAPSIEVE_ASSERT_OK(workshop.Process(old_options, kProcessLimits));
  const LatticeCloud before = FilterLocally(scene, old_options);
  int cancelled = 0;
  for (int64_t visits = 1;; visits += 23) {
    StopAfter stop(visits);
    const auto report =
        workshop.Process(options, kProcessLimits, stop.Context());
    if (report.ok()) {
      EXPECT_FALSE(stop.is_asked());
      break;
    }
    EXPECT_THAT(report, StatusIs(absl::StatusCode::kCancelled, HasSubstr("")));
    ++cancelled;
    EXPECT_EQ(workshop.map().newest_revision, 3);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
    ExpectSameCloud(answer.points, before);
  }
  EXPECT_GT(cancelled, 5);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
  ExpectSameCloud(answer.points, FilterLocally(scene, options));
}

TEST(ProcessMap, DoesNothingWhereNothingChanged) {
  Service service;
  const LatticeCloud scene = MakeScene(42);
  const core::SpdfOptions options = SceneOptions(core::DensityRule::kQuota);
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 8}));
  EXPECT_THAT(
      service->ProcessMap("map", options),
      StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("no points")));
  EXPECT_THAT(service->ProcessMap("other", options),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("other")));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", scene));
  EXPECT_THAT(
      service->ProcessMap("map", core::SpdfOptions{.neighbor_count = 1}),
      StatusIs(absl::StatusCode::kInvalidArgument,
               HasSubstr("neighbor_count is 1")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation first,
                                service.Process("map", options));
  EXPECT_EQ(first.process_report->revision, 3);
  // The same options given, or none: those of the last run.
  for (const std::optional<core::SpdfOptions>& again :
       {std::optional(options), std::optional<core::SpdfOptions>()}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation repeat,
                                  service.Process("map", again));
    EXPECT_EQ(repeat.process_report, first.process_report);
    EXPECT_EQ(service->GetMap("map")->revision, 3);
    service.Reopen();
  }
  core::SpdfOptions other = options;
  other.seed = 8;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation changed,
                                service.Process("map", other));
  EXPECT_EQ(changed.process_report->revision, 4);
  MAPSIEVE_ASSERT_OK(service.Upload("map", "more", MakeScene(43)));
  EXPECT_GT(service->GetMapStats("map")->stale_tile_count, 0);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation more, service.Process("map"));
  EXPECT_EQ(more.process_report->revision, 6);
  EXPECT_EQ(service->GetMapStats("map")->options, other);
  EXPECT_EQ(service->GetMapStats("map")->stale_tile_count, 0);
}

TEST(ProcessMap, WithoutOptionsTakesTheDefaults) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", MakeScene(44)));
  MAPSIEVE_ASSERT_OK(service.Process("map"));
  EXPECT_EQ(service->GetMapStats("map")->options, core::SpdfOptions());
}

TEST(ProcessMap, SurvivesAnyEndOfTheProcess) {
  const LatticeCloud scene = MakeScene(45);
  const core::SpdfOptions options = SceneOptions(core::DensityRule::kPaper);
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 4}));
  MAPSIEVE_ASSERT_OK(service.Stage("map", "scan", MakeUpload(scene)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation finalize,
                                service->FinalizeUpload("map", "scan"));
  service.Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Operation finalized,
      service->WaitOperation(finalize.operation_id, kLong));
  MAPSIEVE_ASSERT_OK(finalized.error);
  EXPECT_EQ(finalized.upload_report->added_point_count,
            static_cast<int64_t>(scene.size()));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation run,
                                service->ProcessMap("map", options));
  service.Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Operation done, service->WaitOperation(run.operation_id, kLong));
  MAPSIEVE_ASSERT_OK(done.error);
  service.Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                service.Query({.map_id = "map"}));
  ExpectSameCloud(answer.points, FilterLocally(scene, options));
  EXPECT_EQ(service->GetMap("map")->revision, 3);
}

TEST(ProcessMap, ShutdownRefusesNewWorkAndGoesOnReading) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", MakeScene(46)));
  MAPSIEVE_ASSERT_OK(service.Process("map"));
  service->Shutdown();
  service->Shutdown();
  EXPECT_THAT(service->ProcessMap("map", std::nullopt),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("")));
  MAPSIEVE_EXPECT_OK(service.Query({.map_id = "map"}));
}

}  // namespace
}  // namespace mapsieve::engine::testing
