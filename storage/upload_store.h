#ifndef MAPSIEVE_STORAGE_UPLOAD_STORE_H_
#define MAPSIEVE_STORAGE_UPLOAD_STORE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/mutex.h"
#include "storage/catalogue.h"
#include "storage/file_system.h"
#include "storage/space_reserve.h"

namespace mapsieve::storage {

class UploadStore;

/// Appends to the staged bytes of one upload. One writer of an upload exists
/// at a time. Not thread-safe.
///
/// What is durable when: Append hands bytes to the system, and a crash may
/// lose them. Commit makes all that was appended durable and then records
/// their count in the catalogue; only the count that Commit returned may be
/// acknowledged to a client. After a crash the upload has exactly the bytes of
/// the last recorded count: what the file holds beyond it is cut when the next
/// writer opens it.
class UploadWriter {
 public:
  ~UploadWriter();
  UploadWriter(const UploadWriter&) = delete;
  UploadWriter& operator=(const UploadWriter&) = delete;

  /// Bytes appended, durable or not: where the next ones go.
  int64_t written_bytes() const { return written_bytes_; }
  /// Bytes that are durable and recorded.
  int64_t committed_bytes() const { return committed_bytes_; }

  /// Appends `bytes`, which begin at `offset` of the upload. Bytes below
  /// written_bytes() are dropped as a repeat. After an error written_bytes()
  /// is what it was, and the call may be repeated.
  /// kOutOfRange: a gap, `offset` > written_bytes(), or an end beyond the
  /// size that the upload declared; kInvalidArgument: `offset` < 0;
  /// kResourceExhausted: disk full.
  absl::Status Append(int64_t offset, std::span<const std::byte> bytes);

  /// Makes all appended bytes durable and returns their count, which is then
  /// committed_bytes(). After kUnavailable the writer is of no use; a new one
  /// starts from committed_bytes(). kNotFound: the upload was deleted;
  /// kFailedPrecondition: it is not kActive any more.
  absl::StatusOr<int64_t> Commit();

 private:
  friend class UploadStore;
  UploadWriter(UploadStore& store, const UploadRecord& record,
               std::unique_ptr<File> file);

  UploadStore& store_;
  const UploadRecord record_;
  std::unique_ptr<File> file_;
  int64_t written_bytes_;
  int64_t committed_bytes_;
};

/// Reads the committed bytes of an upload. Thread-safe.
class UploadReader {
 public:
  UploadReader(const UploadReader&) = delete;
  UploadReader& operator=(const UploadReader&) = delete;

  /// committed_bytes of the upload when the reader was opened.
  int64_t size() const { return size_; }

  /// The `size` bytes at `offset`. kOutOfRange: not inside [0, size()];
  /// kDataLoss: the file has lost them.
  absl::StatusOr<std::vector<std::byte>> Read(int64_t offset,
                                              int64_t size) const;

 private:
  friend class UploadStore;
  UploadReader(std::string path, std::unique_ptr<File> file, int64_t size);

  const std::string path_;
  const std::unique_ptr<File> file_;
  const int64_t size_;
};

/// The staged bytes of uploads: one append-only file each, named by its uid.
/// Thread-safe; outlives its writers and readers.
class UploadStore {
 public:
  /// The directory is made if absent. The references outlive the store.
  static absl::StatusOr<std::unique_ptr<UploadStore>> Open(
      FileSystem& file_system, std::string directory, Catalogue& catalogue,
      const SpaceReserve& reserve);

  /// Goes on with an upload at its committed_bytes. kNotFound;
  /// kFailedPrecondition: the upload is not kActive; kAborted: another writer
  /// has it; kDataLoss: its file is shorter than what was committed.
  absl::StatusOr<std::unique_ptr<UploadWriter>> OpenWriter(
      const std::string& upload_uid);

  /// kNotFound: the upload, or its bytes were removed; kDataLoss as above.
  absl::StatusOr<std::unique_ptr<UploadReader>> OpenReader(
      const std::string& upload_uid) const;

  /// Removes the bytes of an upload whose points are in the map or that was
  /// deleted; OK if there are none.
  absl::Status Remove(const std::string& upload_uid);

  /// Removes files of uploads that are finalized or that the catalogue does not
  /// know; returns how many.
  absl::StatusOr<int64_t> RemoveOrphans();

 private:
  friend class UploadWriter;
  UploadStore(FileSystem& file_system, std::string directory,
              Catalogue& catalogue, const SpaceReserve& reserve);
  std::string PathOf(const std::string& upload_uid) const;
  absl::StatusOr<std::unique_ptr<UploadWriter>> OpenFile(
      const std::string& upload_uid);
  void ReleaseWriter(const std::string& upload_uid);

  FileSystem& file_system_;
  const std::string directory_;
  Catalogue& catalogue_;
  const SpaceReserve& reserve_;
  Mutex mutex_;
  std::set<std::string> writing_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_UPLOAD_STORE_H_
