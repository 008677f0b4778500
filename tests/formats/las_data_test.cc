#include <cmath>
#include <filesystem>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "client/formats/coordinate_systems.h"
#include "client/formats/las_file.h"
#include "core/cloud/point_cloud.h"
#include "core/geometry/crs.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/formats/attributes_of.h"
#include "tests/formats/file_table.h"
#include "tests/testing/status_matchers.h"

#ifdef MAPSIEVE_TEST_DATA

namespace mapsieve::client {
namespace {

using core::Point3;
using core::PointCloud;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::ReadAll;
using testing::Same;
using testing::TemporaryFile;
using testing::Value;

const std::filesystem::path kData = MAPSIEVE_TEST_DATA;

TEST(LasTestData, EveryFileIsReadOrRefused) {
  const auto laz = [](std::string path) {
    return testing::FileCase{.path = std::move(path),
                             .code = absl::StatusCode::kUnimplemented,
                             .message = "LAZ"};
  };
  testing::ExpectTable(
      kData / "formats/las",
      {laz("las-rs/32-1-472-150-76.laz"),
       laz("las-rs/autzen.copc.laz"),
       {"las-rs/autzen.las", 106},
       laz("las-rs/autzen.laz"),
       laz("las-rs/extrabytes.laz"),
       {"laspy/1_4_w_evlr.las", 1000},
       laz("laspy/1_4_w_evlr.laz"),
       laz("laspy/extra.laz"),
       laz("laspy/fullwave.laz"),
       laz("laspy/plane.laz"),
       {"laspy/simple1_1.las", 1065},
       {"laspy/simple1_3.las", 999},
       laz("laspy/simple_with_page.copc.laz"),
       {"laspy/test1_4.las", 1000},
       {"laspy/unregistered_extra_bytes.las", 4},
       {"laspy/vegetation_1_3.las", 10683},
       {"laszip/5points_14.las", 5},
       laz("laszip/broken_coder.laz"),
       laz("laszip/broken_compressor.laz"),
       laz("laszip/broken_size.laz"),
       laz("laszip/broken_type.laz"),
       laz("laszip/broken_version.laz"),
       {"laz-perf/1815.las", 1247},
       laz("laz-perf/1815.laz"),
       laz("laz-perf/point-time-1.4.las.laz"),
       {"laz-perf/point10-1.0.las", 1},
       laz("laz-perf/point10-1.0.laz"),
       {"laz-perf/point10-1.1.las", 1},
       laz("laz-perf/point10-1.1.laz"),
       {"laz-rs/extra-bytes.las", 1065},
       laz("laz-rs/extra-bytes.laz"),
       {"laz-rs/point-color.las", 1065},
       laz("laz-rs/point-color.laz"),
       {"laz-rs/point-time-color.las", 1065},
       laz("laz-rs/point-time-color.laz"),
       {"laz-rs/point-time.las", 1065},
       laz("laz-rs/point-time.laz"),
       laz("laz-rs/point-version-1-point-wise.laz"),
       {"laz-rs/point10.las", 1065},
       laz("laz-rs/point10.laz"),
       laz("loaders/ellipsoid-1.4.laz"),
       {"pdal/1.0_0.las", 1},
       {"pdal/1.0_1.las", 1},
       {"pdal/1.1_0.las", 1},
       {"pdal/1.1_1.las", 1},
       {"pdal/1.2-no-points.las", 0, absl::StatusCode::kDataLoss,
        "declares 1065 points of 34 bytes, the file ends after 0"},
       laz("pdal/1.2-with-color.copc.laz"),
       {"pdal/1.2_0.las", 1},
       {"pdal/1.2_1.las", 1},
       {"pdal/1.2_2.las", 1},
       {"pdal/1.2_3.las", 1},
       {"pdal/100-points.las", 100},
       {"pdal/bad-geotiff-keys.las", 10},
       {"pdal/bad_vlr_count.las", 10},
       {"pdal/extrabytes.las", 1065},
       {"pdal/garbage_nVariableLength.las", 0, absl::StatusCode::kDataLoss,
        "declares 719 points of 20 bytes, the file ends after 718"},
       {"pdal/gps-time-nan.las", 1},
       {"pdal/hextest.las", 8},
       {"pdal/interesting.las", 1065},
       laz("pdal/laszip-generated_with2bytespadding.laz"),
       {"pdal/lots_of_vlr.las", 1},
       {"pdal/no-points.las", 0},
       {"pdal/prec3.las", 110},
       laz("pdal/simple-laszip-compressor-version-1.2r0.laz"),
       {"pdal/simple.las", 1065},
       laz("pdal/simple.laz"),
       {"pdal/spec_3.las", 10},
       {"pdal/spurious.las", 1065},
       {"pdal/synthetic_test.las", 1},
       {"pdal/utm15.las", 1},
       {"pdal/wontcompress3.las", 1000}},
      [](const std::filesystem::path& path) { return OpenPointFile(path); });
}

TEST(LasTestData, ExtentsAreThoseOfTheReadme) {
  const auto expect = [](const char* name, const Point3& low,
                         const Point3& high) {
    SCOPED_TRACE(name);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud,
                                  ReadAll(OpenLasFile, kData / name, 5000));
    testing::ExpectExtent(cloud, low, high);
  };
  expect("maps/autzen_140m_metres.las", {194214.12, 259509.28, 126.641},
         {194354.11, 259649.28, 182.316});
  expect("maps/autzen_trim.las", {636001.76, 848935.2, 406.26},
         {637179.22, 849497.9, 520.51});
  expect("formats/las/laspy/vegetation_1_3.las",
         {-98451.205, -55975.417, -81460.091},
         {-98447.447, -55969.405, -81455.203});
  expect("formats/las/laz-perf/1815.las", {2014000.4, 6493002.1, 87.959183},
         {2014999.7, 6493999.9, 124.07413});
  expect("formats/las/pdal/spurious.las", {-124.06873, 44.050009, 123.93},
         {-123.0625, 44.062497, 178.73});
}

TEST(LasTestData, ExtraBytesRepeatTheFieldsOfTheirPoints) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const PointCloud cloud,
      ReadAll(OpenLasFile, kData / "formats/las/pdal/extrabytes.las"));
  for (size_t i = 0; i < cloud.size(); ++i) {
    EXPECT_EQ(Value(cloud, "Colors_0", i), Value(cloud, "red", i));
    EXPECT_EQ(Value(cloud, "Colors_1", i), Value(cloud, "green", i));
    EXPECT_EQ(Value(cloud, "Colors_2", i), Value(cloud, "blue", i));
    EXPECT_EQ(Value(cloud, "Flags_0", i), Value(cloud, "return_number", i));
    EXPECT_EQ(Value(cloud, "Flags_1", i), Value(cloud, "number_of_returns", i));
    EXPECT_EQ(Value(cloud, "Intensity", i), Value(cloud, "intensity", i));
    EXPECT_EQ(Value(cloud, "Time", i), std::floor(Value(cloud, "gps_time", i)));
  }
}

