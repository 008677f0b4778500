#include "storage/sqlite_operations.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/status.h"
#include "storage/names.h"
#include "storage/record_checks.h"

namespace mapsieve::storage {
namespace {

// In the order of TakeOperation.
constexpr char kSelectOperation[] =
    "SELECT number, id, target, verb, request, state, cancel_requested, "
    "done_count, total_count, error_code, error_message, response, "
    "create_time, update_time FROM operations ";

absl::StatusOr<OperationRecord> TakeOperation(SqliteStatement& row) {
  OperationRecord operation;
  row.TakeCount(operation.number)
      .Take(operation.id)
      .Take(operation.target)
      .Take(operation.verb)
      .TakeBlob(operation.request)
      .Take(operation.state)
      .Take(operation.cancel_requested)
      .TakeCount(operation.done_count)
      .TakeCount(operation.total_count)
      .Take(operation.error_code)
      .Take(operation.error_message)
      .TakeBlob(operation.response)
      .Take(operation.create_time)
      .Take(operation.update_time);
  MAPSIEVE_RETURN_IF_ERROR(row.status());
  return operation;
}

// Binds what may change, in the order of the statements below.
SqliteStatement& BindOutcome(const OperationRecord& operation,
                             SqliteStatement& statement) {
  return statement.Bind(operation.state)
      .Bind(operation.cancel_requested)
      .Bind(operation.done_count)
      .Bind(operation.total_count)
      .Bind(operation.error_code)
      .Bind(operation.error_message)
      .BindBlob(operation.response)
      .Bind(absl::Now());
}

}  // namespace

absl::StatusOr<OperationRecord> CreateOperation(
    SqliteDatabase& database, const OperationRecord& operation) {
  MAPSIEVE_RETURN_IF_ERROR(CheckOperation(operation));
  const auto existing = GetOperation(database, operation.id);
  if (existing.ok()) {
    return absl::AlreadyExistsError(
        absl::StrCat("operation ", operation.id, " exists already"));
  }
  if (!absl::IsNotFound(existing.status())) return existing;
  {
    MAPSIEVE_ASSIGN_OR_RETURN(
        SqliteStatement insert,
        database.Prepare(
            "INSERT INTO operations (id, target, verb, request, create_time, "
            "state, cancel_requested, done_count, total_count, error_code, "
            "error_message, response, update_time) VALUES (?, ?, ?, ?, ?, ?, "
            "?, ?, ?, ?, ?, ?, ?)"));
    insert.Bind(operation.id)
        .Bind(operation.target)
        .Bind(operation.verb)
        .BindBlob(operation.request)
        .Bind(absl::Now());
    MAPSIEVE_RETURN_IF_ERROR(BindOutcome(operation, insert).Run());
  }
  return GetOperation(database, operation.id);
}

absl::StatusOr<OperationRecord> GetOperation(SqliteDatabase& database,
                                             const std::string& id) {
  MAPSIEVE_RETURN_IF_ERROR(CheckResourceId(id));
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(kSelectOperation, "WHERE id = ?")));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool found, query.Bind(id).Step());
  if (!found) {
    return absl::NotFoundError(
        absl::StrCat("operation ", id, " does not exist"));
  }
  return TakeOperation(query);
}

absl::StatusOr<std::vector<OperationRecord>> ListOperations(
    SqliteDatabase& database, const std::string& target, bool unfinished_only,
    int64_t after, int64_t max_count) {
  MAPSIEVE_RETURN_IF_ERROR(CheckPageSize(max_count));
  // Spelled out in the text, as the index of unfinished ones has it.
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement query,
      database.Prepare(absl::StrCat(kSelectOperation, "WHERE number > ?",
                                    unfinished_only ? " AND state < 3" : "",
                                    target.empty() ? "" : " AND target = ?",
                                    " ORDER BY number LIMIT ?")));
  query.Bind(after);
  if (!target.empty()) query.Bind(target);
  query.Bind(max_count);
  std::vector<OperationRecord> operations;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return operations;
    MAPSIEVE_ASSIGN_OR_RETURN(OperationRecord operation, TakeOperation(query));
    operations.push_back(std::move(operation));
  }
}

absl::Status UpdateOperation(SqliteDatabase& database,
                             const OperationRecord& operation) {
  MAPSIEVE_RETURN_IF_ERROR(CheckOperation(operation));
  MAPSIEVE_ASSIGN_OR_RETURN(const OperationRecord existing,
                            GetOperation(database, operation.id));
  if (IsDone(existing.state)) {
    return absl::FailedPreconditionError(
        absl::StrCat("operation ", operation.id, " has ended already"));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement update,
      database.Prepare(
          "UPDATE operations SET state = ?, cancel_requested = ?, "
          "done_count = ?, total_count = ?, error_code = ?, "
          "error_message = ?, response = ?, update_time = ? WHERE id = ?"));
  return BindOutcome(operation, update).Bind(operation.id).Run();
}

absl::Status DeleteOperation(SqliteDatabase& database, const std::string& id) {
  MAPSIEVE_ASSIGN_OR_RETURN(const OperationRecord existing,
                            GetOperation(database, id));
  if (!IsDone(existing.state)) {
    return absl::FailedPreconditionError(
        absl::StrCat("operation ", id, " has not ended; cancel it first"));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      SqliteStatement remove,
      database.Prepare("DELETE FROM operations WHERE id = ?"));
  return remove.Bind(id).Run();
}

}  // namespace mapsieve::storage
