#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/time/clock.h"
#include "gtest/gtest.h"
#include "server/engine/engine.h"
#include "server/engine/revision_watch.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

TEST(RevisionWatchers, WakeThoseOfTheMapWhileTheyAreThere) {
  RevisionWatchers watchers;
  int woken = 0;
  int other_woken = 0;
  {
    const RevisionWatchers::Watcher one(watchers, "a", [&] { ++woken; });
    const RevisionWatchers::Watcher two(watchers, "a", [&] { ++woken; });
    const RevisionWatchers::Watcher other(watchers, "b",
                                          [&] { ++other_woken; });
    watchers.Notify("a");
    EXPECT_EQ(woken, 2);
  }
  watchers.Notify("a");
  watchers.Notify("b");
  EXPECT_EQ(woken, 2);
  EXPECT_EQ(other_woken, 0);
}

TEST(RevisionWatchers, ALeavingWatcherWaitsForACallUnderWay) {
  RevisionWatchers watchers;
  std::atomic<bool> is_called = false;
  std::atomic<bool> may_return = false;
  auto alive = std::make_unique<std::atomic<bool>>(true);
  bool was_alive_at_the_end = false;
  auto watcher = std::make_unique<RevisionWatchers::Watcher>(
      watchers, "a", [&, state = alive.get()] {
        is_called = true;
        while (!may_return) std::this_thread::yield();
        was_alive_at_the_end = *state;
      });
  std::thread notifier([&] { watchers.Notify("a"); });
  while (!is_called) std::this_thread::yield();
  std::thread releaser([&] {
    absl::SleepFor(absl::Milliseconds(20));
    may_return = true;
  });
  watcher.reset();
  *alive = false;
  notifier.join();
  releaser.join();
  EXPECT_TRUE(was_alive_at_the_end);
}

TEST(RevisionWatchers, ComeAndGoWhileTheyAreWoken) {
  RevisionWatchers watchers;
  std::atomic<bool> stop = false;
  std::thread notifier([&] {
    while (!stop) watchers.Notify("a");
  });
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&] {
      for (int k = 0; k < 500; ++k) {
        int woken = 0;
        const RevisionWatchers::Watcher watcher(watchers, "a",
                                                [&woken] { ++woken; });
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  stop = true;
  notifier.join();
}

TEST(WatchRevisions, GivesEachRevisionOnceItIsThere) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  std::atomic<int> woken = 0;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      auto cursor, service->WatchRevisions("map", 0, [&] { ++woken; }));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto first, cursor->Next());
  ASSERT_TRUE(first.has_value());
  EXPECT_EQ(first->number, 1);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto none, cursor->Next());
  EXPECT_FALSE(none.has_value());
  EXPECT_EQ(woken, 0);

  MAPSIEVE_ASSERT_OK(service.Upload("map", "u", MakeScene(1)));
  EXPECT_GT(woken, 0);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto second, cursor->Next());
  ASSERT_TRUE(second.has_value());
  EXPECT_EQ(second->number, 2);
  EXPECT_EQ(second->upload_id, "u");
  MAPSIEVE_ASSERT_OK(service->RollBack("map", 1));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto third, cursor->Next());
  ASSERT_TRUE(third.has_value());
  EXPECT_EQ(third->kind, RevisionKind::kRollback);

  woken = 0;
  MAPSIEVE_ASSERT_OK(service->DeleteMap("map", false));
  EXPECT_EQ(woken, 1);
  EXPECT_THAT(cursor->Next(),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("map")));
}

TEST(WatchRevisions, BeginsWhereItIsAskedTo) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  const auto wake = [] {};
  EXPECT_THAT(service->WatchRevisions("map", -1, wake),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("from_revision is -1")));
  EXPECT_THAT(service->WatchRevisions("map", 3, wake),
              StatusIs(absl::StatusCode::kOutOfRange,
                       HasSubstr("newest revision of map map is 1")));
  EXPECT_THAT(service->WatchRevisions("other", 1, wake),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("other")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(auto cursor,
                                service->WatchRevisions("map", 2, wake));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto none, cursor->Next());
  EXPECT_FALSE(none.has_value());
}

}  // namespace
}  // namespace mapsieve::engine::testing
