#include "server/rpc/reactors.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server.h"
#include "grpcpp/server_builder.h"
#include "gtest/gtest.h"
#include "server/engine/engine.h"
#include "server/rpc/map_service.h"
#include "server/rpc/operations_service.h"
#include "server/rpc/query_service.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::HasSubstr;
using ::testing::NiceMock;
using ::testing::Return;

using Code = absl::StatusCode;

class MockEngine : public engine::Engine {
 public:
  template <typename T>
  using Or = absl::StatusOr<T>;
  using Maps = engine::Page<engine::MapInfo>;
  using Revisions = engine::Page<engine::RevisionInfo>;
  using Uploads = engine::Page<engine::UploadInfo>;
  using Operations = engine::Page<engine::Operation>;
  using Id = const std::string&;

  MOCK_METHOD(absl::Status, CheckSpace, (), (override));
  MOCK_METHOD(void, Shutdown, (), (override));
  MOCK_METHOD(Or<engine::MapInfo>, CreateMap, (const engine::MapSpec&),
              (override));
  MOCK_METHOD(Or<engine::MapInfo>, GetMap, (Id), (override));
  MOCK_METHOD(Or<Maps>, ListMaps, (const engine::PageRequest&), (override));
  MOCK_METHOD(absl::Status, DeleteMap, (Id, bool), (override));
  MOCK_METHOD(Or<engine::MapStats>, GetMapStats, (Id), (override));
  MOCK_METHOD(Or<Revisions>, ListRevisions, (Id, const engine::PageRequest&),
              (override));
  MOCK_METHOD(Or<engine::UploadInfo>, CreateUpload,
              (Id, const engine::UploadSpec&), (override));
  MOCK_METHOD(Or<engine::UploadInfo>, GetUpload, (Id, Id), (override));
  MOCK_METHOD(Or<Uploads>, ListUploads, (Id, const engine::PageRequest&),
              (override));
  MOCK_METHOD(absl::Status, DeleteUpload, (Id, Id), (override));
  MOCK_METHOD(Or<std::unique_ptr<engine::UploadWriter>>, OpenUploadWriter,
              (Id, Id), (override));
  MOCK_METHOD(Or<engine::Operation>, FinalizeUpload,
              (Id, Id, const std::optional<engine::RegionShape>&), (override));
  MOCK_METHOD(Or<engine::Operation>, DeleteRegion,
              (Id, const engine::RegionShape&), (override));
  MOCK_METHOD(Or<engine::RevisionInfo>, RollBack, (Id, int64_t), (override));
  MOCK_METHOD(Or<std::unique_ptr<engine::RevisionCursor>>, WatchRevisions,
              (Id, int64_t, std::function<void()>), (override));
  MOCK_METHOD(Or<engine::RevisionComparison>, CompareRevisions,
              (Id, int64_t, int64_t, const engine::PageRequest&), (override));
  MOCK_METHOD(Or<engine::Operation>, ProcessMap,
              (Id, const std::optional<core::SpdfOptions>&), (override));
  MOCK_METHOD(Or<engine::Operation>, GetOperation, (Id), (override));
  MOCK_METHOD(Or<Operations>, ListOperations, (Id, const engine::PageRequest&),
              (override));
  MOCK_METHOD(absl::Status, CancelOperation, (Id), (override));
  MOCK_METHOD(Or<engine::Operation>, WaitOperation, (Id, absl::Duration),
              (override));
  MOCK_METHOD(Or<int64_t>, WatchOperation, (Id, std::function<void()>),
              (override));
  MOCK_METHOD(void, StopWatching, (int64_t), (override));
  MOCK_METHOD(Or<std::unique_ptr<engine::QueryCursor>>, Query,
              (const engine::QuerySpec&, std::stop_token), (override));
  MOCK_METHOD(Or<std::unique_ptr<engine::SyncCursor>>, Sync,
              (const engine::SyncSpec&, std::stop_token), (override));
  MOCK_METHOD(Or<std::unique_ptr<engine::VerifyCursor>>, Verify,
              (const engine::VerifySpec&, std::stop_token), (override));
  MOCK_METHOD(Or<engine::Operation>, RepairMap, (Id), (override));
};

// Gives blocks of 1 MB, counts them and how many cursors live.
class CountingCursor : public engine::QueryCursor {
 public:
  struct Counts {
    std::atomic<int> made = 0;
    std::atomic<int> alive = 0;
  };

  CountingCursor(int blocks, std::stop_token stop, Counts& counts)
      : blocks_(blocks), stop_(std::move(stop)), counts_(counts) {
    ++counts_.alive;
  }
  ~CountingCursor() override { --counts_.alive; }

