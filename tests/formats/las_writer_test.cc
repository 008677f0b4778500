#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "client/formats/las_file.h"
#include "core/base/bytes.h"
#include "core/cloud/point_cloud.h"
#include "core/geometry/crs.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/formats/attributes_of.h"
#include "tests/formats/file_table.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

using core::Column;
using core::PointCloud;
using core::ScalarType;
using mapsieve::testing::StatusIs;
using ::testing::HasSubstr;
using testing::ReadAll;
using testing::Same;
using testing::TemporaryFile;
using testing::Value;

template <typename T>
Column RandomColumn(const std::string& name, size_t size) {
  std::mt19937_64 random(7);
  Column column({name, core::ScalarTypeOf<T>()}, size);
  for (size_t i = 0; i < size; ++i) {
    T value{};
    const uint64_t bits = random();
    std::memcpy(&value, &bits, sizeof(T));
    column.Set(i, value);
  }
  return column;
}

PointCloud SomePoints(size_t size) {
  PointCloud cloud;
  for (size_t i = 0; i < size; ++i) {
    const auto k = static_cast<double>(i);
    cloud.positions.push_back(
        {331050 + k * 0.001, 5183020 - k * 0.25, 92 + k * 0.002});
  }
  return cloud;
}

absl::StatusOr<PointCloud> WriteAndRead(const PointCloud& cloud,
                                        const WriteOptions& options = {}) {
  const TemporaryFile file(".las");
  MAPSIEVE_RETURN_IF_ERROR(WritePointFile(file.path(), cloud, options));
  return ReadAll(OpenLasFile, file.path(), 1000);
}

TEST(LasWriter, AttributesOfEveryTypeComeBackBitByBit) {
  constexpr size_t kSize = 20000;  // more than a chunk
  PointCloud cloud = SomePoints(kSize);
  auto& columns = cloud.attributes.columns();
  columns.push_back(RandomColumn<int8_t>("a", kSize));
  columns.push_back(RandomColumn<uint8_t>("b", kSize));
  columns.push_back(RandomColumn<int16_t>("c", kSize));
  columns.push_back(RandomColumn<uint16_t>("d", kSize));
  columns.push_back(RandomColumn<int32_t>("e", kSize));
  columns.push_back(RandomColumn<uint32_t>("f", kSize));
  columns.push_back(RandomColumn<int64_t>("g", kSize));
  columns.push_back(RandomColumn<uint64_t>("h", kSize));
  columns.push_back(RandomColumn<float>("i", kSize));
  columns.push_back(
      RandomColumn<double>("j with blanks, 32 bytes, öäü", kSize));
  columns.push_back(RandomColumn<uint16_t>("intensity", kSize));
  columns.push_back(RandomColumn<int16_t>("scan_angle", kSize));
  columns.push_back(RandomColumn<uint8_t>("classification", kSize));
  columns.push_back(RandomColumn<double>("gps_time", kSize));
  columns.push_back(RandomColumn<uint16_t>("blue", kSize));
  columns.push_back(RandomColumn<uint16_t>("nir", kSize));
  columns.push_back(RandomColumn<int8_t>("scan_angle_rank", kSize));
  columns.push_back(RandomColumn<uint64_t>("wave_offset", kSize));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read, WriteAndRead(cloud));
  ASSERT_EQ(read.size(), kSize);
  EXPECT_TRUE(Same(cloud, read) == cloud.attributes);
  for (size_t i = 0; i < kSize; ++i) {
    EXPECT_NEAR(read.positions[i].x, cloud.positions[i].x, 1e-9);
    EXPECT_NEAR(read.positions[i].y, cloud.positions[i].y, 2e-9);
    EXPECT_NEAR(read.positions[i].z, cloud.positions[i].z, 1e-9);
  }
}

TEST(LasWriter, StandardNamesOfAnotherTypeComeBackAsTheyWere) {
  constexpr size_t kSize = 100;
  PointCloud cloud = SomePoints(kSize);
  auto& columns = cloud.attributes.columns();
  columns.push_back(RandomColumn<float>("intensity", kSize));
  columns.push_back(RandomColumn<int32_t>("return_number", kSize));
  columns.push_back(RandomColumn<int64_t>("gps_time", kSize));
  columns.push_back(RandomColumn<float>("red", kSize));
  columns.push_back(RandomColumn<int8_t>("classification", kSize));
  const TemporaryFile file(".las");
  MAPSIEVE_ASSERT_OK(WritePointFile(file.path(), cloud));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read,
                                ReadAll(OpenLasFile, file.path()));
  EXPECT_TRUE(Same(cloud, read) == cloud.attributes);
  EXPECT_EQ(file.Read()[104], 6);  // no colour field is needed
  EXPECT_EQ(read.attributes.Find("extra_intensity"), nullptr);
}

