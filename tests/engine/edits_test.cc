// Deletions, replacements and rollbacks give what a map made from the same
// points gives, bit for bit.

#include <algorithm>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "gtest/gtest.h"
#include "server/engine/job_manager.h"
#include "server/engine/revision_report.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::DensityRule;
using core::LatticeCloud;
using mapsieve::testing::StatusIs;
using storage::ChunkKind;
using ::testing::HasSubstr;

constexpr IngestLimits kLimits = {.block_bytes = 1 << 20,
                                  .bucket_bytes = 100'000,
                                  .chunk_bytes = 20'000,
                                  .chunk_count = 100'000};
constexpr ProcessLimits kProcessLimits = {.unit_points = 3000,
                                          .tile_points = 1 << 26,
                                          .pending_bytes = 1 << 20,
                                          .chunk_bytes = 30'000};
constexpr absl::Duration kLong = absl::Minutes(1);

// In MakeScene: cuts tiles, chunks, the wall and the ground.
const RegionShape kBox = Box{{-3.1, -2.7, -1}, {2.2, 4.4, 0.9}};
const Sphere kSphere = {{1.5, 0.3, 0.2}, 2.75};
const RegionShape kNowhere = Box{{100, 100, 100}, {101, 101, 101}};

/// `cloud` without the points in `shape`, tested in plain double.
LatticeCloud Without(const LatticeCloud& cloud, const RegionShape& shape) {
  std::vector<uint32_t> rows;
  for (uint32_t row = 0; row < cloud.size(); ++row) {
    const core::Point3 p = cloud.lattice.Position(cloud.positions[row]);
    bool is_inside = false;
    if (const auto* box = std::get_if<Box>(&shape)) {
      is_inside = box->min.x <= p.x && p.x < box->max.x && box->min.y <= p.y &&
                  p.y < box->max.y && box->min.z <= p.z && p.z < box->max.z;
    } else {
      const auto& sphere = std::get<Sphere>(shape);
      const double dx = p.x - sphere.center.x;
      const double dy = p.y - sphere.center.y;
      const double dz = p.z - sphere.center.z;
      is_inside = dx * dx + dy * dy + dz * dz <= sphere.radius * sphere.radius;
    }
    if (!is_inside) rows.push_back(row);
  }
  return cloud.Select(rows);
}

LatticeCloud Together(const LatticeCloud& a, const LatticeCloud& b) {
  LatticeCloud all = a;
  EXPECT_TRUE(
      all.attributes.AppendAll(all.size(), b.attributes, b.size()).ok());
  all.positions.insert(all.positions.end(), b.positions.begin(),
                       b.positions.end());
  return all;
}

std::vector<storage::ChunkRef> Chunks(Workshop& workshop, ChunkKind kind,
                                      int64_t revision) {
  const auto chunks = workshop.store().catalogue().ListChunks(
      workshop.map().uid, revision, kind, std::nullopt, std::nullopt, 100'000);
  EXPECT_TRUE(chunks.ok()) << chunks.status();
  return *chunks;
}

void ExpectRaw(Workshop& workshop, const LatticeCloud& expected) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer raw,
                                workshop.Query({.raw = true}));
  ExpectSameCloud(InCanonicalOrder(raw.points), InCanonicalOrder(expected));
}

TEST(DeleteRegion, OfAllPointsMakesAnEmptyResult) {
  Workshop workshop(11);
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(57), kLimits));
  MAPSIEVE_ASSERT_OK(workshop.Process({}, kProcessLimits));
  MAPSIEVE_ASSERT_OK(
      workshop.Delete(Box{{-100, -100, -100}, {100, 100, 100}}, kLimits));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ProcessReport report,
                                workshop.Process({}, kProcessLimits));
  EXPECT_EQ(report.distinct_point_count, 0);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
  EXPECT_EQ(answer.points.size(), 0U);
  EXPECT_EQ(answer.header.revision, report.revision);
}

