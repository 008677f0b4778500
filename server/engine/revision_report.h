#ifndef MAPSIEVE_SERVER_ENGINE_REVISION_REPORT_H_
#define MAPSIEVE_SERVER_ENGINE_REVISION_REPORT_H_

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "server/engine/types.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Tells what made a revision of the map `map_uid` and what it holds. Errors of
/// storage; kDataLoss: what the engine recorded with it is damaged.
absl::StatusOr<RevisionInfo> DescribeRevision(
    const storage::Catalogue& catalogue, const std::string& map_uid,
    const storage::RevisionRecord& revision);

/// A page of Engine::CompareRevisions. `max_count`: tiles looked at, at least
/// 1; `token`: RevisionComparison::tiles.next_page_token of the page before.
absl::StatusOr<RevisionComparison> CompareRevisions(
    storage::Store& store, const std::string& map_id, int64_t base,
    int64_t target, int64_t max_count, const std::string& token);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_REVISION_REPORT_H_