TEST(LasWriter, NarrowerIntegersGoToTheFieldAndComeBackWider) {
  constexpr size_t kSize = 100;
  PointCloud cloud = SomePoints(kSize);
  auto& columns = cloud.attributes.columns();
  columns.push_back(RandomColumn<uint8_t>("intensity", kSize));
  columns.push_back(RandomColumn<int8_t>("scan_angle", kSize));
  columns.push_back(RandomColumn<int32_t>("gps_time", kSize));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read, WriteAndRead(cloud));
  EXPECT_EQ(read.attributes.columns().size(), 15);  // no extra bytes
  for (const Column& column : cloud.attributes.columns()) {
    const Column* found = read.attributes.Find(column.name());
    ASSERT_NE(found, nullptr);
    EXPECT_GT(core::ScalarSize(found->type()), column.value_size());
    for (size_t i = 0; i < kSize; ++i) {
      EXPECT_EQ(found->GetAsDouble(i), column.GetAsDouble(i));
    }
  }
}

TEST(LasWriter, FieldsOfBitsComeBackAndRefuseWhatDoesNotFit) {
  PointCloud cloud = SomePoints(16);
  for (const char* name :
       {"return_number", "number_of_returns", "synthetic", "key_point",
        "withheld", "overlap", "scanner_channel", "scan_direction",
        "edge_of_flight_line"}) {
    const std::string text = name;
    const int bits = text.starts_with("return") || text.starts_with("number")
                         ? 4
                     : text == "scanner_channel" ? 2
                                                 : 1;
    Column column({name, ScalarType::kUint8}, 16);
    for (size_t i = 0; i < 16; ++i) {
      column.Set(i, static_cast<uint8_t>((i * 5 + text.size()) % (1U << bits)));
    }
    cloud.attributes.columns().push_back(column);
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read, WriteAndRead(cloud));
  EXPECT_TRUE(Same(cloud, read) == cloud.attributes);

  cloud.attributes.Find("scanner_channel")->Set<uint8_t>(3, 4);
  EXPECT_THAT(WriteAndRead(cloud),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("point 3: scanner_channel = 4 is beyond 3")));
}

TEST(LasWriter, HeaderSaysWhatThePointsAre) {
  PointCloud cloud;
  cloud.positions = {{10, 20, -1}, {11.5, 19.25, 3}, {10.25, 25, 0.001}};
  Column returns({"return_number", ScalarType::kUint8}, 3);
  returns.Set<uint8_t>(0, 2);
  returns.Set<uint8_t>(1, 15);
  returns.Set<uint8_t>(2, 2);
  cloud.attributes.columns() = {returns,
                                Column({"nir", ScalarType::kUint16}, 3)};
  const TemporaryFile file(".las");
  MAPSIEVE_ASSERT_OK(WritePointFile(
      file.path(), cloud, {.origin = {10500, 20, 0}, .crs_wkt = "PROJCS[]"}));
  const std::string text = file.Read();
  const auto* bytes = reinterpret_cast<const std::byte*>(text.data());
  EXPECT_EQ(text.substr(0, 4), "LASF");
  EXPECT_EQ(LoadLittleEndian<uint16_t>(bytes + 6), 0x10);  // WKT
  EXPECT_EQ(bytes[24], std::byte{1});
  EXPECT_EQ(bytes[25], std::byte{4});
  EXPECT_EQ(LoadLittleEndian<uint16_t>(bytes + 94), 375);
  EXPECT_EQ(LoadLittleEndian<uint32_t>(bytes + 96), 375 + 54 + 9);
  EXPECT_EQ(LoadLittleEndian<uint32_t>(bytes + 100), 1);
  EXPECT_EQ(bytes[104], std::byte{8});
  EXPECT_EQ(LoadLittleEndian<uint16_t>(bytes + 105), 38);
  EXPECT_EQ(LoadLittleEndian<uint32_t>(bytes + 107), 0);  // legacy
  EXPECT_EQ(LoadLittleEndian<double>(bytes + 131), 0.001);
  EXPECT_EQ(LoadLittleEndian<double>(bytes + 155), 10500);
  EXPECT_EQ(LoadLittleEndian<double>(bytes + 163), 20);
  EXPECT_DOUBLE_EQ(LoadLittleEndian<double>(bytes + 179), 11.5);
  EXPECT_DOUBLE_EQ(LoadLittleEndian<double>(bytes + 187), 10);
  EXPECT_DOUBLE_EQ(LoadLittleEndian<double>(bytes + 195), 25);
  EXPECT_DOUBLE_EQ(LoadLittleEndian<double>(bytes + 203), 19.25);
  EXPECT_DOUBLE_EQ(LoadLittleEndian<double>(bytes + 211), 3);
  EXPECT_DOUBLE_EQ(LoadLittleEndian<double>(bytes + 219), -1);
  EXPECT_EQ(LoadLittleEndian<uint64_t>(bytes + 247), 3);
  for (size_t i = 0; i < 15; ++i) {
    EXPECT_EQ(LoadLittleEndian<uint64_t>(bytes + 255 + 8 * i), i == 1    ? 2
                                                               : i == 14 ? 1
                                                                         : 0);
  }
  EXPECT_EQ(text.size(), 375 + 54 + 9 + 3 * 38);
}

