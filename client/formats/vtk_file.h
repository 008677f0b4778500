#ifndef MAPSIEVE_CLIENT_FORMATS_VTK_FILE_H_
#define MAPSIEVE_CLIENT_FORMATS_VTK_FILE_H_

#include <filesystem>
#include <memory>

#include "absl/status/statusor.h"
#include "client/formats/point_file.h"

namespace mapsieve::client {

/// Opens legacy ASCII VTK, as libpointmatcher writes it: a dataset POLYDATA or
/// UNSTRUCTURED_GRID, whose cells are passed over. The file is scanned once for
/// its sections, and then read at as many places at once as there are arrays,
/// so that memory is bounded by the batch.
///
/// Attributes are the arrays of POINT_DATA with their types ("long" is 64 bits,
/// "bit" a uint8): SCALARS and fields under their names, or NAME_0, NAME_1, …
/// where they have several components; NORMALS as nx, ny, nz; VECTORS as
/// NAME_x, NAME_y, NAME_z; COLOR_SCALARS of three or four components as float32
/// red, green, blue, alpha from 0 to 1; TENSORS and the rest as NAME_0, ….
///
/// kUnimplemented: binary files, other datasets, arrays of text; kDataLoss: a
/// section that is damaged, cut or unknown.
absl::StatusOr<std::unique_ptr<PointReader>> OpenVtkFile(
    const std::filesystem::path& path);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_VTK_FILE_H_
