#include "client/formats/vtk_file.h"

#include <cmath>
#include <cstdint>
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
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::ReadAll;
using testing::TemporaryFile;

constexpr char kHead[] =
    "# vtk DataFile Version 3.0\nanything at all\nASCII\nDATASET POLYDATA\n";
constexpr char kPoints[] = "POINTS 3 float\n1 2 3\n4 5 6\n7.5 -8e1 nan\n";
constexpr char kVertices[] = "VERTICES 3 6\n1 0\n1 1\n1 2\n";

absl::StatusOr<PointCloud> ReadText(const std::string& content) {
  const TemporaryFile file(".vtk", content);
  return ReadAll(OpenVtkFile, file.path(), 2);
}

absl::StatusOr<PointCloud> ReadSections(const std::string& sections) {
  return ReadText(absl::StrCat(kHead, kPoints, kVertices, sections));
}

std::vector<double> Values(const PointCloud& cloud, const std::string& name) {
  std::vector<double> values;
  const Column* column = cloud.attributes.Find(name);
  if (column == nullptr) {
    ADD_FAILURE() << "no attribute " << name;
    return {};
  }
  for (size_t i = 0; i < cloud.size(); ++i) {
    values.push_back(column->GetAsDouble(i));
  }
  return values;
}

TEST(VtkReader, ReadsPositions) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadSections(""));
  ASSERT_EQ(cloud.size(), 3);
  EXPECT_EQ(cloud.positions[0], (Point3{1, 2, 3}));
  EXPECT_EQ(cloud.positions[1], (Point3{4, 5, 6}));
  EXPECT_EQ(cloud.positions[2].x, 7.5);
  EXPECT_EQ(cloud.positions[2].y, -80);
  EXPECT_TRUE(std::isnan(cloud.positions[2].z));
  EXPECT_TRUE(cloud.attributes.columns().empty());
}

TEST(VtkReader, SaysWhatTheFileIs) {
  const TemporaryFile file(".vtk", absl::StrCat(kHead, kPoints));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenVtkFile(file.path()));
  EXPECT_EQ(reader->info().format, "VTK 3.0 ASCII");
  EXPECT_EQ(reader->info().point_count, 3);
  EXPECT_EQ(reader->info().coordinate_step, 0);
}

TEST(VtkReader, ReadsEverySectionOfPointData) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadSections("POINT_DATA 3\n"
                   "SCALARS intensity float\nLOOKUP_TABLE default\n1\n2\n3\n"
                   "SCALARS pair int 2\nLOOKUP_TABLE default\n1 2 3 4 5 6\n"
                   "SCALARS bare short 1\n-1 -2 -3\n"
                   "LOOKUP_TABLE mine 2\n0 0 0 1\n1 1 1 1\n"
                   "NORMALS normals double\n0 0 1 0 1 0 1 0 0\n"
                   "VECTORS v float\n1 2 3\n4 5 6\n7 8 9\n"
                   "TENSORS t float\n1 2 3\n4 5 6\n7 8 9\n\n"
                   "1 2 3\n4 5 6\n7 8 9\n\n1 2 3\n4 5 6\n7 8 10\n\n"
                   "COLOR_SCALARS c 4\n.1 .2 .3 1 .1 .2 .3 1 .1 .2 .3 0.5\n"
                   "TEXTURE_COORDINATES uv 2 float\n1 2 3 4 5 6\n"));
  EXPECT_THAT(Values(cloud, "intensity"), ElementsAre(1, 2, 3));
  EXPECT_THAT(Values(cloud, "pair_0"), ElementsAre(1, 3, 5));
  EXPECT_THAT(Values(cloud, "pair_1"), ElementsAre(2, 4, 6));
  EXPECT_THAT(Values(cloud, "bare"), ElementsAre(-1, -2, -3));
  EXPECT_THAT(Values(cloud, "nx"), ElementsAre(0, 0, 1));
  EXPECT_THAT(Values(cloud, "nz"), ElementsAre(1, 0, 0));
  EXPECT_THAT(Values(cloud, "v_y"), ElementsAre(2, 5, 8));
  EXPECT_THAT(Values(cloud, "t_8"), ElementsAre(9, 9, 10));
  EXPECT_THAT(Values(cloud, "alpha"), ElementsAre(1, 1, 0.5));
  EXPECT_THAT(Values(cloud, "uv_1"), ElementsAre(2, 4, 6));
  EXPECT_EQ(cloud.attributes.Find("pair_0")->type(), ScalarType::kInt32);
  EXPECT_EQ(cloud.attributes.Find("bare")->type(), ScalarType::kInt16);
  EXPECT_EQ(cloud.attributes.Find("nx")->type(), ScalarType::kFloat64);
  EXPECT_EQ(cloud.attributes.Find("red")->type(), ScalarType::kFloat32);
  EXPECT_EQ(cloud.attributes.columns().size(), 1 + 2 + 1 + 3 + 3 + 9 + 4 + 2);
}

