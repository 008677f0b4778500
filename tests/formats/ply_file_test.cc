#include "client/formats/ply_file.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "core/base/bytes.h"
#include "core/cloud/point_cloud.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/formats/file_table.h"
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
using ::testing::HasSubstr;
using testing::ReadAll;
using testing::TemporaryFile;

// Bytes of the fields, one after another.
template <bool kBigEndian, typename... Fields>
std::string Packed(Fields... fields) {
  std::string bytes;
  const auto put = [&](auto field) {
    ByteWriter writer;
    writer.Put(field);
    if (kBigEndian) std::reverse(writer.bytes().begin(), writer.bytes().end());
    bytes.append(reinterpret_cast<const char*>(writer.bytes().data()),
                 writer.size());
  };
  (put(fields), ...);
  return bytes;
}

absl::StatusOr<PointCloud> ReadText(const std::string& content) {
  const TemporaryFile file(".ply", content);
  return ReadAll(OpenPlyFile, file.path(), 2);
}

constexpr char kXyz[] =
    "property float x\nproperty float y\nproperty float z\n";

std::string Header(const std::string& format, const std::string& elements) {
  return "ply\nformat " + format + " 1.0\n" + elements + "end_header\n";
}

TEST(PlyReader, ReadsEveryTypeUnderBothNames) {
  struct Case {
    const char* name;
    ScalarType type;
    const char* text;
    double value;
  };
  const std::vector<Case> cases = {
      {"char", ScalarType::kInt8, "-128", -128},
      {"int8", ScalarType::kInt8, "127", 127},
      {"uchar", ScalarType::kUint8, "255", 255},
      {"uint8", ScalarType::kUint8, "200", 200},
      {"short", ScalarType::kInt16, "-32768", -32768},
      {"int16", ScalarType::kInt16, "32767", 32767},
      {"ushort", ScalarType::kUint16, "65535", 65535},
      {"uint16", ScalarType::kUint16, "40000", 40000},
      {"int", ScalarType::kInt32, "-2147483648", -2147483648.0},
      {"int32", ScalarType::kInt32, "2147483647", 2147483647},
      {"uint", ScalarType::kUint32, "4294967295", 4294967295},
      {"uint32", ScalarType::kUint32, "3000000000", 3000000000},
      {"float", ScalarType::kFloat32, "0.5", 0.5},
      {"float32", ScalarType::kFloat32, "-1e-3", -1e-3F},
      {"double", ScalarType::kFloat64, "0.1", 0.1},
      {"float64", ScalarType::kFloat64, "1e300", 1e300},
  };
  std::string properties;
  std::string line = "1 2 3";
  for (const Case& c : cases) {
    absl::StrAppend(&properties, "property ", c.name, " p_", c.name, "\n");
    absl::StrAppend(&line, " ", c.text);
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText(Header("ascii",
                      "element vertex 1\n" + std::string(kXyz) + properties) +
               line));
  ASSERT_EQ(cloud.attributes.columns().size(), cases.size());
  for (size_t i = 0; i < cases.size(); ++i) {
    const Column& column = cloud.attributes.columns()[i];
    EXPECT_EQ(column.name(), absl::StrCat("p_", cases[i].name));
    EXPECT_EQ(column.type(), cases[i].type) << cases[i].name;
    EXPECT_EQ(column.GetAsDouble(0), cases[i].value) << cases[i].name;
  }
}

// An element with a list before the vertices, vertices with a list amid and
// elements after them.
template <bool kBigEndian>
std::string MixedBinary() {
  const auto pack = [](auto... fields) {
    return Packed<kBigEndian>(fields...);
  };
  return Header(kBigEndian ? "binary_big_endian" : "binary_little_endian",
                "comment a\nelement face 2\nproperty list uchar short index\n"
                "property double area\nelement plain 2\nproperty int a\n"
                "element vertex 3\nproperty short z\nproperty uint id\n"
                "property list int double w\nproperty double x\n"
                "property uchar flag\nproperty float y\nelement edge 5\n"
                "property list uint int e\n") +
         pack(uint8_t{3}, int16_t{1}, int16_t{2}, int16_t{3}, 0.5) +
         pack(uint8_t{0}, 0.25) + pack(int32_t{7}, int32_t{8}) +
         pack(int16_t{-3}, uint32_t{4000000000}, int32_t{2}, 1.0, 2.0, 0.1,
              uint8_t{9}, 1.5F) +
         pack(int16_t{300}, uint32_t{5}, int32_t{0}, 2e10, uint8_t{8}, -2.F) +
         pack(int16_t{1}, uint32_t{6}, int32_t{1}, 3.0, -1.0, uint8_t{255},
              0.F);
}

