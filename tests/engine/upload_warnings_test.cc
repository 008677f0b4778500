#include "server/engine/upload_warnings.h"

#include <cmath>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<std::string> CodesOf(const std::vector<UploadWarning>& warnings) {
  std::vector<std::string> codes;
  for (const UploadWarning& warning : warnings) {
    EXPECT_FALSE(warning.message.empty());
    EXPECT_EQ(warning.message.find('\n'), std::string::npos);
    codes.push_back(warning.code);
  }
  return codes;
}

std::vector<std::string> CodesOf(const UploadSource& source,
                                 const storage::MapSpec& map, bool has_points) {
  return CodesOf(WarningsOf(source, map, has_points));
}

TEST(UploadWarnings, TellHowTheSourceDiffersFromTheMap) {
  const storage::MapSpec bare;
  const storage::MapSpec placed = {.crs_wkt = "EPSG:25832", .frame_id = "map"};
  for (const bool has_points : {false, true}) {
    // Of nothing nothing is known to be wrong.
    EXPECT_THAT(CodesOf({}, bare, has_points), IsEmpty());
    EXPECT_THAT(CodesOf({}, placed, has_points), IsEmpty());
    EXPECT_THAT(CodesOf({.crs_wkt = "EPSG:25832",
                         .frame_id = "map",
                         .unit = "metre",
                         .coordinate_step = 0.001},
                        placed, has_points),
                IsEmpty());
    EXPECT_THAT(CodesOf({.crs_wkt = "EPSG:2056",
                         .frame_id = "odom",
                         .unit = "foot",
                         .coordinate_step = 0.0001},
                        placed, has_points),
                ElementsAre("crs_differs", "unit_not_metre", "step_too_coarse",
                            "frame_id_differs"));
    EXPECT_THAT(CodesOf({.unit = "degree"}, bare, has_points),
                ElementsAre("unit_not_metre"));
  }
  const UploadSource somewhere = {.crs_wkt = "EPSG:2056", .frame_id = "odom"};
  EXPECT_THAT(CodesOf(somewhere, bare, false), IsEmpty());
  EXPECT_THAT(CodesOf(somewhere, bare, true),
              ElementsAre("crs_not_taken", "frame_id_not_taken"));
}

TEST(UploadWarnings, NameBothSystems) {
  const auto warnings =
      WarningsOf({.crs_wkt = R"(PROJCS["LV95",AUTHORITY["EPSG","2056"]])"},
                 {.crs_wkt = "EPSG:25832"}, true);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_THAT(warnings[0].message, AllOf(HasSubstr("\"LV95\" (EPSG:2056)"),
                                         HasSubstr("\"EPSG:25832\"")));
}

TEST(UploadWarnings, AStepThatIsRoundedIsNoFinerOne) {
  for (const double step :
       {0.01, double{0.01F}, 0.001, 0.0001, 1e-7, 1.0 / 3}) {
    storage::MapSpec map;
    map.step_nm = std::llround(step * 1e9);
    EXPECT_THAT(CodesOf({.coordinate_step = step}, map, true), IsEmpty());
    map.step_nm += 1 + map.step_nm / 1000;
    EXPECT_THAT(CodesOf({.coordinate_step = step}, map, true),
                ElementsAre("step_too_coarse"));
  }
}

/// A map of a service, and uploads to it.
class UploadSources : public ::testing::Test {
 protected:
  void SetUp() override {
    MAPSIEVE_ASSERT_OK(service_->CreateMap({.map_id = "map"}));
  }

  UploadReport Add(const std::string& id, const core::LatticeCloud& cloud,
                   const UploadSource& source) {
    MAPSIEVE_EXPECT_OK(service_.Stage("map", id, MakeUpload(cloud),
                                      {.non_finite = 2}, source));
    const auto operation = service_.Finalize("map", id);
    EXPECT_TRUE(operation.ok() && operation->error.ok());
    return operation->upload_report.value_or(UploadReport());
  }
  MapInfo Map() { return *service_->GetMap("map"); }

