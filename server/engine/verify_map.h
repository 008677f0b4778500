#ifndef MAPSIEVE_SERVER_ENGINE_VERIFY_MAP_H_
#define MAPSIEVE_SERVER_ENGINE_VERIFY_MAP_H_

#include <memory>
#include <stop_token>

#include "absl/status/statusor.h"
#include "server/engine/memory_pool.h"
#include "server/engine/verify.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Engine::Verify. `memory`: what tiles that are compared, and chunks that are
/// read, are taken from. The references outlive the cursor.
absl::StatusOr<std::unique_ptr<VerifyCursor>> OpenVerification(
    storage::Store& store, MemoryPool& memory, const VerifySpec& spec,
    std::stop_token stop);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_VERIFY_MAP_H_
