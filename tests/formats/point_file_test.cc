#include "client/formats/point_file.h"

#include <sys/resource.h>

#include <cmath>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "client/formats/batch_columns.h"
#include "client/formats/file_input.h"
#include "client/formats/output_file.h"
#include "client/formats/text_numbers.h"
#include "core/base/bytes.h"
#include "core/cloud/point_cloud.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/formats/file_table.h"
#include "tests/testing/status_matchers.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::client {
namespace {

using core::Column;
using core::PointCloud;
using core::ScalarType;
using mapsieve::testing::StatusIs;
using mapsieve::testing::TemporaryDirectory;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::TemporaryFile;

std::vector<std::string> Names(const TemporaryDirectory& folder) {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder.path())) {
    names.push_back(entry.path().filename().string());
  }
  return names;
}

PointCloud OnePoint() {
  PointCloud cloud;
  cloud.positions = {{1, 2, 3}};
  Column column({"label", ScalarType::kUint8}, 1);
  column.Set<uint8_t>(0, 2);
  cloud.attributes.columns() = {column};
  return cloud;
}

TEST(OpenPointFile, JudgesByContentThenByExtension) {
  const TemporaryDirectory folder;
  for (const std::string written : {".las", ".pcd", ".ply", ".csv"}) {
    const auto path = folder / ("cloud" + written);
    MAPSIEVE_ASSERT_OK(WritePointFile(path, OnePoint()));
    // Text has no mark of its own, so only its extension tells.
    for (const std::string& renamed :
         {written, std::string(written == ".csv" ? ".ASC" : ".laz"),
          std::string(written == ".csv" ? ".Txt" : ".data")}) {
      const auto other = folder / ("renamed" + renamed);
      std::filesystem::copy_file(
          path, other, std::filesystem::copy_options::overwrite_existing);
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                    ReadPointFile(other));
      ASSERT_EQ(cloud.size(), 1) << other;
      EXPECT_EQ(cloud.positions[0], OnePoint().positions[0]) << other;
      ASSERT_NE(cloud.attributes.Find("label"), nullptr) << other;
      EXPECT_EQ(cloud.attributes.Find("label")->GetAsDouble(0), 2) << other;
    }
  }
}

TEST(OpenPointFile, RefusesByName) {
  const TemporaryDirectory folder;
  const auto open = [&](const std::string& name, const std::string& content) {
    const auto path = folder / name;
    std::ofstream(path, std::ios::binary) << content;
    return OpenPointFile(path);
  };
  for (const std::string kind : {"e57", "pts", "ptx", "E57"}) {
    EXPECT_THAT(open("a." + kind, "1\n"),
                StatusIs(absl::StatusCode::kUnimplemented,
                         HasSubstr("pdal translate IN.")))
        << kind;
  }
  EXPECT_THAT(open("a.txt", "ASTM-E57...."),
              StatusIs(absl::StatusCode::kUnimplemented, HasSubstr("E57")));
  EXPECT_THAT(open("a.vtp", "<?xml?>"),
              StatusIs(absl::StatusCode::kUnimplemented, HasSubstr("XML")));
  EXPECT_THAT(open("a.laz", "not LASF"),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("not LAS")));
  EXPECT_THAT(open("a.las", "LASF"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("expected 227 bytes, the file has 4")));
  EXPECT_THAT(open("a.png", "\x89PNG"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("not a kind of point file")));
  EXPECT_THAT(open("noextension", "1 2 3\n"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("XYZ")));
  for (const std::string kind : {"las", "pcd", "ply", "csv", "vtk", "e57"}) {
    EXPECT_THAT(open("empty." + kind, ""),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("empty")));
  }
  EXPECT_THAT(OpenPointFile(folder.path()),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("is a directory")));
  EXPECT_THAT(OpenPointFile(folder / "absent.las"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("absent.las")));
  EXPECT_THAT(OpenPointFile("/dev/null"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("not a regular file")));
}

TEST(CreatePointFile, RefusesByName) {
  const TemporaryDirectory folder;
  for (const char* name : {"a.laz", "a.vtk", "a.e57", "a.pts", "a.ptx"}) {
    EXPECT_THAT(
        WritePointFile(folder / name, OnePoint()),
        StatusIs(absl::StatusCode::kUnimplemented, HasSubstr("not written")))
        << name;
  }
  EXPECT_THAT(
      WritePointFile(folder / "a.png", OnePoint()),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("extension")));
  EXPECT_THAT(WritePointFile(folder / "no/a.las", OnePoint()),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("a.las")));
  std::filesystem::create_directory(folder / "b.las");
  EXPECT_THAT(WritePointFile(folder / "b.las", OnePoint()),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("is a directory")));
}