  Service service_;
  const core::LatticeCloud scene_ = Split(MakeScene(3), 40)[0];
};

TEST_F(UploadSources, TheFirstOneThatIsKnownSaysWhereTheMapLies) {
  const UploadSource source = {.crs_wkt = "EPSG:2056", .frame_id = "map"};
  // No point, no place.
  Add("empty", core::LatticeCloud(), source);
  EXPECT_EQ(Map().crs_wkt, "");
  EXPECT_THAT(CodesOf(Add("one", scene_, source).warnings), IsEmpty());
  EXPECT_EQ(Map().crs_wkt, "EPSG:2056");
  EXPECT_EQ(Map().frame_id, "map");
  const UploadSource other = {.crs_wkt = "EPSG:25832", .frame_id = "odom"};
  EXPECT_THAT(CodesOf(Add("two", Split(MakeScene(4), 40)[0], other).warnings),
              ElementsAre("crs_differs", "frame_id_differs"));
  EXPECT_EQ(Map().crs_wkt, "EPSG:2056");
  EXPECT_EQ(Map().frame_id, "map");
  // It stays, even if the map is empty again.
  MAPSIEVE_ASSERT_OK(service_->RollBack("map", 1));
  service_.Reopen();
  EXPECT_EQ(Map().crs_wkt, "EPSG:2056");
  EXPECT_EQ(Map().frame_id, "map");
}

TEST_F(UploadSources, WhatTheCreatorSaidStays) {
  MAPSIEVE_ASSERT_OK(service_->CreateMap(
      {.map_id = "placed", .crs_wkt = "EPSG:2056", .frame_id = "map"}));
  MAPSIEVE_ASSERT_OK(
      service_.Stage("placed", "one", MakeUpload(scene_), {},
                     {.crs_wkt = "EPSG:25832", .frame_id = "odom"}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation operation,
                                service_.Finalize("placed", "one"));
  EXPECT_THAT(CodesOf(operation.upload_report->warnings),
              ElementsAre("crs_differs", "frame_id_differs"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapInfo map, service_->GetMap("placed"));
  EXPECT_EQ(map.crs_wkt, "EPSG:2056");
  EXPECT_EQ(map.frame_id, "map");
}

TEST_F(UploadSources, AMapWithPointsStaysWithoutAPlace) {
  Add("one", scene_, {});
  EXPECT_THAT(CodesOf(Add("two", Split(MakeScene(4), 40)[0],
                          {.crs_wkt = "EPSG:2056", .frame_id = "map"})
                          .warnings),
              ElementsAre("crs_not_taken", "frame_id_not_taken"));
  EXPECT_EQ(Map().crs_wkt, "");
  EXPECT_EQ(Map().frame_id, "");
}

TEST_F(UploadSources, TheReportOutlivesARestart) {
  Add("one", scene_, {.unit = "foot", .coordinate_step = 1e-6});
  const UploadSource source = {.crs_wkt = "EPSG:2056",
                               .frame_id = "map",
                               .unit = "degree",
                               .coordinate_step = 1e-5};
  const UploadReport report = Add("two", scene_, source);
  ASSERT_TRUE(report.census.has_value());
  EXPECT_GT(report.census->overlapping_point_count.value_or(0), 0);
  EXPECT_EQ(report.warnings.size(), 4u);
  service_.Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadInfo upload,
                                service_->GetUpload("map", "two"));
  EXPECT_EQ(upload.report, report);
  EXPECT_EQ(upload.spec.source, source);
  EXPECT_EQ(upload.spec.refused.non_finite, 2);
  // The operation is another record.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation again,
                                service_.Finalize("map", "two"));
  EXPECT_EQ(again.upload_report, report);
  // A rollback and back brings the notes of then.
  MAPSIEVE_ASSERT_OK(service_->RollBack("map", 2));
  MAPSIEVE_ASSERT_OK(service_->RollBack("map", 3));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadInfo restored,
                                service_->GetUpload("map", "two"));
  EXPECT_EQ(restored.report, report);
}

}  // namespace
}  // namespace mapsieve::engine::testing
