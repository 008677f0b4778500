#include "server/rpc/convert.h"

#include <limits>
#include <string>

#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "gmock/gmock.h"
#include "google/protobuf/unknown_field_set.h"
#include "gtest/gtest.h"
#include "mapsieve/v1/processing_service.pb.h"
#include "server/rpc/convert_query.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;

TEST(ParseName, TakesTheSegments) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto map,
                                ParseMapName("name", "maps/campus"));
  EXPECT_EQ(map, "campus");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto stats,
                                ParseStatsName("name", "maps/campus/stats"));
  EXPECT_EQ(stats, "campus");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto upload, ParseUploadName("name", "maps/campus/uploads/0af3"));
  EXPECT_EQ(upload, (UploadName{"campus", "0af3"}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto operation,
                                ParseOperationName("name", "operations/17"));
  EXPECT_EQ(operation, "17");
}

TEST(ParseName, RefusesOtherForms) {
  for (const char* name : {"", "campus", "maps", "maps/", "/maps/campus",
                           "maps/campus/", "maps/../campus", "maps//campus",
                           "map/campus", "maps/a/b", "maps/campus/stats"}) {
    EXPECT_THAT(
        ParseMapName("parent", name),
        StatusIs(kInvalid, HasSubstr("parent: expected \"maps/{map}\"")))
        << name;
  }
  for (const char* name :
       {"maps/a/uploads", "maps/a/uploads/", "maps//uploads/b",
        "maps/a/uploads/b/c", "maps/a/upload/b"}) {
    EXPECT_THAT(ParseUploadName("name", name), StatusIs(kInvalid, _)) << name;
  }
  EXPECT_THAT(ParseStatsName("name", "maps/a"), StatusIs(kInvalid, _));
  EXPECT_THAT(ParseOperationName("name", "maps/a"), StatusIs(kInvalid, _));
}

TEST(ParseName, QuotesLittleOfALongName) {
  const auto result = ParseMapName("name", std::string(100'000, 'x'));
  EXPECT_LT(result.status().message().size(), 200U);
}

TEST(ToSpdfOptions, UnsetFieldsAreTheDefaults) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto options,
                                ToSpdfOptions(v1::SpdfOptions()));
  EXPECT_EQ(options, core::SpdfOptions());
}

TEST(ToSpdfOptions, RoundTrips) {
  const core::SpdfOptions options = {.neighbor_count = 20,
                                     .label_neighbor_count = 90,
                                     .vote_scale_m2 = 0.3,
                                     .density_radius_m = 0.25,
                                     .reach_m = 2,
                                     .max_round_count = 0,
                                     .rule = core::DensityRule::kQuota,
                                     .seed = -5,
                                     .outlier_share = 0};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto again,
                                ToSpdfOptions(ToProto(options)));
  EXPECT_EQ(again, options);
}

TEST(ToSpdfOptions, RefusesUnknownRules) {
  for (const int number : {0, 3, -1}) {
    v1::SpdfOptions options;
    options.set_rule(static_cast<v1::DensityRule>(number));
    EXPECT_THAT(ToSpdfOptions(options),
                StatusIs(kInvalid, HasSubstr("options.rule")));
  }
}

v1::QueryRegionRequest CampusQuery() {
  v1::QueryRegionRequest request;
  request.set_name("maps/campus");
  return request;
}

TEST(ToQuerySpec, NothingSetIsTheWholeMap) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto spec, ToQuerySpec(CampusQuery()));
  EXPECT_EQ(spec.map_id, "campus");
  EXPECT_FALSE(spec.region.has_value());
  EXPECT_FALSE(spec.columns.has_value());
  EXPECT_THAT(spec.labels, ElementsAre());
  EXPECT_EQ(spec.max_points, 0);
  EXPECT_EQ(spec.representative, engine::Representative::kNearest);
}

