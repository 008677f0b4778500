#ifndef MAPSIEVE_STORAGE_SQLITE_CHUNKS_H_
#define MAPSIEVE_STORAGE_SQLITE_CHUNKS_H_

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/catalogue.h"
#include "storage/sqlite_database.h"
#include "storage/sqlite_maps.h"

/// The tables chunks and tiles. Each function runs inside a transaction of its
/// caller.
namespace mapsieve::storage {

template <>
inline constexpr int64_t kLargestEnumerator<ChunkKind> =
    static_cast<int64_t>(ChunkKind::kHistory);

/// Changes the references of `map` from those of its newest revision to those
/// of the next one, and returns the totals of that one. kInvalidArgument: a
/// removed number that the newest revision does not have.
absl::StatusOr<RevisionTotals> ApplyChange(SqliteDatabase& database,
                                           const MapRow& map,
                                           const RevisionTotals& parent_totals,
                                           const RevisionChange& change);

/// Gives `map` a revision after its newest one, with the references and tiles
/// that it had at revision `target`.
absl::Status RestoreChunks(SqliteDatabase& database, const MapRow& map,
                           const RevisionRecord& target);

/// These have the contract of the Catalogue function of their name.
absl::StatusOr<std::vector<ChunkRef>> ListChunks(
    SqliteDatabase& database, const std::string& map_uid, int64_t revision,
    ChunkKind kind, const std::optional<core::LatticeBox>& region,
    const std::optional<ChunkPosition>& after, int64_t max_count);
absl::StatusOr<std::vector<ChunkRef>> ListTileChunks(SqliteDatabase& database,
                                                     const std::string& map_uid,
                                                     int64_t revision,
                                                     ChunkKind kind,
                                                     const core::CellKey& tile);
absl::StatusOr<std::vector<TileSummary>> ListTiles(
    SqliteDatabase& database, const std::string& map_uid, int64_t revision,
    ChunkKind kind, const std::optional<core::LatticeBox>& region,
    const std::optional<core::CellKey>& after, int64_t max_count);
absl::StatusOr<std::vector<ChunkRef>> ListAllChunks(SqliteDatabase& database,
                                                    const std::string& map_uid,
                                                    int64_t after,
                                                    int64_t max_count);
absl::StatusOr<int64_t> CountAllChunks(SqliteDatabase& database,
                                       const std::string& map_uid);
absl::StatusOr<std::vector<core::CellKey>> ListChangedTiles(
    SqliteDatabase& database, const std::string& map_uid, int64_t revision,
    int64_t other, ChunkKind kind, const std::optional<core::CellKey>& after,
    int64_t max_count);
absl::StatusOr<std::vector<bool>> AreBlobsReferenced(
    SqliteDatabase& database, std::span<const BlobId> ids);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_CHUNKS_H_
