#ifndef MAPSIEVE_SERVER_ENGINE_VERIFY_H_
#define MAPSIEVE_SERVER_ENGINE_VERIFY_H_

#include <cstdint>
#include <optional>
#include <string>
#include <variant>

#include "absl/status/statusor.h"
#include "core/geometry/cell_key.h"
#include "server/engine/damaged_chunk.h"

namespace mapsieve::engine {

/// What to verify of a map.
struct VerifySpec {
  std::string map_id;
  /// Tiles of the newest product, evenly spread along the Morton curve, that
  /// are filtered again by themselves and compared; 0 to kMaxComparedTiles.
  int64_t compared_tile_count = 0;
};
inline constexpr int64_t kMaxComparedTiles = 1'000'000;

/// How far a verification is: chunks read and tiles compared.
struct VerifyProgress {
  int64_t done_count = 0;
  int64_t total_count = 0;
};

/// A tile whose product is not what the filter makes of its points.
struct DifferingTile {
  core::CellKey tile;
  /// What differs first.
  std::string difference;
};

using VerifyEvent = std::variant<VerifyProgress, DamagedChunk, DifferingTile>;

/// What was verified so far; of the whole map at the end.
struct VerifySummary {
  /// Of all revisions; a chunk that several of them share counts once.
  int64_t chunk_count = 0;
  int64_t stored_bytes = 0;
  int64_t damaged_chunk_count = 0;
  int64_t compared_tile_count = 0;
  /// Survivors in the tiles compared.
  int64_t compared_point_count = 0;
  int64_t differing_tile_count = 0;
  /// Tiles that were to be compared, but whose points with those around them do
  /// not fit the memory for queries, or are damaged.
  int64_t skipped_tile_count = 0;
};

/// A verification on its way. Used by one thread at a time; destroyed before
/// its Engine.
class VerifyCursor {
 public:
  virtual ~VerifyCursor() = default;

  /// The next finding, or after some time without any the progress; nothing
  /// at the end. After an error the cursor is of no further use. kCancelled;
  /// kUnavailable: storage; kDataLoss: the catalogue is damaged.
  virtual absl::StatusOr<std::optional<VerifyEvent>> Next() = 0;

  virtual VerifySummary summary() const = 0;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_VERIFY_H_