TEST(DeleteRegion, ThenProcessingIsAMapOfTheRest) {
  const LatticeCloud scene = MakeScene(51);
  const core::SpdfOptions options = SceneOptions(DensityRule::kPaper);
  for (const RegionShape& region : {kBox, RegionShape(kSphere)}) {
    Workshop workshop(11, 3);
    for (const LatticeCloud& part : Split(scene, 3)) {
      MAPSIEVE_ASSERT_OK(workshop.Add(part, kLimits));
    }
    MAPSIEVE_ASSERT_OK(workshop.Process(options, kProcessLimits));
    const LatticeCloud rest = Without(scene, region);
    ASSERT_LT(rest.size(), scene.size() - 100);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const DeleteReport report,
                                  workshop.Delete(region, kLimits));
    EXPECT_EQ(report.revision, 6);
    EXPECT_EQ(report.removed_point_count,
              static_cast<int64_t>(scene.size() - rest.size()));
    ExpectRaw(workshop, rest);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const storage::RevisionRecord revision,
        workshop.store().catalogue().GetRevision(workshop.map().uid, 6));
    EXPECT_EQ(revision.totals.stale_tile_count, report.tile_count);
    EXPECT_GT(report.tile_count, 3);
    EXPECT_LT(report.tile_count, revision.totals.tile_count);
    // Chunks away from the region are shared.
    const auto before = Chunks(workshop, ChunkKind::kRaw, 5);
    const auto after = Chunks(workshop, ChunkKind::kRaw, 6);
    int64_t shared_count = 0;
    for (const storage::ChunkRef& chunk : before) {
      shared_count += std::count(after.begin(), after.end(), chunk);
    }
    EXPECT_GT(shared_count, static_cast<int64_t>(before.size()) / 3);

    // Queries answer from the old result until the new one is there.
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer old, workshop.Query({}));
    ExpectSameCloud(old.points, FilterLocally(scene, options));
    MAPSIEVE_ASSERT_OK(workshop.Process(options, kProcessLimits));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
    ExpectSameCloud(answer.points, FilterLocally(rest, options));

    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const DeleteReport again,
                                  workshop.Delete(region, kLimits));
    EXPECT_EQ(again, (DeleteReport{.revision = 7}));
    EXPECT_EQ(workshop.map().newest_revision, 7);
  }
}

TEST(DeleteRegion, MayTakeEverythingOrNothing) {
  const LatticeCloud scene = MakeScene(52);
  Workshop workshop(13);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const DeleteReport empty,
                                workshop.Delete(kBox, kLimits));
  EXPECT_EQ(empty, (DeleteReport{.revision = 1}));
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, kLimits));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const DeleteReport nothing,
                                workshop.Delete(kNowhere, kLimits));
  EXPECT_EQ(nothing, (DeleteReport{.revision = 2}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const DeleteReport everything,
      workshop.Delete(Sphere{{0, 0, 0}, 1e9}, kLimits));
  EXPECT_EQ(everything.removed_point_count, static_cast<int64_t>(scene.size()));
  EXPECT_TRUE(Chunks(workshop, ChunkKind::kRaw, 3).empty());
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, kLimits));
  ExpectRaw(workshop, scene);
}

TEST(DeleteRegion, RunAgainTellsWhatItDid) {
  Workshop workshop(12);
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(53), kLimits));
  const JobSpec spec = {.verb = OperationVerb::kDeleteRegion,
                        .map_uid = workshop.map().uid,
                        .region = kSphere,
                        .edit_uid = NewRandomId(),
                        .base_revision = 2};
  const auto workers = MakeWorkerPool(1);
  const ExecutionContext context = {.executor = workers.get()};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const DeleteReport first,
      DeleteStoredRegion(workshop.store(), "map", spec, kLimits, context));
  EXPECT_GT(first.removed_point_count, 0);
  // Others follow, deletions among them.
  MAPSIEVE_ASSERT_OK(workshop.Delete(kBox, kLimits));
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(53), kLimits));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const DeleteReport second,
      DeleteStoredRegion(workshop.store(), "map", spec, kLimits, context));
  EXPECT_EQ(second, first);
  EXPECT_EQ(workshop.map().newest_revision, 5);
  JobSpec other_map = spec;
  other_map.map_uid = std::string(32, '0');
  EXPECT_THAT(
      DeleteStoredRegion(workshop.store(), "map", other_map, kLimits, context),
      StatusIs(absl::StatusCode::kNotFound, HasSubstr("another")));
}

