#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "client/formats/las_file.h"
#include "core/cloud/point_cloud.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/formats/attributes_of.h"
#include "tests/formats/file_table.h"
#include "tests/formats/las_text.h"
#include "tests/formats/packed.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

using core::Column;
using core::ColumnSpec;
using core::Point3;
using core::PointCloud;
using core::ScalarType;
using mapsieve::testing::StatusIs;
using ::testing::ElementsAre;
using testing::Evlr;
using ::testing::HasSubstr;
using testing::LasText;
using testing::Packed;
using testing::Padded;
using testing::ReadAll;
using testing::Record0;
using testing::TemporaryFile;
using testing::Value;
using testing::Vlr;
using testing::Xyz;

struct Extra {
  int type = 1;
  int options = 0;
  std::string name;
  std::array<std::string, 3> no_data;
  std::array<double, 3> scale{};
  std::array<double, 3> offset{};
};

std::string ExtraVlr(const std::vector<Extra>& extras) {
  std::string payload;
  for (const Extra& extra : extras) {
    payload += Packed(uint16_t{0}, static_cast<uint8_t>(extra.type),
                      static_cast<uint8_t>(extra.options));
    payload += Padded(extra.name, 32) + std::string(4, '\0');
    for (const std::string& no_data : extra.no_data) {
      payload += Padded(no_data, 8);
    }
    payload += std::string(48, '\0');
    for (const double scale : extra.scale) payload += Packed(scale);
    for (const double offset : extra.offset) payload += Packed(offset);
    payload += Padded("description", 32);
  }
  return Vlr("LASF_Spec", 4, payload);
}

absl::StatusOr<PointCloud> ReadBytes(const std::string& bytes) {
  const TemporaryFile file(".las", bytes);
  return ReadAll(OpenLasFile, file.path(), 2);
}

std::vector<std::string> Names(const PointCloud& cloud) {
  std::vector<std::string> names;
  for (const Column& column : cloud.attributes.columns()) {
    names.push_back(column.name());
  }
  return names;
}

constexpr uint8_t kU8 = 200;