TEST(LasTestData, VersionsAndFormatsOfOnePointAgree) {
  for (const char* name : {"1.0_0", "1.0_1", "1.1_0", "1.1_1", "1.2_0", "1.2_1",
                           "1.2_2", "1.2_3"}) {
    const auto path = kData / "formats/las/pdal" / absl::StrCat(name, ".las");
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto reader, OpenLasFile(path));
    EXPECT_EQ(reader->info().crs_wkt, "EPSG:26915");
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadAll(*reader));
    ASSERT_EQ(cloud.size(), 1);
    EXPECT_NEAR(cloud.positions[0].x, 470692.44, 1e-6);
    EXPECT_NEAR(cloud.positions[0].y, 4602888.9, 0.05);
    EXPECT_EQ(cloud.positions[0].z, 16);
  }
}

TEST(LasTestData, UnitsAreThoseOfKeysAndWkt) {
  const auto unit = [](const char* name) {
    const auto reader = OpenLasFile(kData / name);
    EXPECT_TRUE(reader.ok()) << reader.status();
    return (*reader)->info().unit;
  };
  EXPECT_EQ(unit("formats/las/pdal/1.2_0.las"), "metre");
  EXPECT_EQ(unit("formats/las/pdal/wontcompress3.las"), "metre");
  EXPECT_EQ(unit("formats/las/laz-perf/1815.las"), "metre");
  EXPECT_EQ(unit("formats/las/pdal/prec3.las"), "foot");
  EXPECT_EQ(unit("formats/las/pdal/interesting.las"), "foot");
  EXPECT_EQ(unit("formats/las/las-rs/autzen.las"), "foot");
  EXPECT_EQ(unit("maps/autzen_trim.las"), "foot");
  EXPECT_EQ(unit("formats/las/pdal/lots_of_vlr.las"), "US survey foot");
  EXPECT_EQ(unit("formats/las/laspy/test1_4.las"), "US survey foot");
  EXPECT_EQ(unit("formats/las/pdal/spurious.las"), "degree");
  EXPECT_EQ(unit("maps/autzen_140m_metres.las"), "");
  EXPECT_EQ(unit("formats/las/laspy/simple1_3.las"), "");
}

