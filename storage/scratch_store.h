#ifndef MAPSIEVE_STORAGE_SCRATCH_STORE_H_
#define MAPSIEVE_STORAGE_SCRATCH_STORE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/file_system.h"
#include "storage/space_reserve.h"

namespace mapsieve::storage {

/// Bytes [begin, end) of a string.
struct ByteRange {
  int64_t begin = 0;
  int64_t end = 0;
};

/// Named byte strings on disk: what a job puts aside because it does not fit
/// memory. Never synced. Different names may be used from several threads at
/// once.
class Scratch {
 public:
  /// Makes the directory, empty, which is removed with the object. The
  /// references outlive the object.
  static absl::StatusOr<std::unique_ptr<Scratch>> Create(
      FileSystem& file_system, std::string directory,
      const SpaceReserve& reserve);
  /// A directory that stays, with what it holds; Clear makes it. After a crash
  /// of the process it holds what was written; after one of the system,
  /// anything.
  static std::unique_ptr<Scratch> OpenLasting(FileSystem& file_system,
                                              std::string directory,
                                              const SpaceReserve& reserve);
  ~Scratch();
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;

  /// Replaces what `name` (1 to 120 of a-z, 0-9 and -) holds.
  /// kInvalidArgument: the name; kResourceExhausted: disk full.
  absl::Status Write(const std::string& name, std::span<const std::byte> bytes);

  /// Adds to what `name` holds. Errors of Write.
  absl::Status Append(const std::string& name,
                      std::span<const std::byte> bytes);

  /// What was last written. kNotFound if nothing was.
  absl::StatusOr<std::vector<std::byte>> Read(const std::string& name) const;

  /// Writes `parts` of what was last written, ascending, to `room`, which is
  /// just as large. kNotFound if nothing was; kDataLoss: it is shorter.
  absl::Status ReadParts(const std::string& name,
                         std::span<const ByteRange> parts,
                         std::span<std::byte> room) const;

  /// Forgets what `name` holds; OK if nothing.
  absl::Status Remove(const std::string& name);
  /// Forgets everything, and makes the directory.
  absl::Status Clear();

 private:
  Scratch(FileSystem& file_system, std::string directory,
          const SpaceReserve& reserve, bool is_lasting);

  /// Room for a write of `size` bytes to the file `name`, whose name is
  /// checked.
  absl::StatusOr<SpaceReserve::Claim> RoomFor(const std::string& name,
                                              int64_t size) const;

  FileSystem& file_system_;
  const std::string directory_;
  const SpaceReserve& reserve_;
  const bool is_lasting_;
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SCRATCH_STORE_H_
