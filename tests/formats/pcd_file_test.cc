#include "client/formats/pcd_file.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "core/cloud/point_cloud.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/formats/file_table.h"
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
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::Packed;
using testing::ReadAll;
using testing::TemporaryFile;

// The simplest LZF there is: literals only.
std::string LzfLiterals(std::string_view raw) {
  std::string compressed;
  while (!raw.empty()) {
    const std::string_view run = raw.substr(0, 32);
    compressed += static_cast<char>(run.size() - 1);
    compressed += run;
    raw.remove_prefix(run.size());
  }
  return compressed;
}

std::string Compressed(std::string_view raw) {
  const std::string lzf = LzfLiterals(raw);
  return Packed(static_cast<uint32_t>(lzf.size()),
                static_cast<uint32_t>(raw.size())) +
         lzf;
}

absl::StatusOr<PointCloud> ReadText(const std::string& content) {
  const TemporaryFile file(".pcd", content);
  return ReadAll(OpenPcdFile, file.path(), 3);
}

constexpr char kXyzHeader[] =
    "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n";

TEST(PcdReader, ReadsEveryTypeOfAnAsciiFile) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("# comment\nVERSION 0.7\n"
               "FIELDS x y z a b c d e f g h i j\n"
               "SIZE 4 8 2 1 1 2 2 4 4 8 8 4 8\n"
               "TYPE F F I I U I U I U I U F F\n"
               "COUNT 1 1 1 1 1 1 1 1 1 1 1 1 1\n"
               "WIDTH 2\nHEIGHT 1\nVIEWPOINT 1 2 3 0 1 0 0\nPOINTS 2\n"
               "DATA ascii\r\n"
               "4320978.61 -2.5e3 7 -128 255 -32768 65535 -2147483648 "
               "4294967295 -9223372036854775808 18446744073709551615 0.1 0.1\n"
               "\n"
               "nan\tinf,-3, 127,0 32767 0 2147483647 0 9223372036854775807 0 "
               "-nan -inf\r\n"));
  ASSERT_EQ(cloud.size(), 2U);
  // Coordinates are not rounded to the float32 that the header names.
  EXPECT_EQ(cloud.positions[0], (Point3{4320978.61, -2500, 7}));
  EXPECT_TRUE(std::isnan(cloud.positions[1].x));
  EXPECT_EQ(cloud.positions[1].y, std::numeric_limits<double>::infinity());
  EXPECT_EQ(cloud.positions[1].z, -3);
  EXPECT_THAT(cloud.attributes.specs(),
              ElementsAre(ColumnSpec{"a", ScalarType::kInt8},
                          ColumnSpec{"b", ScalarType::kUint8},
                          ColumnSpec{"c", ScalarType::kInt16},
                          ColumnSpec{"d", ScalarType::kUint16},
                          ColumnSpec{"e", ScalarType::kInt32},
                          ColumnSpec{"f", ScalarType::kUint32},
                          ColumnSpec{"g", ScalarType::kInt64},
                          ColumnSpec{"h", ScalarType::kUint64},
                          ColumnSpec{"i", ScalarType::kFloat32},
                          ColumnSpec{"j", ScalarType::kFloat64}));
  EXPECT_EQ(cloud.attributes.Find("a")->Get<int8_t>(0), -128);
  EXPECT_EQ(cloud.attributes.Find("b")->Get<uint8_t>(0), 255);
  EXPECT_EQ(cloud.attributes.Find("c")->Get<int16_t>(0), -32768);
  EXPECT_EQ(cloud.attributes.Find("d")->Get<uint16_t>(0), 65535);
  EXPECT_EQ(cloud.attributes.Find("e")->Get<int32_t>(0), -2147483647 - 1);
  EXPECT_EQ(cloud.attributes.Find("f")->Get<uint32_t>(0), 4294967295U);
  EXPECT_EQ(cloud.attributes.Find("g")->Get<int64_t>(0),
            std::numeric_limits<int64_t>::min());
  EXPECT_EQ(cloud.attributes.Find("g")->Get<int64_t>(1),
            std::numeric_limits<int64_t>::max());
  EXPECT_EQ(cloud.attributes.Find("h")->Get<uint64_t>(0),
            std::numeric_limits<uint64_t>::max());
  EXPECT_EQ(cloud.attributes.Find("i")->Get<float>(0), 0.1F);
  EXPECT_EQ(cloud.attributes.Find("j")->Get<double>(0), 0.1);
  EXPECT_TRUE(std::isnan(cloud.attributes.Find("i")->Get<float>(1)));
}