TEST(DeleteRegion, RefusesMoreChunksThanOneCommitTakes) {
  Workshop workshop(11);
  MAPSIEVE_ASSERT_OK(workshop.Add(MakeScene(54), kLimits));
  IngestLimits few = kLimits;
  few.chunk_count = 5;
  EXPECT_THAT(workshop.Delete(kBox, few),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("more than 5 chunks")));
  EXPECT_EQ(workshop.map().newest_revision, 2);
}

/// Asks for a stop once `done` units of work are done.
class StopAt final : public ProgressSink {
 public:
  explicit StopAt(int64_t done) : done_(done) {}
  void Report(int64_t done, int64_t total) override {
    EXPECT_LE(done, total);
    if (done >= done_) stop_.request_stop();
  }
  ExecutionContext Context() {
    return {.stop = stop_.get_token(), .progress = this};
  }

 private:
  const int64_t done_;
  std::stop_source stop_;
};

TEST(DeleteRegion, CancelledAtAnyChunkLeavesTheMapAsItWas) {
  const LatticeCloud scene = MakeScene(55);
  Workshop workshop(11);
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, kLimits));
  int cancelled = 0;
  for (int64_t done = 0;; done += 5) {
    StopAt stop(done);
    const auto report = workshop.Delete(kBox, kLimits, stop.Context());
    if (report.ok()) break;
    EXPECT_THAT(report, StatusIs(absl::StatusCode::kCancelled, HasSubstr("")));
    ++cancelled;
    EXPECT_EQ(workshop.map().newest_revision, 2);
  }
  EXPECT_GT(cancelled, 2);
  ExpectRaw(workshop, Without(scene, kBox));
}

TEST(DeleteRegion, SurvivesAnyEndOfTheProcess) {
  const LatticeCloud scene = MakeScene(56);
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 1}));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", scene));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation started,
                                service->DeleteRegion("map", kBox));
  EXPECT_EQ(started.verb, OperationVerb::kDeleteRegion);
  service.Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Operation done,
      service->WaitOperation(started.operation_id, kLong));
  MAPSIEVE_ASSERT_OK(done.error);
  service.Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation read,
                                service->GetOperation(started.operation_id));
  ASSERT_TRUE(read.delete_report.has_value());
  EXPECT_EQ(read.delete_report, done.delete_report);
  const LatticeCloud rest = Without(scene, kBox);
  EXPECT_EQ(read.delete_report->removed_point_count,
            static_cast<int64_t>(scene.size() - rest.size()));
  EXPECT_EQ(service->GetMap("map")->revision, 3);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer raw,
                                service.Query({.map_id = "map", .raw = true}));
  ExpectSameCloud(InCanonicalOrder(raw.points), InCanonicalOrder(rest));
}

TEST(DeleteRegion, RefusesWhatIsNoRegionOrNoMap) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  EXPECT_THAT(
      service->DeleteRegion("map", Sphere{{0, 0, 0}, -1}),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("radius")));
  EXPECT_THAT(service->DeleteRegion("other", kBox),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("other")));
  EXPECT_THAT(
      service->FinalizeUpload("map", "u", Box{{1, 1, 1}, {0, 2, 2}}),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("box.min.x")));
}

