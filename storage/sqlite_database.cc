#include "storage/sqlite_database.h"

#include <sqlite3.h>

#include <algorithm>
#include <cerrno>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "storage/sqlite_format.h"

namespace mapsieve::storage {
namespace {

// Values and statements longer than this are refused.
constexpr int kMaxValueBytes = 64 << 20;
// Only another program that looks into the file can make us wait.
constexpr int kBusyTimeoutMs = 10'000;

// A log is read and written in pieces of this size.
constexpr int64_t kLogPieceBytes = 1 << 20;

bool IsDiskFull(int code, int system_error) {
  return code == SQLITE_FULL || code == SQLITE_IOERR_SHMSIZE ||
         ((code & 0xff) == SQLITE_IOERR &&
          (system_error == ENOSPC || system_error == EDQUOT));
}

// Whether SQLite passes on an error of a file.
bool IsOfFiles(int code) {
  const int kind = code & 0xff;
  return kind == SQLITE_IOERR || kind == SQLITE_CANTOPEN || kind == SQLITE_FULL;
}

}  // namespace

SqliteStatement::SqliteStatement(SqliteStatement&& other) noexcept
    : database_(other.database_),
      statement_(std::exchange(other.statement_, nullptr)),
      next_parameter_(other.next_parameter_),
      next_column_(other.next_column_),
      status_(std::move(other.status_)) {}

SqliteStatement::~SqliteStatement() {
  if (statement_ == nullptr) return;
  // Repeats the error of the last Step, which was returned there.
  sqlite3_reset(statement_);
  sqlite3_clear_bindings(statement_);
}

void SqliteStatement::KeepCode(int code) {
  if (code != SQLITE_OK) status_.Update(database_.StatusOf(code));
}

SqliteStatement& SqliteStatement::Bind(int64_t value) {
  KeepCode(sqlite3_bind_int64(statement_, next_parameter_++, value));
  return *this;
}

SqliteStatement& SqliteStatement::Bind(const std::optional<int64_t>& value) {
  return value.has_value() ? Bind(*value) : BindNull();
}

SqliteStatement& SqliteStatement::Bind(std::string_view text) {
  KeepCode(sqlite3_bind_text64(statement_, next_parameter_++, text.data(),
                               text.size(), SQLITE_TRANSIENT, SQLITE_UTF8));
  return *this;
}

SqliteStatement& SqliteStatement::BindBlob(std::string_view bytes) {
  // A null pointer would bind NULL.
  const char* data = bytes.empty() ? "" : bytes.data();
  KeepCode(sqlite3_bind_blob64(statement_, next_parameter_++, data,
                               bytes.size(), SQLITE_TRANSIENT));
  return *this;
}

SqliteStatement& SqliteStatement::BindNull() {
  KeepCode(sqlite3_bind_null(statement_, next_parameter_++));
  return *this;
}

absl::StatusOr<bool> SqliteStatement::Step() {
  MAPSIEVE_RETURN_IF_ERROR(status_);
  next_column_ = 0;
  const int code = sqlite3_step(statement_);
  if (code == SQLITE_ROW) return true;
  if (code == SQLITE_DONE) return false;
  return database_.StatusOf(code);
}

absl::Status SqliteStatement::Run() {
  MAPSIEVE_ASSIGN_OR_RETURN(const bool row, Step());
  if (!row) return absl::OkStatus();
  return absl::InternalError(absl::StrCat(
      database_.path(), ": unexpected row of ", sqlite3_sql(statement_)));
}

void SqliteStatement::Check(bool condition, std::string_view what) {
  if (condition || !status_.ok()) return;
  const int column = next_column_ - 1;
  const char* name = sqlite3_column_name(statement_, column);
  status_ = absl::DataLossError(
      absl::StrCat(database_.path(), ": damaged: column ", column, " (",
                   name == nullptr ? "?" : name, ") ", ToAbsl(what), " in ",
                   sqlite3_sql(statement_)));
}

bool SqliteStatement::HasType(int type, const char* name) {
  const bool has = sqlite3_column_type(statement_, next_column_++) == type;
  if (!has) Check(false, absl::StrCat("is no ", name));
  return has;
}

SqliteStatement& SqliteStatement::Take(int64_t& value) {
  if (HasType(SQLITE_INTEGER, "integer")) {
    value = sqlite3_column_int64(statement_, next_column_ - 1);
  }
  return *this;
}

SqliteStatement& SqliteStatement::TakeCount(int64_t& count) {
  Take(count);
  Check(count >= 0 && count <= int64_t{1} << 62, "is no count");
  return *this;
}

SqliteStatement& SqliteStatement::Take(bool& value) {
  int64_t number = 0;
  Take(number);
  Check(number == 0 || number == 1, "is neither 0 nor 1");
  value = number != 0;
  return *this;
}

SqliteStatement& SqliteStatement::Take(absl::Time& value) {
  int64_t micros = 0;
  Take(micros);
  value = absl::FromUnixMicros(micros);
  return *this;
}

bool SqliteStatement::TakeNull() {
  if (sqlite3_column_type(statement_, next_column_) != SQLITE_NULL) {
    return false;
  }
  ++next_column_;
  return true;
}

SqliteStatement& SqliteStatement::Take(std::optional<int64_t>& value) {
  if (TakeNull()) {
    value.reset();
    return *this;
  }
  return Take(value.emplace());
}

void SqliteStatement::TakeBytes(int type, const char* name,
                                std::string& bytes) {
  if (!HasType(type, name)) return;
  const int column = next_column_ - 1;
  const void* data = sqlite3_column_blob(statement_, column);
  const int size = sqlite3_column_bytes(statement_, column);
  if (data == nullptr && size != 0) return KeepCode(SQLITE_NOMEM);
  bytes.assign(static_cast<const char*>(data), static_cast<size_t>(size));
}

SqliteStatement& SqliteStatement::Take(std::string& text) {
  TakeBytes(SQLITE_TEXT, "text", text);
  return *this;
}

SqliteStatement& SqliteStatement::TakeBlob(std::string& bytes) {
  TakeBytes(SQLITE_BLOB, "blob", bytes);
  return *this;
}

absl::Status SqliteDatabase::SecureLog(FileSystem& file_system,
                                       const std::string& path) {
  const std::string log_path = path + "-wal";
  const auto log = file_system.Open(log_path, OpenMode::kReadWrite);
  if (absl::IsNotFound(log.status())) return absl::OkStatus();
  MAPSIEVE_RETURN_IF_ERROR(log.status());
  MAPSIEVE_RETURN_IF_ERROR(CheckLog(**log, log_path));
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, (*log)->Size());
  for (int64_t at = 0; at < size; at += kLogPieceBytes) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const auto bytes,
        ReadExactly(**log, log_path, at, std::min(kLogPieceBytes, size - at)));
    MAPSIEVE_RETURN_IF_ERROR((*log)->WriteAt(at, bytes));
  }
  return (*log)->Sync();
}

