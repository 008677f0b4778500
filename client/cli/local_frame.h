#ifndef MAPSIEVE_CLIENT_CLI_LOCAL_FRAME_H_
#define MAPSIEVE_CLIENT_CLI_LOCAL_FRAME_H_

#include "absl/status/status.h"
#include "client/api/map_types.h"
#include "client/formats/point_file.h"
#include "core/cloud/point_cloud.h"
#include "core/geometry/lattice.h"

/// Files of a map's points around an origin of their own, with float32
/// coordinates: many readers insist on these, and near the origin they are
/// exact enough.
namespace mapsieve::client {

/// Of a file around `origin`: its coordinates, and the map's CRS and frame if
/// the origin is the map's. The rest is default.
WriteOptions OptionsOfLocalFrame(const MapInfo& map,
                                 const core::Point3& origin);

/// Moves points of a map there. kInvalidArgument: float32 would move one of
/// them by more than a centimetre.
absl::Status MoveToLocalFrame(const core::Point3& origin,
                              core::PointCloud& points);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_LOCAL_FRAME_H_
