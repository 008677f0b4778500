#ifndef MAPSIEVE_SERVER_ENGINE_UPLOAD_WARNINGS_H_
#define MAPSIEVE_SERVER_ENGINE_UPLOAD_WARNINGS_H_

#include <vector>

#include "server/engine/types.h"
#include "storage/records.h"

namespace mapsieve::engine {

/// What may be wrong with points of `source` in a map made with `map`, which
/// `has_points` or takes the CRS and the frame id of `source` where it has
/// none. Codes, in this order:
/// * crs_differs: another CRS than the map's. They are compared by EPSG code or
///   else as texts, so one system may seem two;
/// * crs_not_taken: a CRS, where the map has points and no CRS;
/// * unit_not_metre: another unit than metres;
/// * step_too_coarse: a finer step than the map's;
/// * frame_id_differs, frame_id_not_taken: as those of the CRS.
std::vector<UploadWarning> WarningsOf(const UploadSource& source,
                                      const storage::MapSpec& map,
                                      bool has_points);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_UPLOAD_WARNINGS_H_
