#ifndef MAPSIEVE_SERVER_ENGINE_MEMORY_POOL_H_
#define MAPSIEVE_SERVER_ENGINE_MEMORY_POOL_H_

#include <cstdint>
#include <string_view>

#include "absl/status/status.h"
#include "core/base/mutex.h"

namespace mapsieve::engine {

/// Bytes that several users share, by declaration: each says what it is about
/// to hold before it does. Thread-safe; outlives its reservations.
class MemoryPool {
 public:
  explicit MemoryPool(int64_t capacity_bytes) : capacity_(capacity_bytes) {}

 private:
  friend class Reservation;

  const int64_t capacity_;
  Mutex mutex_;
  int64_t reserved_ ABSL_GUARDED_BY(mutex_) = 0;
};

/// One user's part of a pool, given back when destroyed. Not thread-safe.
class Reservation {
 public:
  explicit Reservation(MemoryPool& pool) : pool_(pool) {}
  ~Reservation();
  Reservation(const Reservation&) = delete;
  Reservation& operator=(const Reservation&) = delete;

  /// Adds `bytes` (>= 0) to the reservation. kResourceExhausted, naming `what`
  /// they are for and the figures, if the pool does not have them; nothing is
  /// changed then.
  absl::Status Grow(int64_t bytes, std::string_view what);

 private:
  MemoryPool& pool_;
  int64_t bytes_ = 0;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_MEMORY_POOL_H_
