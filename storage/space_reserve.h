#ifndef MAPSIEVE_STORAGE_SPACE_RESERVE_H_
#define MAPSIEVE_STORAGE_SPACE_RESERVE_H_

#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "storage/file_system.h"

namespace mapsieve::storage {

/// Space that uploads, blobs and scratch files leave free on the disk, so that
/// the catalogue can always record a deletion. Thread-safe.
class SpaceReserve {
 public:
  /// `directory`: any directory on the disk; `reserve_bytes` >= 0.
  SpaceReserve(FileSystem& file_system, std::string directory,
               int64_t reserve_bytes);

  /// kResourceExhausted if less than the reserve would be free after writing
  /// `bytes` more.
  absl::Status Check(int64_t bytes) const;

 private:
  FileSystem& file_system_;
  const std::string directory_;
  const int64_t reserve_bytes_;
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SPACE_RESERVE_H_
