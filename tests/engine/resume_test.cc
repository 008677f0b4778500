// A run of the filter goes on where another one was stopped or killed.

#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <string>
#include <vector>

#include "core/base/bytes.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/engine/run_checkpoint.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using ::mapsieve::testing::FaultFileSystem;
using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

using core::LatticeCloud;

std::string Text(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

std::string ReadFile(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void WriteFile(const std::filesystem::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << text;
}

/// Visits 0, 1, … that each store some of three states.
class CheckpointTest : public ::testing::Test {
 protected:
  absl::StatusOr<std::unique_ptr<RunCheckpoint>> Open(
      const std::string& key = "key") {
    return RunCheckpoint::Open(
        storage::Scratch::OpenLasting(files_, directory_, reserve_), key);
  }

  static absl::Status MakeVisit(RunCheckpoint& checkpoint) {
    const size_t visit = checkpoint.finished().size();
    for (size_t s = 0; s < 3; ++s) {
      if ((visit + s) % 3 == 2) continue;
      MAPSIEVE_RETURN_IF_ERROR(
          checkpoint.Store(Name(s), TextBytes(Content(s, visit))));
    }
    return checkpoint.FinishVisit(TextBytes(absl::StrCat("visit ", visit)));
  }

  static std::string Name(size_t s) { return absl::StrCat("state-", s); }
  static std::string Content(size_t s, size_t visit) {
    return absl::StrCat("content ", s, " of visit ", visit);
  }

  /// The states are those of the last finished visit.
  static void ExpectWhole(const RunCheckpoint& checkpoint) {
    const size_t visits = checkpoint.finished().size();
    for (size_t v = 0; v < visits; ++v) {
      EXPECT_EQ(Text(checkpoint.finished()[v]), absl::StrCat("visit ", v));
    }
    for (size_t s = 0; s < 3; ++s) {
      std::string expected;
      for (size_t v = 0; v < visits; ++v) {
        if ((v + s) % 3 != 2) expected = Content(s, v);
      }
      std::string state(expected.size(), ' ');
      const std::array parts = {
          storage::ByteRange{0, static_cast<int64_t>(state.size())}};
      const absl::Status loaded = checkpoint.Load(
          Name(s), parts,
          std::as_writable_bytes(std::span(state.data(), state.size())));
      if (expected.empty()) {
        EXPECT_THAT(loaded,
                    StatusIs(absl::StatusCode::kNotFound, HasSubstr("")));
      } else {
        MAPSIEVE_EXPECT_OK(loaded);
        EXPECT_EQ(state, expected);
      }
    }
  }

  storage::TemporaryDirectory dir_;
  const std::string directory_ = dir_.path() + "/run";
  FaultFileSystem files_{storage::PosixFileSystem()};
  const storage::SpaceReserve reserve_{files_, dir_.path(), 0};
};

TEST_F(CheckpointTest, AfterAKillAtAnyFileOperationTheLastVisitIsThere) {
  for (int64_t operation = 1;; ++operation) {
    SCOPED_TRACE(operation);
    std::filesystem::remove_all(directory_);
    files_.Arm({.operation = operation,
                .status = absl::UnavailableError("killed"),
                .lasts = true});
    size_t finished = 0;
    bool completed = false;
    {
      const auto checkpoint = Open();
      if (checkpoint.ok()) {
        absl::Status status;
        for (int i = 0; i < 6 && status.ok(); ++i) {
          status = MakeVisit(**checkpoint);
        }
        finished = (*checkpoint)->finished().size();
        completed = status.ok();
      }
    }
    files_.Disarm();
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto again, Open());
    EXPECT_EQ(again->finished().size(), finished);
    ExpectWhole(*again);
    // And what follows is kept too.
    MAPSIEVE_ASSERT_OK(MakeVisit(*again));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto third, Open());
    EXPECT_EQ(third->finished().size(), finished + 1);
    ExpectWhole(*third);
    if (completed) break;
  }
}