TEST(PcdReader, ReadsTheInterleavedRecordsOfABinaryFile) {
  const auto record = [](double x, float y, int16_t z, uint8_t a, int64_t b) {
    return Packed(a, z, uint8_t{0xEE}, uint8_t{0xEE}, uint8_t{0xEE}, x, y, b);
  };
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("VERSION .7\nFIELDS a Z _ X Y b\nSIZE 1 2 1 8 4 8\n"
               "TYPE U I U F F I\nCOUNT 1 1 3 1 1 1\nWIDTH 2\nHEIGHT 2\n"
               "POINTS 4\nDATA binary\n" +
               record(0.1, 1.5F, -3, 255, -5) + record(2, 3, 4, 1, 6) +
               record(5, 6, 7, 2, 8) + record(8, 9, 10, 3, 1LL << 62) +
               "what follows is ignored"));
  EXPECT_THAT(cloud.positions,
              ElementsAre(Point3{0.1, 1.5, -3}, Point3{2, 3, 4},
                          Point3{5, 6, 7}, Point3{8, 9, 10}));
  EXPECT_THAT(cloud.attributes.specs(),
              ElementsAre(ColumnSpec{"a", ScalarType::kUint8},
                          ColumnSpec{"b", ScalarType::kInt64}));
  EXPECT_EQ(cloud.attributes.Find("a")->Get<uint8_t>(0), 255);
  EXPECT_EQ(cloud.attributes.Find("b")->Get<int64_t>(3), 1LL << 62);
}

TEST(PcdReader, ReadsTheColumnsOfACompressedFileWithOrWithoutPadding) {
  const std::string header =
      "VERSION .7\nFIELDS x y z _ n\nSIZE 4 8 4 1 2\nTYPE F F F U U\n"
      "COUNT 1 1 1 5 2\nWIDTH 3\nHEIGHT 1\nPOINTS 3\n"
      "DATA binary_compressed\n";
  const std::string position =
      Packed(1.F, 2.F, 3.F) + Packed(0.1, 0.2, 0.3) + Packed(7.F, 8.F, 9.F);
  const std::string padding(3 * 5, '\x55');
  const std::string pairs = Packed(uint16_t{10}, uint16_t{11}, uint16_t{20},
                                   uint16_t{21}, uint16_t{30}, uint16_t{65535});
  for (const std::string& raw :
       {position + padding + pairs, position + pairs}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const PointCloud cloud,
        ReadText(header + Compressed(raw) + "trailing"));
    EXPECT_THAT(
        cloud.positions,
        ElementsAre(Point3{1, 0.1, 7}, Point3{2, 0.2, 8}, Point3{3, 0.3, 9}));
    EXPECT_THAT(cloud.attributes.specs(),
                ElementsAre(ColumnSpec{"n_0", ScalarType::kUint16},
                            ColumnSpec{"n_1", ScalarType::kUint16}));
    EXPECT_EQ(cloud.attributes.Find("n_0")->Get<uint16_t>(2), 30);
    EXPECT_EQ(cloud.attributes.Find("n_1")->Get<uint16_t>(0), 11);
    EXPECT_EQ(cloud.attributes.Find("n_1")->Get<uint16_t>(2), 65535);
  }
}

TEST(PcdReader, NumbersTheValuesOfAFieldAndSkipsPaddingInAnAsciiFile) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("FIELDS n _ x y z\nSIZE 2 4 4 4 4\nTYPE U F F F F\n"
               "COUNT 2 3 1 1 1\nPOINTS 1\nDATA ascii\n7 8 nan - . 1 2 3\n"));
  EXPECT_THAT(cloud.positions, ElementsAre(Point3{1, 2, 3}));
  EXPECT_THAT(cloud.attributes.specs(),
              ElementsAre(ColumnSpec{"n_0", ScalarType::kUint16},
                          ColumnSpec{"n_1", ScalarType::kUint16}));
  EXPECT_EQ(cloud.attributes.Find("n_0")->Get<uint16_t>(0), 7);
  EXPECT_EQ(cloud.attributes.Find("n_1")->Get<uint16_t>(0), 8);
}