TEST(ToQuerySpec, TakesEveryField) {
  v1::QueryRegionRequest request = CampusQuery();
  request.set_revision(4);
  request.mutable_sphere()->mutable_center()->set_y(2);
  request.mutable_sphere()->set_radius(3);
  for (const auto label :
       {v1::LABEL_CURVE, v1::LABEL_JUNCTION, v1::LABEL_CURVE}) {
    request.add_labels(label);
  }
  request.set_depth(3);
  request.set_spacing_m(0.5);
  request.set_max_point_count(1000);
  request.mutable_columns()->add_filter_columns(v1::FILTER_COLUMN_TANGENT);
  request.mutable_columns()->add_attributes("intensity");
  request.set_raw(true);
  request.set_representative(v1::REPRESENTATIVE_CENTROID);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto spec, ToQuerySpec(request));
  EXPECT_EQ(spec.revision, 4);
  EXPECT_EQ(spec.region, (engine::QueryShape(engine::Sphere{{0, 2, 0}, 3})));
  EXPECT_THAT(spec.labels,
              ElementsAre(core::Label::kCurve, core::Label::kJunction));
  EXPECT_EQ(spec.depth, 3);
  EXPECT_EQ(spec.spacing_m, 0.5);
  EXPECT_EQ(spec.max_points, 1000);
  ASSERT_TRUE(spec.columns.has_value());
  EXPECT_TRUE(spec.columns->tangent);
  EXPECT_FALSE(spec.columns->label);
  EXPECT_FALSE(spec.columns->all_attributes);
  EXPECT_THAT(spec.columns->attributes, ElementsAre("intensity"));
  EXPECT_TRUE(spec.raw);
  EXPECT_EQ(spec.representative, engine::Representative::kCentroid);
}

TEST(ToQuerySpec, NamesTheWrongField) {
  v1::QueryRegionRequest request = CampusQuery();
  request.mutable_box()->mutable_max();
  EXPECT_THAT(ToQuerySpec(request), StatusIs(kInvalid, HasSubstr("box.min")));
  request.mutable_sphere();
  EXPECT_THAT(ToQuerySpec(request),
              StatusIs(kInvalid, HasSubstr("sphere.center")));

  request = CampusQuery();
  request.add_labels(v1::LABEL_CURVE);
  request.add_labels(v1::LABEL_UNSPECIFIED);
  EXPECT_THAT(ToQuerySpec(request), StatusIs(kInvalid, HasSubstr("labels[1]")));

  request = CampusQuery();
  request.mutable_columns()->add_filter_columns(
      static_cast<v1::FilterColumn>(99));
  EXPECT_THAT(ToQuerySpec(request),
              StatusIs(kInvalid, HasSubstr("columns.filter_columns[0]")));

  request = CampusQuery();
  request.set_representative(static_cast<v1::Representative>(7));
  EXPECT_THAT(ToQuerySpec(request),
              StatusIs(kInvalid, HasSubstr("representative")));
}

