#ifndef MAPSIEVE_STORAGE_SPACE_RESERVE_H_
#define MAPSIEVE_STORAGE_SPACE_RESERVE_H_

#include <atomic>
#include <cstdint>
#include <string>
#include <utility>

#include "absl/status/statusor.h"
#include "storage/file_system.h"

namespace mapsieve::storage {

/// Space that uploads, blobs, scratch files and commits leave free on the disk,
/// so that the catalogue can always record a deletion. Thread-safe.
class SpaceReserve {
 public:
  /// Room for what is being written, which nobody else gets meanwhile. Must not
  /// outlive its reserve.
  class Claim {
   public:
    Claim(Claim&& other) noexcept
        : reserve_(other.reserve_), bytes_(std::exchange(other.bytes_, 0)) {}
    Claim& operator=(Claim&&) = delete;
    ~Claim() { reserve_.claimed_ -= bytes_; }

   private:
    friend class SpaceReserve;
    Claim(const SpaceReserve& reserve, int64_t bytes)
        : reserve_(reserve), bytes_(bytes) {
      reserve_.claimed_ += bytes_;
    }

    const SpaceReserve& reserve_;
    int64_t bytes_;
  };

  /// `directory`: any directory on the disk; `reserve_bytes` >= 0.
  SpaceReserve(FileSystem& file_system, std::string directory,
               int64_t reserve_bytes);

  /// Room to write `bytes` (>= 0) more. kResourceExhausted if less than the
  /// reserve would be free after that, and after what others have room for.
  absl::StatusOr<Claim> Take(int64_t bytes) const;

 private:
  FileSystem& file_system_;
  const std::string directory_;
  const int64_t reserve_bytes_;
  mutable std::atomic<int64_t> claimed_ = 0;
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SPACE_RESERVE_H_