// The part of records that formats 0 to 5 share, with a value of its own in
// every field: 101 010 1 1 and 10110 0 1 0 from the lowest bit on.
std::string OldRecord() {
  return Xyz(100, -200, 300) + Packed(uint16_t{54321}, uint8_t{0b1'1'010'101},
                                      uint8_t{0b0'1'0'10110}, int8_t{-90}, kU8,
                                      uint16_t{65000});
}

void ExpectOldRecord(const PointCloud& cloud) {
  ASSERT_EQ(cloud.size(), 1);
  EXPECT_EQ(cloud.positions[0], (Point3{1.0, -2.0, 3.0}));
  EXPECT_EQ(Value(cloud, "intensity"), 54321);
  EXPECT_EQ(Value(cloud, "return_number"), 5);
  EXPECT_EQ(Value(cloud, "number_of_returns"), 2);
  EXPECT_EQ(Value(cloud, "scan_direction"), 1);
  EXPECT_EQ(Value(cloud, "edge_of_flight_line"), 1);
  EXPECT_EQ(Value(cloud, "classification"), 22);
  EXPECT_EQ(Value(cloud, "synthetic"), 0);
  EXPECT_EQ(Value(cloud, "key_point"), 1);
  EXPECT_EQ(Value(cloud, "withheld"), 0);
  EXPECT_EQ(Value(cloud, "scan_angle_rank"), -90);
  EXPECT_EQ(Value(cloud, "user_data"), 200);
  EXPECT_EQ(Value(cloud, "point_source_id"), 65000);
}

// Likewise of formats 6 to 10.
std::string NewRecord() {
  return Xyz(100, -200, 300) + Packed(uint16_t{54321}, uint8_t{0b1011'1110},
                                      uint8_t{0b0'1'10'1'0'1'0}, uint8_t{201},
                                      kU8, int16_t{-30000}, uint16_t{65000},
                                      double{123456789.25});
}

void ExpectNewRecord(const PointCloud& cloud) {
  ASSERT_EQ(cloud.size(), 1);
  EXPECT_EQ(cloud.positions[0], (Point3{1.0, -2.0, 3.0}));
  EXPECT_EQ(Value(cloud, "intensity"), 54321);
  EXPECT_EQ(Value(cloud, "return_number"), 14);
  EXPECT_EQ(Value(cloud, "number_of_returns"), 11);
  EXPECT_EQ(Value(cloud, "synthetic"), 0);
  EXPECT_EQ(Value(cloud, "key_point"), 1);
  EXPECT_EQ(Value(cloud, "withheld"), 0);
  EXPECT_EQ(Value(cloud, "overlap"), 1);
  EXPECT_EQ(Value(cloud, "scanner_channel"), 2);
  EXPECT_EQ(Value(cloud, "scan_direction"), 1);
  EXPECT_EQ(Value(cloud, "edge_of_flight_line"), 0);
  EXPECT_EQ(Value(cloud, "classification"), 201);
  EXPECT_EQ(Value(cloud, "user_data"), 200);
  EXPECT_EQ(Value(cloud, "scan_angle"), -30000);
  EXPECT_EQ(Value(cloud, "point_source_id"), 65000);
  EXPECT_EQ(Value(cloud, "gps_time"), 123456789.25);
}

const std::string& Colour() {
  static const std::string bytes =
      Packed(uint16_t{65535}, uint16_t{2}, uint16_t{3});
  return bytes;
}

void ExpectColour(const PointCloud& cloud) {
  EXPECT_EQ(Value(cloud, "red"), 65535);
  EXPECT_EQ(Value(cloud, "green"), 2);
  EXPECT_EQ(Value(cloud, "blue"), 3);
}

const std::string& Wave() {
  static const std::string bytes =
      Packed(uint8_t{7}, uint64_t{1} << 40, uint32_t{4000000000}, 1.5F, 2.5F,
             3.5F, 4.5F);
  return bytes;
}

void ExpectWave(const PointCloud& cloud) {
  EXPECT_EQ(Value(cloud, "wave_descriptor_index"), 7);
  EXPECT_EQ(Value(cloud, "wave_offset"), std::ldexp(1.0, 40));
  EXPECT_EQ(Value(cloud, "wave_size"), 4e9);
  EXPECT_EQ(Value(cloud, "wave_return_point"), 1.5);
  EXPECT_EQ(Value(cloud, "wave_x_t"), 2.5);
  EXPECT_EQ(Value(cloud, "wave_y_t"), 3.5);
  EXPECT_EQ(Value(cloud, "wave_z_t"), 4.5);
}

TEST(LasReader, ReadsEveryFieldOfEveryPointFormat) {
  const std::string time = Packed(987654.5);
  const std::string nir = Packed(uint16_t{4444});
  const std::array<std::string, 11> records = {
      OldRecord(),
      OldRecord() + time,
      OldRecord() + Colour(),
      OldRecord() + time + Colour(),
      OldRecord() + time + Wave(),
      OldRecord() + time + Colour() + Wave(),
      NewRecord(),
      NewRecord() + Colour(),
      NewRecord() + Colour() + nir,
      NewRecord() + Wave(),
      NewRecord() + Colour() + nir + Wave()};
  const std::array<size_t, 11> sizes = {20, 28, 26, 34, 57, 63,
                                        30, 36, 38, 59, 67};
  for (int format = 0; format <= 10; ++format) {
    SCOPED_TRACE(format);
    const std::string& record = records[static_cast<size_t>(format)];
    ASSERT_EQ(record.size(), sizes[static_cast<size_t>(format)]);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const PointCloud cloud,
        ReadBytes(LasText{.minor = 4, .format = format, .records = {record}}
                      .Build()));
    if (format < 6) {
      ExpectOldRecord(cloud);
    } else {
      ExpectNewRecord(cloud);
    }
    const bool has_time = format != 0 && format != 2;
    const bool has_colour = format == 2 || format == 3 || format == 5 ||
                            format == 7 || format == 8 || format == 10;
    const bool has_nir = format == 8 || format == 10;
    const bool has_wave =
        format == 4 || format == 5 || format == 9 || format == 10;
    if (has_time && format < 6) {
      EXPECT_EQ(Value(cloud, "gps_time"), 987654.5);
    }
    if (has_colour) ExpectColour(cloud);
    if (has_nir) {
      EXPECT_EQ(Value(cloud, "nir"), 4444);
    }
    if (has_wave) ExpectWave(cloud);
    EXPECT_EQ(Names(cloud).size(), (format < 6 ? 12 : 14) + (has_time ? 1 : 0) +
                                       (has_colour ? 3 : 0) +
                                       (has_nir ? 1 : 0) + (has_wave ? 7 : 0));

    EXPECT_THAT(
        ReadBytes(LasText{.minor = 4,
                          .format = format,
                          .records = {record},
                          .record_bytes = static_cast<int>(record.size()) - 1}
                      .Build()),
        StatusIs(absl::StatusCode::kDataLoss, HasSubstr("length of a point")));
  }
}

TEST(LasReader, GivesFieldsTheirTypes) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadBytes(LasText{.format = 3,
                        .records = {OldRecord() + Packed(1.0) + Colour()}}
                    .Build()));
  EXPECT_THAT(cloud.attributes.specs(),
              ElementsAre(ColumnSpec{"intensity", ScalarType::kUint16},
                          ColumnSpec{"return_number", ScalarType::kUint8},
                          ColumnSpec{"number_of_returns", ScalarType::kUint8},
                          ColumnSpec{"scan_direction", ScalarType::kUint8},
                          ColumnSpec{"edge_of_flight_line", ScalarType::kUint8},
                          ColumnSpec{"classification", ScalarType::kUint8},
                          ColumnSpec{"synthetic", ScalarType::kUint8},
                          ColumnSpec{"key_point", ScalarType::kUint8},
                          ColumnSpec{"withheld", ScalarType::kUint8},
                          ColumnSpec{"scan_angle_rank", ScalarType::kInt8},
                          ColumnSpec{"user_data", ScalarType::kUint8},
                          ColumnSpec{"point_source_id", ScalarType::kUint16},
                          ColumnSpec{"gps_time", ScalarType::kFloat64},
                          ColumnSpec{"red", ScalarType::kUint16},
                          ColumnSpec{"green", ScalarType::kUint16},
                          ColumnSpec{"blue", ScalarType::kUint16}));
}

