#include "client/formats/csv_file.h"

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
using ::testing::AnyOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::ReadAll;
using testing::TemporaryFile;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

absl::StatusOr<PointCloud> ReadText(const std::string& content,
                                    const ReadOptions& options = {}) {
  const TemporaryFile file(".csv", content);
  return ReadAll(
      [&](const std::filesystem::path& path) {
        return OpenCsvFile(path, options);
      },
      file.path(), 2);
}

std::vector<std::string> Names(const PointCloud& cloud) {
  std::vector<std::string> names;
  for (const Column& column : cloud.attributes.columns()) {
    EXPECT_EQ(column.type(), ScalarType::kFloat64);
    names.push_back(column.name());
  }
  return names;
}

std::vector<double> Values(const PointCloud& cloud, size_t column) {
  std::vector<double> values;
  for (size_t i = 0; i < cloud.size(); ++i) {
    values.push_back(cloud.attributes.columns()[column].Get<double>(i));
  }
  return values;
}

TEST(CsvReader, FindsTheSeparator) {
  for (const char* text :
       {"1,2,3,4\n5,6,7,8\n", "1;2;3;4\n5;6;7;8\n", "1\t2\t3\t4\n5\t6\t7\t8\n",
        "1 2 3 4\n5 6 7 8\n", "  1   2 3\t 4  \n 5 6\t7 8\n",
        "1\t 2 \t3\t4\n5\t6\t7\t8\n", "1 , 2 , 3,4\n5,6 ,7, 8\n",
        "1,2,3,4\r\n5,6,7,8\r\n", "1,2,3,4\n5,6,7,8",
        "\xEF\xBB\xBF"
        "1,2,3,4\n5,6,7,8\n",
        "1,2,3,4,\n5,6,7,8,\n", "\n# c\n1,2,3,4\n\n// c\n  # c\n5,6,7,8\n\n"}) {
    SCOPED_TRACE(text);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadText(text));
    EXPECT_THAT(cloud.positions, ElementsAre(Point3{1, 2, 3}, Point3{5, 6, 7}));
    EXPECT_THAT(Names(cloud), ElementsAre("c3"));
    EXPECT_THAT(Values(cloud, 0), ElementsAre(4, 8));
  }
}

TEST(CsvReader, TakesNamesFromTheHeaderWhereverXyzAre) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("t, Z ,\"intensity\",X,y,,Zone 1\n1,2,3,4,5,6,7\n"));
  EXPECT_THAT(cloud.positions, ElementsAre(Point3{4, 5, 2}));
  EXPECT_THAT(Names(cloud), ElementsAre("t", "intensity", "c5", "Zone 1"));
  EXPECT_THAT(Values(cloud, 1), ElementsAre(3));
  EXPECT_THAT(Values(cloud, 3), ElementsAre(7));
}

TEST(CsvReader, TakesNamesFromACommentThatFits) {
  for (const char* text : {"//X Y Z R\n1 2 3 4\n", "# x y z R\n1 2 3 4\n",
                           "# by hand\n#x,y,z,R\n1,2,3,4\n"}) {
    SCOPED_TRACE(text);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadText(text));
    EXPECT_THAT(Names(cloud), ElementsAre("R"));
    EXPECT_THAT(cloud.positions, ElementsAre(Point3{1, 2, 3}));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                ReadText("# x y z\n1 2 3 4\n"));
  EXPECT_THAT(Names(cloud), ElementsAre("c3"));
}

TEST(CsvReader, TakesNamesGiven) {
  const ReadOptions options{.column_names = {"a", "x", "y", "z"}};
  for (const char* text :
       {"1 2 3 4\n5 6 7 8\n", "p q r s\n1 2 3 4\n5 6 7 8\n"}) {
    SCOPED_TRACE(text);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                  ReadText(text, options));
    EXPECT_THAT(cloud.positions, ElementsAre(Point3{2, 3, 4}, Point3{6, 7, 8}));
    EXPECT_THAT(Names(cloud), ElementsAre("a"));
  }
  EXPECT_THAT(ReadText("1 2 3\n", options),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("4 column names are given, line 1 has 3")));
  EXPECT_THAT(ReadText("1 2 3\n", {.column_names = {"x", "y", "y"}}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("two columns are named \"y\"")));
}

