#include "client/formats/geotiff_keys.h"

#include <geotiff/geo_normalize.h>
#include <geotiff/geo_simpletags.h>
#include <geotiff/geo_tiffp.h>
#include <geotiff/geotiff.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string_view>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/formats/batch_columns.h"
#include "client/formats/coordinate_systems.h"
#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/geometry/crs.h"

namespace mapsieve::client {
namespace {

constexpr int kModelKey = 1024;
constexpr int kCitationKey = 1026;
constexpr int kGeographicKey = 2048;
constexpr int kGeographicCitationKey = 2049;
constexpr int kProjectedKey = 3072;
constexpr int kProjectedCitationKey = 3073;
constexpr int kLengthUnitKey = 3076;
constexpr int kVerticalKey = 4096;

constexpr int kProjectedModel = 1;
constexpr int kGeographicModel = 2;
constexpr int kGeocentricModel = 3;

// The name of a unit of length by its EPSG code; empty if it is none.
std::string NameOfLengthUnit(int code) {
  switch (code) {
    case 9001:
      return std::string(core::kMetre);
    case 9002:
      return std::string(core::kFoot);
    case 9003:
      return std::string(core::kUsSurveyFoot);
    default:
      // Codes of units of length; files have others there by mistake.
      return code > 9003 && code < 9100 ? absl::StrCat("EPSG unit ", code) : "";
  }
}

// A parameter of GeoTIFF and its name in WKT.
struct Parameter {
  int key;
  const char* name;
};

// A projection method of GeoTIFF and its name in WKT.
struct Method {
  int code;
  const char* name;
  std::array<Parameter, 5> parameters;
};

constexpr Parameter kNoParameter = {0, nullptr};
constexpr std::array<Method, 4> kMethods = {{
    {1,
     "Transverse_Mercator",
     {{{3081, "latitude_of_origin"},
       {3080, "central_meridian"},
       {3092, "scale_factor"},
       kNoParameter,
       kNoParameter}}},
    {8,
     "Lambert_Conformal_Conic_2SP",
     {{{3085, "latitude_of_origin"},
       {3084, "central_meridian"},
       {3078, "standard_parallel_1"},
       {3079, "standard_parallel_2"},
       kNoParameter}}},
    {9,
     "Lambert_Conformal_Conic_1SP",
     {{{3081, "latitude_of_origin"},
       {3080, "central_meridian"},
       {3092, "scale_factor"},
       kNoParameter,
       kNoParameter}}},
    {11,
     "Albers_Conic_Equal_Area",
     {{{3081, "latitude_of_center"},
       {3080, "longitude_of_center"},
       {3078, "standard_parallel_1"},
       {3079, "standard_parallel_2"},
       kNoParameter}}},
}};
constexpr std::array<Parameter, 2> kFalseOrigin = {
    {{3082, "false_easting"}, {3083, "false_northing"}}};

std::string Number(double value) { return absl::StrFormat("%.15g", value); }

// The directory of those keys whose values are there, for libgeotiff believes
// the numbers of keys and values.
std::vector<std::byte> WholeKeys(const GeoKeyRecords& records) {
  constexpr size_t kMaxKeys = 1000;
  const size_t entries = std::min(records.directory.size() / 8, kMaxKeys);
  ByteWriter out;
  // Version, revision, minor revision; the number of keys follows.
  out.Put(uint16_t{1});
  out.Put(uint16_t{1});
  out.Put(uint16_t{0});
  ByteWriter keys;
  uint16_t count = 0;
  for (size_t i = 1; i < entries; ++i) {
    const auto entry = std::span(records.directory).subspan(8 * i, 8);
    const auto at = [&](size_t offset) {
      return size_t{LoadLittleEndian<uint16_t>(entry.data() + offset)};
    };
    const size_t location = at(2);
    const size_t end = at(6) + at(4);
    const bool is_whole =
        (location == 0 && at(4) == 1) ||
        (location == 34736 && end <= records.doubles.size() / sizeof(double)) ||
        (location == 34737 && end <= records.text.size());
    if (!is_whole || at(4) == 0) continue;
    keys.PutBytes(entry);
    ++count;
  }
  out.Put(count);
  out.PutBytes(keys.bytes());
  return std::move(out.bytes());
}

// Parses keys as libgeotiff does. Not to be moved: libgeotiff points into it.
class Definition {
 public:
  Definition(const GeoKeyRecords& records, pj_ctx* proj)
      : tags_(ST_Create(), &ST_Destroy), keys_(nullptr, &GTIFFree) {
    Set(34735, STT_SHORT, WholeKeys(records), sizeof(uint16_t));
    Set(34736, STT_DOUBLE, records.doubles, sizeof(double));
    std::vector<std::byte> text = records.text;
    text.push_back(std::byte{0});
    Set(34737, STT_ASCII, text, 1);
    TIFFMethod methods;
    GTIFSetSimpleTagsMethods(&methods);
    keys_.reset(GTIFNewWithMethodsEx(tags_.get(), &methods, &Ignore, nullptr));
    if (keys_ == nullptr) return;
    GTIFAttachPROJContext(keys_.get(), proj);
    is_valid_ = GTIFGetDefn(keys_.get(), &values_) != 0;
  }
  Definition(const Definition&) = delete;
  Definition& operator=(const Definition&) = delete;