TEST(LasReader, AppliesScaleAndOffsetByAxis) {
  const TemporaryFile file(
      ".las", LasText{.records = {Padded(Xyz(2147483647, -2147483647, 7), 20)},
                      .scale = {0.001, 0.5, 2},
                      .offset = {1000, -1, 0.25}}
                  .Build());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(auto reader, OpenLasFile(file.path()));
  EXPECT_EQ(reader->info().coordinate_step, 0.001);
  EXPECT_EQ(reader->info().format, "LAS 1.2, point format 0");
  EXPECT_EQ(reader->info().point_count, 1);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadAll(*reader));
  EXPECT_DOUBLE_EQ(cloud.positions[0].x, 2148483.647);
  EXPECT_EQ(cloud.positions[0].y, -1073741824.5);
  EXPECT_EQ(cloud.positions[0].z, 14.25);
}

TEST(LasReader, BatchesAreTheFileWhateverTheirSize) {
  LasText text;
  for (int i = 0; i < 1000; ++i) text.records.push_back(Record0(i));
  const TemporaryFile file(".las", text.Build());
  for (const size_t batch : {1U, 7U, 999U, 1000U, 4000U}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                  ReadAll(OpenLasFile, file.path(), batch));
    ASSERT_EQ(cloud.size(), 1000);
    for (size_t i = 0; i < 1000; ++i) {
      EXPECT_EQ(cloud.positions[i].x, static_cast<double>(i) * 0.01);
    }
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(auto reader, OpenLasFile(file.path()));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud all,
      reader->ReadBatch(std::numeric_limits<size_t>::max()));
  EXPECT_EQ(all.size(), 1000);
}

