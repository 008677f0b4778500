#ifndef MAPSIEVE_CLIENT_FORMATS_CSV_FILE_H_
#define MAPSIEVE_CLIENT_FORMATS_CSV_FILE_H_

#include <filesystem>
#include <memory>

#include "absl/status/statusor.h"
#include "client/formats/point_file.h"

namespace mapsieve::client {

/// Opens a text of one point a line, columns separated by semicolons, commas,
/// tabs or blanks, whichever its first line has, in this order.
///
/// Names come from options.column_names, else from the header line, which is a
/// first line that is not all numbers, else from a comment before the
/// first point that names x, y, z and as many columns; else they are x, y, z,
/// c3, c4, …. The position is x, y, z, in any case; every other column is a
/// float64 attribute, because the text declares no type and is not read ahead:
/// whole numbers beyond 2^53 lose digits. An empty field or "nan" is missing,
/// in a position NaN. Blank lines and lines that begin with "#" or "//" are
/// passed over; a separator at the end of a line is ignored.
///
/// kInvalidArgument: fewer than three columns, no x, y or z, a name twice, or
/// column_names of another count; kDataLoss: neither points nor names.
/// ReadBatch: kDataLoss with the line for a word that is not a number or a line
/// of another count.
absl::StatusOr<std::unique_ptr<PointReader>> OpenCsvFile(
    const std::filesystem::path& path, const ReadOptions& options = {});

/// Creates such a text: with commas and a header line if the extension is .csv,
/// else with blanks and the names in a comment. Positions have the decimals
/// that options.coordinate_step (>= 0) needs, at most 15, and where it is 0, or
/// not decimal, the shortest that read back the same; attributes always the
/// latter. Missing values are empty, or "nan" between blanks. In names, what
/// separates columns becomes "_".
///
/// kInvalidArgument: a step that is negative or not finite, an attribute named
/// x, y or z in any case, or two names that became the same.
absl::StatusOr<std::unique_ptr<PointWriter>> CreateCsvFile(
    const std::filesystem::path& path, const WriteOptions& options);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_CSV_FILE_H_
