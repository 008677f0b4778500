// What the service does without space, and to save it.

#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "absl/time/clock.h"
#include "gtest/gtest.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::LatticeCloud;
using mapsieve::testing::FaultFileSystem;
using mapsieve::testing::StatusIs;
using ::testing::AllOf;
using ::testing::HasSubstr;

const auto kFull =
    StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("free"));
const RegionShape kEverywhere = Box{{-99, -99, -99}, {99, 99, 99}};
const RegionShape kBox = Box{{-3, -2, -1}, {2, 4, 1}};

TEST(FullDisk, StopsWhatWritesAndNothingElseUntilSpaceReturns) {
  FaultFileSystem files(storage::PosixFileSystem());
  Service service;
  service.options().file_system = &files;
  service.Reopen();
  const LatticeCloud scene = MakeScene(41);
  for (const char* map : {"map", "other"}) {
    MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = map, .tile_edge = 4}));
    MAPSIEVE_ASSERT_OK(service.Upload(map, "scan", scene));
  }
  MAPSIEVE_ASSERT_OK(service.Process("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer before,
                                service.Query({.map_id = "map"}));
  MAPSIEVE_ASSERT_OK(
      service->CreateUpload("map", {.upload_id = "more",
                                    .expected_bytes = 3,
                                    .content_hash = std::string(32, '0')}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                service->OpenUploadWriter("map", "more"));
  MAPSIEVE_EXPECT_OK(service->CheckSpace());

  // The reserve is whole, and nearly nothing more.
  files.SetFreeBytes((int64_t{64} << 20) + 2);
  EXPECT_THAT(service->CheckSpace(), kFull);
  const std::vector<std::byte> bytes(3);
  EXPECT_THAT(writer->Append(0, bytes), kFull);
  EXPECT_THAT(service->CreateMap({.map_id = "new"}), kFull);
  EXPECT_THAT(service->RollBack("map", 2), kFull);
  EXPECT_THAT(service.Process("other"), kFull);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer meanwhile,
                                service.Query({.map_id = "map"}));
  ExpectSameCloud(meanwhile.points, before.points);
  MAPSIEVE_EXPECT_OK(service->GetMapStats("map"));
  MAPSIEVE_EXPECT_OK(service.Delete("map", kEverywhere));
  EXPECT_EQ(service->GetMapStats("map")->raw_point_count, 0);
  MAPSIEVE_EXPECT_OK(service->DeleteMap("other", false));

  files.SetFreeBytes(int64_t{1} << 40);
  MAPSIEVE_EXPECT_OK(service->CheckSpace());
  MAPSIEVE_EXPECT_OK(writer->Append(0, bytes));
  MAPSIEVE_EXPECT_OK(writer->Commit());
  MAPSIEVE_EXPECT_OK(service->CreateMap({.map_id = "new"}));
  MAPSIEVE_EXPECT_OK(service.Upload("new", "scan", scene));
}

class RetentionTest : public ::testing::Test {
 protected:
  RetentionTest() {
    keeping_.options().kept_revision_count = 3;
    keeping_.Reopen();
    for (Service* service : {&keeping_, &twin_}) {
      EXPECT_THAT((*service)->CreateMap({.map_id = "map", .tile_edge = 4}),
                  mapsieve::testing::IsOk());
    }
  }

  /// Does the same to the service that keeps 3 revisions and to one that keeps
  /// all, and waits until the first has expired what it does not keep.
  template <typename Step>
  void Both(const Step& step) {
    for (Service* service : {&keeping_, &twin_}) step(*service);
    const absl::Time end = absl::Now() + absl::Seconds(30);
    while (Kept() != ExpectedKept()) {
      ASSERT_LT(absl::Now(), end);
      absl::SleepFor(absl::Milliseconds(5));
    }
  }

  std::set<int64_t> Kept() {
    std::set<int64_t> kept;
    const auto revisions = keeping_->ListRevisions("map", {})->items;
    for (const RevisionInfo& revision : revisions) {
      if (!revision.is_expired) kept.insert(revision.number);
    }
    return kept;
  }

  std::set<int64_t> ExpectedKept() {
    std::set<int64_t> kept;
    const auto revisions = twin_->ListRevisions("map", {.page_size = 3})->items;
    for (const RevisionInfo& revision : revisions) {
      kept.insert(revision.number);
      if (revision.processed_revision == 0) continue;
      kept.insert(revision.processed_revision);
    }
    return kept;
  }

  void ExpectSameAnswers(int64_t revision) {
    for (const bool raw : {false, true}) {
      const QuerySpec spec = {
          .map_id = "map", .revision = revision, .raw = raw};
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer kept, keeping_.Query(spec));
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer whole, twin_.Query(spec));
      ExpectSameCloud(kept.points, whole.points);
    }
  }

  Service keeping_;
  Service twin_;
};