  bool is_valid() const { return is_valid_; }
  const GTIFDefn& values() const { return values_; }

  // The value of a parameter, in degrees or metres; nothing: it has none.
  const double* Find(int key) const {
    for (int i = 0; i < std::min(values_.nParms, MAX_GTIF_PROJPARMS); ++i) {
      if (values_.ProjParmId[i] == key) return &values_.ProjParm[i];
    }
    return nullptr;
  }

  // The name that a citation begins with, fit for quotes.
  std::string Name(int key) const {
    std::array<char, 256> text{};
    GTIFKeyGetASCII(keys_.get(), static_cast<geokey_t>(key), text.data(),
                    static_cast<int>(text.size() - 1));
    std::string_view name = text.data();
    constexpr std::string_view kLabel = "GCS Name = ";
    if (name.starts_with(kLabel)) name.remove_prefix(kLabel.size());
    std::string clean = CleanText(name.substr(0, name.find('|')), ' ');
    std::replace(clean.begin(), clean.end(), '"', '\'');
    return clean;
  }

 private:
  static void Ignore(GTIF* /*keys*/, int /*level*/, const char* /*text*/, ...) {
  }

  void Set(int tag, int type, const std::vector<std::byte>& bytes,
           size_t value_bytes) {
    const size_t count = bytes.size() / value_bytes;
    if (count == 0) return;
    // It copies them.
    ST_SetKey(tags_.get(), tag, static_cast<int>(count), type,
              const_cast<std::byte*>(bytes.data()));
  }