TEST(PcdReader, KeepsTheBitsOfAColourPackedInAFloat) {
  constexpr uint32_t kSignallingNan = 0xFF812345;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("FIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 1\n"
               "DATA binary\n" +
               Packed(1.F, 2.F, 3.F, kSignallingNan)));
  const Column& rgb = *cloud.attributes.Find("rgb");
  EXPECT_EQ(rgb.type(), ScalarType::kFloat32);
  EXPECT_EQ(rgb.Get<uint32_t>(0), kSignallingNan);
  EXPECT_FALSE(rgb.IsMissing(0));
}

TEST(PcdReader, TakesTheDefaultsOfOldHeaders) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("VERSION .5\nCOLUMNS x y z i\nPOINTS 1\nDATA ascii\n1 2 3 4"));
  EXPECT_THAT(cloud.positions, ElementsAre(Point3{1, 2, 3}));
  EXPECT_THAT(cloud.attributes.specs(),
              ElementsAre(ColumnSpec{"i", ScalarType::kFloat32}));
}

TEST(PcdReader, PrefersLowerCaseCoordinates) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("FIELDS X x Y z\nPOINTS 1\nDATA ascii\n1 2 3 4\n"));
  EXPECT_THAT(cloud.positions, ElementsAre(Point3{2, 3, 4}));
  EXPECT_THAT(cloud.attributes.specs(),
              ElementsAre(ColumnSpec{"X", ScalarType::kFloat32}));
}

TEST(PcdReader, TellsFormatCountAndAttributesAtOnce) {
  const TemporaryFile file(".pcd",
                           "FIELDS x y z i\nSIZE 4 4 4 2\nTYPE F F F U\n"
                           "POINTS 2\nDATA ascii\n1 2 3 4\n5 6 7 8\n");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenPcdFile(file.path()));
  EXPECT_EQ(reader->info().format, "PCD ascii");
  EXPECT_EQ(reader->info().point_count, 2);
  EXPECT_EQ(reader->info().coordinate_step, 0);
  EXPECT_THAT(reader->info().attributes,
              ElementsAre(ColumnSpec{"i", ScalarType::kUint16}));
}