TEST(CreatePointFile, AFileAppearsWhenFinishedAndNotBefore) {
  for (const char* extension : {".las", ".pcd", ".ply", ".csv", ".xyz"}) {
    const TemporaryDirectory folder;
    const auto path = folder / absl::StrCat("cloud", extension);
    const WriteOptions options{.attributes = OnePoint().attributes.specs()};
    {
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                    CreatePointFile(path, options));
      MAPSIEVE_ASSERT_OK(writer->Write(OnePoint()));
    }
    EXPECT_THAT(Names(folder), IsEmpty());
    std::ofstream(path) << "old";
    {
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                    CreatePointFile(path, options));
      MAPSIEVE_ASSERT_OK(writer->Write(OnePoint()));
      EXPECT_EQ(TemporaryFile::ReadFile(path), "old");
      MAPSIEVE_ASSERT_OK(writer->Finish());
    }
    EXPECT_EQ(Names(folder).size(), 1);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadPointFile(path));
    EXPECT_EQ(cloud.size(), 1);
  }
}

TEST(CreatePointFile, WritesRefuseOtherAttributes) {
  const TemporaryDirectory folder;
  for (const char* extension : {".las", ".pcd", ".ply", ".csv"}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto writer,
        CreatePointFile(folder / absl::StrCat("a", extension),
                        {.attributes = OnePoint().attributes.specs()}));
    PointCloud lacking = OnePoint();
    lacking.attributes.columns().clear();
    EXPECT_THAT(
        writer->Write(lacking),
        StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("label")));
    PointCloud other = OnePoint();
    other.attributes.columns()[0] = Column({"label", ScalarType::kInt8}, 1);
    EXPECT_THAT(writer->Write(other),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         HasSubstr("int8; expected uint8")));
    PointCloud more = OnePoint();
    more.attributes.columns().push_back(Column({"b", ScalarType::kInt8}, 1));
    EXPECT_THAT(writer->Write(more),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         HasSubstr("2 attributes; expected 1")));
    PointCloud longer = OnePoint();
    longer.attributes.columns()[0].Resize(2);
    EXPECT_THAT(writer->Write(longer),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         HasSubstr("2 values of \"label\" for 1 points")));
    MAPSIEVE_EXPECT_OK(writer->Write(OnePoint()));
    MAPSIEVE_EXPECT_OK(writer->Finish());
  }
}

TEST(OutputFile, OverwritesWhatWasAppended) {
  const TemporaryDirectory folder;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(auto file,
                                OutputFile::Create(folder / "a.las"));
  MAPSIEVE_ASSERT_OK(file->Append("abc"));
  MAPSIEVE_ASSERT_OK(file->Overwrite(1, TextBytes("x")));
  MAPSIEVE_ASSERT_OK(file->Append("d"));
  EXPECT_EQ(file->size(), 4);
  MAPSIEVE_ASSERT_OK(file->Finish());
  EXPECT_EQ(TemporaryFile::ReadFile(folder / "a.las"), "axcd");
}

TEST(OutputFile, AFailedWriteStaysFailedAndLeavesNothing) {
  const TemporaryDirectory folder;
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(auto file,
                                  OutputFile::Create(folder / "a.las"));
    // A limit on the size of files stands for a disk that is full.
    const rlimit small{.rlim_cur = 1000, .rlim_max = before.rlim_max};
    ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
    const absl::Status failed = file->Append(std::string(3 << 20, 'a'));
    ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
    EXPECT_FALSE(failed.ok());
    EXPECT_THAT(std::string(failed.message()),
                HasSubstr("a.las, offset 1000: cannot be written"));
    EXPECT_EQ(file->Append("b"), failed);
    EXPECT_EQ(file->Overwrite(0, TextBytes("b")), failed);
    EXPECT_EQ(file->Finish(), failed);
  }
  std::signal(SIGXFSZ, handler);
  EXPECT_THAT(Names(folder), IsEmpty());
}