TEST(VtkReader, ReadsFieldsOfEveryType) {
  const std::vector<std::tuple<std::string, std::string, ScalarType>> types = {
      {"bit", "1", ScalarType::kUint8},
      {"char", "-128", ScalarType::kInt8},
      {"unsigned_char", "255", ScalarType::kUint8},
      {"short", "-32768", ScalarType::kInt16},
      {"unsigned_short", "65535", ScalarType::kUint16},
      {"int", "-2147483648", ScalarType::kInt32},
      {"unsigned_int", "4294967295", ScalarType::kUint32},
      {"long", "-9007199254740992", ScalarType::kInt64},
      {"unsigned_long", "9007199254740992", ScalarType::kUint64},
      {"vtkIdType", "12345678901", ScalarType::kInt64},
      {"vtktypeint64", "-12345678901", ScalarType::kInt64},
      {"float", "0.25", ScalarType::kFloat32},
      {"double", "0.1", ScalarType::kFloat64}};
  std::string text =
      absl::StrCat("POINT_DATA 3\nFIELD FieldData ", types.size(), "\n");
  for (const auto& [name, value, type] : types) {
    absl::StrAppend(&text, "of_", name, " 1 3 ", name, "\n", value, " 0 0\n");
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadSections(text));
  for (const auto& [name, value, type] : types) {
    EXPECT_EQ(Values(cloud, "of_" + name)[0], std::stod(value)) << name;
    EXPECT_EQ(cloud.attributes.Find("of_" + name)->type(), type) << name;
  }
}

TEST(VtkReader, PassesOverWhatIsNotOfThePoints) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText("# vtk DataFile Version 5.1\nvtk output\nASCII\n"
               "DATASET UNSTRUCTURED_GRID\n"
               "FIELD FieldData 1\nTIME 1 1 double\n12.5\n"
               "METADATA\nINFORMATION 1\nNAME a LOCATION b\nDATA 1\n\n"
               "POINTS 2 double\n1 2 3 4 5 6\n"
               "METADATA\nCOMPONENT_NAMES\nX\nY\nZ\n\n"
               "CELLS 3 2\nOFFSETS vtktypeint64\n0 1 2\n"
               "CONNECTIVITY vtktypeint64\n0 1\n"
               "CELL_TYPES 2\n1 1\n"
               "CELL_DATA 2\nSCALARS cell int\nLOOKUP_TABLE default\n8 9\n"
               "POINT_DATA 2\nFIELD FieldData 2\na 1 2 int\n5 6\n"
               "METADATA\nINFORMATION 0\n\n"
               "b 1 2 int\n7 8\n"));
  ASSERT_EQ(cloud.size(), 2);
  EXPECT_EQ(cloud.positions[1], (Point3{4, 5, 6}));
  EXPECT_THAT(Values(cloud, "a"), ElementsAre(5, 6));
  EXPECT_THAT(Values(cloud, "b"), ElementsAre(7, 8));
  EXPECT_EQ(cloud.attributes.columns().size(), 2);
}

TEST(VtkReader, ReadsNoPoints) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadText(absl::StrCat(kHead,
                            "POINTS 0 float\nVERTICES 0 0\nPOINT_DATA "
                            "0\nSCALARS a float\nLOOKUP_TABLE d\n")));
  EXPECT_EQ(cloud.size(), 0);
  EXPECT_NE(cloud.attributes.Find("a"), nullptr);
}

