#include "core/geometry/crs.h"

#include <string>

#include "gtest/gtest.h"

namespace mapsieve::core {
namespace {

// As EPSG publishes them, shortened where nothing is read.
constexpr char kUtm32[] =
    R"(PROJCS["ETRS89 / UTM zone 32N",GEOGCS["ETRS89",DATUM["ETRS_1989",SPHEROID["GRS 1980",6378137,298.257222101]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4258"]],PROJECTION["Transverse_Mercator"],UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AUTHORITY["EPSG","25832"]])";
constexpr char kUtm32Wkt2[] =
    R"(PROJCRS["ETRS89 / UTM zone 32N",
  BASEGEOGCRS["ETRS89",DATUM["x",ELLIPSOID["GRS 1980",6378137,298.257222101,
    LENGTHUNIT["metre",1]]],PRIMEM["Greenwich",0,
    ANGLEUNIT["degree",0.0174532925199433]],ID["EPSG",4258]],
  CONVERSION["UTM zone 32N",METHOD["Transverse Mercator"]],
  CS[Cartesian,2],
  AXIS["E",east,ORDER[1],LENGTHUNIT["metre",1]],
  AXIS["N",north,ORDER[2],LENGTHUNIT["metre",1]],
  ID["EPSG",25832]])";
constexpr char kOregon[] =
    R"(PROJCS["Oregon feet",GEOGCS["a",UNIT["degree",0.01745]],UNIT["foot",0.3048]])";
constexpr char kNewMexico[] =
    R"(PROJCS["New Mexico",GEOGCS["a",UNIT["degree",0.01745]],UNIT["Foot_US",0.3048006096012192]])";
constexpr char kWgs84[] =
    R"(GEOGCS["WGS 84",DATUM["x"],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]])";

std::string Compound(const std::string& horizontal) {
  return R"(COMPD_CS["both",)" + horizontal +
         R"(,VERT_CS["heights",UNIT["foot",0.3048],AUTHORITY["EPSG","5703"]]])";
}

TEST(Crs, UnitIsThatOfTheHorizontalCoordinates) {
  EXPECT_EQ(UnitOfCrs(kUtm32), "metre");
  EXPECT_EQ(UnitOfCrs(kUtm32Wkt2), "metre");
  EXPECT_EQ(UnitOfCrs(kOregon), "foot");
  EXPECT_EQ(UnitOfCrs(kNewMexico), "US survey foot");
  EXPECT_EQ(UnitOfCrs(kWgs84), "degree");
  EXPECT_EQ(UnitOfCrs(Compound(kUtm32)), "metre");
  EXPECT_EQ(UnitOfCrs(Compound(kNewMexico)), "US survey foot");
  EXPECT_EQ(UnitOfCrs(R"(GEOGCRS["a",CS[ellipsoidal,2]])"), "degree");
  EXPECT_EQ(UnitOfCrs(R"(GEODCRS["a",CS[Cartesian,3],LENGTHUNIT["m",1.0]])"),
            "metre");
  EXPECT_EQ(UnitOfCrs(R"(GEOCCS["a",UNIT["Meter",1]])"), "metre");
  EXPECT_EQ(UnitOfCrs(R"(LOCAL_CS["a",UNIT["chain",20.1168]])"), "chain");
  EXPECT_EQ(UnitOfCrs(R"(BOUNDCRS[SOURCECRS[PROJCRS["a",UNIT["metre",1]]]])"),
            "metre");
  // Without a size only the name tells.
  EXPECT_EQ(UnitOfCrs(R"(projcs ( "a" , unit("rod") ) )"), "rod");
}