TEST(ReplaceRegion, IsOneRevisionAndThenAMapOfTheResult) {
  const LatticeCloud scene = MakeScene(58);
  const LatticeCloud news = Split(MakeScene(59), 3)[1];
  const core::SpdfOptions options = SceneOptions(DensityRule::kQuota);
  Workshop workshop(12, 2);
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, kLimits));
  MAPSIEVE_ASSERT_OK(workshop.Process(options, kProcessLimits));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadReport report,
                                workshop.Add(news, kLimits, kSphere));
  const LatticeCloud rest = Without(scene, kSphere);
  EXPECT_EQ(report.revision, 4);
  EXPECT_EQ(report.added_point_count, static_cast<int64_t>(news.size()));
  EXPECT_EQ(report.removed_point_count,
            static_cast<int64_t>(scene.size() - rest.size()));
  EXPECT_EQ(workshop.map().newest_revision, 4);
  // The new points stay, wherever they lie.
  const LatticeCloud result = Together(rest, news);
  ExpectRaw(workshop, result);
  MAPSIEVE_ASSERT_OK(workshop.Process(options, kProcessLimits));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, workshop.Query({}));
  ExpectSameCloud(answer.points, FilterLocally(result, options));
}

TEST(ReplaceRegion, OnceHoweverOftenItIsAskedFor) {
  const LatticeCloud scene = MakeScene(60);
  const LatticeCloud news = Split(scene, 10)[0];
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 2}));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", scene));
  MAPSIEVE_ASSERT_OK(service.Stage("map", "news", MakeUpload(news)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation started,
                                service->FinalizeUpload("map", "news", kBox));
  service.Reopen();
  for (int i = 0; i < 2; ++i) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation done,
                                  service.Finalize("map", "news", kBox));
    MAPSIEVE_ASSERT_OK(done.error);
    EXPECT_EQ(done.operation_id, started.operation_id);
    EXPECT_EQ(done.upload_report->revision, 3);
    service.Reopen();
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer raw,
                                service.Query({.map_id = "map", .raw = true}));
  ExpectSameCloud(InCanonicalOrder(raw.points),
                  InCanonicalOrder(Together(Without(scene, kBox), news)));
}

TEST(ReplaceRegion, DamageOfTheMapIsNotThatOfTheUpload) {
  const LatticeCloud scene = MakeScene(65);
  Workshop workshop(12);
  MAPSIEVE_ASSERT_OK(workshop.Add(scene, kLimits));
  const auto chunks = workshop.Chunks(ChunkKind::kRaw);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Region region,
                                Region::OfEdit(kSphere, scene.lattice));
  const auto cut =
      std::find_if(chunks.begin(), chunks.end(), [&](const auto& chunk) {
        return region.Intersects(chunk.bounds) &&
               !region.Encloses(chunk.bounds);
      });
  ASSERT_NE(cut, chunks.end());
  workshop.DamageBlob(cut->blob_id);
  const LatticeCloud news = Split(MakeScene(66), 5)[0];
  EXPECT_THAT(workshop.Add(news, kLimits, kSphere),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr(cut->blob_id)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto upload,
      workshop.store().catalogue().GetUpload(workshop.map().uid, "upload-1"));
  EXPECT_EQ(upload.state, storage::UploadState::kActive);
  // It is added once the damage is gone.
  workshop.DamageBlob(cut->blob_id);
  MAPSIEVE_ASSERT_OK(
      AddUpload(workshop.store(), "map", upload.uid, kSphere, kLimits, {}));
  ExpectRaw(workshop, Together(Without(scene, kSphere), news));
}

/// All that a query of a revision says, but for the number of the revision.
void ExpectSameAnswers(Service& service, int64_t actual, int64_t expected) {
  for (QuerySpec spec :
       {QuerySpec{}, QuerySpec{.raw = true}, QuerySpec{.region = kSphere},
        QuerySpec{.labels = {core::Label::kSurface}, .max_points = 300}}) {
    spec.map_id = "map";
    spec.revision = expected;
    const auto want = service.Query(spec);
    spec.revision = actual;
    const auto have = service.Query(spec);
    ASSERT_EQ(have.status().code(), want.status().code());
    if (!want.ok()) continue;
    EXPECT_EQ(have->header.columns, want->header.columns);
    EXPECT_EQ(have->summary.label_counts, want->summary.label_counts);
    ExpectSameCloud(have->points, want->points);
  }
}