TEST(PcdReader, RefusesWithTheReason) {
  struct Case {
    std::string content;
    absl::StatusCode code;
    std::string message;
  };
  using enum absl::StatusCode;
  const std::string point = Packed(1.F, 2.F, 3.F);
  const std::string sizes_3 = absl::StrCat(
      kXyzHeader, "WIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA binary_compressed\n");
  const std::vector<Case> cases = {
      {"FIELDS pos i\nCOUNT 3 1\nPOINTS 1\nDATA ascii\n1 2 3 4\n",
       kInvalidArgument, "x y z in one field (\"pos\" has COUNT 3)"},
      {"FIELDS x y i\nPOINTS 1\nDATA ascii\n1 2 3\n", kInvalidArgument,
       "no z among \"x\", \"y\", \"i\""},
      {"FIELDS x y z\nCOUNT 1 1 2\nPOINTS 1\nDATA ascii\n1 2 3 4\n",
       kInvalidArgument, "field z has COUNT 2"},
      {"FIELDS x y z a a\nPOINTS 1\nDATA ascii\n1 2 3 4 5\n", kInvalidArgument,
       "two columns are named \"a\""},
      {"FIELDS x y z a\nSIZE 4 4 4 2\nPOINTS 1\nDATA ascii\n1 2 3 4\n",
       kInvalidArgument, "field \"a\" is TYPE \"F\" SIZE 2"},
      {"FIELDS x y z a\nTYPE F F F Q\nPOINTS 1\nDATA ascii\n1 2 3 4\n",
       kInvalidArgument, "field \"a\" is TYPE \"Q\" SIZE 4"},
      {"FIELDS x y z a\nCOUNT 1 1 1 2000\nPOINTS 0\nDATA ascii\n",
       kInvalidArgument, "more than 1024 values a point"},
      {"FIELDS x y z _\nCOUNT 1 1 1 1000000\nPOINTS 0\nDATA binary\n",
       kInvalidArgument, "more than 1048576 bytes"},
      {"VERSION 0.8\n", kUnimplemented, "PCD version 0.8"},
      {"VERSION nan\n", kUnimplemented, "PCD version nan"},
      {"VERSION x\n", kDataLoss, "line 1: VERSION: expected a number"},
      {"FIELDS x y z\nSIZE 4 4\n", kDataLoss,
       "line 2: SIZE: expected a word for each of the 3 fields, found 2"},
      {"FIELDS x y z\nCOUNT 1 1 0\n", kDataLoss, "COUNT of field \"z\""},
      {"FIELDS x y z\nWIDTH -1\n", kDataLoss, "WIDTH"},
      {"FIELDS x y z\nDATA binaer\n", kDataLoss, "found \"binaer\""},
      {"FIELDS x y z\nDATA ascii\n", kDataLoss, "neither POINTS nor WIDTH"},
      {"POINTS 0\nDATA ascii\n", kDataLoss, "no FIELDS"},
      {"FIELDS x y z\nWIDTH 2\nHEIGHT 2\nPOINTS 5\nDATA ascii\n", kDataLoss,
       "WIDTH 2 and HEIGHT 2, but POINTS 5"},
      {"FIELDS x y z\nWIDTH 9223372036854775807\nHEIGHT 3\nDATA ascii\n",
       kDataLoss, "WIDTH 9223372036854775807 and HEIGHT 3"},
      {"FIELDS x y z\nPOINTS 9223372036854775807\nDATA ascii\n1 2 3\n",
       kDataLoss,
       "9223372036854775807 records of at least 5 bytes, but only 6"},
      {"FIELDS x y z\nPOINTS 9223372036854775807\nDATA binary\n" + point,
       kDataLoss,
       "9223372036854775807 records of at least 12 bytes, but only 12"},
      {"FIELDS x y z\nPOINTS 2\nDATA ascii\n100.25 200 300\n", kDataLoss,
       "the file ends before point 2 of 2"},
      {"FIELDS x y z\nPOINTS 1\nDATA ascii\n1 2 3 4\n", kDataLoss,
       "line 4: expected the 3 values of a point, found 4"},
      {"FIELDS x y z\nPOINTS 1\nDATA ascii\n\n1 2 3..5\n", kDataLoss,
       "line 5: z: expected a number of type float32, found \"3..5\""},
      {"FIELDS x y z a\nSIZE 4 4 4 1\nTYPE F F F U\nPOINTS 1\nDATA ascii\n"
       "1 2 3 256\n",
       kDataLoss, "line 6: a: expected a number of type uint8, found \"256\""},
      // More points than the payload says; a payload beyond the end of the
      // file; one that no compression could have shrunk so far; a reference to
      // bytes before the first; fewer bytes than declared.
      {sizes_3 + Compressed(point), kDataLoss,
       "expected 3 points of 12 bytes, found an uncompressed size of 12"},
      {sizes_3 + Packed(uint32_t{100}, uint32_t{36}) + point, kDataLoss,
       "expected 100 compressed bytes that make 36, the file has 12"},
      {absl::StrCat(kXyzHeader, "POINTS 357913941\nDATA binary_compressed\n") +
           Packed(uint32_t{12}, uint32_t{4294967292}) + point,
       kDataLoss, "expected 12 compressed bytes that make 4294967292"},
      {sizes_3 + Packed(uint32_t{3}, uint32_t{36}) +
           Packed(uint8_t{0xE0}, uint8_t{20}, uint8_t{9}),
       kDataLoss, "the compressed points are damaged"},
      {sizes_3 + Packed(uint32_t{13}, uint32_t{36}) + LzfLiterals(point),
       kDataLoss, "expected 36 bytes, decompressing gave 12"},
      {sizes_3 + "1234567", kDataLoss, "compressed size"},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.content);
    EXPECT_THAT(ReadText(c.content), StatusIs(c.code, HasSubstr(c.message)));
  }
}

TEST(PcdReader, RefusesAHeaderWithoutEnd) {
  const std::string endless = "FIELDS x y z\n" +
                              std::string(size_t{2} << 20, '\n') +
                              "POINTS 1\nDATA ascii\n1 2 3\n";
  EXPECT_THAT(ReadText(endless),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("no DATA line")));
}

TEST(PcdReader, ReportsAMissingFile) {
  EXPECT_THAT(OpenPcdFile("/nonexistent/a.pcd"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("a.pcd")));
}

// Small files of each kind, of five points.
std::vector<std::string> SmallFiles() {
  const std::string head =
      "VERSION .7\nFIELDS x y z i\nSIZE 4 4 4 2\nTYPE F F F U\n"
      "COUNT 1 1 1 1\nWIDTH 5\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
      "POINTS 5\nDATA ";
  std::string text;
  std::string records;
  std::string columns(5 * 14, '\0');
  for (int i = 0; i < 5; ++i) {
    absl::StrAppend(&text, i, ".5 ", 10 + i, " ", 20 + i, " ", 30 + i, "\n");
    records += Packed(static_cast<float>(i) + 0.5F, 10.F, 20.F, uint16_t{30});
    columns[static_cast<size_t>(i * 4 + 3)] = 'A';
  }
  return {head + "ascii\n" + text, head + "binary\n" + records,
          head + "binary_compressed\n" + Compressed(columns)};
}