TEST(PlyReader, SkipsListsAndOtherElementsInBothByteOrders) {
  for (const std::string& content :
       {MixedBinary<false>(), MixedBinary<true>()}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadText(content));
    EXPECT_THAT(cloud.positions,
                ElementsAre(Point3{0.1, 1.5, -3}, Point3{2e10, -2, 300},
                            Point3{-1, 0, 1}));
    EXPECT_THAT(cloud.attributes.specs(),
                ElementsAre(ColumnSpec{"id", ScalarType::kUint32},
                            ColumnSpec{"flag", ScalarType::kUint8}));
    EXPECT_EQ(cloud.attributes.Find("id")->Get<uint32_t>(0), 4000000000U);
    EXPECT_EQ(cloud.attributes.Find("id")->Get<uint32_t>(2), 6U);
    EXPECT_EQ(cloud.attributes.Find("flag")->Get<uint8_t>(2), 255);
  }
}

template <bool kBigEndian>
std::string PlainBinary() {
  return Header(kBigEndian ? "binary_big_endian" : "binary_little_endian",
                "element vertex 3\nproperty ushort i\nproperty int z\n"
                "property double y\nproperty float x\n") +
         Packed<kBigEndian>(uint16_t{258}, int32_t{-70000}, 0.1, 1.5F) +
         Packed<kBigEndian>(uint16_t{1}, int32_t{2}, 3.0, 4.F) +
         Packed<kBigEndian>(uint16_t{5}, int32_t{6}, 7.0, 8.F);
}

TEST(PlyReader, ReadsPropertiesInAnyOrderInBothByteOrders) {
  for (const std::string& content :
       {PlainBinary<false>(), PlainBinary<true>()}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                  ReadText(content + "more is ignored"));
    EXPECT_THAT(cloud.positions, ElementsAre(Point3{1.5, 0.1, -70000},
                                             Point3{4, 3, 2}, Point3{8, 7, 6}));
    EXPECT_THAT(cloud.attributes.specs(),
                ElementsAre(ColumnSpec{"i", ScalarType::kUint16}));
    EXPECT_EQ(cloud.attributes.Find("i")->Get<uint16_t>(0), 258);
  }
}

TEST(PlyReader, SkipsListsAndOtherElementsOfAnAsciiFile) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("ply \r\nformat ascii 1.0\r\nobj_info by hand\r\n"
               "comment h\xC3\xA9\r\n\r\nelement face 2 \r\n"
               "property list uchar int i\r\nelement nothing 3\r\n"
               "element vertex 3\r\nproperty list uchar int l\r\n"
               "property char x\r\nproperty float y\r\nproperty double z\r\n"
               "property list uchar int m\r\nelement edge 9\r\n"
               "property int e\r\nend_header\r\n"
               "3 0 1 2\r\n\r\n1 0\r\n"
               "2 5 6 -1 2.5 331050.123456 1 9\r\n"
               "0 4 5 6 0\r\n   \r\n"
               // The list that ends the line may be left out when empty.
               "0 7 8 9\r\n"));
  EXPECT_THAT(cloud.positions, ElementsAre(Point3{-1, 2.5, 331050.123456},
                                           Point3{4, 5, 6}, Point3{7, 8, 9}));
  EXPECT_THAT(cloud.attributes.specs(), ElementsAre());
}

TEST(PlyReader, ReadsFilesWithoutVerticesAsNoPoints) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud none,
      ReadText(Header("ascii", absl::StrCat("element vertex 0\n", kXyz))));
  EXPECT_EQ(none.size(), 0U);
  const TemporaryFile file(".ply", Header("ascii", "element face 0\n"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenPlyFile(file.path()));
  EXPECT_EQ(reader->info().point_count, 0);
  EXPECT_THAT(reader->info().attributes, ElementsAre());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud batch, reader->ReadBatch(10));
  EXPECT_EQ(batch.size(), 0U);
}