TEST(LasReader, ReadsExtraBytesOfEveryTypeUnderTheirNames) {
  std::vector<Extra> extras;
  for (int type = 1; type <= 10; ++type) {
    extras.push_back({.type = type, .name = absl::StrCat("extra type ", type)});
  }
  const std::string values =
      Packed(uint8_t{255}, int8_t{-128}, uint16_t{65535}, int16_t{-32768},
             uint32_t{4294967295}, int32_t{INT32_MIN}, uint64_t{UINT64_MAX},
             int64_t{INT64_MIN}, 0.1F, 0.1);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadBytes(
          LasText{.vlrs = {ExtraVlr(extras)}, .records = {Record0(1) + values}}
              .Build()));
  const auto column = [&](int type) -> const Column& {
    return *cloud.attributes.Find(absl::StrCat("extra type ", type));
  };
  EXPECT_EQ(column(1).Get<uint8_t>(0), 255);
  EXPECT_EQ(column(2).Get<int8_t>(0), -128);
  EXPECT_EQ(column(3).Get<uint16_t>(0), 65535);
  EXPECT_EQ(column(4).Get<int16_t>(0), -32768);
  EXPECT_EQ(column(5).Get<uint32_t>(0), 4294967295);
  EXPECT_EQ(column(6).Get<int32_t>(0), INT32_MIN);
  EXPECT_EQ(column(7).Get<uint64_t>(0), UINT64_MAX);
  EXPECT_EQ(column(8).Get<int64_t>(0), INT64_MIN);
  EXPECT_EQ(column(9).Get<float>(0), 0.1F);
  EXPECT_EQ(column(10).Get<double>(0), 0.1);
  EXPECT_EQ(column(7).type(), ScalarType::kUint64);
  EXPECT_EQ(column(9).type(), ScalarType::kFloat32);
}

TEST(LasReader, ScalesExtraBytesAndKnowsTheirMissingValues) {
  const std::vector<Extra> extras = {
      {.type = 4,
       .options = 0x19,
       .name = "height",
       .no_data = {Packed(int64_t{-1})},
       .scale = {0.05, 0, 0},
       .offset = {10, 0, 0}},
      {.type = 1, .options = 0x18, .name = "plain", .scale = {1, 1, 1}},
      {.type = 9, .options = 1, .name = "real", .no_data = {Packed(-9999.0)}},
      {.type = 1, .options = 0x08, .name = "no scale", .scale = {}}};
  const auto record = [](int16_t height, float real) {
    return Record0(0) + Packed(height, uint8_t{9}, real, uint8_t{3});
  };
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadBytes(LasText{.vlrs = {ExtraVlr(extras)},
                        .records = {record(100, 1.5F), record(-1, 2.5F),
                                    record(-2, -9999.0F)}}
                    .Build()));
  const Column& height = *cloud.attributes.Find("height");
  EXPECT_EQ(height.type(), ScalarType::kFloat64);
  EXPECT_DOUBLE_EQ(height.Get<double>(0), 15.0);
  EXPECT_TRUE(height.IsMissing(1));
  EXPECT_FALSE(height.IsMissing(2));
  EXPECT_DOUBLE_EQ(height.Get<double>(2), 9.9);
  const Column& real = *cloud.attributes.Find("real");
  EXPECT_EQ(real.type(), ScalarType::kFloat32);
  EXPECT_FALSE(real.IsMissing(0));
  EXPECT_TRUE(real.IsMissing(2));
  EXPECT_EQ(cloud.attributes.Find("plain")->type(), ScalarType::kUint8);
  EXPECT_EQ(cloud.attributes.Find("no scale")->Get<uint8_t>(0), 3);
}

