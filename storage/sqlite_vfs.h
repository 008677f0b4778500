#ifndef MAPSIEVE_STORAGE_SQLITE_VFS_H_
#define MAPSIEVE_STORAGE_SQLITE_VFS_H_

#include <memory>

#include "absl/status/status.h"
#include "storage/file_system.h"

/// How SQLite reaches its files: through storage::FileSystem, as the rest of
/// storage does.
namespace mapsieve::storage {

/// The operating system of one connection to a database: the database, its log
/// and its journal are Files of a FileSystem. Locks between connections and
/// processes, the log's index (shared memory) and temporary files without a
/// name, none of which outlives the process, are those of SQLite's own
/// implementation for this system. No file is mapped into memory but that
/// index. Used by one thread at a time, as the connection is.
///
/// * The first sync of a file that may be new is followed by one of its
///   directory.
/// * After a failed sync of the log it is opened anew for the next write:
///   SQLite writes all that was not synced once more. The database file stays
///   unsyncable until the connection is closed: the log keeps what it lacks.
/// * Pages of a database that has checksums get theirs when they are written,
///   to the database or to its log, and are compared with them when they are
///   read: a page that is not what was written is kDataLoss, naming file,
///   offset, expected and actual.
class SqliteVfs {
 public:
  /// `file_system` outlives the object. The object outlives the connection.
  explicit SqliteVfs(FileSystem& file_system);
  ~SqliteVfs();
  SqliteVfs(const SqliteVfs&) = delete;
  SqliteVfs& operator=(const SqliteVfs&) = delete;

  /// Name to open a connection with. Null if SQLite has no memory for it.
  const char* name() const;

  /// The error of the operation that failed last; OK if it was one of SQLite's
  /// own implementation.
  const absl::Status& last_failure() const;

  /// Whether the pages of the connection's own database carry checksums
  /// (HasPageChecksums); false before it is open.
  bool has_page_checksums() const;

 private:
  class Impl;
  const std::unique_ptr<Impl> impl_;
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_VFS_H_
