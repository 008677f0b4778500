#include <cstdint>
#include <string>
#include <vector>

#include "client/formats/coordinate_systems.h"
#include "client/formats/las_file.h"
#include "core/geometry/crs.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/formats/file_table.h"
#include "tests/formats/las_text.h"
#include "tests/formats/packed.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

using testing::Evlr;
using ::testing::HasSubstr;
using testing::LasText;
using testing::Packed;
using testing::Record0;
using testing::TemporaryFile;
using testing::Vlr;

TEST(LasReader, FindsTheCrs) {
  const auto crs = [](const LasText& text) {
    const TemporaryFile file(".las", text.Build());
    const auto reader = OpenLasFile(file.path());
    EXPECT_TRUE(reader.ok()) << reader.status();
    return reader.ok() ? (*reader)->info().crs_wkt : "";
  };
  const auto keys = [](uint16_t projected, uint16_t geographic) {
    return Vlr("LASF_Projection", 34735,
               Packed(uint16_t{1}, uint16_t{1}, uint16_t{0}, uint16_t{3},
                      uint16_t{1026}, uint16_t{34737}, uint16_t{9}, uint16_t{7},
                      uint16_t{3072}, uint16_t{0}, uint16_t{1}, projected,
                      uint16_t{2048}, uint16_t{0}, uint16_t{1}, geographic));
  };
  const std::string wkt =
      Vlr("LASF_Projection", 2112, std::string("PROJCS[\"a\"]\0\0", 13));
  const std::string liblas = Vlr("liblas", 2112, "PROJCS[\"b\"]");
  LasText text{.minor = 4, .records = {Record0(0)}};
  EXPECT_EQ(crs(text), "");
  text.vlrs = {liblas};
  EXPECT_EQ(crs(text), "PROJCS[\"b\"]");
  text.vlrs = {keys(26915, 4269), liblas};
  EXPECT_EQ(crs(text), "EPSG:26915");
  text.vlrs = {keys(0, 4326)};
  EXPECT_EQ(crs(text), "EPSG:4326");
  text.vlrs = {keys(32767, 32767)};
  EXPECT_EQ(crs(text), "");
  text.vlrs = {wkt, keys(26915, 4269), liblas};
  EXPECT_EQ(crs(text), "PROJCS[\"a\"]");
  text.vlrs = {};
  text.evlrs = {Evlr("other", 1, "payload"),
                Evlr("LASF_Projection", 2112, "PROJCS[\"c\"]")};
  EXPECT_EQ(crs(text), "PROJCS[\"c\"]");
}

TEST(LasReader, FindsTheUnit) {
  const auto info = [](const std::vector<std::string>& vlrs) {
    const TemporaryFile file(
        ".las",
        LasText{.minor = 4, .vlrs = vlrs, .records = {Record0(0)}}.Build());
    return (*OpenLasFile(file.path()))->info();
  };
  const auto keys = [](uint16_t model, uint16_t projected, uint16_t geographic,
                       uint16_t unit) {
    return Vlr("LASF_Projection", 34735,
               Packed(uint16_t{1}, uint16_t{1}, uint16_t{0}, uint16_t{4},
                      uint16_t{1024}, uint16_t{0}, uint16_t{1}, model,
                      uint16_t{3072}, uint16_t{0}, uint16_t{1}, projected,
                      uint16_t{2048}, uint16_t{0}, uint16_t{1}, geographic,
                      uint16_t{3076}, uint16_t{0}, uint16_t{1}, unit));
  };
  const std::string wkt =
      Vlr("LASF_Projection", 2112, "PROJCS[\"a\",UNIT[\"metre\",1]]");
  EXPECT_EQ(info({}).unit, "");
  EXPECT_EQ(info({keys(1, 26915, 0, 9001)}).unit, "metre");
  EXPECT_EQ(info({keys(1, 2994, 0, 9002)}).unit, "foot");
  EXPECT_EQ(info({keys(1, 2903, 0, 9003)}).unit, "US survey foot");
  EXPECT_EQ(info({keys(1, 2903, 0, 9036)}).unit, "EPSG unit 9036");
  EXPECT_EQ(info({keys(1, 2903, 0, 0)}).unit, "US survey foot");
  EXPECT_EQ(info({keys(2, 0, 4326, 0)}).unit, "degree");
  // Of a key that is none of a unit nothing is believed.
  EXPECT_EQ(info({keys(1, 0, 0, 32632)}).unit, "");
  // The WKT prevails.
  EXPECT_EQ(info({keys(1, 26915, 0, 9002), wkt}).unit, "metre");
  // The base of a projection of the file's own is not its system.
  EXPECT_EQ(info({keys(1, 32767, 4269, 9002)}).crs_wkt, "");
  EXPECT_EQ(info({keys(1, 32767, 4269, 9002)}).unit, "foot");
}

