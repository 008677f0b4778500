#ifndef MAPSIEVE_CLIENT_FORMATS_GEOTIFF_KEYS_H_
#define MAPSIEVE_CLIENT_FORMATS_GEOTIFF_KEYS_H_

#include <cstddef>
#include <span>
#include <string>
#include <vector>

/// The coordinate reference system of GeoTIFF keys (GeoTIFF 1.0 section 2.7,
/// OGC 19-008), which LAS holds in three records. Any bytes may be given; all
/// functions are thread-safe.
namespace mapsieve::client {

/// The records 34735, 34736 and 34737 of LAS.
struct GeoKeyRecords {
  std::vector<std::byte> directory;
  std::vector<std::byte> doubles;
  std::vector<std::byte> text;
};

/// What the directory says by itself.
struct GeoKeys {
  /// GTModelTypeGeoKey: 1 projected, 2 geographic, 3 geocentric; 0: none.
  int model = 0;
  /// Codes of EPSG, or kUserDefined; 0: none.
  int horizontal = 0;
  int vertical = 0;
  /// Of the horizontal coordinates, as PointFileInfo has it.
  std::string unit;

  static constexpr int kUserDefined = 32767;
};

GeoKeys ReadGeoKeys(std::span<const std::byte> directory);

/// What could be made of keys.
struct GeoKeyCrs {
  /// "EPSG:n", "EPSG:n+m" or, of user-defined keys, WKT; empty: nothing.
  std::string text;
  /// What the keys say of the system and `text` does not, and why, for people;
  /// empty: nothing.
  std::string problem;
};

/// Codes are taken as they are, but for vertical ones that PROJ does not know.
/// Of systems of the file's own those are understood that are geographic, or
/// projected by Transverse Mercator, Lambert conformal conic (of one or two
/// parallels) or Albers, with angles in degrees.
GeoKeyCrs CrsOfGeoKeys(const GeoKeys& keys, const GeoKeyRecords& records);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_GEOTIFF_KEYS_H_