TEST(InputCursor, GivesBytesLinesAndWordsOverTheBuffersEdges) {
  std::string text;
  for (int i = 0; i < 1000; ++i) absl::StrAppend(&text, "line ", i, "\r\n");
  const TemporaryFile written(".txt", text);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto file,
                                InputFile::Open(written.path()));
  for (const size_t buffer : {1U, 2U, 7U, 64U, 100000U}) {
    InputCursor lines(file, 0, buffer);
    std::string_view line;
    for (int i = 0; i < 1000; ++i) {
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const bool more, lines.NextLine(line));
      ASSERT_TRUE(more);
      EXPECT_EQ(line, absl::StrCat("line ", i));
      EXPECT_EQ(lines.line_number(), i + 1);
    }
    EXPECT_FALSE(*lines.NextLine(line));
    EXPECT_TRUE(lines.at_end());

    InputCursor words(file, 0, buffer);
    for (int i = 0; i < 1000; ++i) {
      EXPECT_TRUE(*words.NextToken(line));
      EXPECT_EQ(line, "line");
      EXPECT_TRUE(*words.NextToken(line));
      EXPECT_EQ(line, absl::StrCat(i));
      EXPECT_EQ(words.line_number(), i + 1);
    }
    EXPECT_FALSE(*words.NextToken(line));

    InputCursor bytes(file, 5, buffer);
    MAPSIEVE_ASSERT_OK(bytes.Skip(3, "a"));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto four, bytes.Take(4, "b"));
    EXPECT_EQ(std::string(reinterpret_cast<const char*>(four.data()), 4),
              text.substr(8, 4));
    EXPECT_THAT(bytes.Take(text.size(), "all"),
                StatusIs(absl::StatusCode::kDataLoss,
                         HasSubstr("offset 12: all: expected")));
    EXPECT_THAT(bytes.Skip(bytes.remaining() + 1, "more"),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("more")));
    MAPSIEVE_EXPECT_OK(bytes.Skip(bytes.remaining(), "rest"));
    EXPECT_TRUE(bytes.at_end());
  }
}

TEST(TextNumbers, ParseWholeWordsOnly) {
  const auto parses = [](std::string_view text, double expected) {
    double value = -7;
    return ParseNumber(text, value) && value == expected;
  };
  EXPECT_TRUE(parses("1", 1));
  EXPECT_TRUE(parses("+1.5e3", 1500));
  EXPECT_TRUE(parses(".5", 0.5));
  EXPECT_TRUE(parses("5.", 5));
  EXPECT_TRUE(parses("-1e-999", 0));
  EXPECT_TRUE(parses("INF", INFINITY));
  double value = -7;
  for (const char* bad : {"", "+", "-", "+-1", "1x", " 1", "1 ", "0x1", "1e",
                          "1e999", "-1e999", "1,5", "abc"}) {
    EXPECT_FALSE(ParseNumber(std::string_view(bad), value)) << bad;
    EXPECT_EQ(value, -7) << bad;
  }
}

TEST(TextNumbers, ParseIntegersThatFit) {
  uint8_t small = 7;
  EXPECT_TRUE(ParseNumber("255", small));
  EXPECT_EQ(small, 255);
  EXPECT_TRUE(ParseNumber("2.5e1", small));
  EXPECT_EQ(small, 25);
  for (const char* bad : {"256", "-1", "1.5", "nan", "1e3", "inf"}) {
    EXPECT_FALSE(ParseNumber(std::string_view(bad), small)) << bad;
    EXPECT_EQ(small, 25) << bad;
  }
  int64_t large = 0;
  EXPECT_TRUE(ParseNumber("-9223372036854775808", large));
  EXPECT_EQ(large, INT64_MIN);
  EXPECT_FALSE(ParseNumber("9223372036854775808", large));
  EXPECT_FALSE(ParseNumber("9223372036854775808.0", large));
}

TEST(CleanText, GivesOneLineOfUtf8) {
  EXPECT_EQ(CleanText("  a b\t", '_'), "a b");
  EXPECT_EQ(CleanText("höhe", '_'), "höhe");
  EXPECT_EQ(CleanText("a\nb\x7F", '_'), "a_b_");
  EXPECT_EQ(CleanText("h\xF6he", '_'), "h_he");           // Latin-1
  EXPECT_EQ(CleanText("\xC0\x80", '_'), "__");            // overlong
  EXPECT_EQ(CleanText("\xED\xA0\x80", '_'), "___");       // surrogate
  EXPECT_EQ(CleanText("\xF4\x90\x80\x80", '_'), "____");  // too large
  EXPECT_EQ(CleanText("\xE2\x82", '_'), "__");            // cut
  EXPECT_EQ(CleanText("\xF0\x9F\x98\x80", '_'), "\xF0\x9F\x98\x80");
}

#ifdef MAPSIEVE_TEST_DATA

const std::filesystem::path kData = MAPSIEVE_TEST_DATA;

absl::StatusOr<std::unique_ptr<PointReader>> Open(
    const std::filesystem::path& path) {
  return OpenPointFile(path);
}

testing::FileCase Refused(const std::string& path, const std::string& message) {
  return {.path = path,
          .code = absl::StatusCode::kUnimplemented,
          .message = message};
}