TEST(RollBack, AnswersAsTheRevisionThatItRestored) {
  const LatticeCloud scene = MakeScene(61);
  LatticeCloud bare = MakeScene(62);
  bare.attributes.columns().clear();
  const core::SpdfOptions paper = SceneOptions(DensityRule::kPaper);
  const core::SpdfOptions quota = SceneOptions(DensityRule::kQuota);
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 4}));
  std::map<int64_t, MapStats> stats;
  const auto remember = [&] {
    const auto now = service->GetMapStats("map");
    ASSERT_TRUE(now.ok()) << now.status();
    stats[now->revision] = *now;
  };
  remember();
  MAPSIEVE_ASSERT_OK(service.Upload("map", "bare", bare));
  remember();
  MAPSIEVE_ASSERT_OK(service.Process("map", paper));
  remember();
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", scene));
  remember();
  MAPSIEVE_ASSERT_OK(service.Delete("map", kBox));
  remember();
  MAPSIEVE_ASSERT_OK(service.Process("map", quota));
  remember();
  MAPSIEVE_ASSERT_OK(service.Delete("map", kSphere));
  remember();
  for (const int64_t target : {3, 4, 7, 2, 6, 1, 5, 9}) {
    const int64_t newest = service->GetMap("map")->revision;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RevisionInfo made,
                                  service->RollBack("map", target));
    ASSERT_EQ(made.number, newest + 1);
    EXPECT_EQ(made.kind, RevisionKind::kRollback);
    EXPECT_EQ(made.restored_revision, target);
    // 9 is a rollback to 4.
    MapStats expected = stats[target == 9 ? 4 : target];
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapStats now,
                                  service->GetMapStats("map"));
    EXPECT_EQ(now.processed_revision, expected.processed_revision);
    EXPECT_EQ(now.raw_point_count, expected.raw_point_count);
    EXPECT_EQ(now.point_count, expected.point_count);
    EXPECT_EQ(now.stale_tile_count, expected.stale_tile_count);
    EXPECT_EQ(now.stored_bytes, expected.stored_bytes);
    EXPECT_EQ(now.bounds, expected.bounds);
    EXPECT_EQ(now.attributes, expected.attributes);
    EXPECT_EQ(now.options, expected.options);
    ExpectSameAnswers(service, made.number, target);
    // Again makes nothing.
    EXPECT_EQ(service->RollBack("map", target)->number, made.number);
    EXPECT_EQ(service->RollBack("map", made.number)->number, made.number);
  }
  // The newest equals 4: processed as that would be, with the options of 3.
  MAPSIEVE_ASSERT_OK(service.Process("map"));
  EXPECT_EQ(service->GetMapStats("map")->options, paper);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                service.Query({.map_id = "map"}));
  ExpectSameCloud(answer.points, FilterLocally(Together(scene, bare), paper));
  // Nothing to do where nothing was stale.
  MAPSIEVE_ASSERT_OK(service->RollBack("map", 6));
  const int64_t newest = service->GetMap("map")->revision;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation nothing,
                                service.Process("map"));
  EXPECT_EQ(nothing.process_report->revision, 6);
  EXPECT_EQ(service->GetMap("map")->revision, newest);
}

TEST(RollBack, TheSameUploadCanBeMadeAgain) {
  const LatticeCloud scene = MakeScene(63);
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", scene));
  MAPSIEVE_ASSERT_OK(service->RollBack("map", 1));
  EXPECT_EQ(service->GetMapStats("map")->raw_point_count, 0);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation again,
                                service.Upload("map", "scan", scene));
  EXPECT_EQ(again.upload_report->revision, 4);
  EXPECT_EQ(service->GetMapStats("map")->raw_point_count,
            static_cast<int64_t>(scene.size()));
}