TEST(PcdReader, RefusesEveryPrefixOfAFile) {
  for (const std::string& whole : SmallFiles()) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud all, ReadText(whole));
    ASSERT_EQ(all.size(), 5U);
    const bool is_text = whole.find("DATA ascii") != std::string::npos;
    // Without the last line's end, or its last digit, a text is still one.
    const size_t end = whole.size() - (is_text ? 2 : 0);
    for (size_t size = 0; size < end; ++size) {
      const auto result = ReadText(whole.substr(0, size));
      ASSERT_FALSE(result.ok()) << size << " of " << whole.size() << " bytes";
    }
  }
}

TEST(PcdReader, SurvivesAnyByteChanged) {
  for (const std::string& whole : SmallFiles()) {
    for (size_t i = 0; i < whole.size(); ++i) {
      for (const char c :
           {'\0', '\n', ' ', '9', '\xFF', static_cast<char>(whole[i] ^ 1)}) {
        std::string changed = whole;
        changed[i] = c;
        const auto result = ReadText(changed);
        if (result.ok()) {
          EXPECT_LE(result->size(), whole.size());
        }
      }
    }
  }
}

PointCloud CloudOfEveryType(size_t size) {
  PointCloud cloud;
  for (size_t i = 0; i < size; ++i) {
    const auto t = static_cast<double>(i);
    cloud.positions.push_back({331050.001 + t, 5183020.0003 - t / 3, 1 / t});
  }
  for (int type = 1; type <= 10; ++type) {
    const auto scalar = static_cast<ScalarType>(type);
    Column column({absl::StrCat("a", type), scalar}, size);
    // Any bits will do, NaN with payloads among them.
    uint32_t state = 12345;
    for (std::byte& b : column.mutable_bytes()) {
      state = state * 1664525U + 1013904223U;
      b = static_cast<std::byte>(state >> 24);
    }
    EXPECT_TRUE(cloud.attributes.Add(std::move(column)).ok());
  }
  return cloud;
}