TEST(PlyReader, TellsFormatAndCountAtOnce) {
  const TemporaryFile file(".ply", PlainBinary<true>());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenPlyFile(file.path()));
  EXPECT_EQ(reader->info().format, "PLY binary_big_endian");
  EXPECT_EQ(reader->info().point_count, 3);
  EXPECT_EQ(reader->info().coordinate_step, 0);
}

TEST(PlyReader, RefusesWithTheReason) {
  struct Case {
    std::string content;
    absl::StatusCode code;
    std::string message;
  };
  using enum absl::StatusCode;
  const std::string vertex = absl::StrCat("element vertex 1\n", kXyz);
  const std::string little = "binary_little_endian";
  const std::vector<Case> cases = {
      {"plyx\n", kDataLoss, "found \"plyx\""},
      {"ply\nformat ascii 1.0\n", kDataLoss, "no line end_header"},
      {"ply\nend_header\n", kDataLoss, "no line format"},
      {"ply\nformat utf8 1.0\n", kDataLoss, "line 2: format"},
      {"ply\nformat ascii 2.0\n", kInvalidArgument, "PLY version \"2.0\""},
      {"ply\nproperty int x\n", kDataLoss, "a property before any element"},
      {"ply\nelement vertex\n", kDataLoss, "expected how many"},
      {"ply\nelement vertex -1\n", kDataLoss, "found \"-1\""},
      {"ply\nelement vertex 1\nelement vertex 1\n", kDataLoss,
       "line 3: a second element"},
      {"ply\nelement vertex 1\nproperty int\n", kDataLoss,
       "line 3: expected \"property TYPE NAME\""},
      {"ply\nelement vertex 1\nproperty int \x01\x02\n", kDataLoss,
       "binary data amid the header"},
      {"ply\nelemnt vertex 1\n", kDataLoss, "found \"elemnt\""},
      {"ply\nelement vertex 1\nproperty bool b\n", kInvalidArgument,
       "property \"b\" is of type \"bool\""},
      {"ply\nelement vertex 1\nproperty list float int b\n", kInvalidArgument,
       "it must be an integer"},
      {Header("ascii", "element vertex 1\nproperty int x\nproperty int y\n") +
           "1 2\n",
       kInvalidArgument, "no z among \"x\", \"y\""},
      {Header("ascii", "element vertex 0\nproperty int x\nproperty int y\n"),
       kInvalidArgument, "no z among \"x\", \"y\""},
      {Header("ascii", vertex + "property list uchar int w\nproperty int w\n"
                                "property int w\n") +
           "1 2 3 0 1 1\n",
       kInvalidArgument, "two columns are named \"w\""},
      {Header("ascii", vertex) + "1 2 x\n", kDataLoss,
       "line 8: z: expected a number of type float32, found \"x\""},
      {Header("ascii", vertex) + "1 2 3 4\n", kDataLoss,
       "expected the 3 values of a point, found 4"},
      {Header("ascii", vertex + "property list uchar int w\n") + "1 2 3 2 1\n",
       kDataLoss, "a list of \"2\" values, but 1 words are left"},
      {Header("ascii", vertex + "property list uchar int w\n") +
           "1 2 3 1 1 1\n",
       kDataLoss, "expected the 5 words of a point, found 6"},
      {Header("ascii", "element vertex 1\nproperty list uchar int w\n" +
                           std::string(kXyz)) +
           "1 1 2 3\n",
       kDataLoss, "ends after 4 words"},
      {Header("ascii", "element face 2\nproperty int a\n" + vertex) + "1\n",
       kDataLoss, "the file ends after 1 of 2 lines of element \"face\""},
      {Header("ascii",
              "element vertex 9223372036854775807\n" + std::string(kXyz)) +
           "1 2 3\n",
       kDataLoss, "9223372036854775807 records"},
      {Header(little,
              "element vertex 9223372036854775807\n" + std::string(kXyz)) +
           "123456789012",
       kDataLoss, "9223372036854775807 records"},
      {Header(little, "element vertex 9223372036854775807\n" +
                          std::string(kXyz) + "property list int int l\n") +
           "123456789012",
       kDataLoss, "9223372036854775807 records"},
      {Header(little,
              "element a 4611686018427387904\nproperty int i\n" + vertex) +
           "123456789012",
       kDataLoss, "4611686018427387904 records of at least 4 bytes"},
      {Header(little,
              "element a 9223372036854775807\n"
              "property list uchar int i\n" +
                  vertex) +
           std::string(100, '\0'),
       kDataLoss, "expected 1 bytes, the file has 0"},
      {Header(little,
              "element a 1\nproperty int i\x7F\n"
              "property list uchar int j\n" +
                  vertex) +
           "123",
       kDataLoss, "i_: expected 4 bytes, the file has 3"},
      {Header(little, "element a 1\nproperty list int int i\n" + vertex) +
           Packed<false>(int32_t{-1}) + "123456789012",
       kDataLoss, "list \"i\" has -1 values"},
      {Header(little, "element a 1\nproperty list uint double i\n" + vertex) +
           Packed<false>(uint32_t{4294967295}) + "123456789012",
       kDataLoss, "expected 34359738360 bytes, the file has 12"},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.content);
    EXPECT_THAT(ReadText(c.content), StatusIs(c.code, HasSubstr(c.message)));
  }
}