TEST(LasWriter, PointsWithoutReturnsAreSingleReturns) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read,
                                WriteAndRead(SomePoints(2)));
  EXPECT_EQ(Value(read, "return_number"), 1);
  EXPECT_EQ(Value(read, "number_of_returns"), 1);
}

TEST(LasWriter, MissingValuesComeBackMissingInExtraFloats) {
  PointCloud cloud = SomePoints(3);
  Column real({"real", ScalarType::kFloat32}, 3);
  real.Set(0, 1.5F);
  real.SetMissing(1);
  Column whole({"whole", ScalarType::kInt32}, 3);
  whole.Set(0, 7);
  whole.SetMissing(1);
  Column nan({"nan", ScalarType::kFloat64}, 3);
  nan.Set(2, std::numeric_limits<double>::quiet_NaN());
  cloud.attributes.columns() = {real, whole, nan};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read, WriteAndRead(cloud));
  EXPECT_TRUE(*read.attributes.Find("real") == real);
  EXPECT_EQ(Value(read, "whole", 1), 0);
  EXPECT_FALSE(read.attributes.Find("nan")->has_missing());
  EXPECT_TRUE(std::isnan(Value(read, "nan", 2)));
}

TEST(LasWriter, KeepsTheCrs) {
  // Whatever PROJ does not know, or has no codes, stays as it is.
  for (const std::string crs :
       {"EPSG:1", "EPSG:26915+26915", "PROJCS[\"ö\"]", ""}) {
    const TemporaryFile file(".las");
    MAPSIEVE_ASSERT_OK(
        WritePointFile(file.path(), SomePoints(1), {.crs_wkt = crs}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenLasFile(file.path()));
    EXPECT_EQ(reader->info().crs_wkt, crs);
  }
}

TEST(LasWriter, WritesCodesAsWkt) {
  struct Case {
    const char* crs;
    const char* keyword;
    const char* name;
    const char* unit;
  };
  // Names and units as the EPSG registry has them. Codes beyond 4999 may be of
  // geographic systems, and codes from 4000 to 4999 of others.
  for (const Case& c : std::initializer_list<Case>{
           {"EPSG:26915", "PROJCS", "NAD83 / UTM zone 15N", "metre"},
           {"EPSG:2903", "PROJCS", "NAD83(HARN) / New Mexico Central (ftUS)",
            "US survey foot"},
           {"EPSG:4326", "GEOGCS", "WGS 84", "degree"},
           {"EPSG:6318", "GEOGCS", "NAD83(2011)", "degree"},
           {"EPSG:7844", "GEOGCS", "GDA2020", "degree"},
           {"EPSG:4978", "GEOCCS", "WGS 84", "metre"},
           {"EPSG:4087", "PROJCS", "WGS 84 / World Equidistant Cylindrical",
            "metre"},
           {"EPSG:4979", "COMPD_CS", "WGS 84 + Ellipsoid (metre)", "degree"},
           {"EPSG:26910+5703", "COMPD_CS",
            "NAD83 / UTM zone 10N + NAVD88 height", "metre"}}) {
    SCOPED_TRACE(c.crs);
    const TemporaryFile file(".las");
    MAPSIEVE_ASSERT_OK(
        WritePointFile(file.path(), SomePoints(1), {.crs_wkt = c.crs}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenLasFile(file.path()));
    const std::string& wkt = reader->info().crs_wkt;
    EXPECT_THAT(wkt, ::testing::StartsWith(std::string(c.keyword) + "["));
    EXPECT_EQ(core::NameOfCrs(wkt), c.name);
    EXPECT_EQ(core::VerticalEpsgCodeOf(wkt), core::VerticalEpsgCodeOf(c.crs));
    EXPECT_EQ(reader->info().unit, c.unit);
    EXPECT_EQ(reader->info().crs_problem, "");
    // The bit says WKT, so there are no keys.
    EXPECT_EQ(file.Read().find("GeoTIFF"), std::string::npos);
  }
}

TEST(LasWriter, NamesTheDatabaseThatItMisses) {
  const TemporaryFile file(".las");
  ASSERT_EQ(setenv("PROJ_DATA", "/no/such/folder", 1), 0);
  const absl::Status codes =
      WritePointFile(file.path(), SomePoints(1), {.crs_wkt = "EPSG:26915"});
  const absl::Status wkt =
      WritePointFile(file.path(), SomePoints(1), {.crs_wkt = "PROJCS[\"a\"]"});
  unsetenv("PROJ_DATA");
  EXPECT_THAT(codes, StatusIs(absl::StatusCode::kFailedPrecondition,
                              HasSubstr("PROJ_DATA")));
  MAPSIEVE_EXPECT_OK(wkt);
  MAPSIEVE_EXPECT_OK(
      WritePointFile(file.path(), SomePoints(1), {.crs_wkt = "EPSG:26915"}));
}

TEST(LasWriter, MarksItsPointFormatsAsOthersDemand) {
  // LAS 1.4 R15, table 5 and section 2.5: the WKT bit, with formats 6 to 10.
  for (const std::string crs : {"EPSG:26915", "PROJCS[\"a\"]", ""}) {
    const TemporaryFile file(".las");
    MAPSIEVE_ASSERT_OK(
        WritePointFile(file.path(), SomePoints(1), {.crs_wkt = crs}));
    const std::string bytes = file.Read();
    EXPECT_EQ(bytes[6] & 0x11, 0x10) << crs;
    EXPECT_GE(bytes[104], 6) << crs;
  }
}

TEST(LasWriter, NamesAScaleThatWouldHoldTheCoordinates) {
  PointCloud cloud;
  cloud.positions = {{0, 0, 0}, {5183020.5, 0, 0}};
  EXPECT_THAT(
      WriteAndRead(cloud, {.origin = {0.001, 0, 0}}),
      StatusIs(absl::StatusCode::kInvalidArgument,
               HasSubstr("point 1: x = 5183020.5 is beyond what LAS holds at "
                         "scale 0.001 and offset 0; a scale of 0.01 would "
                         "do")));
  MAPSIEVE_EXPECT_OK(
      WriteAndRead(cloud, {.coordinate_step = 0.01, .origin = {0.001, 0, 0}}));
}

TEST(LasWriter, TakesTheOffsetFromTheFirstBatch) {
  PointCloud cloud;
  cloud.positions = {{4e6, -5e6, 1e6}, {4.000001e6, -5e6, 1e6}};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read, WriteAndRead(cloud));
  EXPECT_EQ(read.positions[0], cloud.positions[0]);
  EXPECT_EQ(read.positions[1], cloud.positions[1]);
}

TEST(LasWriter, RefusesWhatLasCannotHold) {
  PointCloud cloud;
  cloud.positions = {{0, 0, std::numeric_limits<double>::infinity()}};
  EXPECT_THAT(WriteAndRead(cloud), StatusIs(absl::StatusCode::kInvalidArgument,
                                            HasSubstr("point 0: z = inf")));
  cloud.positions = {{0, std::numeric_limits<double>::quiet_NaN(), 0}};
  EXPECT_THAT(WriteAndRead(cloud), StatusIs(absl::StatusCode::kInvalidArgument,
                                            HasSubstr("point 0: y = nan")));
  for (const double step :
       {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()}) {
    EXPECT_THAT(WriteAndRead(SomePoints(1), {.coordinate_step = step}),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         HasSubstr("coordinate step")));
  }
  cloud = SomePoints(1);
  cloud.attributes.columns() = {
      Column({std::string(33, 'n'), ScalarType::kInt8}, 1)};
  EXPECT_THAT(WriteAndRead(cloud), StatusIs(absl::StatusCode::kInvalidArgument,
                                            HasSubstr("33 bytes")));
  cloud.attributes.columns().clear();
  for (int i = 0; i < 342; ++i) {
    cloud.attributes.columns().push_back(
        Column({absl::StrCat("a", i), ScalarType::kInt8}, 1));
  }
  EXPECT_THAT(WriteAndRead(cloud), StatusIs(absl::StatusCode::kInvalidArgument,
                                            HasSubstr("more than 341")));
  cloud.attributes.columns().pop_back();
  MAPSIEVE_EXPECT_OK(WriteAndRead(cloud));
}

TEST(LasWriter, WritesNoPoints) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read, WriteAndRead({}));
  EXPECT_EQ(read.size(), 0);
}

}  // namespace
}  // namespace mapsieve::client