  std::unique_ptr<ST_TIFF, decltype(&ST_Destroy)> tags_;
  std::unique_ptr<GTIF, decltype(&GTIFFree)> keys_;
  GTIFDefn values_{};
  bool is_valid_ = false;
};

absl::Status NotUnderstood(const std::string& what) {
  return absl::NotFoundError(what);
}

// The geographic system that the coordinates are in or a projection is of.
absl::StatusOr<std::string> GeographicWkt(const Definition& definition) {
  const GTIFDefn& values = definition.values();
  constexpr double kTolerance = 1e-9;
  if (std::abs(values.UOMAngleInDegrees - 1) > kTolerance) {
    return NotUnderstood("angles in another unit than degrees");
  }
  const auto code = static_cast<uint16_t>(values.GCS);
  const auto datum = static_cast<uint16_t>(values.Datum);
  // Systems with the codes 4001 to 4999 have the datum 2000 beyond.
  constexpr int kDatumOffset = 2000;
  const bool has_pair = datum > 4000 + kDatumOffset &&
                        datum < 5000 + kDatumOffset &&
                        values.PMLongToGreenwich == 0;
  if (code != GeoKeys::kUserDefined || has_pair) {
    const bool is_known = code != GeoKeys::kUserDefined;
    MAPSIEVE_ASSIGN_OR_RETURN(
        std::string wkt, WktOfCrs(absl::StrCat(
                             "EPSG:", is_known ? code : datum - kDatumOffset)));
    if (!wkt.starts_with("GEOGCS[") || core::UnitOfCrs(wkt) != core::kDegree) {
      return NotUnderstood(absl::StrCat("GeographicTypeGeoKey ", code));
    }
    return wkt;
  }
  if (!(values.SemiMajor > 0) || !(values.SemiMinor > 0) ||
      !std::isfinite(values.SemiMajor) || values.SemiMinor > values.SemiMajor) {
    return NotUnderstood("no ellipsoid");
  }
  // WKT has 0 for a sphere.
  const double flattening = 1 - values.SemiMinor / values.SemiMajor;
  std::string name = definition.Name(kGeographicCitationKey);
  if (name.empty()) name = "unknown";
  return absl::StrCat(
      "GEOGCS[\"", name, "\",DATUM[\"unknown\",SPHEROID[\"unknown\",",
      Number(values.SemiMajor), ",",
      flattening > 0 ? absl::StrFormat("%.13g", 1 / flattening) : "0",
      "]],PRIMEM[\"", values.PMLongToGreenwich == 0 ? "Greenwich" : "unknown",
      "\",", Number(values.PMLongToGreenwich),
      "],UNIT[\"degree\",0.0174532925199433]]");
}

absl::StatusOr<std::string> ProjectedWkt(const Definition& definition) {
  const GTIFDefn& values = definition.values();
  const auto* const method = std::find_if(
      kMethods.begin(), kMethods.end(),
      [&](const Method& known) { return known.code == values.CTProjection; });
  if (method == kMethods.end()) {
    return NotUnderstood(absl::StrCat("projection method ", values.CTProjection,
                                      " of ProjCoordTransGeoKey"));
  }
  const double unit = values.UOMLengthInMeters;
  if (!(unit > 0) || !std::isfinite(unit)) {
    return NotUnderstood("unit of ProjLinearUnitsGeoKey");
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const std::string base, GeographicWkt(definition));
  std::string name = definition.Name(kProjectedCitationKey);
  if (name.empty()) name = definition.Name(kCitationKey);
  if (name.empty()) name = "unknown";
  std::string wkt = absl::StrCat("PROJCS[\"", name, "\",", base,
                                 ",PROJECTION[\"", method->name, "\"]");
  const auto add = [&](const Parameter& parameter,
                       double size) -> absl::Status {
    if (parameter.name == nullptr) return absl::OkStatus();
    const double* value = definition.Find(parameter.key);
    if (value == nullptr || !std::isfinite(*value)) {
      return NotUnderstood(absl::StrCat("no ", parameter.name));
    }
    absl::StrAppend(&wkt, ",PARAMETER[\"", parameter.name, "\",",
                    Number(*value / size), "]");
    return absl::OkStatus();
  };
  for (const Parameter& parameter : method->parameters) {
    MAPSIEVE_RETURN_IF_ERROR(add(parameter, 1));
  }
  for (const Parameter& parameter : kFalseOrigin) {
    MAPSIEVE_RETURN_IF_ERROR(add(parameter, unit));
  }
  std::string unit_name =
      NameOfLengthUnit(static_cast<uint16_t>(values.UOMLength));
  if (unit_name.empty()) unit_name = "unknown";
  return absl::StrCat(wkt, ",UNIT[\"", unit_name, "\",", Number(unit), "]]");
}

// The WKT of keys whose horizontal system is of the file's own.
absl::StatusOr<std::string> UserDefinedWkt(const GeoKeyRecords& records) {
  MAPSIEVE_ASSIGN_OR_RETURN(const ProjContext proj, OpenProj());
  const Definition definition(records, proj.get());
  if (!definition.is_valid()) return NotUnderstood("damaged keys");
  MAPSIEVE_ASSIGN_OR_RETURN(const std::string wkt,
                            definition.values().Model == kProjectedModel
                                ? ProjectedWkt(definition)
                                : GeographicWkt(definition));
  // As PROJ writes it, which so has read it.
  return WktOfCrs(wkt);
}

// "A + B" of two systems.
std::string CompoundWkt(const std::string& horizontal,
                        const std::string& vertical) {
  return absl::StrCat("COMPD_CS[\"", core::NameOfCrs(horizontal), " + ",
                      core::NameOfCrs(vertical), "\",", horizontal, ",",
                      vertical, "]");
}

}  // namespace

GeoKeys ReadGeoKeys(std::span<const std::byte> directory) {
  const auto at = [&](size_t offset) {
    return LoadLittleEndian<uint16_t>(directory.subspan(offset, 2).data());
  };
  GeoKeys keys;
  int projected = 0;
  int geographic = 0;
  int length_unit = 0;
  // The first entry is the directory's own head.
  for (size_t i = 8; i + 8 <= directory.size(); i += 8) {
    const int key = at(i);
    const int value = at(i + 6);
    // Other values are in the other records; 0 is undefined.
    if (at(i + 2) != 0 || value == 0) continue;
    if (key == kModelKey) keys.model = value;
    if (key == kProjectedKey && projected == 0) projected = value;
    if (key == kGeographicKey) geographic = value;
    if (key == kLengthUnitKey) length_unit = value;
    if (key == kVerticalKey) keys.vertical = value;
  }
  // A projection of the file's own has the geographic system as its base.
  if (projected != 0 || keys.model == kProjectedModel) {
    keys.horizontal = projected;
    if (projected == 0 && geographic != 0) {
      keys.horizontal = GeoKeys::kUserDefined;
    }
  } else {
    keys.horizontal = geographic;
  }
  keys.unit = keys.model == kGeographicModel ? std::string(core::kDegree)
                                             : NameOfLengthUnit(length_unit);
  return keys;
}

GeoKeyCrs CrsOfGeoKeys(const GeoKeys& keys, const GeoKeyRecords& records) {
  if (keys.horizontal == 0) {
    const bool is_empty = keys.model == 0 && keys.vertical == 0;
    return {.text = "",
            .problem =
                is_empty ? "" : "its GeoTIFF keys have no horizontal system"};
  }
  const bool is_defined = keys.horizontal == GeoKeys::kUserDefined;
  const std::string name = absl::StrCat("EPSG:", keys.horizontal);
  std::string horizontal = name;
  if (is_defined) {
    absl::StatusOr<std::string> wkt = UserDefinedWkt(records);
    if (!wkt.ok()) {
      return {.text = "",
              .problem = absl::StrCat("its GeoTIFF keys define a system of "
                                      "their own, which is not understood: ",
                                      wkt.status().message())};
    }
    horizontal = *std::move(wkt);
  } else if (keys.model == kGeocentricModel) {
    // The code may be that of longitude and latitude.
    const absl::StatusOr<std::string> wkt = WktOfCrs(name);
    if (wkt.ok() && !wkt->starts_with("GEOCCS[")) {
      return {.text = "",
              .problem = absl::StrCat("its GeoTIFF keys say geocentric and ",
                                      name, ", which is not")};
    }
  }
  if (keys.vertical == 0) return {.text = horizontal, .problem = ""};
  const absl::StatusOr<std::string> heights =
      keys.vertical == GeoKeys::kUserDefined
          ? NotUnderstood("it is user-defined")
          : WktOfCrs(absl::StrCat("EPSG:", keys.vertical));
  if (heights.ok() ? !heights->starts_with("VERT_CS[")
                   : absl::IsNotFound(heights.status())) {
    return {.text = horizontal,
            .problem = absl::StrCat(
                "its VerticalCSTypeGeoKey ", keys.vertical,
                " is no vertical system that PROJ knows; the heights are left "
                "without one")};
  }
  return {.text = is_defined ? CompoundWkt(horizontal, *heights)
                             : absl::StrCat(name, "+", keys.vertical),
          .problem = ""};
}

}  // namespace mapsieve::client
