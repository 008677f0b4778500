#ifndef MAPSIEVE_CORE_GEOMETRY_CRS_H_
#define MAPSIEVE_CORE_GEOMETRY_CRS_H_

#include <string>
#include <string_view>

/// What can be read from texts that name coordinate reference systems, which
/// are WKT (OGC 01-009, OGC 18-010), "EPSG:n", or "EPSG:n+m" of a horizontal
/// and a vertical system. Of a compound system all is that of its horizontal
/// part, unless it says otherwise. Any text may be given; all functions are
/// thread-safe.
namespace mapsieve::core {

/// Names of units, as the functions here and the readers of files give them.
inline constexpr std::string_view kMetre = "metre";
inline constexpr std::string_view kFoot = "foot";
inline constexpr std::string_view kUsSurveyFoot = "US survey foot";
inline constexpr std::string_view kDegree = "degree";

/// n of "EPSG:n" and "EPSG:n+m", n and m 1 to 32766; 0 for any other text.
int ParseEpsgName(std::string_view text);

/// The EPSG code that a name of codes gives or a WKT bears; 0: none.
int EpsgCodeOf(std::string_view crs);

/// The EPSG code of the vertical part of a compound system; 0: none.
int VerticalEpsgCodeOf(std::string_view crs);

/// The unit of the coordinates by a WKT: one of the names above, or else the
/// name there. Empty: it does not tell, or `crs` is no WKT.
std::string UnitOfCrs(std::string_view crs);

/// The name that a WKT gives the system; any other text itself.
std::string NameOfCrs(std::string_view crs);

/// Whether both name one system: by EPSG code where both have one, else by the
/// same text but for blanks between its parts. By code, vertical parts count
/// where both have the code of one.
bool IsSameCrs(std::string_view a, std::string_view b);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_CRS_H_