TEST(CsvReader, KeepsMissingValuesMissing) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("x,y,z,a\n1,2,3,\n,nan,3,NaN\n1,2,3,-0.5e1\n1,2,3,-inf\n"));
  ASSERT_EQ(cloud.size(), 4);
  const Column& a = cloud.attributes.columns()[0];
  EXPECT_TRUE(a.IsMissing(0));
  EXPECT_TRUE(a.IsMissing(1));
  EXPECT_FALSE(a.IsMissing(2));
  EXPECT_EQ(a.Get<double>(2), -5);
  EXPECT_EQ(a.Get<double>(3), -std::numeric_limits<double>::infinity());
  EXPECT_TRUE(std::isnan(cloud.positions[1].x));
  EXPECT_TRUE(std::isnan(cloud.positions[1].y));
  EXPECT_EQ(cloud.positions[1].z, 3);
}

TEST(CsvReader, ReadsNumbersExactly) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("331050.123 5183020.0625 +92.1 1e-400\n"));
  EXPECT_EQ(cloud.positions[0], (Point3{331050.123, 5183020.0625, 92.1}));
  EXPECT_THAT(Values(cloud, 0), ElementsAre(0));
}

TEST(CsvReader, ReadsAHeaderAlone) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadText("x,y,z,a\n"));
  EXPECT_EQ(cloud.size(), 0);
  EXPECT_THAT(Names(cloud), ElementsAre("a"));
}

TEST(CsvReader, ReadsACommentThatNamesColumnsAlone) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                ReadText("# x y z a\n"));
  EXPECT_EQ(cloud.size(), 0);
  EXPECT_THAT(Names(cloud), ElementsAre("a"));
}

TEST(CsvReader, NamesTheLineOfDamage) {
  const std::string start = "x,y,z,a\n# c\n1,2,3,4\n1,2,3,4\n1,2,3,4\n";
  EXPECT_THAT(ReadText(start + "1,2,3,four\n"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("line 6: column 4: expected a number, found "
                                 "\"four\"")));
  EXPECT_THAT(ReadText(start + "1,2,0x3,4\n"),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("\"0x3\"")));
  EXPECT_THAT(ReadText(start + "1,2,3\n"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("line 6: expected 4 columns, found 3")));
  EXPECT_THAT(ReadText(start + "1,2,3,4,5\n"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("line 6: expected 4 columns, found 5")));
  EXPECT_THAT(ReadText(start + "1,2,3,1e400\n"),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("1e400")));
}

TEST(CsvReader, RefusesByName) {
  EXPECT_THAT(ReadText("\n1,2\n3,4\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("line 2: expected at least three columns, x, "
                                 "y, z, found 2: \"1,2\"")));
  EXPECT_THAT(ReadText("2498\n1 2 3\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("found 1: \"2498\"")));
  EXPECT_THAT(ReadText("a text\n"), StatusIs(absl::StatusCode::kInvalidArgument,
                                             HasSubstr("found 2: \"a text\"")));
  EXPECT_THAT(ReadText("x,y,height\n1,2,3\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("no column is named \"z\" among x, y, "
                                 "height")));
  EXPECT_THAT(ReadText("x,y,z,X\n1,2,3,4\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("two columns are named \"x\"")));
  EXPECT_THAT(ReadText("x,y,z,a,a\n1,2,3,4,5\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("two columns are named \"a\"")));
  EXPECT_THAT(ReadText("# nothing\n\n"),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("x y z")));
  std::string wide = "x,y,z";
  for (int i = 0; i < 2000; ++i) absl::StrAppend(&wide, ",a", i);
  EXPECT_THAT(
      ReadText(wide + "\n"),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("at most 1024")));
  EXPECT_THAT(
      ReadText("x,y,z," + std::string(256, 'n') + "\n"),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("256 bytes")));
  EXPECT_THAT(ReadText(std::string(3 << 20, ',')),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("line 1: longer than 1048576 bytes")));
  EXPECT_THAT(ReadText(std::string("\0\x01\x02\n", 4)),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("\\x00\\x01\\x02")));
}

TEST(CsvReader, ReadsLinesOverTheBuffersEdges) {
  std::string text;
  const int count = 100000;
  for (int i = 0; i < count; ++i) {
    absl::StrAppend(&text, i, ",", i * 2, ",", i * 3, "\n");
  }
  const TemporaryFile file(".csv", text);
  ASSERT_GT(text.size(), 1 << 20);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadAll([](const auto& path) { return OpenCsvFile(path); }, file.path(),
              7777));
  ASSERT_EQ(cloud.size(), count);
  for (int i = 0; i < count; ++i) {
    EXPECT_EQ(cloud.positions[static_cast<size_t>(i)],
              (Point3{i * 1.0, i * 2.0, i * 3.0}));
  }
}