TEST(PlyReader, RefusesAHeaderWithoutEnd) {
  const std::string endless = "ply\nformat ascii 1.0\n" +
                              std::string(size_t{2} << 20, '\n') +
                              "end_header\n";
  EXPECT_THAT(ReadText(endless), StatusIs(absl::StatusCode::kDataLoss,
                                          HasSubstr("no line end_header")));
}

std::vector<std::string> SmallFiles() {
  return {PlainBinary<false>(), PlainBinary<true>(), MixedBinary<false>(),
          MixedBinary<true>(),
          Header("ascii",
                 "element face 1\nproperty list uchar int i\n"
                 "element vertex 2\n" +
                     std::string(kXyz) + "property uchar c\n") +
              "2 10 20\n1 2 3 45\n4 5 6 78\n"};
}

TEST(PlyReader, RefusesEveryPrefixOfAFile) {
  for (const std::string& whole : SmallFiles()) {
    MAPSIEVE_ASSERT_OK(ReadText(whole));
    const bool is_text = whole.find("ascii") != std::string::npos;
    // Without the last line's end, or its last digit, a text is still one.
    const size_t end = whole.size() - (is_text ? 2 : 0);
    for (size_t size = 0; size < end; ++size) {
      const auto result = ReadText(whole.substr(0, size));
      ASSERT_FALSE(result.ok()) << size << " of " << whole.size() << " bytes";
    }
  }
}

TEST(PlyReader, SurvivesAnyByteChanged) {
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

TEST(PlyWriter, WritesTheHeaderAndRecordsOfTheProduct) {
  const TemporaryFile file(".ply");
  const WriteOptions options{
      .attributes = {{"label", ScalarType::kUint8},
                     {"confidence", ScalarType::kFloat32},
                     {"gps time", ScalarType::kFloat64},
                     {"id", ScalarType::kInt64}}};
  PointCloud cloud{.positions = {{331050.001, 2, -3}}};
  // The batch may have its columns in another order.
  Column id(options.attributes[3], 1);
  id.Set<int64_t>(0, -(int64_t{1} << 53));
  Column label(options.attributes[0], 1);
  label.Set<uint8_t>(0, 2);
  Column confidence(options.attributes[1], 1);
  confidence.Set(0, 0.75F);
  Column time(options.attributes[2], 1);
  time.Set(0, 0.1);
  for (Column* column : {&id, &time, &confidence, &label}) {
    MAPSIEVE_ASSERT_OK(cloud.attributes.Add(*column));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                CreatePlyFile(file.path(), options));
  MAPSIEVE_ASSERT_OK(writer->Write(cloud));
  EXPECT_FALSE(std::filesystem::exists(file.path()));
  MAPSIEVE_ASSERT_OK(writer->Finish());
  const std::string content = file.Read();
  EXPECT_THAT(content, ::testing::StartsWith(
                           "ply\nformat binary_little_endian 1.0\ncomment "));
  EXPECT_THAT(content,
              ::testing::EndsWith(
                  "\nelement vertex 1\nproperty double x\nproperty double y\n"
                  "property double z\nproperty uchar label\nproperty float "
                  "confidence\nproperty double gps_time\nproperty double id\n"
                  "end_header\n" +
                  Packed<false>(331050.001, 2.0, -3.0, uint8_t{2}, 0.75F, 0.1,
                                -9007199254740992.0)));
}

TEST(PlyWriter, WritesFloatPositionsOnRequest) {
  const TemporaryFile file(".ply");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto writer, CreatePlyFile(file.path(), {.float_positions = true}));
  MAPSIEVE_ASSERT_OK(writer->Write({.positions = {{1, 2.5, 16777217}}}));
  MAPSIEVE_ASSERT_OK(writer->Finish());
  EXPECT_THAT(file.Read(),
              ::testing::EndsWith(
                  "\nelement vertex 1\nproperty float x\nproperty float y\n"
                  "property float z\nend_header\n" +
                  Packed<false>(1.0F, 2.5F, 16777216.0F)));
}