TEST_F(RetentionTest, KeptRevisionsAreAsIfAllWereKept) {
  const std::vector<LatticeCloud> parts = Split(MakeScene(43), 12);
  const auto upload = [&](size_t i) {
    return [&parts, i](Service& service) {
      MAPSIEVE_ASSERT_OK(
          service.Upload("map", "part" + std::to_string(i), parts[i]));
    };
  };
  const auto process = [](Service& service) {
    MAPSIEVE_EXPECT_OK(
        service.Process("map", SceneOptions(core::DensityRule::kPaper)));
  };
  const auto remove = [](Service& service) {
    MAPSIEVE_EXPECT_OK(service.Delete("map", kBox));
  };
  const auto roll_back = [](int64_t revision) {
    return [revision](Service& service) {
      MAPSIEVE_EXPECT_OK(service->RollBack("map", revision));
    };
  };
  Both(upload(0));  // 2
  std::string resume_token;
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto cursor, keeping_->Query({.map_id = "map", .raw = true}, {}));
    MAPSIEVE_ASSERT_OK(cursor->NextBatch());
    resume_token = cursor->resume_token();
  }
  Both(process);
  Both(upload(1));  // 4
  Both(remove);
  Both(upload(2));  // 6
  Both(upload(3));
  EXPECT_EQ(keeping_->GetMapStats("map")->oldest_revision, 3);
  for (const int64_t expired : {1, 2, 4}) {
    const auto refused =
        StatusIs(absl::StatusCode::kOutOfRange,
                 AllOf(HasSubstr("expired"), HasSubstr("kept is 3")));
    EXPECT_THAT(
        keeping_.Query({.map_id = "map", .revision = expired, .raw = true}),
        refused);
    EXPECT_THAT(keeping_->RollBack("map", expired), refused);
    EXPECT_THAT(keeping_->CompareRevisions("map", expired, 7, {}), refused);
  }
  const QuerySpec resumed = {
      .map_id = "map", .raw = true, .resume_token = resume_token};
  EXPECT_THAT(
      keeping_.Query(resumed),
      StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("revision 2 expired")));
  MAPSIEVE_EXPECT_OK(
      twin_.Query({.map_id = "map", .revision = 2, .raw = true}));
  for (const int64_t kept : {3, 5, 6, 7}) ExpectSameAnswers(kept);
  EXPECT_EQ(keeping_->CompareRevisions("map", 3, 7, {})->tiles.items.size(),
            twin_->CompareRevisions("map", 3, 7, {})->tiles.items.size());
  const MapStats kept = *keeping_->GetMapStats("map");
  const MapStats whole = *twin_->GetMapStats("map");
  EXPECT_EQ(kept.stored_bytes, whole.stored_bytes);
  EXPECT_LT(kept.reclaimable_bytes, whole.reclaimable_bytes);

  // An update from a product that is older than the newest three.
  Both(process);  // 8
  ExpectSameAnswers(8);
  Both(roll_back(7));
  EXPECT_EQ(keeping_->GetMapStats("map")->stale_tile_count,
            twin_->GetMapStats("map")->stale_tile_count);
  Both(remove);  // 10
  Both(roll_back(9));
  Both(remove);  // 12
  EXPECT_EQ(keeping_->GetMapStats("map")->stale_tile_count,
            twin_->GetMapStats("map")->stale_tile_count);
  Both(process);
  for (const int64_t revision : {11, 12, 13}) ExpectSameAnswers(revision);
  keeping_.Reopen();
  ExpectSameAnswers(13);
  const auto revisions = keeping_->ListRevisions("map", {})->items;
  ASSERT_EQ(revisions.size(), 13u);
  EXPECT_FALSE(revisions[0].is_expired);
  EXPECT_TRUE(revisions[12].is_expired);

  // A repair that does not get far goes through all that are kept.
  for (const auto& entry : std::filesystem::recursive_directory_iterator(
           keeping_.path() + "/data/blobs")) {
    if (entry.is_regular_file()) storage::WriteWholeFile(entry.path(), "");
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation started,
                                keeping_->RepairMap("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Operation done,
      keeping_->WaitOperation(started.operation_id, absl::Minutes(1)));
  MAPSIEVE_ASSERT_OK(done.error);
  ASSERT_TRUE(done.repair_report.has_value());
  EXPECT_GT(done.repair_report->raw_chunk_count, 0);
  EXPECT_EQ(done.repair_report->repaired_chunk_count, 0);
  EXPECT_THAT(done.repair_report->obstacle, HasSubstr("revision 13"));
}

}  // namespace
}  // namespace mapsieve::engine::testing