absl::StatusOr<std::string> Written(const std::string& extension,
                                    const PointCloud& cloud,
                                    const WriteOptions& options = {}) {
  const TemporaryFile file(extension);
  MAPSIEVE_RETURN_IF_ERROR(WritePointFile(file.path(), cloud, options));
  return file.Read();
}

PointCloud TwoPoints() {
  PointCloud cloud;
  cloud.positions = {{331050.1234, -5, 92}, {kNan, 0.5, -0.0004}};
  Column wide({"wide, \"one\"", ScalarType::kUint64}, 2);
  wide.Set(0, std::numeric_limits<uint64_t>::max());
  wide.SetMissing(1);
  Column real({"real one", ScalarType::kFloat32}, 2);
  real.Set(0, 0.1F);
  real.Set(1, -3.0F);
  cloud.attributes.columns() = {wide, real};
  return cloud;
}

TEST(CsvWriter, WritesTextOfEachKind) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::string csv,
                                Written(".csv", TwoPoints()));
  EXPECT_EQ(csv,
            "x,y,z,wide_ _one_,real one\n"
            "331050.123,-5.000,92.000,18446744073709551615,0.1\n"
            "nan,0.500,-0.000,,-3\n");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::string xyz,
                                Written(".xyz", TwoPoints()));
  EXPECT_EQ(xyz,
            "# x y z wide,__one_ real_one\n"
            "331050.123 -5.000 92.000 18446744073709551615 0.1\n"
            "nan 0.500 -0.000 nan -3\n");
}

TEST(CsvWriter, DecimalsFollowTheStep) {
  PointCloud cloud;
  cloud.positions = {{1.25, 2, 3}};
  const std::vector<std::pair<double, std::string>> cases = {
      {1, "1,2,3"},  // half to even of 1.25
      {0.5, "1.2,2.0,3.0"},
      {0.25, "1.25,2.00,3.00"},
      {0.001, "1.250,2.000,3.000"},
      {0.00025, "1.25000,2.00000,3.00000"},
      {1e-9, "1.250000000,2.000000000,3.000000000"},
      {10, "1,2,3"},
      {0, "1.25,2,3"},
      {1.0 / 3, "1.25,2,3"}};
  for (const auto& [step, line] : cases) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const std::string text,
        Written(".csv", cloud, {.coordinate_step = step}));
    EXPECT_EQ(text, absl::StrCat("x,y,z\n", line, "\n")) << step;
  }
  for (const double step : {-1.0, kNan}) {
    EXPECT_THAT(Written(".csv", cloud, {.coordinate_step = step}),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         HasSubstr("coordinate step")));
  }
}

TEST(CsvWriter, ItsReaderGetsTheValuesBack) {
  PointCloud cloud;
  Column real({"real", ScalarType::kFloat64});
  Column whole({"whole", ScalarType::kInt16});
  for (int i = 0; i < 5000; ++i) {
    cloud.positions.push_back({i / 3.0, -i * 1e10, i * 1e-300});
    real.Append(std::sqrt(i));
    whole.Append(static_cast<int16_t>(i * 13));
  }
  real.SetMissing(7);
  whole.SetMissing(8);
  cloud.attributes.columns() = {real, whole};
  for (const char* extension : {".csv", ".xyz", ".txt"}) {
    const TemporaryFile file(extension);
    MAPSIEVE_ASSERT_OK(
        WritePointFile(file.path(), cloud, {.coordinate_step = 0}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read,
                                  ReadPointFile(file.path()));
    EXPECT_EQ(read.positions, cloud.positions);
    EXPECT_TRUE(read.attributes.columns()[0] == real);
    const Column& read_whole = read.attributes.columns()[1];
    EXPECT_EQ(read_whole.name(), "whole");
    for (size_t i = 0; i < cloud.size(); ++i) {
      EXPECT_EQ(read_whole.IsMissing(i), whole.IsMissing(i));
      EXPECT_EQ(read_whole.Get<double>(i), whole.GetAsDouble(i));
    }
  }
}

TEST(CsvWriter, RefusesAnAttributeThatWouldBeAPosition) {
  PointCloud cloud;
  cloud.attributes.columns() = {Column({"Y", ScalarType::kInt8})};
  EXPECT_THAT(Written(".csv", cloud),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("\"Y\"")));
}

TEST(CsvWriter, RefusesNamesThatBecomeOne) {
  PointCloud cloud;
  cloud.attributes.columns() = {Column({"a b", ScalarType::kInt8}),
                                Column({"a_b", ScalarType::kInt8})};
  MAPSIEVE_EXPECT_OK(Written(".csv", cloud));
  EXPECT_THAT(Written(".xyz", cloud),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a_b")));
}

}  // namespace
}  // namespace mapsieve::client