TEST(PlyWriter, WritesWhatTheReaderReadsBitForBit) {
  const TemporaryFile file(".ply");
  // More records than fit one block of the reader.
  constexpr size_t kSize = 20'000;
  PointCloud cloud;
  for (size_t i = 0; i < kSize; ++i) {
    const auto t = static_cast<double>(i);
    cloud.positions.push_back({331050.001 + t, 5183020.0003 - t / 3, 1 / t});
  }
  for (const ScalarType type :
       {ScalarType::kInt8, ScalarType::kUint8, ScalarType::kInt16,
        ScalarType::kUint16, ScalarType::kInt32, ScalarType::kUint32,
        ScalarType::kFloat32, ScalarType::kFloat64}) {
    Column column({std::string(ScalarTypeName(type)), type}, kSize);
    // Any bits will do, NaN with payloads among them.
    uint32_t state = 12345;
    for (std::byte& b : column.mutable_bytes()) {
      state = state * 1664525U + 1013904223U;
      b = static_cast<std::byte>(state >> 24);
    }
    MAPSIEVE_ASSERT_OK(cloud.attributes.Add(std::move(column)));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto writer,
      CreatePlyFile(file.path(), {.attributes = cloud.attributes.specs()}));
  MAPSIEVE_ASSERT_OK(writer->Write(cloud));
  MAPSIEVE_ASSERT_OK(
      writer->Write({.attributes = cloud.attributes.Select({})}));
  MAPSIEVE_ASSERT_OK(writer->Finish());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud back,
                                ReadAll(OpenPlyFile, file.path(), 40'000));
  EXPECT_EQ(back.positions, cloud.positions);
  EXPECT_EQ(back.attributes, cloud.attributes);
}

TEST(PlyWriter, KeepsWherePointsLieInComments) {
  const std::string wkt = "PROJCS[\"a b\",UNIT[\"foot\",0.3048]]";
  for (const std::string& crs : {std::string("EPSG:2056"), wkt}) {
    const TemporaryFile file(".ply");
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto writer,
        CreatePlyFile(file.path(), {.crs_wkt = crs, .frame_id = "map 1"}));
    MAPSIEVE_ASSERT_OK(writer->Write({.positions = {{1, 2, 3}}}));
    MAPSIEVE_ASSERT_OK(writer->Finish());
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenPlyFile(file.path()));
    EXPECT_EQ(reader->info().crs_wkt, crs);
    EXPECT_EQ(reader->info().frame_id, "map 1");
    EXPECT_EQ(reader->info().unit, crs == wkt ? "foot" : "metre");
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadAll(*reader));
    EXPECT_THAT(cloud.positions, ElementsAre(Point3{1, 2, 3}));
  }
  // Lines that are too long for readers are left out.
  const TemporaryFile file(".ply");
  MAPSIEVE_ASSERT_OK(
      WritePointFile(file.path(), {.positions = {{1, 2, 3}}},
                     {.crs_wkt = "A[\"" + std::string(900, 'x') + "\"]"}));
  EXPECT_EQ(file.Read().find("crs:"), std::string::npos);
  // Of those that bear codes there are the codes.
  MAPSIEVE_ASSERT_OK(WritePointFile(
      file.path(), {.positions = {{1, 2, 3}}},
      {.crs_wkt = "COMPD_CS[\"" + std::string(900, 'x') +
                  "\",PROJCS[\"a\",AUTHORITY[\"EPSG\",\"6580\"]],"
                  "VERT_CS[\"b\",AUTHORITY[\"EPSG\",\"5703\"]]]"}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenPlyFile(file.path()));
  EXPECT_EQ(reader->info().crs_wkt, "EPSG:6580+5703");
}