  const engine::QueryHeader& header() const override { return header_; }
  absl::StatusOr<std::optional<std::vector<std::byte>>> NextBatch() override {
    if (stop_.stop_requested()) return absl::CancelledError("stopped");
    if (blocks_ == 0) return std::nullopt;
    --blocks_;
    ++counts_.made;
    return std::vector<std::byte>(engine::kMaxBatchBytes);
  }
  bool gave_stored_chunk() const override { return false; }
  engine::QuerySummary summary() const override { return {}; }
  std::string resume_token() const override { return "token"; }

 private:
  int blocks_;
  std::stop_token stop_;
  Counts& counts_;
  engine::QueryHeader header_;
};

// Gives revisions of 100 kB, and then kNotFound. Before each there is none for
// once, and the wake-up comes before the caller learns of that.
class WakingCursor : public engine::RevisionCursor {
 public:
  WakingCursor(int revisions, std::function<void()> wake,
               std::atomic<int>& given)
      : revisions_(revisions), wake_(std::move(wake)), given_(given) {}

  absl::StatusOr<std::optional<engine::RevisionInfo>> Next() override {
    waits_ = !waits_;
    if (waits_) {
      wake_();
      return std::nullopt;
    }
    if (given_ == revisions_) return absl::NotFoundError("deleted");
    return engine::RevisionInfo{.number = ++given_,
                                .upload_id = std::string(100'000, 'u')};
  }

 private:
  const int revisions_;
  const std::function<void()> wake_;
  std::atomic<int>& given_;
  bool waits_ = false;
};

// Services over a mock, and a client of them.
class ReactorTest : public ::testing::Test {
 protected:
  void SetUp() override {
    calls_ = {&workers_, &workers_, &workers_, &admission_,
              [this](const char*, const absl::Status&) { ++ended_; }};
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(),
                             &port);
    builder.RegisterService(&maps_);
    builder.RegisterService(&queries_);
    builder.RegisterService(&operations_);
    server_ = builder.BuildAndStart();
    ASSERT_NE(server_, nullptr);
    client_ = std::make_unique<TestClient>("127.0.0.1:" + std::to_string(port));
    ON_CALL(engine_, Query).WillByDefault([this](const auto&, auto stop) {
      return std::make_unique<CountingCursor>(blocks_, stop, counts_);
    });
    request_.set_name("maps/campus");
  }
  void TearDown() override {
    client_.reset();
    server_->Shutdown();
    server_.reset();
  }

  // Waits for something to come true.
  static bool Soon(const std::function<bool()>& condition) {
    for (int i = 0; i < 1000; ++i) {
      if (condition()) return true;
      absl::SleepFor(absl::Milliseconds(10));
    }
    return false;
  }

  // Reads a whole answer and counts its messages.
  int ReadAll() {
    const auto context = client_->NewContext();
    const auto stream = client_->queries->QueryRegion(context.get(), request_);
    int count = 0;
    for (v1::QueryRegionResponse response; stream->Read(&response);) ++count;
    MAPSIEVE_EXPECT_OK(FromGrpc(stream->Finish()));
    return count;
  }

  NiceMock<MockEngine> engine_;
  CountingCursor::Counts counts_;
  int blocks_ = 100;
  std::atomic<int> ended_ = 0;
  Admission admission_{{.unary = 4, .wait = 4, .upload = 1, .query = 2}};
  WorkerPool workers_{2};
  CallContext calls_;
  MapService maps_{calls_, engine_};
  QueryService queries_{calls_, engine_};
  OperationsService operations_{calls_, engine_};
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<TestClient> client_;
  v1::QueryRegionRequest request_;
};

TEST_F(ReactorTest, StreamsEveryMessageOnce) {
  EXPECT_EQ(ReadAll(), 102);
  EXPECT_EQ(counts_.made, 100);
  EXPECT_TRUE(Soon([&] { return ended_ == 1; }));
}

TEST_F(ReactorTest, AClientThatStopsReadingCostsLittleAndBlocksNobody) {
  blocks_ = 1'000'000;
  const auto context = client_->NewContext();
  const auto stream = client_->queries->QueryRegion(context.get(), request_);
  v1::QueryRegionResponse response;
  ASSERT_TRUE(stream->Read(&response));
  // The windows of the connection fill, then nothing more is made.
  int made = -1;
  EXPECT_TRUE(Soon([&] {
    const int before = made;
    made = counts_.made;
    absl::SleepFor(absl::Milliseconds(200));
    return made == before;
  }));
  EXPECT_LT(made, 20);

  blocks_ = 30;
  EXPECT_EQ(ReadAll(), 32);

  EXPECT_EQ(counts_.alive, 1);
  context->TryCancel();
  EXPECT_TRUE(Soon([&] { return counts_.alive == 0; }));
  EXPECT_THAT(FromGrpc(stream->Finish()), StatusIs(Code::kCancelled, _));
}

TEST_F(ReactorTest, AWakeUpBeforeThePauseEndsIt) {
  std::atomic<int> given = 0;
  ON_CALL(engine_, WatchRevisions)
      .WillByDefault([&](const auto&, auto, auto wake) {
        return std::make_unique<WakingCursor>(50, wake, given);
      });
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::seconds(20));
  v1::WatchMapRequest request;
  request.set_name("maps/campus");
  const auto stream = client_->maps->WatchMap(&context, request);
  v1::WatchMapResponse response;
  for (int number = 1; number <= 50; ++number) {
    ASSERT_TRUE(stream->Read(&response));
    EXPECT_EQ(response.revision().number(), number);
  }
  EXPECT_FALSE(stream->Read(&response));
  EXPECT_THAT(FromGrpc(stream->Finish()), StatusIs(Code::kNotFound, _));
}

