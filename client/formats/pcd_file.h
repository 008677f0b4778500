#ifndef MAPSIEVE_CLIENT_FORMATS_PCD_FILE_H_
#define MAPSIEVE_CLIENT_FORMATS_PCD_FILE_H_

#include <filesystem>
#include <memory>

#include "absl/status/statusor.h"
#include "client/formats/point_file.h"

namespace mapsieve::client {

/// Opens a PCD file of version .4 to .7: ascii (values between blanks or
/// commas), binary or binary_compressed.
///
/// Fields of TYPE I and U with SIZE 1, 2, 4 or 8 and F with 4 or 8 keep their
/// type; a field of COUNT n > 1 gives the attributes NAME_0 to NAME_(n-1);
/// fields named "_" are padding. Bit patterns survive, so that a colour packed
/// in a float comes through. Organised clouds are read in row order. VIEWPOINT
/// is the pose of the sensor, not of the points: it is not applied and not
/// kept. What follows the declared points is ignored.
///
/// The payload of binary_compressed is one block of columns: the first
/// ReadBatch decompresses it whole and the reader holds it (as many bytes as
/// the binary form) until destroyed. Sizes that the file cannot hold are
/// refused before anything is allocated.
///
/// Errors besides those of InputFile::Open: kInvalidArgument: no x, y or z, x y
/// z in one field, a type that PCD does not have; kUnimplemented: another
/// version; kDataLoss: a damaged header, or fewer bytes than declared.
absl::StatusOr<std::unique_ptr<PointReader>> OpenPcdFile(
    const std::filesystem::path& path);

/// Creates a PCD 0.7 binary file: x y z as 8-byte floats, then the attributes
/// in the order and with the types of `options`. Blanks in names become "_".
/// kInvalidArgument: an attribute named x, y, z or "_", or two of one name.
absl::StatusOr<std::unique_ptr<PointWriter>> CreatePcdFile(
    const std::filesystem::path& path, const WriteOptions& options);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_PCD_FILE_H_
