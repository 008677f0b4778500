#ifndef MAPSIEVE_CLIENT_FORMATS_PLY_FILE_H_
#define MAPSIEVE_CLIENT_FORMATS_PLY_FILE_H_

#include <filesystem>
#include <memory>

#include "absl/status/statusor.h"
#include "client/formats/point_file.h"

namespace mapsieve::client {

/// Opens a PLY 1.0 file: ascii, binary_little_endian or binary_big_endian. The
/// points are the element "vertex"; its properties keep their types, in any
/// order. Its list properties and all other elements, before it (passed over
/// here, in time linear in their size) and after it, are skipped. A file
/// without an element "vertex" has no points, and no attributes.
///
/// Errors besides those of InputFile::Open: kInvalidArgument: no x, y or z, a
/// type or a version that PLY does not have; kDataLoss: a damaged header, or
/// fewer bytes than declared.
absl::StatusOr<std::unique_ptr<PointReader>> OpenPlyFile(
    const std::filesystem::path& path);

/// Creates a PLY file, binary little-endian: x y z as double, then the
/// attributes in the order and with the types of `options`. PLY has no 64-bit
/// integers: int64 and uint64 are written as double, and Write refuses a value
/// that double does not hold. Blanks in names become "_". kInvalidArgument: an
/// attribute named x, y or z, or two of one name.
absl::StatusOr<std::unique_ptr<PointWriter>> CreatePlyFile(
    const std::filesystem::path& path, const WriteOptions& options);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_PLY_FILE_H_