absl::StatusOr<std::unique_ptr<SqliteDatabase>> SqliteDatabase::Open(
    FileSystem& file_system, const std::string& path) {
  auto vfs = std::make_unique<SqliteVfs>(file_system);
  sqlite3* handle = nullptr;
  int code = SQLITE_NOMEM;
  if (vfs->name() != nullptr) {
    code = sqlite3_open_v2(path.c_str(), &handle,
                           SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE |
                               SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_EXRESCODE,
                           vfs->name());
  }
  if (handle == nullptr) {
    return absl::ResourceExhaustedError(
        absl::StrCat(path, ": no memory to open it"));
  }
  std::unique_ptr<SqliteDatabase> database(
      new SqliteDatabase(path, std::move(vfs), handle));
  if (code != SQLITE_OK) return database->StatusOf(code);
  sqlite3_busy_timeout(handle, kBusyTimeoutMs);
  sqlite3_limit(handle, SQLITE_LIMIT_LENGTH, kMaxValueBytes);
  // A damaged schema must not run code of its own.
  sqlite3_db_config(handle, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  sqlite3_db_config(handle, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  // The last one: a log that a large transaction made long is cut to 16 MiB.
  for (const char* pragma :
       {"PRAGMA page_size = 4096", "PRAGMA synchronous = FULL",
        "PRAGMA foreign_keys = ON", "PRAGMA cell_size_check = ON",
        "PRAGMA temp_store = MEMORY", "PRAGMA journal_size_limit = 16777216"}) {
    MAPSIEVE_RETURN_IF_ERROR(database->Execute(pragma));
  }
  // For the checksums of a new database. One that exists stays as it is.
  int reserved_bytes = kPageChecksumBytes;
  sqlite3_file_control(handle, "main", SQLITE_FCNTL_RESERVE_BYTES,
                       &reserved_bytes);
  MAPSIEVE_RETURN_IF_ERROR(database->UseWriteAheadLog());
  return database;
}

absl::Status SqliteDatabase::UseWriteAheadLog() {
  MAPSIEVE_ASSIGN_OR_RETURN(SqliteStatement query,
                            Prepare("PRAGMA journal_mode = WAL"));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
  std::string mode;
  if (row) query.Take(mode);
  MAPSIEVE_RETURN_IF_ERROR(query.status());
  // The mode is written at the end of the statement, after its row.
  MAPSIEVE_RETURN_IF_ERROR(query.Step().status());
  if (mode == "wal") return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(path_, ": this file system cannot hold a write-ahead log (",
                   mode, "); name a directory on a local disk"));
}

SqliteDatabase::~SqliteDatabase() {
  for (const auto& [sql, statement] : statements_) sqlite3_finalize(statement);
  sqlite3_close(handle_);
}

absl::Status SqliteDatabase::StatusOf(int code) const {
  const absl::Status& failure = vfs_->last_failure();
  // That of SQLite's own calls, not of those of our files.
  const int system_error = failure.ok() ? sqlite3_system_errno(handle_) : 0;
  const std::string message =
      absl::StrCat(path_, ": ", sqlite3_errmsg(handle_), " (SQLite ", code,
                   system_error == 0 ? "" : ", system error ",
                   system_error == 0 ? "" : absl::StrCat(system_error), ")",
                   IsOfFiles(code) && !failure.ok() ? "; " : "",
                   IsOfFiles(code) ? failure.message() : "");
  if (IsDiskFull(code, system_error)) {
    return absl::ResourceExhaustedError(
        absl::StrCat(message, "; free some space"));
  }
  switch (code & 0xff) {
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
    // Our statements fit the tables that we made.
    case SQLITE_ERROR:
      return absl::DataLossError(
          absl::StrCat(message, "; restore the data directory from a backup"));
    case SQLITE_IOERR:
    case SQLITE_CANTOPEN:
      if (absl::IsDataLoss(failure)) {
        return absl::DataLossError(absl::StrCat(
            message, "; restore the data directory from a backup"));
      }
      return absl::UnavailableError(
          absl::StrCat(message, "; the device fails, see the system's log"));
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return absl::UnavailableError(
          absl::StrCat(message, "; another program has the file open"));
    case SQLITE_NOMEM:
      return absl::ResourceExhaustedError(message);
    case SQLITE_READONLY:
    case SQLITE_PERM:
    case SQLITE_AUTH:
      return absl::PermissionDeniedError(message);
    case SQLITE_TOOBIG:
      return absl::InvalidArgumentError(
          absl::StrCat(message, "; at most ", kMaxValueBytes, " bytes"));
    default:
      return absl::InternalError(message);
  }
}

absl::Status SqliteDatabase::Execute(const std::string& sql) {
  const int code =
      sqlite3_exec(handle_, sql.c_str(), nullptr, nullptr, nullptr);
  return code == SQLITE_OK ? absl::OkStatus() : StatusOf(code);
}

absl::StatusOr<int64_t> SqliteDatabase::QueryInteger(const std::string& sql) {
  MAPSIEVE_ASSIGN_OR_RETURN(SqliteStatement query, Prepare(sql));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
  if (!row) {
    return absl::InternalError(absl::StrCat(path_, ": no row of ", sql));
  }
  int64_t value = 0;
  query.Take(value);
  MAPSIEVE_RETURN_IF_ERROR(query.status());
  return value;
}

absl::StatusOr<SqliteStatement> SqliteDatabase::Prepare(
    const std::string& sql) {
  sqlite3_stmt*& statement = statements_[sql];
  if (statement == nullptr) {
    const int code =
        sqlite3_prepare_v3(handle_, sql.c_str(), static_cast<int>(sql.size()),
                           SQLITE_PREPARE_PERSISTENT, &statement, nullptr);
    if (code != SQLITE_OK) return StatusOf(code);
  }
  return SqliteStatement(*this, statement);
}

int64_t SqliteDatabase::changed_row_count() const {
  return sqlite3_changes64(handle_);
}

int64_t SqliteDatabase::last_row_number() const {
  return sqlite3_last_insert_rowid(handle_);
}

SqliteTransaction::~SqliteTransaction() {
  if (sqlite3_get_autocommit(database_.handle_) != 0) return;
  // What fails here has been undone by SQLite already.
  database_.Execute("ROLLBACK").IgnoreError();
}

absl::Status SqliteTransaction::Begin(Kind kind) {
  return database_.Execute(kind == Kind::kRead ? "BEGIN" : "BEGIN IMMEDIATE");
}

absl::Status SqliteTransaction::Commit() { return database_.Execute("COMMIT"); }

}  // namespace mapsieve::storage