TEST(LasReader, TellsWhatItMakesOfKeys) {
  const auto info = [](const std::vector<std::vector<uint16_t>>& keys,
                       const std::vector<double>& values) {
    // A number of keys that is wrong.
    std::string directory = Packed(uint16_t{1}, uint16_t{1}, uint16_t{0},
                                   static_cast<uint16_t>(keys.size() + 500));
    for (const std::vector<uint16_t>& key : keys) {
      // A key, where its value is, and the value.
      directory += Packed(key[0], key[1], uint16_t{1}, key[2]);
    }
    std::string doubles;
    for (const double value : values) doubles += Packed(value);
    const TemporaryFile file(
        ".las", LasText{.minor = 4,
                        .vlrs = {Vlr("LASF_Projection", 34735, directory),
                                 Vlr("LASF_Projection", 34736, doubles)},
                        .records = {Record0(0)}}
                    .Build());
    return (*OpenLasFile(file.path()))->info();
  };
  constexpr uint16_t kOwn = 32767;
  constexpr uint16_t kDoubles = 34736;
  EXPECT_EQ(info({{1024, 0, 1}, {3072, 0, 26910}, {4096, 0, 5703}}, {}).crs_wkt,
            "EPSG:26910+5703");
  // An ellipsoid of the first GeoTIFF, which is no vertical system.
  PointFileInfo told =
      info({{1024, 0, 1}, {3072, 0, 32632}, {4096, 0, 5030}}, {});
  EXPECT_EQ(told.crs_wkt, "EPSG:32632");
  EXPECT_THAT(told.crs_problem, HasSubstr("VerticalCSTypeGeoKey 5030"));
  told = info({{1024, 0, 1}, {3072, 0, 32632}, {4096, 0, kOwn}}, {});
  EXPECT_EQ(told.crs_wkt, "EPSG:32632");
  EXPECT_THAT(told.crs_problem, HasSubstr("VerticalCSTypeGeoKey 32767"));
  told = info({{1024, 0, 3}, {2048, 0, 4326}}, {});
  EXPECT_EQ(told.crs_wkt, "");
  EXPECT_THAT(told.crs_problem, HasSubstr("geocentric"));

  // Krovak, which is not understood, and a cone that is, in feet: EPSG:2994.
  const auto own = [&](uint16_t method, uint16_t vertical) {
    return info({{1024, 0, 1},
                 {2048, 0, 4152},
                 {3072, 0, kOwn},
                 {3074, 0, kOwn},
                 {3075, 0, method},
                 {3076, 0, 9002},
                 {3078, kDoubles, 0},
                 {3079, kDoubles, 1},
                 {3084, kDoubles, 2},
                 {3085, kDoubles, 3},
                 {3086, kDoubles, 4},
                 {3087, kDoubles, 5},
                 {4096, 0, vertical}},
                {43, 45.5, -120.5, 41.75, 1312335.958, 0});
  };
  told = own(26, 0);
  EXPECT_EQ(told.crs_wkt, "");
  EXPECT_THAT(told.crs_problem, HasSubstr("projection method 26"));
  told = own(8, 0);
  EXPECT_EQ(told.crs_problem, "");
  EXPECT_EQ(told.unit, "foot");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::string published,
                                WktOfCrs("EPSG:2994"));
  // They differ in names and codes alone: from the projection to the unit.
  const auto projection = [](const std::string& wkt) {
    const size_t begin = wkt.find("GEOGCS");
    return wkt.substr(begin, wkt.find("UNIT[\"foot\"") - begin);
  };
  EXPECT_EQ(projection(told.crs_wkt), projection(published));
  const std::string both = own(8, 5703).crs_wkt;
  EXPECT_EQ(both.find("COMPD_CS[\"unknown + NAVD88 height\",PROJCS["), 0);
  EXPECT_EQ(core::VerticalEpsgCodeOf(both), 5703);
  EXPECT_EQ(projection(both), projection(published));
}

}  // namespace
}  // namespace mapsieve::client
