#ifndef MAPSIEVE_SERVER_ENGINE_SYNC_REGION_H_
#define MAPSIEVE_SERVER_ENGINE_SYNC_REGION_H_

#include <memory>
#include <stop_token>

#include "absl/status/statusor.h"
#include "server/engine/memory_pool.h"
#include "server/engine/sync.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Engine::Sync. `memory` is what all queries may hold together; both
/// references outlive the cursor.
absl::StatusOr<std::unique_ptr<SyncCursor>> OpenSync(storage::Store& store,
                                                     MemoryPool& memory,
                                                     const SyncSpec& spec,
                                                     std::stop_token stop);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_SYNC_REGION_H_