TEST(PcdWriter, WritesWhatTheReaderReadsBitForBit) {
  const TemporaryFile file(".pcd");
  // More records than fit one block of the reader.
  const PointCloud cloud = CloudOfEveryType(20'000);
  const WriteOptions options{.attributes = cloud.attributes.specs()};
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                  CreatePcdFile(file.path(), options));
    MAPSIEVE_ASSERT_OK(writer->Write(cloud));
    MAPSIEVE_ASSERT_OK(writer->Write(cloud));
    EXPECT_FALSE(std::filesystem::exists(file.path()));
    MAPSIEVE_ASSERT_OK(writer->Finish());
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(PointCloud back,
                                ReadAll(OpenPcdFile, file.path(), 40'000));
  PointCloud twice = cloud;
  twice.positions.insert(twice.positions.end(), cloud.positions.begin(),
                         cloud.positions.end());
  MAPSIEVE_ASSERT_OK(
      twice.attributes.AppendAll(cloud.size(), cloud.attributes, cloud.size()));
  EXPECT_EQ(back.positions, twice.positions);
  EXPECT_EQ(back.attributes, twice.attributes);
}

TEST(PcdWriter, WritesTheHeaderOfTheFormat) {
  const TemporaryFile file(".pcd");
  PointCloud cloud{.positions = {{1, 2, 3}}};
  Column intensity({"my intensity", ScalarType::kUint16}, 1);
  intensity.Set<uint16_t>(0, 513);
  MAPSIEVE_ASSERT_OK(cloud.attributes.Add(std::move(intensity)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto writer,
      CreatePcdFile(file.path(), {.attributes = cloud.attributes.specs()}));
  MAPSIEVE_ASSERT_OK(writer->Write(cloud));
  MAPSIEVE_ASSERT_OK(writer->Finish());
  const std::string content = file.Read();
  EXPECT_THAT(content, ::testing::StartsWith(
                           "# .PCD v0.7 - Point Cloud Data file format"));
  EXPECT_THAT(content,
              ::testing::EndsWith(
                  "\nVERSION 0.7\nFIELDS x y z my_intensity\nSIZE 8 8 8 2\n"
                  "TYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 1\nHEIGHT 1\n"
                  "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA binary\n" +
                  Packed(1.0, 2.0, 3.0, uint16_t{513})));
}

TEST(PcdWriter, WritesFloatPositionsOnRequest) {
  const TemporaryFile file(".pcd");
  PointCloud cloud{.positions = {{1, 2.5, 16777217}}};
  Column ring({"ring", ScalarType::kUint8}, 1);
  ring.Set<uint8_t>(0, 7);
  MAPSIEVE_ASSERT_OK(cloud.attributes.Add(std::move(ring)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto writer,
      CreatePcdFile(file.path(), {.attributes = cloud.attributes.specs(),
                                  .float_positions = true}));
  MAPSIEVE_ASSERT_OK(writer->Write(cloud));
  MAPSIEVE_ASSERT_OK(writer->Finish());
  EXPECT_THAT(
      file.Read(),
      ::testing::EndsWith("\nVERSION 0.7\nFIELDS x y z ring\nSIZE 4 4 4 1\n"
                          "TYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 1\nHEIGHT 1\n"
                          "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA binary\n" +
                          Packed(1.0F, 2.5F, 16777216.0F, uint8_t{7})));
}

TEST(PcdWriter, KeepsWherePointsLieInComments) {
  const std::string wkt = "PROJCS[\"a b\",UNIT[\"foot\",0.3048]]";
  for (const std::string& crs : {std::string("EPSG:2056"), wkt}) {
    const TemporaryFile file(".pcd");
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto writer,
        CreatePcdFile(file.path(), {.crs_wkt = crs, .frame_id = "map 1"}));
    MAPSIEVE_ASSERT_OK(writer->Write({.positions = {{1, 2, 3}}}));
    MAPSIEVE_ASSERT_OK(writer->Finish());
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenPcdFile(file.path()));
    EXPECT_EQ(reader->info().crs_wkt, crs);
    EXPECT_EQ(reader->info().frame_id, "map 1");
    EXPECT_EQ(reader->info().unit, crs == wkt ? "foot" : "metre");
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadAll(*reader));
    EXPECT_THAT(cloud.positions, ElementsAre(Point3{1, 2, 3}));
  }
  // Lines that are too long for readers are left out.
  const TemporaryFile file(".pcd");
  MAPSIEVE_ASSERT_OK(
      WritePointFile(file.path(), {.positions = {{1, 2, 3}}},
                     {.crs_wkt = "A[\"" + std::string(900, 'x') + "\"]"}));
  EXPECT_EQ(file.Read().find("crs:"), std::string::npos);
}

TEST(PcdReader, TakesOnlyItsOwnComments) {
  const auto info = [](const std::string& comments) {
    const TemporaryFile file(".pcd", comments +
                                         "VERSION 0.7\nFIELDS x y z\nWIDTH "
                                         "1\nPOINTS 1\nDATA ascii\n1 2 3\n");
    return (*OpenPcdFile(file.path()))->info();
  };
  EXPECT_EQ(info("# frame_id:   base link \n").frame_id, "base link");
  EXPECT_EQ(info("# crs: EPSG:25832\n").crs_wkt, "EPSG:25832");
  EXPECT_EQ(info("# crs: unknown\n").crs_wkt, "");
  EXPECT_EQ(info("# crs: unknown [sic]\n").crs_wkt, "");
  EXPECT_EQ(info("# the frame_id: map\n").frame_id, "");
  EXPECT_EQ(info("#\n").frame_id, "");
}

TEST(PcdWriter, WritesMissingValuesAsNanOrZero) {
  const TemporaryFile file(".pcd");
  PointCloud cloud{.positions = {{1, 2, 3}, {4, 5, 6}}};
  for (const ScalarType type :
       {ScalarType::kFloat32, ScalarType::kFloat64, ScalarType::kInt32}) {
    Column column({std::string(ScalarTypeName(type)), type}, 2);
    column.SetMissing(1);
    MAPSIEVE_ASSERT_OK(cloud.attributes.Add(std::move(column)));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto writer,
      CreatePcdFile(file.path(), {.attributes = cloud.attributes.specs()}));
  MAPSIEVE_ASSERT_OK(writer->Write(cloud));
  MAPSIEVE_ASSERT_OK(writer->Finish());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud back,
                                ReadAll(OpenPcdFile, file.path()));
  EXPECT_EQ(back.attributes.Find("float32")->Get<float>(0), 0);
  EXPECT_TRUE(std::isnan(back.attributes.Find("float32")->Get<float>(1)));
  EXPECT_TRUE(std::isnan(back.attributes.Find("float64")->Get<double>(1)));
  EXPECT_EQ(back.attributes.Find("int32")->Get<int32_t>(1), 0);
}

