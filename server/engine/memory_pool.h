#ifndef MAPSIEVE_SERVER_ENGINE_MEMORY_POOL_H_
#define MAPSIEVE_SERVER_ENGINE_MEMORY_POOL_H_

#include <cstdint>
#include <stop_token>
#include <string_view>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "core/base/mutex.h"

namespace mapsieve::engine {

/// Bytes that several users share, by declaration: each says what it is about
/// to hold before it does. Thread-safe; outlives its reservations.
class MemoryPool {
 public:
  /// `max_wait`: how long users wait for one another.
  explicit MemoryPool(int64_t capacity_bytes,
                      absl::Duration max_wait = absl::ZeroDuration())
      : capacity_(capacity_bytes), max_wait_(max_wait) {}

 private:
  friend class Reservation;

  const int64_t capacity_;
  const absl::Duration max_wait_;
  Mutex mutex_;
  ConditionVariable given_back_;
  int64_t reserved_ ABSL_GUARDED_BY(mutex_) = 0;
};

/// One user's part of a pool, given back when destroyed. Not thread-safe.
class Reservation {
 public:
  explicit Reservation(MemoryPool& pool) : pool_(pool) {}
  ~Reservation();
  Reservation(const Reservation&) = delete;
  Reservation& operator=(const Reservation&) = delete;

  /// Adds `bytes` (>= 0) to the reservation. Waits until others have given back
  /// what is missing, as long as the pool says, if that can help and this holds
  /// nothing: so no two wait for each other. kResourceExhausted, naming `what`
  /// they are for and the figures, if the pool does not have them; kCancelled:
  /// `stop`. Nothing is changed then.
  absl::Status Grow(int64_t bytes, std::string_view what,
                    const std::stop_token& stop = {});

  /// Gives back `bytes` (0 to what it holds).
  void Shrink(int64_t bytes);

 private:
  absl::Status Exhausted(int64_t bytes, std::string_view what) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(pool_.mutex_);

  MemoryPool& pool_;
  int64_t bytes_ = 0;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_MEMORY_POOL_H_