TEST(LasTestData, SystemsAreThoseOfTheKeys) {
  const auto info = [](const char* name) {
    const auto reader = OpenLasFile(kData / "formats/las" / name);
    EXPECT_TRUE(reader.ok()) << reader.status();
    return (*reader)->info();
  };
  EXPECT_EQ(info("laz-perf/1815.las").crs_wkt, "EPSG:6580+5703");
  // The file's keys give the ellipsoid for the unit, and no system.
  EXPECT_THAT(info("laspy/simple1_3.las").crs_problem,
              HasSubstr("no horizontal system"));
  // Systems of the files' own; the second is that of EPSG:2994.
  const std::string florida = info("pdal/lots_of_vlr.las").crs_wkt;
  EXPECT_THAT(florida, AllOf(HasSubstr("\"Transverse_Mercator\""),
                             HasSubstr("[\"scale_factor\",0.999941]"),
                             HasSubstr("[\"false_easting\",200000]"),
                             HasSubstr("6378137,298.257222101]")));
  EXPECT_EQ(core::UnitOfCrs(florida), "US survey foot");
  const std::string oregon = info("pdal/prec3.las").crs_wkt;
  EXPECT_EQ(core::NameOfCrs(oregon), "NAD_1983_HARN_Lambert_Conformal_Conic");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::string published,
                                WktOfCrs("EPSG:2994"));
  for (const char* part :
       {"DATUM[\"NAD83_High_Accuracy_Reference_Network\"",
        "PROJECTION[\"Lambert_Conformal_Conic_2SP\"]",
        "[\"latitude_of_origin\",41.75]", "[\"central_meridian\",-120.5]",
        "[\"standard_parallel_1\",43]", "[\"standard_parallel_2\",45.5]",
        "[\"false_easting\",1312335.958", "[\"false_northing\",0]"}) {
    EXPECT_THAT(oregon, HasSubstr(part));
    EXPECT_THAT(published, HasSubstr(part));
  }
}

TEST(LasTestData, EveryReadableFileSurvivesWriting) {
  int count = 0;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(kData / "formats/las")) {
    if (entry.path().extension() != ".las") continue;
    SCOPED_TRACE(entry.path());
    auto reader = OpenLasFile(entry.path());
    if (!reader.ok()) continue;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud cloud, ReadAll(**reader));
    const PointFileInfo& info = (*reader)->info();
    const TemporaryFile file(".las");
    MAPSIEVE_ASSERT_OK(WritePointFile(
        file.path(), cloud,
        {.coordinate_step = info.coordinate_step, .crs_wkt = info.crs_wkt}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto again, OpenLasFile(file.path()));
    // Codes become WKT.
    EXPECT_TRUE(core::IsSameCrs(again->info().crs_wkt, info.crs_wkt));
    if (core::ParseEpsgName(info.crs_wkt) == 0) {
      EXPECT_EQ(again->info().crs_wkt, info.crs_wkt);
    }
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const PointCloud read, ReadAll(*again));
    ASSERT_EQ(read.size(), cloud.size());
    EXPECT_TRUE(Same(cloud, read) == cloud.attributes);
    for (size_t i = 0; i < read.size(); ++i) {
      const double limit = info.coordinate_step * 0.51;
      EXPECT_NEAR(read.positions[i].x, cloud.positions[i].x, limit);
      EXPECT_NEAR(read.positions[i].y, cloud.positions[i].y, limit);
      EXPECT_NEAR(read.positions[i].z, cloud.positions[i].z, limit);
    }
    ++count;
  }
  EXPECT_EQ(count, 40);
}

}  // namespace
}  // namespace mapsieve::client

#endif  // MAPSIEVE_TEST_DATA