TEST(VtkReader, NamesTheLineOfDamage) {
  EXPECT_THAT(
      ReadText(absl::StrCat(kHead, "POINTS 3 float\n1 2 3\n4 5 6\n7 8\n",
                            kVertices)),
      StatusIs(absl::StatusCode::kDataLoss,
               HasSubstr("line 9: POINTS: expected 9 numbers, found 8 and then "
                         "\"VERTICES\"")));
  EXPECT_THAT(ReadText(absl::StrCat(kHead, "POINTS 3 float\n1 2 3\n")),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("found 3 and the end of the file")));
  EXPECT_THAT(ReadSections("9 9 9\n"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("line 13: expected a section, found \"9\"")));
  EXPECT_THAT(ReadSections("POINT_DATA 4\n"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("POINT_DATA of 4 points; expected 3")));
  EXPECT_THAT(
      ReadSections("POINT_DATA 3\nSCALARS a int\nLOOKUP_TABLE d\n1\n2.5\n3\n"),
      StatusIs(absl::StatusCode::kDataLoss,
               HasSubstr("line 17: expected a number of type int32, found "
                         "\"2.5\"")));
  EXPECT_THAT(ReadSections("POINT_DATA 3\nFIELD F 1\na 1 2 int\n1 2\n"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("a value for each of 3 points, found 2")));
  EXPECT_THAT(
      ReadSections("POINT_DATA 3\nNORMALS n float\n0 0 1 0 0 1\nNORMALS "
                   "m float\n"),
      StatusIs(absl::StatusCode::kDataLoss, HasSubstr("found 6")));
  EXPECT_THAT(ReadSections("POINT_DATA 3\nFIELD F 1\na\x01 1 b\n"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("\"a\\x01\": expected a count")));
  EXPECT_THAT(ReadText(kHead),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("POINTS")));
  EXPECT_THAT(
      ReadText(absl::StrCat(kHead, "POINTS 9000000000000000000 float\n1 2 3")),
      StatusIs(absl::StatusCode::kDataLoss, HasSubstr("9000000000000000000")));
  EXPECT_THAT(ReadText(absl::StrCat(kHead, "POINTS -1 float\n")),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("\"-1\"")));
  EXPECT_THAT(ReadSections("POINT_DATA 3\nSCALARS a float 4000000000\n1 2 3\n"),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("4000000000")));
}

TEST(VtkReader, RefusesByName) {
  EXPECT_THAT(ReadText("# vtk DataFile Version 3.0\nt\nBINARY\nDATASET "
                       "POLYDATA\n"),
              StatusIs(absl::StatusCode::kUnimplemented,
                       HasSubstr("binary VTK is not read")));
  EXPECT_THAT(ReadText("# vtk DataFile Version 3.0\nt\nASCII\nDATASET "
                       "STRUCTURED_POINTS\n"),
              StatusIs(absl::StatusCode::kUnimplemented,
                       HasSubstr("STRUCTURED_POINTS")));
  EXPECT_THAT(ReadSections("POINT_DATA 3\nFIELD F 1\na 1 3 string\nb\nc\nd\n"),
              StatusIs(absl::StatusCode::kUnimplemented, HasSubstr("string")));
  EXPECT_THAT(ReadSections("POINT_DATA 3\nSCALARS a int\nLOOKUP_TABLE d\n1 2 "
                           "3\nSCALARS a int\nLOOKUP_TABLE d\n1 2 3\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("two columns are named \"a\"")));
  EXPECT_THAT(ReadText("x,y,z\n1,2,3\n"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("this is not legacy VTK")));
}

TEST(VtkReader, RefusesEveryCut) {
  const std::string whole = absl::StrCat(
      kHead, kPoints, kVertices,
      "POINT_DATA 3\nSCALARS a float\nLOOKUP_TABLE default\n1\n2\n3\n");
  const auto complete = ReadText(whole);
  MAPSIEVE_ASSERT_OK(complete);
  for (size_t size = 1; size < whole.size() - 1; ++size) {
    const auto cut = ReadText(whole.substr(0, size));
    if (cut.ok()) {
      // Between two sections a cut cannot be seen.
      EXPECT_TRUE(cut->attributes.columns().empty()) << size;
    } else if (size > std::string(kHead).size()) {
      EXPECT_EQ(cut.status().code(), absl::StatusCode::kDataLoss) << size;
    }
  }
}

#ifdef MAPSIEVE_TEST_DATA

TEST(VtkTestData, ValuesAreThoseOfTheFile) {
  const std::filesystem::path path =
      std::filesystem::path(MAPSIEVE_TEST_DATA) /
      "registration/norlab/cloud_1690309709_285305600.vtk";
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                ReadAll(OpenVtkFile, path, 1000));
  ASSERT_EQ(cloud.size(), 41400);
  EXPECT_THAT(cloud.attributes.specs(),
              ElementsAre(ColumnSpec{"intensity", ScalarType::kFloat32},
                          ColumnSpec{"t", ScalarType::kFloat32}));
  EXPECT_EQ(cloud.positions[0], (Point3{4.39017, -0.830303, -0.814437}));
  EXPECT_EQ(cloud.positions[1], (Point3{4.35316, -0.809244, -0.504289}));
  const std::vector<double> intensity = Values(cloud, "intensity");
  EXPECT_EQ(intensity[0], 36);
  EXPECT_EQ(intensity[1], 31);
  EXPECT_EQ(intensity[2], 4);
  double lowest = 1e9;
  double highest = -1e9;
  for (const Point3& p : cloud.positions) {
    lowest = std::min(lowest, p.z);
    highest = std::max(highest, p.z);
  }
  EXPECT_EQ(lowest, -1.76881);
  EXPECT_EQ(highest, 20.4724);
}

#endif  // MAPSIEVE_TEST_DATA

}  // namespace
}  // namespace mapsieve::client
