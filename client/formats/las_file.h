#ifndef MAPSIEVE_CLIENT_FORMATS_LAS_FILE_H_
#define MAPSIEVE_CLIENT_FORMATS_LAS_FILE_H_

#include <filesystem>
#include <memory>

#include "absl/status/statusor.h"
#include "client/formats/point_file.h"

namespace mapsieve::client {

/// Opens LAS 1.0 to 1.4, point formats 0 to 10, uncompressed.
///
/// Attributes are all fields of the point format, under the names intensity,
/// return_number, number_of_returns, scan_direction, edge_of_flight_line,
/// classification, synthetic, key_point, withheld, overlap, scanner_channel,
/// scan_angle_rank (formats 0 to 5, int8, degrees), scan_angle (formats 6 to
/// 10, int16, 0.006 degrees), user_data, point_source_id, gps_time, red, green,
/// blue, nir, wave_*; then the extra bytes under their own names:
/// * with a scale or an offset they are float64 in real units, else they keep
///   their type; the value that stands for "no data" is missing;
/// * two or three values in one (types 11 to 30) become NAME_0, NAME_1, NAME_2;
/// * bytes that nothing describes become uint8 columns: NAME_0, … or extra_0, …
///   All are such bytes where the description is longer than the record;
/// * the name of a standard field becomes extra_NAME.
/// The CRS is the WKT record, else what CrsOfGeoKeys makes of the GeoTIFF keys;
/// the WKT that libLAS left stands for keys that define a system of their own,
/// and for none. The unit is that of the WKT, else of the keys, else of their
/// code. Variable length records beyond the damaged or impossible end of their
/// area are passed over, for the points do not depend on them.
///
/// kUnimplemented: compressed points (LAZ), another version or point format;
/// kDataLoss: a damaged header, or a file too short for the points declared.
absl::StatusOr<std::unique_ptr<PointReader>> OpenLasFile(
    const std::filesystem::path& path);

/// Creates LAS 1.4, point format 6, 7 (with red, green or blue) or 8 (with
/// nir), at the scale of options.coordinate_step (> 0).
///
/// An attribute with the name of a field of the format goes there if every
/// value of its type fits the field's type; so a narrower integer comes back
/// wider. Fields of less than 8 bits take uint8, and Write refuses values
/// beyond them with kInvalidArgument. All other attributes go to extra bytes,
/// with their type, and come back under their name, even that of a field.
/// Missing values are 0 in integers; in extra bytes of floating point they are
/// NaN, marked as "no data", and come back missing. Without the attributes,
/// points are the single return of their pulse.
/// The offset is options.origin, or where that is (0, 0, 0) the middle of the
/// first batch. The CRS is written as WKT: codes as PROJ has them, or as they
/// are if it does not know them; any other text as it is.
///
/// Write: kInvalidArgument for a coordinate that is not finite or beyond int32
/// at this scale, naming one that would do. Create: kInvalidArgument for a name
/// longer than 32 bytes, more than 341 extra attributes, a CRS over 65535
/// bytes, a step that is not positive. kFailedPrecondition: a CRS of codes, and
/// no database of PROJ.
absl::StatusOr<std::unique_ptr<PointWriter>> CreateLasFile(
    const std::filesystem::path& path, const WriteOptions& options);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_LAS_FILE_H_