TEST(LasReader, SplitsArraysAndKeepsUndescribedBytes) {
  const std::vector<Extra> extras = {
      {.type = 23, .name = "colour"},
      {.type = 0, .options = 2, .name = "reserved"},
      {.type = 0, .options = 1, .name = "one"},
      {.type = 12, .name = "flags"}};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadBytes(LasText{
          .vlrs = {ExtraVlr(extras)},
          .records = {Record0(0) + Packed(uint16_t{1}, uint16_t{2}, uint16_t{3},
                                          uint8_t{4}, uint8_t{5}, uint8_t{6},
                                          int8_t{-7}, int8_t{-8}, uint8_t{9},
                                          uint8_t{10})}}
                    .Build()));
  std::vector<std::string> extra_names = Names(cloud);
  extra_names.erase(extra_names.begin(), extra_names.begin() + 12);
  EXPECT_THAT(extra_names,
              ElementsAre("colour_0", "colour_1", "colour_2", "reserved_0",
                          "reserved_1", "one", "flags_0", "flags_1", "extra_0",
                          "extra_1"));
  EXPECT_EQ(Value(cloud, "colour_2"), 3);
  EXPECT_EQ(Value(cloud, "reserved_1"), 5);
  EXPECT_EQ(Value(cloud, "one"), 6);
  EXPECT_EQ(Value(cloud, "flags_1"), -8);
  EXPECT_EQ(Value(cloud, "extra_1"), 10);
}

TEST(LasReader, IgnoresADescriptionLongerThanTheRecord) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadBytes(LasText{.vlrs = {ExtraVlr({{.type = 1, .name = "a"},
                                           {.type = 3, .name = "b"}})},
                        .records = {Record0(0) + "12"}}
                    .Build()));
  EXPECT_EQ(cloud.attributes.Find("a"), nullptr);
  EXPECT_EQ(Value(cloud, "extra_0"), '1');
  EXPECT_EQ(Value(cloud, "extra_1"), '2');
}

TEST(LasReader, KeepsExtraBytesThatRepeatAName) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadBytes(LasText{.vlrs = {ExtraVlr({{.type = 1, .name = "intensity"},
                                           {.type = 1, .name = "twice"},
                                           {.type = 1, .name = "twice"},
                                           {.type = 1, .name = ""},
                                           {.type = 1, .name = "x"}})},
                        .records = {OldRecord() + "12345"}}
                    .Build()));
  EXPECT_EQ(Value(cloud, "intensity"), 54321);
  EXPECT_EQ(Value(cloud, "extra_intensity"), '1');
  EXPECT_EQ(Value(cloud, "twice"), '2');
  EXPECT_EQ(Value(cloud, "extra_twice"), '3');
  EXPECT_EQ(Value(cloud, "extra"), '4');
  EXPECT_EQ(Value(cloud, "extra_x"), '5');
}

TEST(LasReader, RefusesTooManyAttributes) {
  EXPECT_THAT(
      ReadBytes(
          LasText{.records = {Record0(0) + std::string(60000, 'a')}}.Build()),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("attributes")));
}

TEST(LasReader, CountsByTheRuleOfVersion14) {
  LasText text{.minor = 4, .records = {Record0(0), Record0(1), Record0(2)}};
  text.legacy_count = 0;
  EXPECT_EQ(ReadBytes(text.Build())->size(), 3);
  text.legacy_count = 2;
  EXPECT_EQ(ReadBytes(text.Build())->size(), 2);
  text.legacy_count = 0;
  text.count = int64_t{1} << 62;
  EXPECT_THAT(ReadBytes(text.Build()),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("4611686018427387904 points")));
}