TEST_F(ReactorTest, AWatcherThatDoesNotReadCostsLittle) {
  std::atomic<int> given = 0;
  ON_CALL(engine_, WatchRevisions)
      .WillByDefault([&](const auto&, auto, auto wake) {
        return std::make_unique<WakingCursor>(1'000'000, wake, given);
      });
  const auto context = client_->NewContext();
  v1::WatchMapRequest request;
  request.set_name("maps/campus");
  const auto stream = client_->maps->WatchMap(context.get(), request);
  v1::WatchMapResponse response;
  ASSERT_TRUE(stream->Read(&response));
  // The windows of the connection fill, then no revision is read any more.
  int before = -1;
  EXPECT_TRUE(Soon([&] {
    const bool stands_still = before == given;
    before = given;
    absl::SleepFor(absl::Milliseconds(200));
    return stands_still;
  }));
  EXPECT_LT(given, 200);
  context->TryCancel();
  EXPECT_THAT(FromGrpc(stream->Finish()), StatusIs(Code::kCancelled, _));
  EXPECT_TRUE(Soon([&] { return ended_ == 1; }));
}

TEST_F(ReactorTest, ADeadlineStopsTheEngine) {
  blocks_ = 1'000'000;
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::milliseconds(300));
  const auto stream = client_->queries->QueryRegion(&context, request_);
  for (v1::QueryRegionResponse response; stream->Read(&response);) {
  }
  EXPECT_THAT(FromGrpc(stream->Finish()), StatusIs(Code::kDeadlineExceeded, _));
  EXPECT_TRUE(Soon([&] { return counts_.alive == 0; }));
  const int made = counts_.made;
  absl::SleepFor(absl::Milliseconds(50));
  EXPECT_EQ(counts_.made, made);
}

TEST_F(ReactorTest, TooManyQueriesAreRefused) {
  blocks_ = 1'000'000;
  v1::QueryRegionResponse response;
  std::vector<std::unique_ptr<grpc::ClientContext>> contexts;
  std::vector<std::unique_ptr<grpc::ClientReader<v1::QueryRegionResponse>>>
      streams;
  for (int i = 0; i < 2; ++i) {
    contexts.push_back(client_->NewContext());
    streams.push_back(
        client_->queries->QueryRegion(contexts.back().get(), request_));
    ASSERT_TRUE(streams.back()->Read(&response));
  }
  EXPECT_THAT(client_->Query(request_),
              StatusIs(Code::kResourceExhausted, HasSubstr("QueryRegion")));
  contexts[0]->TryCancel();
  EXPECT_TRUE(Soon([&] { return counts_.alive == 1; }));
  blocks_ = 3;
  EXPECT_EQ(ReadAll(), 5);
  contexts[1]->TryCancel();
  for (const auto& stream : streams) {
    EXPECT_THAT(FromGrpc(stream->Finish()), StatusIs(Code::kCancelled, _));
  }
}

TEST_F(ReactorTest, ExceptionsBecomeErrorsAndTheServerGoesOn) {
  ON_CALL(engine_, CreateMap).WillByDefault([](const auto&) {
    throw std::bad_alloc();
    return absl::UnknownError("");
  });
  EXPECT_THAT(client_->CreateMap("campus"),
              StatusIs(Code::kResourceExhausted, _));
  ON_CALL(engine_, Query)
      .WillByDefault(
          [](const auto&, const auto&)
              -> absl::StatusOr<std::unique_ptr<engine::QueryCursor>> {
            throw std::logic_error("oops");
          });
  EXPECT_THAT(client_->Query(request_),
              StatusIs(Code::kInternal, HasSubstr("oops")));
  ON_CALL(engine_, CreateMap)
      .WillByDefault(Return(engine::MapInfo{.map_id = "campus"}));
  MAPSIEVE_EXPECT_OK(client_->CreateMap("campus"));
}

