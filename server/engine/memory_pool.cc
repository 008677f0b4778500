#include "server/engine/memory_pool.h"

#include "core/base/status.h"

namespace mapsieve::engine {

Reservation::~Reservation() {
  MutexLock lock(pool_.mutex_);
  pool_.reserved_ -= bytes_;
}

absl::Status Reservation::Grow(int64_t bytes, std::string_view what) {
  MutexLock lock(pool_.mutex_);
  const int64_t available = pool_.capacity_ - pool_.reserved_;
  if (bytes > available) {
    const int64_t others = pool_.reserved_ - bytes_;
    return absl::ResourceExhaustedError(absl::StrCat(
        ToAbsl(what), " needs ", bytes, " bytes beside the ", bytes_,
        " it holds, but ", available, " of ", pool_.capacity_,
        " bytes of memory are left, others holding ", others,
        others > 0 ? ": try again later, ask for less" : ": ask for less",
        " or give the server more memory"));
  }
  pool_.reserved_ += bytes;
  bytes_ += bytes;
  return absl::OkStatus();
}

}  // namespace mapsieve::engine
