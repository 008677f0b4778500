#ifndef MAPSIEVE_STORAGE_SQLITE_DATABASE_H_
#define MAPSIEVE_STORAGE_SQLITE_DATABASE_H_

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <unordered_map>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "storage/file_system.h"
#include "storage/sqlite_vfs.h"

struct sqlite3;
struct sqlite3_stmt;

/// SQLite with our statuses, for the catalogue only.
namespace mapsieve::storage {

/// Largest value of an enumeration whose values are 1, 2, …; specialised
/// beside the tables that store it.
template <typename Enum>
inline constexpr int64_t kLargestEnumerator = 0;

class SqliteDatabase;

/// One run of a prepared statement: parameters are bound from the first to the
/// last, then rows are stepped through, then it is destroyed, which makes the
/// statement free for its next run. An error of a Bind or a Take is kept and
/// returned by the next Step, or by status().
class SqliteStatement {
 public:
  ~SqliteStatement();
  SqliteStatement(SqliteStatement&& other) noexcept;
  SqliteStatement& operator=(SqliteStatement&&) = delete;

  SqliteStatement& Bind(int64_t value);
  SqliteStatement& Bind(int value) { return Bind(int64_t{value}); }
  SqliteStatement& Bind(uint16_t value) { return Bind(int64_t{value}); }
  SqliteStatement& Bind(bool value) { return Bind(int64_t{value}); }
  SqliteStatement& Bind(absl::Time value) {
    return Bind(absl::ToUnixMicros(value));
  }
  template <typename Enum>
  requires std::is_enum_v<Enum> SqliteStatement& Bind(Enum value) {
    return Bind(static_cast<int64_t>(value));
  }
  SqliteStatement& Bind(const std::optional<int64_t>& value);
  /// Text. Not converted, so it may hold anything.
  SqliteStatement& Bind(std::string_view text);
  SqliteStatement& Bind(const std::string& text) {
    return Bind(std::string_view(text));
  }
  SqliteStatement& Bind(const char*) = delete;
  SqliteStatement& BindBlob(std::string_view bytes);
  SqliteStatement& BindNull();

  /// True: a row is there; false: no more.
  absl::StatusOr<bool> Step();
  /// Runs a statement that gives no rows.
  absl::Status Run();

  /// Takes the columns of the row from the first to the last. kDataLoss is
  /// kept if a value is not of the type, or not in its range.
  SqliteStatement& Take(int64_t& value);
  SqliteStatement& Take(bool& value);
  SqliteStatement& Take(int& value) { return TakeNarrow(value); }
  SqliteStatement& Take(uint16_t& value) { return TakeNarrow(value); }
  SqliteStatement& Take(absl::Time& value);
  template <typename Enum>
  requires std::is_enum_v<Enum> SqliteStatement& Take(Enum& value) {
    int64_t number = 0;
    Take(number);
    Check(number >= 1 && number <= kLargestEnumerator<Enum>,
          "is no enumerator");
    value = static_cast<Enum>(number);
    return *this;
  }
  SqliteStatement& Take(std::optional<int64_t>& value);
  SqliteStatement& Take(std::string& text);
  SqliteStatement& TakeBlob(std::string& bytes);
  /// Whether the next column is NULL; takes it if so.
  bool TakeNull();
  /// Takes a number of things, 0 to 2^62.
  SqliteStatement& TakeCount(int64_t& count);
  /// Keeps kDataLoss, naming the column taken last, if `condition` is false.
  void Check(bool condition, std::string_view what);

  /// The first error of a Bind, Take or Check.
  const absl::Status& status() const { return status_; }

 private:
  friend class SqliteDatabase;
  SqliteStatement(SqliteDatabase& database, sqlite3_stmt* statement)
      : database_(database), statement_(statement) {}

  template <typename T>
  SqliteStatement& TakeNarrow(T& value) {
    int64_t wide = 0;
    Take(wide);
    Check(wide >= std::numeric_limits<T>::min() &&
              wide <= std::numeric_limits<T>::max(),
          "is out of range");
    value = static_cast<T>(wide);
    return *this;
  }
  void KeepCode(int code);
  bool HasType(int type, const char* name);
  void TakeBytes(int type, const char* name, std::string& bytes);

  SqliteDatabase& database_;
  sqlite3_stmt* statement_;
  int next_parameter_ = 1;
  int next_column_ = 0;
  absl::Status status_;
};

/// A connection to a database file. Not thread-safe.
class SqliteDatabase {
 public:
  /// Opens `path`, which is made if absent, with checksums of its pages, a
  /// write-ahead log, full syncs, foreign keys, and no mapping of files into
  /// memory. `file_system` outlives the object.
  static absl::StatusOr<std::unique_ptr<SqliteDatabase>> Open(
      FileSystem& file_system, const std::string& path);
  /// Makes durable what the log of the database `path` holds, if there is one;
  /// no connection is open. A process that died may have written a commit and
  /// not synced it, and after a failed sync the system may even show bytes that
  /// it will never write: so all is written once more, and synced. kDataLoss,
  /// naming log and offset: committed transactions in it are damaged
  /// (CheckLog).
  static absl::Status SecureLog(FileSystem& file_system,
                                const std::string& path);

  ~SqliteDatabase();
  SqliteDatabase(const SqliteDatabase&) = delete;
  SqliteDatabase& operator=(const SqliteDatabase&) = delete;

  const std::string& path() const { return path_; }
  /// Whether every page carries a checksum that is compared when it is read.
  bool has_page_checksums() const { return vfs_->has_page_checksums(); }

  /// Runs statements that give no rows.
  absl::Status Execute(const std::string& sql);
  /// The one value of a query that gives one integer.
  absl::StatusOr<int64_t> QueryInteger(const std::string& sql);

  /// Makes a run of `sql`, which is prepared once and kept. One run of the same
  /// text exists at a time.
  absl::StatusOr<SqliteStatement> Prepare(const std::string& sql);

  /// Rows changed by the statement run last.
  int64_t changed_row_count() const;
  /// Number of the row inserted last.
  int64_t last_row_number() const;

 private:
  friend class SqliteStatement;
  friend class SqliteTransaction;
  SqliteDatabase(std::string path, std::unique_ptr<SqliteVfs> vfs,
                 sqlite3* handle)
      : path_(std::move(path)), vfs_(std::move(vfs)), handle_(handle) {}
  absl::Status UseWriteAheadLog();
  /// The status of SQLite's result `code`.
  absl::Status StatusOf(int code) const;

  const std::string path_;
  const std::unique_ptr<SqliteVfs> vfs_;
  sqlite3* const handle_;
  std::unordered_map<std::string, sqlite3_stmt*> statements_;
};

/// Undone when destroyed unless Commit succeeded.
class SqliteTransaction {
 public:
  enum class Kind { kRead, kWrite };

  explicit SqliteTransaction(SqliteDatabase& database) : database_(database) {}
  ~SqliteTransaction();
  SqliteTransaction(const SqliteTransaction&) = delete;
  SqliteTransaction& operator=(const SqliteTransaction&) = delete;

  absl::Status Begin(Kind kind);
  absl::Status Commit();

 private:
  SqliteDatabase& database_;
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_DATABASE_H_