TEST_F(ReactorTest, NothingBeginsOnceTheServerDrains) {
  admission_.Drain();
  EXPECT_THAT(client_->CreateMap("campus"), StatusIs(Code::kUnavailable, _));
  EXPECT_THAT(client_->Query(request_), StatusIs(Code::kUnavailable, _));
  EXPECT_THAT(client_->Wait("operations/1"), StatusIs(Code::kUnavailable, _));
}

// Operations that are done when the test says so.
class WaitTest : public ReactorTest {
 protected:
  void SetUp() override {
    ReactorTest::SetUp();
    ON_CALL(engine_, GetOperation).WillByDefault([this](const auto& id) {
      engine::Operation operation = {.operation_id = id};
      if (done_) {
        operation.state = engine::OperationState::kSucceeded;
        operation.process_report.emplace();
      }
      return operation;
    });
    ON_CALL(engine_, WatchOperation)
        .WillByDefault([this](const auto&, std::function<void()> callback) {
          if (done_) {
            callback();
          } else {
            const MutexLock lock(mutex_);
            callback_ = std::move(callback);
          }
          return absl::StatusOr<int64_t>(5);
        });
  }

  bool Watched() {
    const MutexLock lock(mutex_);
    return callback_ != nullptr;
  }
  void End() {
    done_ = true;
    const MutexLock lock(mutex_);
    callback_();
  }

  std::atomic<bool> done_ = false;
  Mutex mutex_;
  std::function<void()> callback_;
};

TEST_F(WaitTest, EndsWithTheOperation) {
  EXPECT_CALL(engine_, StopWatching(5));
  std::thread ender([&] {
    EXPECT_TRUE(Soon([&] { return Watched(); }));
    End();
  });
  MAPSIEVE_EXPECT_OK(client_->Wait("operations/1"));
  ender.join();
}

TEST_F(WaitTest, EndsAtOnceIfTheOperationIsDone) {
  done_ = true;
  MAPSIEVE_EXPECT_OK(client_->Wait("operations/1"));
}

TEST_F(WaitTest, EndsWithTheDrain) {
  std::thread drain([&] {
    EXPECT_TRUE(Soon([&] { return Watched(); }));
    admission_.Drain();
  });
  EXPECT_THAT(client_->Wait("operations/1"), StatusIs(Code::kUnavailable, _));
  drain.join();
}

TEST_F(WaitTest, EndsWhenTheClientLeavesAndHoldsNoThread) {
  constexpr int kWaits = 4;  // Twice the workers.
  std::vector<std::unique_ptr<grpc::ClientContext>> contexts(kWaits);
  std::vector<std::thread> waits;
  for (auto& context : contexts) {
    context = client_->NewContext();
    waits.emplace_back([&] {
      v1::WaitOperationRequest request;
      request.set_name("operations/1");
      v1::Operation operation;
      EXPECT_THAT(FromGrpc(client_->operations->WaitOperation(
                      context.get(), request, &operation)),
                  StatusIs(Code::kCancelled, _));
    });
  }
  EXPECT_TRUE(Soon([&] { return Watched(); }));
  blocks_ = 5;
  EXPECT_EQ(ReadAll(), 7);
  for (auto& context : contexts) context->TryCancel();
  for (std::thread& wait : waits) wait.join();
  EXPECT_TRUE(Soon([&] { return ended_ == kWaits + 1; }));
}

TEST(WorkerPool, RunsEverythingBeforeItGoes) {
  std::atomic<int> done = 0;
  {
    WorkerPool pool(3);
    for (int i = 0; i < 1000; ++i) pool.Post([&] { ++done; });
  }
  EXPECT_EQ(done, 1000);
}

// One task after another stays with a few of many threads.
TEST(WorkerPool, WakesWhoCameLast) {
  std::map<std::thread::id, int> counts;
  WorkerPool pool(8);
  for (int i = 0; i < 64; ++i) {
    std::promise<void> done;
    pool.Post([&] {
      ++counts[std::this_thread::get_id()];
      done.set_value();
    });
    done.get_future().wait();
    // Time to become idle again.
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  int most = 0;
  for (const auto& [thread, count] : counts) most = std::max(most, count);
  EXPECT_GE(most, 16);
}

}  // namespace
}  // namespace mapsieve::rpc