TEST(PcdWriter, WritesAFileWithoutPoints) {
  const TemporaryFile file(".pcd");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                CreatePcdFile(file.path(), {}));
  MAPSIEVE_ASSERT_OK(writer->Finish());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud back,
                                ReadAll(OpenPcdFile, file.path()));
  EXPECT_EQ(back.size(), 0U);
}

TEST(PcdWriter, LeavesNothingWithoutFinish) {
  const TemporaryFile file(".pcd");
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                  CreatePcdFile(file.path(), {}));
    MAPSIEVE_ASSERT_OK(writer->Write({.positions = {{1, 2, 3}}}));
  }
  EXPECT_FALSE(std::filesystem::exists(file.path()));
}

TEST(PcdWriter, RefusesNamesThatTheFormatCannotHold) {
  const TemporaryFile file(".pcd");
  for (const std::vector<std::string>& names :
       std::vector<std::vector<std::string>>{
           {"x"}, {"_"}, {" \t"}, {""}, {"a b", "a_b"}}) {
    WriteOptions options;
    for (const std::string& name : names) {
      options.attributes.push_back({name, ScalarType::kFloat32});
    }
    EXPECT_THAT(CreatePcdFile(file.path(), options),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         HasSubstr(file.path().string())))
        << names.front();
  }
}

TEST(PcdWriter, RefusesABatchWithOtherAttributes) {
  const TemporaryFile file(".pcd");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto writer,
      CreatePcdFile(file.path(), {.attributes = {{"i", ScalarType::kUint16}}}));
  PointCloud cloud{.positions = {{1, 2, 3}}};
  MAPSIEVE_ASSERT_OK(
      cloud.attributes.Add(Column({"i", ScalarType::kInt16}, 1)));
  EXPECT_THAT(writer->Write(cloud),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("int16"), HasSubstr("uint16"))));
}

#ifdef MAPSIEVE_TEST_DATA

const std::filesystem::path kFolder =
    std::filesystem::path(MAPSIEVE_TEST_DATA) / "formats" / "pcd";

TEST(PcdReader, ReadsOrRefusesEveryRealFile) {
  using enum absl::StatusCode;
  testing::ExpectTable(
      kFolder,
      {
          {"loaders/Zaghetto.pcd", 59750},
          {"loaders/simple-ascii.pcd", 213},
          {"pcd-rs/ascii.pcd", 213},
          {"pcd-rs/binary.pcd", 28944},
          {"pcd-rs/corrupt_compressed.pcd", 0, kDataLoss,
           "expected 3 points of 12 bytes, found an uncompressed size of 200"},
          {"pcd-rs/empty_compressed.pcd", 0},
          {"pcd-rs/empty_compressed_debug.pcd", 0},
          {"pcd-rs/highly_compressed.pcd", 1000},
          {"pcd-rs/highly_uncompressed.pcd", 1000},
          {"pcd-rs/large_compressed.pcd", 10000},
          {"pcd-rs/mixed_types_compressed.pcd", 0, kInvalidArgument,
           "no z among"},
          {"pcd-rs/output_binary.pcd", 3},
          {"pcd-rs/output_compressed.pcd", 3},
          {"pcd-rs/single_compressed.pcd", 1},
          {"pcd-rs/test_unsupported_version.pcd", 1},
          {"pcd-rs/test_v05_ascii.pcd", 2},
          {"pcd-rs/test_v05_no_viewpoint.pcd", 0, kInvalidArgument,
           "no y among \"x\""},
          {"pcd-rs/test_v06_binary.pcd", 1},
          // Its field pos has COUNT 1: there is no position at all.
          {"pcd-rs/test_v06_mixed_types.pcd", 0, kInvalidArgument,
           "no x among \"pos\""},
          {"pcd-rs/test_v5_compressed.pcd", 0, kDataLoss, "compressed size"},
          {"pcd-rs/test_v6_compressed.pcd", 0, kDataLoss, "compressed size"},
          {"pcl/bun0.pcd", 397},
          {"pcl/car6.pcd", 10031},
          {"pcl/colored_cloud.pcd", 1000},
          {"pcl/cturtle.pcd", 167198},
          {"pcl/lamppost.pcd", 1771},
          {"pcl/milk_color.pcd", 13704},
          {"pdal/autzen-utm.pcd", 1065},
          {"pdal/missingheader.pcd", 0, kDataLoss,
           "line 1: expected an entry of a PCD header"},
          // Ten lines of X Y Z each, and POINTS 10.
          {"pdal/utm17_comma.pcd", 10},
          {"pdal/utm17_space.pcd", 10},
          {"pdal/utm17_tab.pcd", 10},
          {"pypcd4/ascii.pcd", 213},
          {"pypcd4/ascii_empty.pcd", 0, kDataLoss, "no DATA line"},
          {"pypcd4/ascii_invalid_header.pcd", 0, kDataLoss, "\"FIEL\""},
          {"pypcd4/ascii_multi_count.pcd", 8},
          {"pypcd4/ascii_organized.pcd", 8},
          {"pypcd4/ascii_with_empty_points.pcd", 0},
          {"pypcd4/ascii_with_underscore.pcd", 213},
          {"pypcd4/binary.pcd", 213},
          {"pypcd4/binary_compressed.pcd", 213},
          {"pypcd4/binary_compressed_organized.pcd", 8},
      },
      OpenPcdFile);
}

