#include <algorithm>
#include <atomic>
#include <fstream>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "client/api/map_client.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/rpc/service_fixture.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::HasSubstr;

using Code = absl::StatusCode;

class WatchTest : public ServiceTest {
 protected:
  // A call of WatchMap.
  class Watch {
   public:
    Watch(TestClient& client, const std::string& map_id, int64_t from)
        : context_(client.NewContext()) {
      v1::WatchMapRequest request;
      request.set_name("maps/" + map_id);
      request.set_from_revision(from);
      stream_ = client.maps->WatchMap(context_.get(), request);
    }

    // The next revision, nothing at the end.
    std::optional<v1::Revision> Next() {
      v1::WatchMapResponse response;
      if (!stream_->Read(&response)) return std::nullopt;
      return response.revision();
    }
    int64_t NextNumber() {
      const auto revision = Next();
      return revision ? revision->number() : 0;
    }
    absl::Status Finish() { return FromGrpc(stream_->Finish()); }
    void Cancel() { context_->TryCancel(); }

   private:
    std::unique_ptr<grpc::ClientContext> context_;
    std::unique_ptr<grpc::ClientReader<v1::WatchMapResponse>> stream_;
  };

  // A rollback to another revision than the newest, to `number` or the one
  // after it: the cheapest commit. Needs three revisions.
  void Commit(int64_t number) {
    v1::RollBackMapRequest request;
    request.set_name("maps/campus");
    request.set_revision(number);
    v1::Revision revision;
    MAPSIEVE_ASSERT_OK(FromGrpc(client_->maps->RollBackMap(
        client_->NewContext().get(), request, &revision)));
  }

  // Revisions 1 and 2.
  void MakeMap() {
    MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
    MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(1000)));
  }

  void DeleteMap() {
    v1::DeleteMapRequest request;
    request.set_name("maps/campus");
    google::protobuf::Empty empty;
    MAPSIEVE_ASSERT_OK(FromGrpc(client_->maps->DeleteMap(
        client_->NewContext().get(), request, &empty)));
  }
};

TEST_F(WatchTest, GivesWhatIsThereAndThenWhatComes) {
  MakeMap();
  Watch all(*client_, "campus", 1);
  Watch newest(*client_, "campus", 0);
  Watch coming(*client_, "campus", 3);
  EXPECT_EQ(all.Next()->kind(), v1::Revision::KIND_CREATE);
  const auto upload = all.Next();
  ASSERT_TRUE(upload);
  EXPECT_EQ(upload->number(), 2);
  EXPECT_EQ(upload->upload(), kUpload);
  EXPECT_EQ(upload->added_point_count(), 1000);
  EXPECT_EQ(newest.NextNumber(), 2);

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto run, client_->Process("campus"));
  for (Watch* watch : {&all, &newest, &coming}) {
    const auto processed = watch->Next();
    ASSERT_TRUE(processed);
    EXPECT_EQ(processed->number(), 3);
    EXPECT_EQ(processed->kind(), v1::Revision::KIND_PROCESS);
  }
  MAPSIEVE_ASSERT_OK(client_->Wait(run.name()));
  Commit(2);
  EXPECT_EQ(all.Next()->kind(), v1::Revision::KIND_ROLLBACK);
  all.Cancel();
  EXPECT_FALSE(all.Next());
  EXPECT_THAT(all.Finish(), StatusIs(Code::kCancelled, _));
}

TEST_F(WatchTest, ManyWatchersMissNothingAndKeepTheOrder) {
  MakeMap();
  constexpr int64_t kCommits = 60;
  constexpr int kWatchers = 40;
  std::atomic<int> complete = 0;
  std::vector<std::thread> threads;
  for (int i = 0; i < kWatchers; ++i) {
    threads.emplace_back([&, i] {
      // Some begin before what they ask for is there, some go on after a break.
      int64_t next = 1 + i % 3;
      while (next <= 2 + kCommits) {
        Watch watch(*client_, "campus", next);
        const int64_t until = i % 2 == 0 ? 2 + kCommits : next + 7;
        while (next <= std::min(until, 2 + kCommits)) {
          ASSERT_EQ(watch.NextNumber(), next);
          ++next;
        }
        watch.Cancel();
      }
      ++complete;
    });
  }
  for (int64_t i = 0; i < kCommits; ++i) Commit(1 + i % 2);
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(complete, kWatchers);
}

TEST_F(WatchTest, ADeletedMapIsNotFoundEvenIfItsNameIsTakenAgain) {
  MakeMap();
  Watch watch(*client_, "campus", 0);
  EXPECT_EQ(watch.NextNumber(), 2);
  DeleteMap();
  EXPECT_FALSE(watch.Next());
  EXPECT_THAT(watch.Finish(), StatusIs(Code::kNotFound, HasSubstr("campus")));

  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  Watch second(*client_, "campus", 1);
  EXPECT_EQ(second.NextNumber(), 1);
  DeleteMap();
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  EXPECT_FALSE(second.Next());
  EXPECT_THAT(second.Finish(), StatusIs(Code::kNotFound, _));
}

