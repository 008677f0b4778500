#ifndef MAPSIEVE_SERVER_ENGINE_SYNC_H_
#define MAPSIEVE_SERVER_ENGINE_SYNC_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/cell_key.h"
#include "server/engine/query.h"

namespace mapsieve::engine {

/// Chunks that a client may say it holds.
inline constexpr size_t kMaxHeldChunks = 65'536;

/// What a client wants to hold of a map, and what it holds. A chunk is what a
/// query gives of one tile; its id changes with anything that the query's
/// answer depends on, and seldom else.
struct SyncSpec {
  /// The region chooses tiles; their chunks hold all their points that pass the
  /// other filters, whether in the region or not. Without a budget and
  /// allow_partial.
  QuerySpec query;
  /// Made of all that the query asks for but map, revision and region: equal
  /// keys ask for the same columns of the same points of a tile.
  std::string query_key;
  /// Ids of chunks, at most kMaxHeldChunks.
  std::vector<std::string> held_chunk_ids;
};

/// Part of a chunk that the client does not hold.
struct SyncPart {
  /// 32 hexadecimal digits.
  std::string chunk_id;
  core::CellKey tile;
  /// A point block; nothing in a chunk without points.
  std::vector<std::byte> block;
  /// The chunk is complete.
  bool is_last = false;
};

/// What the chunks have in common.
struct SyncHeader {
  /// Revision that they are of, as QueryHeader has it.
  int64_t revision = 0;
  int64_t step_nm = 0;
  int tile_level = 0;
  /// Columns of the blocks, which come in any order there.
  std::vector<core::ColumnSpec> columns;
};

struct SyncSummary {
  /// Chunks of the region, those that the client holds included.
  int64_t chunk_count = 0;
  /// Of these, chunks that were given.
  int64_t sent_chunk_count = 0;
  /// Held chunks that are none of the region's, in the order of the request.
  std::vector<std::string> dropped_chunk_ids;
};

/// A synchronisation on its way, pinned to one revision. Used by one thread at
/// a time; destroyed before its Engine.
class SyncCursor {
 public:
  virtual ~SyncCursor() = default;

  virtual const SyncHeader& header() const = 0;

  /// Whether the client lacks any chunk.
  virtual bool has_parts() const = 0;

  /// The parts of the chunks that the client lacks, chunk by chunk in Morton
  /// order of their tiles; nothing once all were given. Errors as
  /// QueryCursor::NextBatch.
  virtual absl::StatusOr<std::optional<SyncPart>> Next() = 0;

  /// Complete once Next gave nothing.
  virtual const SyncSummary& summary() const = 0;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_SYNC_H_
