#ifndef MAPSIEVE_STORAGE_SQLITE_OPERATIONS_H_
#define MAPSIEVE_STORAGE_SQLITE_OPERATIONS_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/catalogue.h"
#include "storage/sqlite_database.h"

/// The table operations. Each function runs inside a transaction of its caller
/// and has the contract of the Catalogue function of its name.
namespace mapsieve::storage {

template <>
inline constexpr int64_t kLargestEnumerator<OperationState> =
    static_cast<int64_t>(OperationState::kCancelled);

absl::StatusOr<OperationRecord> CreateOperation(
    SqliteDatabase& database, const OperationRecord& operation);
absl::StatusOr<OperationRecord> GetOperation(SqliteDatabase& database,
                                             const std::string& id);
absl::StatusOr<std::vector<OperationRecord>> ListOperations(
    SqliteDatabase& database, const std::string& target, bool unfinished_only,
    int64_t after, int64_t max_count);
absl::Status UpdateOperation(SqliteDatabase& database,
                             const OperationRecord& operation);
absl::Status DeleteOperation(SqliteDatabase& database, const std::string& id);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_OPERATIONS_H_