TEST(PlyReader, TakesOnlyItsOwnComments) {
  const auto info = [](const std::string& comments) {
    const TemporaryFile file(
        ".ply",
        Header("ascii", comments + "element vertex 1\n" + kXyz) + "1 2 3\n");
    return (*OpenPlyFile(file.path()))->info();
  };
  EXPECT_EQ(info("comment frame_id:   base link \n").frame_id, "base link");
  EXPECT_EQ(info("comment crs: EPSG:25832\n").crs_wkt, "EPSG:25832");
  EXPECT_EQ(info("comment crs: unknown\n").crs_wkt, "");
  EXPECT_EQ(info("comment crs: unknown [sic]\n").crs_wkt, "");
  EXPECT_EQ(info("comment the frame_id: map\n").frame_id, "");
  EXPECT_EQ(info("comment\n").frame_id, "");
}

TEST(PlyWriter, WritesMissingValuesAsNanOrZero) {
  const TemporaryFile file(".ply");
  PointCloud cloud{.positions = {{1, 2, 3}, {4, 5, 6}}};
  for (const ScalarType type :
       {ScalarType::kFloat32, ScalarType::kUint16, ScalarType::kInt64}) {
    Column column({std::string(ScalarTypeName(type)), type}, 2);
    column.SetMissing(1);
    MAPSIEVE_ASSERT_OK(cloud.attributes.Add(std::move(column)));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto writer,
      CreatePlyFile(file.path(), {.attributes = cloud.attributes.specs()}));
  MAPSIEVE_ASSERT_OK(writer->Write(cloud));
  MAPSIEVE_ASSERT_OK(writer->Finish());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud back,
                                ReadAll(OpenPlyFile, file.path()));
  EXPECT_EQ(back.attributes.Find("float32")->Get<float>(0), 0);
  EXPECT_TRUE(std::isnan(back.attributes.Find("float32")->Get<float>(1)));
  EXPECT_EQ(back.attributes.Find("uint16")->Get<uint16_t>(1), 0);
  EXPECT_TRUE(std::isnan(back.attributes.Find("int64")->Get<double>(1)));
}

TEST(PlyWriter, RefusesIntegersThatDoubleDoesNotHold) {
  const TemporaryFile file(".ply");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto writer,
      CreatePlyFile(file.path(), {.attributes = {{"s", ScalarType::kInt64},
                                                 {"u", ScalarType::kUint64}}}));
  const auto write = [&](int64_t s, uint64_t u) {
    PointCloud cloud{.positions = {{1, 2, 3}}};
    Column signed_column({"s", ScalarType::kInt64}, 1);
    signed_column.Set(0, s);
    Column unsigned_column({"u", ScalarType::kUint64}, 1);
    unsigned_column.Set(0, u);
    EXPECT_TRUE(cloud.attributes.Add(std::move(signed_column)).ok());
    EXPECT_TRUE(cloud.attributes.Add(std::move(unsigned_column)).ok());
    return writer->Write(cloud);
  };
  const auto refused =
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("of point 1 is"));
  constexpr int64_t kExact = int64_t{1} << 53;
  EXPECT_THAT(write(kExact + 1, 0), refused);
  EXPECT_THAT(write(-kExact - 1, 0), refused);
  EXPECT_THAT(write(std::numeric_limits<int64_t>::max(), 0), refused);
  EXPECT_THAT(write(0, std::numeric_limits<uint64_t>::max()), refused);
  EXPECT_THAT(write(0, (uint64_t{1} << 63) + 1), refused);
  MAPSIEVE_EXPECT_OK(
      write(std::numeric_limits<int64_t>::min(), uint64_t{1} << 63));
  MAPSIEVE_EXPECT_OK(write(-kExact, kExact + 2));
  MAPSIEVE_ASSERT_OK(writer->Finish());
  // What was refused left no trace.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud back,
                                ReadAll(OpenPlyFile, file.path()));
  ASSERT_EQ(back.size(), 2U);
  EXPECT_EQ(back.attributes.Find("s")->Get<double>(0), -0x1p63);
  EXPECT_EQ(back.attributes.Find("u")->Get<double>(1), 0x1p53 + 2);
}

