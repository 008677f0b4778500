#ifndef MAPSIEVE_STORAGE_FILE_SYSTEM_H_
#define MAPSIEVE_STORAGE_FILE_SYSTEM_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

/// The operating system as storage sees it: everything durable goes through
/// this interface, so that tests can fail, delay or forget any operation.
///
/// Errors, with operation and path in the message:
/// * kNotFound: the file or a directory of its path does not exist;
/// * kAlreadyExists: OpenMode::kCreateNew on an existing path;
/// * kResourceExhausted: the disk or a quota is full, too many files are open;
/// * kPermissionDenied: rights, or a read-only file system;
/// * kUnavailable: the device failed (EIO); what was asked may or may not have
///   happened, and a retry may succeed;
/// * kFailedPrecondition: a directory where a file is wanted, or the reverse;
/// * kInternal: anything else.
namespace mapsieve::storage {

/// An open file. ReadAt may be called from several threads at once and beside
/// one writer; the other calls need external ordering. Closed when destroyed,
/// without being synced.
class File {
 public:
  virtual ~File() = default;

  /// Reads up to `buffer.size()` bytes at `offset` >= 0; fewer only at the end
  /// of the file. Returns how many.
  virtual absl::StatusOr<size_t> ReadAt(int64_t offset,
                                        std::span<std::byte> buffer) const = 0;

  /// Writes all of `bytes` at `offset` >= 0, beyond the end too (the gap reads
  /// as zeros). After an error any part of them may have been written.
  virtual absl::Status WriteAt(int64_t offset,
                               std::span<const std::byte> bytes) = 0;

  /// Cuts or extends (with zeros) the file.
  virtual absl::Status Truncate(int64_t size) = 0;

  /// Returns when content and size are on the medium. After a failed Sync
  /// nothing written since the last good one may be relied on, and every later
  /// Sync of this File fails too: a retry would claim what the system has
  /// already thrown away.
  virtual absl::Status Sync() = 0;

  virtual absl::StatusOr<int64_t> Size() const = 0;
};

/// Held by one opener at a time, across processes and inside one; released
/// when destroyed or when the process dies.
class FileLock {
 public:
  virtual ~FileLock() = default;
};

enum class OpenMode {
  /// Must exist.
  kRead,
  /// For reading and writing; must exist.
  kReadWrite,
  /// For reading and writing; must not exist.
  kCreateNew,
  /// For reading and writing; created empty if it does not exist.
  kCreateIfAbsent,
};

/// Thread-safe. Paths are UTF-8 and may be relative.
///
/// Entries of a directory (a new file, a rename, a removal) are durable only
/// after SyncDirectory of that directory; content is durable only after
/// File::Sync.
class FileSystem {
 public:
  virtual ~FileSystem() = default;

  virtual absl::StatusOr<std::unique_ptr<File>> Open(const std::string& path,
                                                     OpenMode mode) = 0;

  /// Gives `from` the name `to`, atomically replacing a file of that name.
  virtual absl::Status Rename(const std::string& from,
                              const std::string& to) = 0;

  /// Removes a file. kNotFound if there is none.
  virtual absl::Status Remove(const std::string& path) = 0;

  /// Removes a directory with all that is in it; OK if there is none.
  virtual absl::Status RemoveTree(const std::string& path) = 0;

  /// Makes a directory and those above it; OK where they exist. The new
  /// entries are durable when it returns.
  virtual absl::Status MakeDirectories(const std::string& path) = 0;

  /// Names of the entries of a directory without "." and "..", sorted.
  virtual absl::StatusOr<std::vector<std::string>> List(
      const std::string& directory) = 0;

  /// Makes the entries of a directory durable.
  virtual absl::Status SyncDirectory(const std::string& directory) = 0;

  /// Whether anything has this name.
  virtual absl::StatusOr<bool> Exists(const std::string& path) = 0;

  /// Bytes of a file.
  virtual absl::StatusOr<int64_t> FileSize(const std::string& path) = 0;

  /// Bytes that can still be written to the file system that holds `path`.
  virtual absl::StatusOr<int64_t> FreeBytes(const std::string& path) = 0;

  /// Locks the file `path`, which is created if absent and then holds the
  /// process id of its owner. Does not wait: kAborted while another opener
  /// holds it, naming its process id.
  virtual absl::StatusOr<std::unique_ptr<FileLock>> Lock(
      const std::string& path) = 0;
};

/// The file system of the operating system.
FileSystem& PosixFileSystem();

/// `directory`/`name`.
std::string JoinPath(const std::string& directory, const std::string& name);

/// Fills `room` with the bytes at `offset`. kDataLoss if the file ends before
/// that, naming `path`, the offset, expected and actual.
absl::Status ReadExactly(const File& file, const std::string& path,
                         int64_t offset, std::span<std::byte> room);

/// All `size` bytes at `offset`, as the other ReadExactly. The caller has
/// checked `size` against a limit of its own.
absl::StatusOr<std::vector<std::byte>> ReadExactly(const File& file,
                                                   const std::string& path,
                                                   int64_t offset,
                                                   int64_t size);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_FILE_SYSTEM_H_