TEST(TestData, EveryE57FileIsRefused) {
  std::vector<testing::FileCase> table;
  for (const char* name : {"cry-inc/bunnyInt19",
                           "cry-inc/bunnyInt21",
                           "cry-inc/cartesian_invalid_state_single",
                           "cry-inc/corrupt_crc",
                           "cry-inc/empty",
                           "cry-inc/empty_pc",
                           "cry-inc/float_intensity_without_min_max",
                           "cry-inc/integer_intensity",
                           "cry-inc/las2e57_no_images_tag",
                           "cry-inc/no_ext_namespace",
                           "cry-inc/original_guids",
                           "cry-inc/read_error",
                           "cry-inc/scaled_integer_intensity",
                           "cry-inc/tinyCartesianFloatRgb",
                           "cry-inc/tiny_pc_and_images",
                           "cry-inc/tiny_pc_with_extension",
                           "cry-inc/tiny_spherical",
                           "libE57Format/ColourRepresentation",
                           "libE57Format/ColouredCubeDouble",
                           "libE57Format/ColouredCubeFloat",
                           "libE57Format/InvalidCVHeader",
                           "libE57Format/PinholeImageWithDistortionParameters",
                           "libE57Format/ZeroPoints",
                           "libE57Format/ZeroPointsInvalid",
                           "libE57Format/bad-crc",
                           "libE57Format/bunnyInt32",
                           "libE57Format/empty",
                           "libE57Format/test filename äöü",
                           "libE57Format/测试点云",
                           "pdal/A4",
                           "pdal/A4_moved",
                           "pdal/A_B",
                           "pdal/A_B_different_dims",
                           "pdal/A_merged_B",
                           "pdal/A_moved_B",
                           "pdal/B2",
                           "pye57/testWithNormals",
                           "pye57/translationWithoutRotation"}) {
    table.push_back(Refused(absl::StrCat(name, ".e57"), "E57 is not read"));
  }
  testing::ExpectTable(kData / "formats/e57", table, Open);
}

TEST(TestData, EveryPtsAndPtxFileIsRefused) {
  testing::ExpectTable(
      kData / "formats/pts-ptx",
      {Refused("1.2-with-color.ptx", "PTX is not read"),
       Refused("autzen.pts", "PTS is not read"),
       Refused("bunny_8.pts", "PTS is not read"),
       Refused("complex-transform.ptx", "PTX is not read"),
       Refused("multiple-and-transform.ptx", "PTX is not read"),
       Refused("no-color.ptx", "PTX is not read"),
       Refused("site_56_8.pts", "PTS is not read"),
       Refused("test.pts", "PTS is not read")},
      Open);
}

TEST(TestData, EveryXyzFileIsReadOrRefused) {
  testing::ExpectTable(
      kData / "formats/xyz",
      {{"scan.3d.txt", 2498},
       {"sources.txt", 0, absl::StatusCode::kInvalidArgument,
        "expected at least three columns, x, y, z, found 1: \"scan.2d.txt\""}},
      Open);
}

TEST(TestData, EveryMapIsReadOrRefused) {
  testing::ExpectTable(kData / "maps",
                       {Refused("ahn3_cropped_2.laz", "LAZ"),
                        {"autzen_140m_metres.las", 125377},
                        {"autzen_trim.las", 110000},
                        Refused("autzen_trim.laz", "LAZ"),
                        Refused("indoor.laz", "LAZ"),
                        Refused("lone-star.laz", "LAZ")},
                       Open);
}

TEST(TestData, EveryRegistrationFileIsReadOrRefused) {
  testing::ExpectTable(
      kData / "registration",
      {{"libpointmatcher/carCloudList.csv", 0,
        absl::StatusCode::kInvalidArgument, "no column is named \"x\""},
       {"libpointmatcher/car_cloud400.csv", 24989},
       {"libpointmatcher/car_cloud401.csv", 25193},
       {"libpointmatcher/cloud.00000.vtk", 24989},
       {"libpointmatcher/cloud.00001.vtk", 25193},
       {"libpointmatcher/cloud_0.vtk", 36674},
       {"libpointmatcher/cloud_1.vtk", 36670},
       {"norlab/cloud_1690309709_285305600.vtk", 41400},
       {"norlab/cloud_1690309709_485205504.vtk", 41195},
       {"norlab/cloud_1690309709_785777664.vtk", 41339},
       {"norlab/cloud_1690309710_85582848.vtk", 41406},
       {"norlab/trajectory.csv", 0, absl::StatusCode::kInvalidArgument,
        "no column is named \"x\""},
       // A matrix of four numbers a line reads as four points.
       {"small_gicp/T_target_source.txt", 4},
       {"small_gicp/source.ply", 69792},
       {"small_gicp/target.ply", 69088}},
      Open);
}

#endif  // MAPSIEVE_TEST_DATA

}  // namespace
}  // namespace mapsieve::client