TEST(CheckedContent, ComparesTheChecksum) {
  v1::ChecksummedData data;
  EXPECT_THAT(CheckedContent("data", data),
              StatusIs(kInvalid, HasSubstr("data.content")));
  data.set_content("points");
  EXPECT_THAT(CheckedContent("data", data),
              StatusIs(kInvalid, HasSubstr("data.xxh3_64")));
  data.set_xxh3_64(Hash64(TextBytes("points")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto content,
                                CheckedContent("data", data));
  EXPECT_EQ(content, "points");
  data.set_content("pointz");
  EXPECT_THAT(
      CheckedContent("data", data),
      StatusIs(absl::StatusCode::kDataLoss, HasSubstr("send them again")));
  data.set_content(std::string((1 << 20) + 1, 'x'));
  EXPECT_THAT(CheckedContent("data", data),
              StatusIs(kInvalid, HasSubstr("1048577")));
}

TEST(ToUploadSpec, NeedsAnUpload) {
  EXPECT_THAT(ToUploadSpec(v1::CreateUploadRequest()),
              StatusIs(kInvalid, HasSubstr("upload: missing")));
}

TEST(ToMapSpec, ZeroStepIsTheDefault) {
  v1::CreateMapRequest request;
  EXPECT_EQ(ToMapSpec(request).step_nm, core::kDefaultStepNm);
  request.set_step_nm(-3);
  EXPECT_EQ(ToMapSpec(request).step_nm, -3);
}

TEST(ToProto, OperationIsDoneWithExactlyOneResult) {
  engine::Operation operation = {.operation_id = "9",
                                 .verb = engine::OperationVerb::kFinalizeUpload,
                                 .map_id = "campus",
                                 .upload_id = "u",
                                 .state = engine::OperationState::kRunning,
                                 .create_time = absl::FromUnixMillis(1500),
                                 .done_work = 2,
                                 .total_work = 5};
  v1::Operation proto = ToProto(operation);
  EXPECT_EQ(proto.name(), "operations/9");
  EXPECT_FALSE(proto.done());
  EXPECT_EQ(proto.result_case(), v1::Operation::RESULT_NOT_SET);
  v1::OperationMetadata metadata;
  ASSERT_TRUE(proto.metadata().UnpackTo(&metadata));
  EXPECT_EQ(metadata.target(), "maps/campus/uploads/u");
  EXPECT_EQ(metadata.verb(), "FinalizeUpload");
  EXPECT_EQ(metadata.create_time().seconds(), 1);
  EXPECT_EQ(metadata.create_time().nanos(), 500'000'000);
  EXPECT_FALSE(metadata.has_end_time());
  EXPECT_EQ(metadata.done_work(), 2);

  operation.state = engine::OperationState::kCancelled;
  operation.error = absl::CancelledError("as asked");
  proto = ToProto(operation);
  EXPECT_TRUE(proto.done());
  EXPECT_EQ(proto.error().code(), 1);

  operation.state = engine::OperationState::kSucceeded;
  operation.error = absl::OkStatus();
  operation.upload_report = engine::UploadReport{.added_point_count = 7};
  proto = ToProto(operation);
  v1::FinalizeUploadResponse response;
  ASSERT_TRUE(proto.response().UnpackTo(&response));
  EXPECT_EQ(response.report().added_point_count(), 7);
  EXPECT_FALSE(response.report().has_bounds());
}

TEST(ToProto, ReportHasTheCensusAndTheWarnings) {
  engine::UploadReport report;
  EXPECT_FALSE(ToProto(report).has_census());
  report.census = {.duplicate_point_count = 3,
                   .overlapping_point_count = 0,
                   .density_cell_level = 10,
                   .density_histogram = {4, 0, 5}};
  report.warnings = {{"crs_differs", "as it is"}};
  v1::UploadReport proto = ToProto(report);
  EXPECT_EQ(proto.census().duplicate_point_count(), 3);
  EXPECT_TRUE(proto.census().has_overlapping_point_count());
  EXPECT_EQ(proto.census().density_cell_level(), 10);
  EXPECT_THAT(proto.census().density_histogram(),
              ::testing::ElementsAre(4, 0, 5));
  ASSERT_EQ(proto.warnings_size(), 1);
  EXPECT_EQ(proto.warnings(0).code(), "crs_differs");
  EXPECT_EQ(proto.warnings(0).message(), "as it is");
  report.census->overlapping_point_count.reset();
  proto = ToProto(report);
  EXPECT_FALSE(proto.census().has_overlapping_point_count());
}

TEST(ToProto, ColumnNamesAreValidText) {
  EXPECT_EQ(
      ToProto(core::ColumnSpec{"H\xf6he", core::ScalarType::kInt8}).name(),
      "H?he");
  EXPECT_EQ(ToProto(core::ColumnSpec{"x", core::ScalarType::kFloat64}).type(),
            v1::SCALAR_TYPE_FLOAT64);
}

TEST(ToRegion, RefusesWhatANewerClientMayMean) {
  v1::FinalizeUploadRequest request;
  request.set_name("maps/campus/uploads/whole");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto none, ToRegion(request));
  EXPECT_FALSE(none.has_value());
  // A kind of region that comes later has a number of its own.
  request.GetReflection()->MutableUnknownFields(&request)->AddLengthDelimited(
      100, "a cone");
  EXPECT_THAT(ToRegion(request), StatusIs(kInvalid, HasSubstr("region")));
}

}  // namespace
}  // namespace mapsieve::rpc