TEST(RollBack, IsRefusedWhereItCannotBe) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 1}));
  EXPECT_THAT(service->RollBack("other", 1),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("other")));
  for (const int64_t number : {-3, 0, 2}) {
    EXPECT_THAT(service->RollBack("map", number),
                StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("1 to 1")));
  }
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", MakeScene(64)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Operation run,
      service->ProcessMap("map", SceneOptions(DensityRule::kPaper)));
  EXPECT_THAT(service->RollBack("map", 1),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("not done")));
  MAPSIEVE_ASSERT_OK(service->WaitOperation(run.operation_id, kLong));
  MAPSIEVE_EXPECT_OK(service->RollBack("map", 1));
}

TEST(Revisions, SayWhatMadeThem) {
  const LatticeCloud scene = MakeScene(65);
  const LatticeCloud news = Split(scene, 5)[2];
  const core::SpdfOptions options = SceneOptions(DensityRule::kQuota);
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 2}));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", scene));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation run,
                                service.Process("map", options));
  MAPSIEVE_ASSERT_OK(service.Delete("map", kBox));
  MAPSIEVE_ASSERT_OK(service.Stage("map", "news", MakeUpload(news)));
  MAPSIEVE_ASSERT_OK(service.Finalize("map", "news", kSphere));
  MAPSIEVE_ASSERT_OK(service->RollBack("map", 3));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(Page<RevisionInfo> page,
                                service->ListRevisions("map", {}));
  std::vector<RevisionInfo>& r = page.items;
  ASSERT_EQ(r.size(), 6U);
  std::reverse(r.begin(), r.end());
  const auto all = static_cast<int64_t>(scene.size());
  const auto added = static_cast<int64_t>(news.size());
  const auto rest = static_cast<int64_t>(Without(scene, kBox).size());
  const auto replaced =
      static_cast<int64_t>(Without(Without(scene, kBox), kSphere).size());
  EXPECT_EQ(r[0].kind, RevisionKind::kCreate);
  EXPECT_EQ(r[1].kind, RevisionKind::kUpload);
  EXPECT_EQ(r[1].upload_id, "scan");
  EXPECT_EQ(r[1].added_point_count, all);
  EXPECT_EQ(r[1].point_count, 0);
  EXPECT_GT(r[1].stored_bytes, 0);
  EXPECT_EQ(r[2].kind, RevisionKind::kProcess);
  EXPECT_EQ(r[2].options, options);
  EXPECT_EQ(r[2].point_count, run.process_report->point_count);
  EXPECT_EQ(r[2].label_counts, run.process_report->label_counts);
  EXPECT_GT(r[2].stored_bytes, r[1].stored_bytes);
  EXPECT_EQ(r[3].kind, RevisionKind::kDeleteRegion);
  EXPECT_EQ(r[3].region, kBox);
  EXPECT_EQ(r[3].removed_point_count, all - rest);
  EXPECT_EQ(r[3].raw_point_count, rest);
  EXPECT_EQ(r[3].processed_revision, 3);
  EXPECT_EQ(r[3].point_count, r[2].point_count);
  EXPECT_GT(r[3].stale_tile_count, 0);
  EXPECT_EQ(r[4].kind, RevisionKind::kReplaceRegion);
  EXPECT_EQ(r[4].upload_id, "news");
  EXPECT_EQ(r[4].region, RegionShape(kSphere));
  EXPECT_EQ(r[4].added_point_count, added);
  EXPECT_EQ(r[4].removed_point_count, rest - replaced);
  EXPECT_EQ(r[4].raw_point_count, replaced + added);
  EXPECT_EQ(r[5].kind, RevisionKind::kRollback);
  EXPECT_EQ(r[5].restored_revision, 3);
  EXPECT_EQ(r[5].added_point_count - r[5].removed_point_count,
            all - replaced - added);
  EXPECT_EQ(r[5].stored_bytes, r[2].stored_bytes);
}