TEST(PlyWriter, RefusesNamesThatTheFormatCannotHold) {
  const TemporaryFile file(".ply");
  for (const std::string name : {"y", "", "\n"}) {
    EXPECT_THAT(
        CreatePlyFile(file.path(),
                      {.attributes = {{name, ScalarType::kFloat32}}}),
        StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(".ply")));
  }
}

#ifdef MAPSIEVE_TEST_DATA

const std::filesystem::path kData(MAPSIEVE_TEST_DATA);
const std::filesystem::path kFolder = kData / "formats" / "ply";

absl::StatusOr<std::unique_ptr<PointReader>> OpenAny(
    const std::filesystem::path& path) {
  return path.extension() == ".ply" ? OpenPlyFile(path) : OpenPointFile(path);
}

TEST(PlyReader, ReadsOrRefusesEveryRealFile) {
  using enum absl::StatusCode;
  testing::ExpectTable(
      kFolder,
      {
          {"assimp/crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply", 0,
           kDataLoss, "line 7: binary data amid the header"},
          {"assimp/cube.ply", 8},
          {"assimp/cube_binary.ply", 8},
          {"assimp/cube_binary_header_with_RN_newline.ply", 8},
          {"assimp/cube_binary_starts_with_nl.ply", 8},
          {"assimp/cube_uv.ply", 24},
          {"assimp/empty.ply", 0, kDataLoss, "the end of the file"},
          {"assimp/float-color.ply", 3},
          // Its lines leave the list out that the header declares last.
          {"assimp/issue623.ply", 24},
          {"assimp/points.ply", 4},
          {"happly/platonic_shelf.ply", 50},
          {"happly/platonic_shelf_ascii.ply", 50},
          {"happly/platonic_shelf_big_endian.ply", 50},
          {"open3d/knot.ply", 1440},
          {"open3d/simple.xyz", 4},
          {"open3d/sphere.ply", 642},
          {"open3d/test_sample_ascii.ply", 7},
          {"open3d/test_sample_custom.ply", 7},
          {"open3d/test_sample_wrong_format.ply", 2},
          {"pdal/issue_2421.ply", 1},
          {"pdal/mesh.ply", 4},
          {"pdal/mesh_fixed.ply", 4},
          {"pdal/no_vertex.ply", 0},
          {"pdal/simple_binary.ply", 3},
          {"pdal/simple_text.ply", 3},
          {"pdal/sized_dims.ply", 0, kInvalidArgument, "no z among"},
          {"pdal/text_extradim.ply", 1},
          {"pdal/unsized_dims.ply", 0, kInvalidArgument, "no z among"},
          {"pyntcloud/diamond.las", 6},
          {"pyntcloud/diamond.laz", 0, kUnimplemented, "LAZ"},
          {"pyntcloud/diamond.ply", 6},
          {"pyntcloud/diamond.vtk", 6},
          {"pyntcloud/diamond.xyz", 6},
          {"pyntcloud/diamond_ascii.ply", 6},
          {"pyntcloud/diamond_ascii_vertex_index.ply", 6},
          {"pyntcloud/diamond_with_bool.ply", 0, kInvalidArgument,
           "property \"is_green\" is of type \"bool\""},
          {"pyntcloud/has_offsets.las", 20},
          {"pyntcloud/sphere.ply", 2929},
          {"pyntcloud/voxelgrid.ply", 6},
          {"trimesh/BoxTextured.ply", 24},
          {"trimesh/cube_blender_uv.ply", 24},
          {"trimesh/cube_blender_uv_meshlab.ply", 24},
          {"trimesh/empty.ply", 0},
          {"trimesh/fuze.ply", 502},
          {"trimesh/metadata.ply", 4},
          {"trimesh/mirror.ply", 143},
          {"trimesh/multi.ply", 4},
          {"trimesh/octagonal_pocket.ply", 1658},
          {"trimesh/plane.ply", 4},
          {"trimesh/plane_tri.ply", 4},
          {"trimesh/ply_empty_ascii.ply", 0},
          {"trimesh/ply_empty_bin.ply", 0},
          {"trimesh/ply_empty_header.ply", 0},
          {"trimesh/ply_points_ascii.ply", 8},
          {"trimesh/ply_points_bin.ply", 8},
          {"trimesh/points_agisoft.xyz", 100},
          {"trimesh/points_ascii.ply", 5},
          {"trimesh/points_ascii_with_lists.ply", 5},
          {"trimesh/points_bin.ply", 5},
          {"trimesh/points_cloudcompare.xyz", 101},
          // A thirteenth line follows the twelve that the header declares.
          {"trimesh/points_emptyascii.ply", 12},
          {"trimesh/points_emptyface.ply", 1024},
          {"trimesh/reference.ply", 845},
          {"trimesh/sphere.ply", 642},
          {"trimesh/tet.ply", 4},
      },
      OpenAny);
}

