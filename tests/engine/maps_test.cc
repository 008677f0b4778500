#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <future>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "server/engine/engine.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::LatticeCloud;
using mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;

TEST(EngineOptions, AreChecked) {
  EXPECT_THAT(Engine::Open({}), StatusIs(kInvalid, HasSubstr("data_dir")));
  EXPECT_THAT(Engine::Open({.data_dir = "x", .memory_bytes = 1}),
              StatusIs(kInvalid, HasSubstr("memory_bytes is 1")));
  EXPECT_THAT(Engine::Open({.data_dir = "x", .worker_count = 0}),
              StatusIs(kInvalid, HasSubstr("worker_count is 0")));
  EXPECT_THAT(Engine::Open({.data_dir = "x", .max_queued_operations = 0}),
              StatusIs(kInvalid, HasSubstr("max_queued_operations")));
  EXPECT_THAT(Engine::Open({.data_dir = "x", .max_finished_operations = -1}),
              StatusIs(kInvalid, HasSubstr("max_finished_operations")));
}

TEST(Engine, OneAtATimeHasADirectory) {
  Service service;
  EXPECT_THAT(Engine::Open(service.options()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("")));
}

TEST(Engine, TellsThatACollectionFailed) {
  std::promise<absl::Status> failed;
  std::future<absl::Status> told = failed.get_future();
  Service service;
  service.Close();
  service.options().on_collection_failure = [&](const absl::Status& error) {
    failed.set_value(error);
  };
  // Of the name of a blob, but nothing that can be removed as one.
  const std::string blob =
      service.options().data_dir + "/blobs/00/" + std::string(32, '0');
  std::filesystem::create_directories(blob);
  service.Reopen();
  ASSERT_EQ(told.wait_for(std::chrono::minutes(1)), std::future_status::ready);
  EXPECT_THAT(told.get(),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr(blob)));
}

TEST(Maps, CreateFillsInDefaultsAndRoundsTheTileUp) {
  Service service;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const MapInfo campus, service->CreateMap({.map_id = "campus",
                                                .display_name = "Campus, north",
                                                .crs_wkt = "PROJCRS[]",
                                                .frame_id = "map"}));
  EXPECT_EQ(campus.map_id, "campus");
  EXPECT_EQ(campus.step_nm, 1'000'000);
  EXPECT_EQ(campus.tile_level, 15);
  EXPECT_EQ(campus.display_name, "Campus, north");
  EXPECT_EQ(campus.crs_wkt, "PROJCRS[]");
  EXPECT_EQ(campus.frame_id, "map");
  EXPECT_EQ(campus.revision, 1);
  EXPECT_EQ(campus.processed_revision, 0);
  EXPECT_EQ(campus.uid.size(), 32U);

  struct Case {
    int64_t step_nm;
    double tile_edge;
    int level;
  };
  int number = 0;
  for (const Case& c :
       {Case{1'000'000, 32.768, 15}, Case{1'000'000, 32.7681, 16},
        Case{1'000'000, 1.024, 10}, Case{1'000'000, 1e-9, 4},
        Case{1'000'000, 2097.152, 21}, Case{1'000'000'000, 100, 7},
        Case{1, 1e-6, 10}}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const MapInfo map,
        service->CreateMap({.map_id = absl::StrCat("m", number++),
                            .step_nm = c.step_nm,
                            .tile_edge = c.tile_edge}));
    EXPECT_EQ(map.tile_level, c.level) << c.tile_edge;
  }
}