TEST(Crs, TextsThatTellNothingTellNothing) {
  for (const char* text :
       {"", "EPSG:25832", "metre", "[", "]", "A[", "A[]", "A[]]", "A[\"x",
        "A[\"\"\"", "PROJCS[\"a\",UNIT[\"metre\",1]", "PROJCS[\"a\"],B[]",
        "PROJCS[\"a\";UNIT[\"metre\",1]]", "PROJCS[UNIT[]]", "COMPD_CS[]"}) {
    EXPECT_EQ(UnitOfCrs(text), "") << text;
    EXPECT_EQ(EpsgCodeOf(text), std::string(text) == "EPSG:25832" ? 25832 : 0)
        << text;
  }
  // Deeper than any system is.
  std::string deep;
  for (int i = 0; i < 100'000; ++i) deep += "A[";
  EXPECT_EQ(UnitOfCrs(deep), "");
  EXPECT_EQ(UnitOfCrs(deep + std::string(100'000, ']')), "");
}

TEST(Crs, CodeIsThatOfTheHorizontalSystem) {
  EXPECT_EQ(EpsgCodeOf("EPSG:2056"), 2056);
  EXPECT_EQ(EpsgCodeOf(kUtm32), 25832);
  EXPECT_EQ(EpsgCodeOf(kUtm32Wkt2), 25832);
  EXPECT_EQ(EpsgCodeOf(Compound(kUtm32)), 25832);
  // Not that of its base.
  EXPECT_EQ(EpsgCodeOf(kOregon), 0);
  EXPECT_EQ(EpsgCodeOf(R"(PROJCS["a",AUTHORITY["ESRI","102100"]])"), 0);
  EXPECT_EQ(ParseEpsgName("EPSG:32766"), 32766);
  for (const char* text : {"EPSG:", "EPSG:0", "EPSG:-1", "EPSG:32767",
                           "EPSG:1x", "epsg:1", "EPSG: 1", "2056", kUtm32}) {
    EXPECT_EQ(ParseEpsgName(text), 0) << text;
  }
}

TEST(Crs, HeightsHaveACodeOfTheirOwn) {
  EXPECT_EQ(ParseEpsgName("EPSG:26910+5703"), 26910);
  EXPECT_EQ(EpsgCodeOf("EPSG:26910+5703"), 26910);
  EXPECT_EQ(VerticalEpsgCodeOf("EPSG:26910+5703"), 5703);
  EXPECT_EQ(VerticalEpsgCodeOf("EPSG:26910"), 0);
  EXPECT_EQ(VerticalEpsgCodeOf(Compound(kUtm32)), 5703);
  EXPECT_EQ(VerticalEpsgCodeOf(kUtm32), 0);
  for (const char* text : {"EPSG:26910+", "EPSG:+5703", "EPSG:26910+0",
                           "EPSG:26910+32767", "EPSG:26910+5703+5703"}) {
    EXPECT_EQ(ParseEpsgName(text), 0) << text;
    EXPECT_EQ(VerticalEpsgCodeOf(text), 0) << text;
  }
  // They tell systems apart where both have one.
  EXPECT_TRUE(IsSameCrs("EPSG:25832+5703", Compound(kUtm32)));
  EXPECT_TRUE(IsSameCrs("EPSG:25832+5703", "EPSG:25832"));
  EXPECT_FALSE(IsSameCrs("EPSG:25832+7837", Compound(kUtm32)));
}

TEST(Crs, SameSystemsAreKnownByCodeOrText) {
  EXPECT_TRUE(IsSameCrs("EPSG:25832", kUtm32));
  EXPECT_TRUE(IsSameCrs(kUtm32, kUtm32Wkt2));
  EXPECT_TRUE(IsSameCrs(kUtm32, Compound(kUtm32)));
  EXPECT_FALSE(IsSameCrs("EPSG:25833", kUtm32));
  EXPECT_TRUE(IsSameCrs(R"(PROJCS["a b", UNIT["x",1]])",
                        R"(PROJCS["a b",UNIT["x",1]])"));
  EXPECT_FALSE(IsSameCrs(R"(PROJCS["a b"])", R"(PROJCS["ab"])"));
  EXPECT_FALSE(IsSameCrs(kOregon, kNewMexico));
  EXPECT_FALSE(IsSameCrs("", "EPSG:25832"));
  EXPECT_EQ(NameOfCrs(kUtm32Wkt2), "ETRS89 / UTM zone 32N");
  EXPECT_EQ(NameOfCrs(R"(A["say ""x"""])"), "say \"x\"");
}

}  // namespace
}  // namespace mapsieve::core