TEST(LasReader, ReadsPointsBehindDamagedRecords) {
  LasText text{.vlrs = {Vlr("a", 1, "payload")}, .records = {Record0(5)}};
  text.vlr_count = 4000000000;
  EXPECT_EQ(ReadBytes(text.Build())->size(), 1);
  std::string bytes = text.Build();
  bytes[227 + 20] = '\xFF';  // the record's length
  EXPECT_EQ(ReadBytes(bytes)->size(), 1);
}

TEST(LasReader, RefusesByName) {
  const LasText text{.records = {Record0(0)}};
  const auto with = [&](size_t at, char byte) {
    std::string bytes = text.Build();
    bytes[at] = byte;
    return ReadBytes(bytes);
  };
  EXPECT_THAT(with(0, 'X'),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("not LAS")));
  EXPECT_THAT(with(24, 2),
              StatusIs(absl::StatusCode::kUnimplemented, HasSubstr("LAS 2.2")));
  EXPECT_THAT(with(25, 5),
              StatusIs(absl::StatusCode::kUnimplemented, HasSubstr("LAS 1.5")));
  EXPECT_THAT(
      with(104, static_cast<char>(0x80)),
      StatusIs(absl::StatusCode::kUnimplemented, HasSubstr("decompress")));
  EXPECT_THAT(with(104, 11), StatusIs(absl::StatusCode::kUnimplemented,
                                      HasSubstr("point format 11")));
  EXPECT_THAT(with(94, 10), StatusIs(absl::StatusCode::kDataLoss,
                                     HasSubstr("offset 94: LAS 1.2 header")));
  EXPECT_THAT(with(96, 10), StatusIs(absl::StatusCode::kDataLoss,
                                     HasSubstr("offset of the points")));
  EXPECT_THAT(with(107, 9),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("declares 9 points of 20 bytes, the file "
                                 "ends after 1")));
  LasText zero_scale = text;
  zero_scale.scale[1] = 0;
  EXPECT_THAT(ReadBytes(zero_scale.Build()),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("scale")));
  LasText bad_offset = text;
  bad_offset.offset[2] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(ReadBytes(bad_offset.Build()),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("nan")));
  EXPECT_THAT(OpenLasFile("/no/such/file.las"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("file.las")));
}

TEST(LasReader, SurvivesEveryCutAndEveryChangedByte) {
  const std::string whole = LasText{
      .minor = 4,
      .format = 6,
      .vlrs = {ExtraVlr({{.type = 4, .options = 0x19, .name = "a"}}),
               Vlr("LASF_Projection", 2112, "WKT")},
      .records = {NewRecord() + "ab", NewRecord() + "cd"},
      .evlrs = {Evlr(
          "a", 1, "payload")}}.Build();
  const TemporaryFile file(".las");
  // Replacing a file in place waits for the disk, making a new one does not.
  const auto read = [&](const std::string& bytes) {
    std::filesystem::remove(file.path());
    file.Write(bytes);
    return ReadAll(OpenLasFile, file.path());
  };
  for (size_t size = 1; size < whole.size(); ++size) {
    const auto cloud = read(whole.substr(0, size));
    if (cloud.ok()) {
      EXPECT_EQ(cloud->size(), 2) << size;
    } else {
      EXPECT_EQ(cloud.status().code(), absl::StatusCode::kDataLoss) << size;
    }
  }
  for (size_t at = 0; at < whole.size(); ++at) {
    for (const char change : {'\x01', '\x80', '\xFF'}) {
      std::string changed = whole;
      changed[at] = static_cast<char>(changed[at] ^ change);
      const auto cloud = read(changed);
      if (cloud.ok()) {
        EXPECT_LE(cloud->size(), whole.size() / 30) << at;
      }
    }
  }
}

}  // namespace
}  // namespace mapsieve::client