TEST(Maps, CreateRefusesWhatIsNoMap) {
  Service service;
  for (const char* id :
       {"", "../etc", "Campus", "1st", "a/b", "a-", "-a", "a.b", "maps/a"}) {
    EXPECT_THAT(service->CreateMap({.map_id = id}),
                StatusIs(kInvalid, HasSubstr("")))
        << id;
  }
  EXPECT_THAT(service->CreateMap({.map_id = "a", .step_nm = 0}),
              StatusIs(kInvalid, HasSubstr("step_nm is 0")));
  EXPECT_THAT(service->CreateMap({.map_id = "a", .step_nm = 1'000'000'001}),
              StatusIs(kInvalid, HasSubstr("step_nm")));
  for (const double edge : {-1.0, 2097.153, std::nan("")}) {
    EXPECT_THAT(service->CreateMap({.map_id = "a", .tile_edge = edge}),
                StatusIs(kInvalid, HasSubstr("tile_edge")));
  }
  EXPECT_THAT(service->CreateMap(
                  {.map_id = "a", .display_name = std::string(129, 'x')}),
              StatusIs(kInvalid, HasSubstr("display_name has 129")));
  EXPECT_THAT(
      service->CreateMap({.map_id = "a", .crs_wkt = std::string(65537, 'x')}),
      StatusIs(kInvalid, HasSubstr("crs_wkt")));
  EXPECT_THAT(
      service->CreateMap({.map_id = "a", .frame_id = std::string(256, 'x')}),
      StatusIs(kInvalid, HasSubstr("frame_id")));
  EXPECT_THAT(service->CreateMap({.map_id = "a", .frame_id = "a\nb"}),
              StatusIs(kInvalid, HasSubstr("no control characters")));
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "a"}));
  EXPECT_THAT(service->CreateMap({.map_id = "a"}),
              StatusIs(absl::StatusCode::kAlreadyExists, HasSubstr("a")));
  EXPECT_THAT(service->GetMap("b"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("b")));
}

TEST(Maps, ListComesInPagesById) {
  Service service;
  std::vector<std::string> ids;
  for (const char* id : {"delta", "alpha", "echo", "bravo", "charlie"}) {
    MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = id}));
  }
  PageRequest page = {.page_size = 2};
  int page_count = 0;
  do {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Page<MapInfo> result,
                                  service->ListMaps(page));
    for (const MapInfo& map : result.items) ids.push_back(map.map_id);
    page.page_token = result.next_page_token;
    ++page_count;
  } while (!page.page_token.empty());
  EXPECT_EQ(page_count, 3);
  EXPECT_EQ(ids, (std::vector<std::string>{"alpha", "bravo", "charlie", "delta",
                                           "echo"}));
  // A full last page has no next one.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Page<MapInfo> all,
                                service->ListMaps({.page_size = 5}));
  EXPECT_EQ(all.next_page_token, "");
  EXPECT_THAT(service->ListMaps({.page_size = -1}),
              StatusIs(kInvalid, HasSubstr("page_size")));
}