TEST_F(WatchTest, ExpiredRevisionsComeMarked) {
  server_.reset();
  ServerOptions options = Options();
  options.kept_revision_count = 1;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(server_, Server::Start(options, logger_));
  client_ = std::make_unique<TestClient>(server_->address().ToString());
  MakeMap();
  // A rollback would need a revision that may have expired by now.
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "more", TestScene(10)));
  const absl::Time end = absl::Now() + absl::Seconds(20);
  bool is_expired = false;
  while (!is_expired && absl::Now() < end) {
    Watch watch(*client_, "campus", 1);
    const auto first = watch.Next();
    ASSERT_TRUE(first);
    EXPECT_EQ(first->number(), 1);
    is_expired = first->expired();
    EXPECT_EQ(watch.NextNumber(), 2);
    const auto newest = watch.Next();
    ASSERT_TRUE(newest);
    EXPECT_FALSE(newest->expired());
    watch.Cancel();
  }
  EXPECT_TRUE(is_expired);
}

TEST_F(WatchTest, DrainingEndsWatches) {
  MakeMap();
  Watch watch(*client_, "campus", 0);
  EXPECT_EQ(watch.NextNumber(), 2);
  const absl::Time begin = absl::Now();
  server_->Shutdown(absl::Seconds(30));
  EXPECT_FALSE(watch.Next());
  EXPECT_THAT(watch.Finish(), StatusIs(Code::kUnavailable, _));
  EXPECT_LT(absl::Now() - begin, absl::Seconds(20));
}

TEST_F(WatchTest, TheClientGoesOnWhenTheServerComesBack) {
  MakeMap();
  std::atomic<int> seen = 0;
  std::vector<int64_t> numbers;
  absl::Status end;
  std::thread watcher([&, address = server_->address().ToString()] {
    client::MapClient client(address);
    end = client.WatchMap("campus", 1, [&](const client::RevisionInfo& info) {
      numbers.push_back(info.number);
      ++seen;
      return absl::OkStatus();
    });
  });
  const auto await = [&](int count) {
    while (seen < count) absl::SleepFor(absl::Milliseconds(5));
  };
  await(2);
  const int port = server_->address().port;
  const auto start = [&](int at) {
    server_.reset();
    ServerOptions options = Options();
    options.listen.port = at;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(server_, Server::Start(options, logger_));
    client_ = std::make_unique<TestClient>(server_->address().ToString());
  };
  // `change` happens where the watcher does not see it.
  const auto restart = [&](const auto& change) {
    server_->Shutdown(absl::ZeroDuration());
    start(0);
    change();
    server_->Shutdown(absl::ZeroDuration());
    start(port);
  };
  restart([&] {
    MAPSIEVE_ASSERT_OK(client_->Upload("campus", "second", TestScene(20)));
  });
  await(3);
  // Another map of the name is not taken for it.
  restart([&] {
    DeleteMap();
    MakeMap();
    MAPSIEVE_ASSERT_OK(client_->Upload("campus", "second", TestScene(20)));
  });
  watcher.join();
  EXPECT_THAT(end, StatusIs(Code::kNotFound, _));
  EXPECT_EQ(numbers, (std::vector<int64_t>{1, 2, 3}));
}

// "Threads:" and "VmRSS:" of this process, in which the server runs.
int64_t ProcessFigure(const std::string& name) {
  std::ifstream file("/proc/self/status");
  for (std::string word; file >> word;) {
    int64_t value = 0;
    if (word == name && file >> value) return value;
  }
  return 0;
}

TEST_F(WatchTest, WatchersCostNeitherThreadsNorMemoryAndAreLimited) {
  MakeMap();
  for (int64_t i = 0; i < 100; ++i) Commit(1 + i % 2);
  std::vector<std::unique_ptr<Watch>> watches;
  // gRPC's own threads are there by then.
  watches.push_back(std::make_unique<Watch>(*client_, "campus", 1));
  EXPECT_EQ(watches.back()->NextNumber(), 1);
  const int64_t threads = ProcessFigure("Threads:");
  const int64_t memory_kb = ProcessFigure("VmRSS:");
  // None of these reads what is there for it.
  while (watches.size() < 1024) {
    watches.push_back(std::make_unique<Watch>(*client_, "campus", 1));
  }
  EXPECT_EQ(watches.back()->NextNumber(), 1);
  EXPECT_LE(ProcessFigure("Threads:"), threads + 8);
  // Client and server together.
  EXPECT_LT(ProcessFigure("VmRSS:") - memory_kb, 1024 * 200);

  Watch one_more(*client_, "campus", 1);
  EXPECT_FALSE(one_more.Next());
  EXPECT_THAT(one_more.Finish(),
              StatusIs(Code::kResourceExhausted, HasSubstr("WatchMap")));
  for (const auto& watch : watches) watch->Cancel();
}

}  // namespace
}  // namespace mapsieve::rpc
