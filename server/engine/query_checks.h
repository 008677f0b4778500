#ifndef MAPSIEVE_SERVER_ENGINE_QUERY_CHECKS_H_
#define MAPSIEVE_SERVER_ENGINE_QUERY_CHECKS_H_

#include "absl/status/status.h"
#include "server/engine/query.h"

namespace mapsieve::engine {

/// What is wrong with `spec` on any map, its region aside: kInvalidArgument,
/// naming the field (FieldOf).
absl::Status CheckSpec(const QuerySpec& spec);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_QUERY_CHECKS_H_
