#ifndef MAPSIEVE_SERVER_ENGINE_REGION_QUERY_H_
#define MAPSIEVE_SERVER_ENGINE_REGION_QUERY_H_

#include <cstdint>
#include <memory>
#include <stop_token>

#include "absl/status/statusor.h"
#include "server/engine/answer_columns.h"
#include "server/engine/memory_pool.h"
#include "server/engine/point_filter.h"
#include "server/engine/query.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Engine::Query. `memory` is what all queries may hold together; both
/// references outlive the cursor.
absl::StatusOr<std::unique_ptr<QueryCursor>> OpenQuery(storage::Store& store,
                                                       MemoryPool& memory,
                                                       const QuerySpec& spec,
                                                       std::stop_token stop);

/// The same for a checked `spec` without budget and resume token, over a pinned
/// revision that answers it (OpenRevision), for a caller that has reserved
/// AnswerBytes for the largest chunk that the region meets.
absl::StatusOr<std::unique_ptr<QueryCursor>> OpenQuery(
    std::shared_ptr<const storage::ReadSnapshot> snapshot,
    const QuerySpec& spec, std::stop_token stop);

/// Memory of an answer without a budget; `largest_chunk` in points.
int64_t AnswerBytes(const AnswerColumns& columns, const PointFilter& filter,
                    int64_t largest_chunk);

/// Pins the revision that answers `spec`. kNotFound; kFailedPrecondition: never
/// processed, and not `raw`; kOutOfRange: no such revision, it expired, or
/// nothing was processed up to it.
absl::StatusOr<std::shared_ptr<const storage::ReadSnapshot>> OpenRevision(
    storage::Store& store, const QuerySpec& spec);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_REGION_QUERY_H_
