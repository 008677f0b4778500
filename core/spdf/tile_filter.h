#ifndef MAPSIEVE_CORE_SPDF_TILE_FILTER_H_
#define MAPSIEVE_CORE_SPDF_TILE_FILTER_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/cell_key.h"
#include "core/spdf/labels.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::core {

/// A tile of a map and how many distinct points it holds at most.
struct TileInfo {
  CellKey key;
  int64_t point_count = 0;
};

/// Round in which a point died: 1, 2, …; kAlive for a survivor.
using DeathRound = uint8_t;
inline constexpr DeathRound kAlive = 255;

/// What the filter keeps of a tile between two visits.
enum class TileStateKind : uint8_t { kDeaths = 1, kRounds = 2, kVoters = 3 };

/// The filter's answer for one tile: the survivors of the rounds, outliers
/// included, in Morton order. Valid during the call that receives it.
struct TileResult {
  CellKey key;
  /// Distinct points of the tile.
  int64_t point_count = 0;
  /// One a distinct point of the tile.
  std::span<const DeathRound> deaths;
  /// Rows of the survivors among the tile's distinct points, ascending.
  std::span<const uint32_t> rows;
  std::span<const LatticePoint> positions;
  LabelSpans columns;
};

/// Some rows of a tile: [begin, end).
struct RowRange {
  uint32_t begin = 0;
  uint32_t end = 0;

  friend bool operator==(const RowRange&, const RowRange&) = default;
};

inline size_t RowCount(std::span<const RowRange> rows) {
  size_t count = 0;
  for (const RowRange& part : rows) count += part.end - part.begin;
  return count;
}

/// Copies the `rows` of `all`, whose rows have `row_size` entries each, to
/// `room`, one after the other.
template <typename T>
void CopyRows(std::span<const T> all, std::span<const RowRange> rows,
              std::span<T> room, size_t row_size = 1) {
  auto to = room.begin();
  for (const RowRange& part : rows) {
    const auto from =
        all.subspan(part.begin * row_size, (part.end - part.begin) * row_size);
    to = std::copy(from.begin(), from.end(), to);
  }
}

/// Where the points of tiles come from.
class PointTiles {
 public:
  virtual ~PointTiles() = default;

  /// Every tile that holds points; all of one level, in Morton order.
  virtual std::vector<TileInfo> Tiles() const = 0;

  /// Writes the distinct points of a tile in Morton order, the same at each
  /// call, to `room`, which is as large as the tile's point_count. Returns how
  /// many they are. Called from several threads at once.
  virtual absl::StatusOr<int64_t> LoadPoints(const CellKey& key,
                                             std::span<LatticePoint> room) = 0;

  /// Writes some of those points, in ascending order, to `room`, which is just
  /// as large; called after a LoadPoints of the tile, from several threads at
  /// once.
  virtual absl::Status LoadPointRows(const CellKey& key,
                                     std::span<const RowRange> rows,
                                     std::span<LatticePoint> room) = 0;
};

/// Where the filter finds the tiles of a map and puts what it makes of them.
/// The methods that load are called from several threads at once, the others
/// from one.
class TileStore : public PointTiles {
 public:
  /// Keeps bytes of the filter for a tile, as many for each distinct point,
  /// until the next StoreState of the same kind or the end of the run.
  virtual absl::Status StoreState(const CellKey& key, TileStateKind kind,
                                  std::span<const std::byte> bytes) = 0;
  /// Writes the bytes last stored for some points, in ascending order, to
  /// `room`, which is just as large; called only after StoreState.
  virtual absl::Status LoadState(const CellKey& key, TileStateKind kind,
                                 std::span<const RowRange> rows,
                                 std::span<std::byte> room) = 0;

  /// The filter is done with a visit: it would go on from the states stored so
  /// far, given the `record` of this visit and of those before. A store that
  /// does not resume runs ignores it.
  virtual absl::Status FinishVisit(std::span<const std::byte> /*record*/) {
    return absl::OkStatus();
  }
  /// The records of the visits that an earlier run finished, in their order, if
  /// the states are as they were after the last of them and tiles, options and
  /// max_unit_points are the same: FilterTiles does not make them again.
  virtual std::vector<std::vector<std::byte>> FinishedVisits() { return {}; }

  /// Takes the answer for a tile; called once for every tile, in their order.
  virtual absl::Status Emit(const TileResult& result) = 0;
};

struct TilingOptions {
  /// Adjacent tiles are filtered together, as one unit, up to this many
  /// points without the halo (a single larger tile is a unit of its own). The
  /// result does not depend on it.
  int64_t max_unit_points = 8'000'000;
  /// Rule kPaper makes all rounds of a unit in one visit, with all points
  /// around it that have a say in them, if those are about this share of all
  /// points at most; else rounds in lock-step, each round of all units before
  /// the next. The result does not depend on it.
  double max_halo_share = 0.4;
};

/// What a run did; sums over all tiles.
struct SpdfSummary {
  int64_t point_count = 0;
  /// Survivors of the rounds, outliers included.
  int64_t survivor_count = 0;
  /// Survivors of each label, outliers included.
  LabelCounts label_counts{};
  MaxConfidence max_confidence{};
  /// Rounds until nothing was flagged, or the limit.
  int round_count = 0;
  /// Votes of neighbours that were summed up: the work, which depends on the
  /// units too.
  int64_t vote_count = 0;
};

/// Runs the filter over every tile of `store`: rounds, then ball votes, aware
/// votes and labels. The result is a function of the set of points and
/// `options`: neither tile size nor `tiling`, order of points nor worker count
/// show in it.
/// Errors: kInvalidArgument (options), kCancelled, those of `store`.
/// Source: Labussière, Laconte, Pomerleau, 2020; core/README.md.
absl::StatusOr<SpdfSummary> FilterTiles(TileStore& store,
                                        const Lattice& lattice,
                                        const SpdfOptions& options,
                                        const TilingOptions& tiling,
                                        const ExecutionContext& context);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_TILE_FILTER_H_