TEST_F(CheckpointTest, DamageOfAnyByteIsFound) {
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto checkpoint, Open());
    for (int i = 0; i < 4; ++i) MAPSIEVE_ASSERT_OK(MakeVisit(*checkpoint));
  }
  std::map<std::filesystem::path, std::string> whole;
  for (const auto& entry : std::filesystem::directory_iterator(directory_)) {
    whole[entry.path()] = ReadFile(entry.path());
  }
  ASSERT_EQ(whole.size(), 5u);
  const auto restore = [&] {
    std::filesystem::remove_all(directory_);
    std::filesystem::create_directory(directory_);
    for (const auto& [path, text] : whole) WriteFile(path, text);
  };
  for (const auto& [path, text] : whole) {
    for (size_t i = 0; i < text.size(); ++i) {
      SCOPED_TRACE(absl::StrCat(path.string(), " byte ", i));
      for (const bool cut : {false, true}) {
        restore();
        std::string damaged = cut ? text.substr(0, i) : text;
        if (!cut) damaged[i] = static_cast<char>(damaged[i] ^ 4);
        WriteFile(path, damaged);
        MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto checkpoint, Open());
        EXPECT_LT(checkpoint->finished().size(), 4u);
        ExpectWhole(*checkpoint);
      }
    }
  }
  restore();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto same, Open());
  EXPECT_EQ(same->finished().size(), 4u);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto other, Open("another run"));
  EXPECT_EQ(other->finished().size(), 0u);
  ExpectWhole(*other);
}

TEST(Resume, ARunThatWasStoppedMakesNoVisitAgain) {
  constexpr ProcessLimits kLimits = {.unit_points = 2000,
                                     .tile_points = 1 << 26,
                                     .pending_bytes = 1 << 20,
                                     .chunk_bytes = 30'000};
  const LatticeCloud scene = MakeScene(45);
  for (const auto rule :
       {core::DensityRule::kPaper, core::DensityRule::kQuota}) {
    const core::SpdfOptions options = SceneOptions(rule);
    const auto log_of = [](Workshop& workshop) {
      return ReadFile(workshop.path() + "/data/runs/" + workshop.map().uid +
                      "/log");
    };
    Workshop whole(12);
    MAPSIEVE_ASSERT_OK(whole.Add(scene, IngestLimits::Of(1 << 25)));
    MAPSIEVE_ASSERT_OK(whole.Process(options, kLimits));
    const std::string whole_log = log_of(whole);
    for (const int64_t stop_at : {30, 80}) {
      SCOPED_TRACE(absl::StrCat("stopped at ", stop_at));
      Workshop workshop(12);
      MAPSIEVE_ASSERT_OK(workshop.Add(scene, IngestLimits::Of(1 << 25)));
      StopAfter stop(stop_at);
      EXPECT_THAT(workshop.Process(options, kLimits, stop.Context()),
                  StatusIs(absl::StatusCode::kCancelled, HasSubstr("")));
      const std::string log = log_of(workshop);
      ASSERT_GT(log.size(), 0u);
      ASSERT_LT(log.size(), whole_log.size());
      EXPECT_EQ(log, whole_log.substr(0, log.size()));
      MAPSIEVE_ASSERT_OK(workshop.Process(options, kLimits));
      EXPECT_EQ(log_of(workshop), whole_log);
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
      ExpectSameCloud(answer.points, FilterLocally(scene, options));
    }
  }
}

TEST(Resume, AServiceKeepsWhatAnUnfinishedRunNeedsAndNothingElse) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 8}));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", MakeScene(46)));
  const std::filesystem::path runs = service.path() + "/data/runs";
  std::filesystem::create_directories(runs / "of-a-map-that-is-gone");
  service.Reopen();
  EXPECT_FALSE(std::filesystem::exists(runs / "of-a-map-that-is-gone"));
  // A map that is one unit puts nothing aside.
  std::filesystem::remove(runs);
  MAPSIEVE_ASSERT_OK(service.Process("map"));
  EXPECT_FALSE(std::filesystem::exists(runs));
}

}  // namespace
}  // namespace mapsieve::engine::testing
