#ifndef MAPSIEVE_SERVER_ENGINE_REPAIR_MAP_H_
#define MAPSIEVE_SERVER_ENGINE_REPAIR_MAP_H_

#include <string>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "server/engine/process_map.h"
#include "server/engine/types.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Reads every chunk of all revisions of the map `map_id`, if its uid is still
/// `map_uid`, and makes damaged and missing chunks of products and histories
/// again: for each revision that has some, from the newest one on, the filter
/// runs over its raw points with its own options, and what has the id of a
/// damaged blob is stored. Makes no revision and touches no sound chunk;
/// queries may run beside it. What cannot be made again is in the report and no
/// error. Cost: reading the map, and a run of the filter for each such
/// revision. Memory, `io` and `context` as ProcessStoredMap; progress: chunks,
/// a run counting as many as the map has. kNotFound; kCancelled; kUnavailable;
/// kDataLoss: the catalogue is damaged.
absl::StatusOr<RepairReport> RepairStoredMap(storage::Store& store,
                                             const std::string& map_id,
                                             const std::string& map_uid,
                                             const ProcessLimits& limits,
                                             Executor& io,
                                             const ExecutionContext& context);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_REPAIR_MAP_H_