/// What CompareRevisions must tell, from the chunks of both revisions.
std::vector<TileChange> CompareByBruteForce(Workshop& workshop, int64_t base,
                                            int64_t target) {
  using Blobs = std::multiset<storage::BlobId>;
  struct Tile {
    TileChange change;
    Blobs blobs[2][2];
  };
  std::map<core::CellKey, Tile, core::CellKeyLess> tiles;
  for (const bool is_product : {false, true}) {
    for (const bool is_target : {false, true}) {
      for (const storage::ChunkRef& chunk :
           Chunks(workshop, is_product ? ChunkKind::kProduct : ChunkKind::kRaw,
                  is_target ? target : base)) {
        Tile& tile = tiles[chunk.tile];
        tile.blobs[is_product][is_target].insert(chunk.blob_id);
        TileChange& change = tile.change;
        if (!is_product) {
          (is_target ? change.target_raw_point_count
                     : change.base_raw_point_count) += chunk.point_count;
        }
        for (size_t l = 0; l < core::kLabelCount; ++l) {
          (is_target ? change.target_label_counts
                     : change.base_label_counts)[l] += chunk.label_counts[l];
        }
      }
    }
  }
  const auto kind = [](const Blobs(&blobs)[2]) {
    if (blobs[0] == blobs[1]) return TileChangeKind::kNone;
    if (blobs[0].empty()) return TileChangeKind::kAdded;
    return blobs[1].empty() ? TileChangeKind::kRemoved
                            : TileChangeKind::kChanged;
  };
  std::vector<TileChange> changes;
  for (auto& [key, tile] : tiles) {
    tile.change.tile = key;
    tile.change.raw = kind(tile.blobs[0]);
    tile.change.product = kind(tile.blobs[1]);
    if (tile.change.raw != TileChangeKind::kNone ||
        tile.change.product != TileChangeKind::kNone) {
      changes.push_back(tile.change);
    }
  }
  return changes;
}

TEST(CompareRevisions, TellsWhichTilesDiffer) {
  const LatticeCloud scene = MakeScene(66);
  const core::SpdfOptions options = SceneOptions(DensityRule::kQuota);
  Workshop workshop(11);
  MAPSIEVE_ASSERT_OK(workshop.Add(Without(scene, kSphere), kLimits));
  MAPSIEVE_ASSERT_OK(workshop.Process(options, kProcessLimits));
  MAPSIEVE_ASSERT_OK(workshop.Add(Split(scene, 9)[0], kLimits));
  MAPSIEVE_ASSERT_OK(workshop.Delete(kBox, kLimits));
  MAPSIEVE_ASSERT_OK(workshop.Process(options, kProcessLimits));
  MAPSIEVE_ASSERT_OK(
      workshop.store().catalogue().RollBack(workshop.map().uid, 4));
  size_t most = 0;
  for (int64_t base = 1; base <= 7; ++base) {
    for (int64_t target = 1; target <= 7; ++target) {
      std::vector<TileChange> actual;
      std::string token;
      do {
        MAPSIEVE_ASSERT_OK_AND_ASSIGN(
            const RevisionComparison part,
            engine::CompareRevisions(workshop.store(), "map", base, target, 7,
                                     token));
        EXPECT_LE(part.tiles.items.size(), 7U);
        EXPECT_EQ(part.base.number, base);
        EXPECT_EQ(part.target.number, target);
        actual.insert(actual.end(), part.tiles.items.begin(),
                      part.tiles.items.end());
        token = part.tiles.next_page_token;
      } while (!token.empty());
      EXPECT_EQ(actual, CompareByBruteForce(workshop, base, target))
          << base << " and " << target;
      most = std::max(most, actual.size());
    }
  }
  EXPECT_GT(most, 30U);
  for (const std::string token : {"x", "1,2", "1,2,", "1,2,3,4", "1,2,3 "}) {
    EXPECT_THAT(
        engine::CompareRevisions(workshop.store(), "map", 1, 2, 7, token),
        StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("page_token")));
  }
  for (const int64_t number : {-1, 0, 8}) {
    EXPECT_THAT(
        engine::CompareRevisions(workshop.store(), "map", number, 1, 7, ""),
        StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("")));
    EXPECT_THAT(
        engine::CompareRevisions(workshop.store(), "map", 1, number, 7, ""),
        StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("")));
  }
}

}  // namespace
}  // namespace mapsieve::engine::testing
