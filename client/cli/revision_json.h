#ifndef MAPSIEVE_CLIENT_CLI_REVISION_JSON_H_
#define MAPSIEVE_CLIENT_CLI_REVISION_JSON_H_

#include "client/api/map_types.h"
#include "client/cli/output.h"

namespace mapsieve::client {

/// A revision and what made it, without the members that do not apply to its
/// kind. Kinds have the names of the commands that make them.
Json RevisionJson(const RevisionInfo& revision);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_REVISION_JSON_H_