TEST(PlyReader, ReadsTheRegistrationPair) {
  for (const auto& [name, count] :
       {std::pair{"source.ply", 69792U}, std::pair{"target.ply", 69088U}}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const PointCloud cloud,
        ReadAll(OpenPlyFile, kData / "registration" / "small_gicp" / name,
                10'000));
    EXPECT_EQ(cloud.size(), count);
    EXPECT_THAT(
        cloud.attributes.specs(),
        ElementsAre(ColumnSpec{"scalar_intensity", ScalarType::kFloat32}));
  }
}

TEST(PlyReader, ReadsTheSameMeshFromAllThreeEncodings) {
  const auto read = [](const char* name) {
    return ReadAll(OpenPlyFile, kFolder / "happly" / name);
  };
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud little,
                                read("platonic_shelf.ply"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud big,
                                read("platonic_shelf_big_endian.ply"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud text,
                                read("platonic_shelf_ascii.ply"));
  EXPECT_EQ(little.positions, big.positions);
  ASSERT_EQ(text.size(), big.size());
  for (size_t i = 0; i < text.size(); ++i) {
    EXPECT_NEAR(text.positions[i].x, big.positions[i].x, 1e-6);
    EXPECT_NEAR(text.positions[i].y, big.positions[i].y, 1e-6);
    EXPECT_NEAR(text.positions[i].z, big.positions[i].z, 1e-6);
  }
}

TEST(PlyReader, ReadsTheExtentOfRealFiles) {
  struct Case {
    const char* path;
    Point3 low;
    Point3 high;
  };
  // As the files' README gives them, to its eight digits.
  const std::vector<Case> cases = {
      {"formats/ply/assimp/cube_binary_starts_with_nl.ply",
       {5.9675341, 0, 0},
       {6.9675341, 1, 1}},
      {"formats/ply/happly/platonic_shelf_big_endian.ply",
       {-6.524307, -1.158087, -1.158087},
       {6.963232, 1.158087, 1.158086}},
      {"formats/ply/trimesh/fuze.ply",
       {-0.036391001, -0.036711, 0.0040159998},
       {0.036221001, 0.036803, 0.219144}},
      {"registration/small_gicp/source.ply",
       {-23.75902, -52.001141, -3.0212898},
       {18.479933, 6.5078692, 9.1728048}},
      {"registration/small_gicp/target.ply",
       {-23.337479, -74.68161, -2.9573359},
       {19.024696, 8.9195099, 10.795936}},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.path);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                  ReadAll(OpenPlyFile, kData / c.path, 1000));
    testing::ExpectExtent(cloud, c.low, c.high);
  }
}

TEST(PlyReader, KeepsTheAttributesOfARealFile) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadAll(OpenPlyFile, kFolder / "pdal" / "text_extradim.ply"));
  EXPECT_THAT(cloud.positions,
              ElementsAre(Point3{-2.64944, -13.0955, 0.00640115}));
  EXPECT_EQ(cloud.attributes.Find("blue")->type(), ScalarType::kInt8);
  EXPECT_EQ(cloud.attributes.Find("alpha")->Get<uint8_t>(0), 255);
  EXPECT_EQ(cloud.attributes.Find("omg")->Get<int32_t>(0), 1234);
  EXPECT_EQ(cloud.attributes.Find("nz")->Get<float>(0), 0.999665F);
}

#endif  // MAPSIEVE_TEST_DATA

}  // namespace
}  // namespace mapsieve::client
