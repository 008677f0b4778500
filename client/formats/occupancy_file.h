#ifndef MAPSIEVE_CLIENT_FORMATS_OCCUPANCY_FILE_H_
#define MAPSIEVE_CLIENT_FORMATS_OCCUPANCY_FILE_H_

#include <filesystem>
#include <memory>

#include "absl/status/statusor.h"
#include "client/formats/point_file.h"
#include "core/cloud/point_cloud.h"

namespace mapsieve::client {

struct OccupancyOptions {
  /// Edge of a voxel in units of the points; finite, above 0.
  double voxel_edge = 0.1;
  /// Becomes the origin of the file, which reaches 2^15 voxels from there on
  /// each side of every axis.
  core::Point3 origin;
};

/// Creates an OctoMap octree (https://octomap.github.io) of the points that are
/// written to it: a voxel that holds any is occupied, for certain; of the
/// others nothing is known, as no ray was cast. Attributes are left out. The
/// extension says which of OctoMap's files: .bt, two bits a voxel, or .ot, with
/// log-odds. The tree is in memory until Finish, about 50 bytes a voxel.
///
/// kInvalidArgument: another extension, or the options. Write:
/// kInvalidArgument: a point beyond the file's reach.
absl::StatusOr<std::unique_ptr<PointWriter>> CreateOccupancyFile(
    const std::filesystem::path& path, const OccupancyOptions& options);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_OCCUPANCY_FILE_H_