TEST(PcdReader, ReadsTheExtentOfRealFiles) {
  struct Case {
    const char* path;
    Point3 low;
    Point3 high;
  };
  // As the files' README gives them, to its eight digits.
  const std::vector<Case> cases = {
      {"pcl/bun0.pcd",
       {-0.093938001, 0.037420001, -0.055025999},
       {0.059562001, 0.18449999, 0.057803001}},
      {"pcl/car6.pcd",
       {-40.168999, -68.559998, -6.9899998},
       {-33.950001, -61.880001, -5.4299998}},
      {"pcl/cturtle.pcd",
       {-1.419718, -1.049687, 1.396101},
       {1.419718, 1.064718, 1.999997}},
      {"pcl/milk_color.pcd",
       {-0.1400829, -0.26378, 0.71399999},
       {0.01380667, -0.01172857, 0.89099997}},
      {"loaders/Zaghetto.pcd",
       {0.17192, 0.42276001, 0.50111997},
       {0.72847003, 0.83886999, 0.69725001}},
      {"pcd-rs/binary.pcd",
       {-3.6720905, -62.97187, -4.3202682},
       {52.610332, 93.156784, 18.786121}},
      {"pcd-rs/large_compressed.pcd",
       {-0.99999964, -1, -0.99999976},
       {333.30002, 666.60004, 999.90002}},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.path);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                  ReadAll(OpenPcdFile, kFolder / c.path, 1000));
    testing::ExpectExtent(cloud, c.low, c.high);
  }
}

TEST(PcdReader, ReadsTheSameCloudFromAllThreeKindsOfData) {
  const auto read = [](const char* name) {
    return ReadAll(OpenPcdFile, kFolder / "pypcd4" / name);
  };
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud text, read("ascii.pcd"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud binary, read("binary.pcd"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud compressed,
                                read("binary_compressed.pcd"));
  EXPECT_EQ(compressed.positions, binary.positions);
  EXPECT_EQ(compressed.attributes, binary.attributes);
  EXPECT_EQ(text.attributes, binary.attributes);
  for (size_t i = 0; i < text.size(); ++i) {
    EXPECT_EQ(static_cast<float>(text.positions[i].x), binary.positions[i].x);
    EXPECT_EQ(static_cast<float>(text.positions[i].y), binary.positions[i].y);
  }
}

TEST(PcdReader, KeepsTheCoordinatesAndAttributesOfAnAutzenScan) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud comma,
      ReadAll(OpenPcdFile, kFolder / "pdal" / "utm17_comma.pcd"));
  EXPECT_EQ(comma.positions[9], (Point3{289818.50, 4320980.59, 170.58}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto reader, OpenPcdFile(kFolder / "pdal" / "autzen-utm.pcd"));
  EXPECT_EQ(reader->info().attributes.size(), 13U);
  EXPECT_EQ(reader->info().attributes[0],
            (ColumnSpec{"Intensity", ScalarType::kUint16}));
  EXPECT_EQ(reader->info().attributes[9],
            (ColumnSpec{"GpsTime", ScalarType::kFloat64}));
}

#endif  // MAPSIEVE_TEST_DATA

}  // namespace
}  // namespace mapsieve::client
