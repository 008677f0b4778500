#include "server/engine/memory_pool.h"

#include <chrono>
#include <condition_variable>

#include "core/base/status.h"

namespace mapsieve::engine {

Reservation::~Reservation() { Shrink(bytes_); }

absl::Status Reservation::Grow(int64_t bytes, std::string_view what,
                               const std::stop_token& stop) {
  const auto deadline = std::chrono::steady_clock::now() +
                        absl::ToChronoNanoseconds(pool_.max_wait_);
  const std::stop_callback wake(stop, [this] {
    MutexLock lock(pool_.mutex_);
    pool_.given_back_.notify_all();
  });
  MutexLock lock(pool_.mutex_);
  bool may_wait = bytes_ == 0 && bytes <= pool_.capacity_;
  while (bytes > pool_.capacity_ - pool_.reserved_) {
    if (stop.stop_requested()) return absl::CancelledError("cancelled");
    if (!may_wait) return Exhausted(bytes, what);
    may_wait = pool_.given_back_.wait_until(pool_.mutex_, deadline) !=
               std::cv_status::timeout;
  }
  pool_.reserved_ += bytes;
  bytes_ += bytes;
  return absl::OkStatus();
}

void Reservation::Shrink(int64_t bytes) {
  {
    MutexLock lock(pool_.mutex_);
    pool_.reserved_ -= bytes;
    bytes_ -= bytes;
  }
  pool_.given_back_.notify_all();
}

absl::Status Reservation::Exhausted(int64_t bytes,
                                    std::string_view what) const {
  const int64_t others = pool_.reserved_ - bytes_;
  return absl::ResourceExhaustedError(absl::StrCat(
      ToAbsl(what), " needs ", bytes, " bytes beside the ", bytes_,
      " it holds, but ", pool_.capacity_ - pool_.reserved_, " of ",
      pool_.capacity_, " bytes of memory are left, others holding ", others,
      others > 0 ? ": try again later, ask for less" : ": ask for less",
      " or give the server more memory"));
}

}  // namespace mapsieve::engine