TEST(Maps, StatsAndRevisionsTellWhatHappened) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map", .tile_edge = 4}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(MapStats stats, service->GetMapStats("map"));
  EXPECT_EQ(stats.revision, 1);
  EXPECT_FALSE(stats.bounds.has_value());
  EXPECT_FALSE(stats.options.has_value());
  EXPECT_EQ(stats.tile_count, 0);

  const LatticeCloud scene = MakeScene(21);
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", scene));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(stats, service->GetMapStats("map"));
  EXPECT_EQ(stats.revision, 2);
  EXPECT_EQ(stats.processed_revision, 0);
  EXPECT_EQ(stats.raw_point_count, static_cast<int64_t>(scene.size()));
  EXPECT_EQ(stats.stale_tile_count, stats.tile_count);
  EXPECT_GT(stats.tile_count, 16);
  ASSERT_TRUE(stats.bounds.has_value());
  core::Point3 min = {1e9, 1e9, 1e9};
  core::Point3 max = {-1e9, -1e9, -1e9};
  for (const core::LatticePoint& q : scene.positions) {
    const core::Point3 p = scene.lattice.Position(q);
    min = {std::min(min.x, p.x), std::min(min.y, p.y), std::min(min.z, p.z)};
    max = {std::max(max.x, p.x), std::max(max.y, p.y), std::max(max.z, p.z)};
  }
  EXPECT_EQ(*stats.bounds, (Bounds{min, max}));
  std::vector<std::string> names;
  for (const auto& column : stats.attributes) names.push_back(column.name);
  EXPECT_EQ(names,
            (std::vector<std::string>{"intensity", "label", "ring", "time"}));
  const int64_t raw_bytes = stats.stored_bytes;
  EXPECT_GT(raw_bytes, 0);

  const core::SpdfOptions options = SceneOptions(core::DensityRule::kPaper);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation operation,
                                service.Process("map", options));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(stats, service->GetMapStats("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer,
                                service.Query({.map_id = "map"}));
  EXPECT_EQ(stats.revision, 3);
  EXPECT_EQ(stats.processed_revision, 3);
  EXPECT_EQ(stats.stale_tile_count, 0);
  EXPECT_EQ(stats.point_count, answer.summary.point_count);
  EXPECT_EQ(stats.label_counts, answer.summary.label_counts);
  EXPECT_EQ(stats.outlier_count, operation.process_report->outlier_count);
  EXPECT_EQ(stats.options, options);
  EXPECT_GT(stats.stored_bytes, raw_bytes);

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Page<RevisionInfo> first,
      service->ListRevisions("map", {.page_size = 2}));
  ASSERT_EQ(first.items.size(), 2U);
  EXPECT_EQ(first.items[0].kind, RevisionKind::kProcess);
  EXPECT_EQ(first.items[0].processed_revision, 3);
  EXPECT_EQ(first.items[1].kind, RevisionKind::kUpload);
  EXPECT_EQ(first.items[1].processed_revision, 0);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const Page<RevisionInfo> second,
      service->ListRevisions(
          "map", {.page_size = 2, .page_token = first.next_page_token}));
  ASSERT_EQ(second.items.size(), 1U);
  EXPECT_EQ(second.items[0].kind, RevisionKind::kCreate);
  EXPECT_EQ(second.next_page_token, "");
  for (const char* token : {"x", "0", "-1", "3x", "99999999999999999999"}) {
    EXPECT_THAT(service->ListRevisions("map", {.page_token = token}),
                StatusIs(kInvalid, HasSubstr("page_token")))
        << token;
  }
}

TEST(Maps, DeleteTakesEverythingAndFreesTheName) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  EXPECT_THAT(service->DeleteMap("other", false),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("other")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation operation,
                                service.Upload("map", "done", MakeScene(22)));
  MAPSIEVE_ASSERT_OK(service.Stage("map", "open", MakeUpload(MakeScene(23))));
  EXPECT_THAT(service->DeleteMap("map", false),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("unfinished upload open")));
  MAPSIEVE_ASSERT_OK(service->DeleteUpload("map", "open"));
  MAPSIEVE_ASSERT_OK(service->DeleteMap("map", false));
  EXPECT_THAT(service->GetMap("map"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("map")));
  EXPECT_THAT(service->GetOperation(operation.operation_id),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("")));
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  EXPECT_THAT(service->GetUpload("map", "done"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("done")));
  EXPECT_THAT(service.Query({.map_id = "map", .raw = true})->points.size(),
              ::testing::Eq(0U));
}

TEST(Maps, ForcedDeleteEndsUploadsAndOperations) {
  Service service;
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "map"}));
  MAPSIEVE_ASSERT_OK(service.Upload("map", "scan", MakeScene(24)));
  MAPSIEVE_ASSERT_OK(service.Stage("map", "open", MakeUpload(MakeScene(25))));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation run,
                                service->ProcessMap("map", std::nullopt));
  MAPSIEVE_ASSERT_OK(service->DeleteMap("map", true));
  EXPECT_THAT(service->GetMap("map"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("map")));
  EXPECT_THAT(service->GetOperation(run.operation_id),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Page<Operation> operations,
                                service->ListOperations("", {}));
  EXPECT_TRUE(operations.items.empty());
}

}  // namespace
}  // namespace mapsieve::engine::testing
