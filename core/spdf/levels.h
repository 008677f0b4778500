#ifndef MAPSIEVE_CORE_SPDF_LEVELS_H_
#define MAPSIEVE_CORE_SPDF_LEVELS_H_

#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/lattice.h"
#include "core/spdf/labels.h"
#include "core/spdf/spdf_options.h"
#include "core/spdf/tile_filter.h"

/// Levels of detail. Level 0 is what the rounds leave, outliers included; level
/// i + 1 is rule kQuota at radius density_radius_m * 2^(i+1) over the points of
/// level i, with the priorities of the same seed. A point's depth is the
/// coarsest level that it is part of. So level i is the points of depth i and
/// above, a subset of every finer one, of uniform density, and a function of
/// the set of points of level 0 and the options.
namespace mapsieve::core {

/// Squared radius of the balls of level `level`, 0 to kMaxDepth, in steps²;
/// `options` are valid on `lattice`.
int64_t LevelRadiusD2(const SpdfOptions& options, const Lattice& lattice,
                      int level);

/// Mean spacing in map units of level `level` on a surface that holds as many
/// points as aimed at: the edge of a square with one of them.
double LevelSpacing(const SpdfOptions& options, int level);

/// The coarsest level whose LevelSpacing is at most `spacing_m`; 0 if there is
/// none.
int LevelOfSpacing(const SpdfOptions& options, double spacing_m);

/// Where the levels find their points by cells and put what becomes of them.
/// LoadPoints is called from several threads at once, the others from one.
class LevelStore {
 public:
  virtual ~LevelStore() = default;

  /// Every tile that holds points of level 0; all of one level of cells, in
  /// Morton order.
  virtual std::vector<TileInfo> Tiles() const = 0;

  /// Writes points of level `level` in Morton order, the same at each call, to
  /// `room` and returns how many they are. Level 0: those of the tile `cell`;
  /// `room` is as large as its point_count. Else: what StorePoints got.
  virtual absl::StatusOr<int64_t> LoadPoints(int level, const CellKey& cell,
                                             std::span<LatticePoint> room) = 0;

  /// Keeps the points of level `level`, 1 to kMaxDepth, in a cell until the end
  /// of the run; called once at most for each, with at least a point.
  virtual absl::Status StorePoints(int level, const CellKey& cell,
                                   std::span<const LatticePoint> points) = 0;

  /// Takes the depth of each point of level `level` in a tile; called once at
  /// most for each tile, in their order. Level 0 are all points; else the
  /// others have the depths of before.
  virtual absl::Status EmitDepths(const CellKey& tile, int level,
                                  std::span<const uint8_t> depths) = 0;
};

/// The levels of an earlier set of points from which that of a LevelStore
/// differs in some tiles. Load is called from several threads at once.
class PreviousLevels {
 public:
  virtual ~PreviousLevels() = default;

  /// Every tile whose points of level 0 may be others now, those that came or
  /// went included; of the store's level of cells, in Morton order.
  virtual std::vector<CellKey> ChangedTiles() const = 0;

  /// At least as many as the points of level `level`, 0 to kMaxDepth, that the
  /// tile held.
  virtual int64_t CountAtMost(int level, const CellKey& tile) const = 0;

  /// Writes those points in Morton order, the same at each call, to `room`, as
  /// large as CountAtMost, and returns how many they are.
  virtual absl::StatusOr<int64_t> Load(int level, const CellKey& tile,
                                       std::span<LatticePoint> room) = 0;
};

/// Computes the depths of the points of `store` and emits those of every tile,
/// or, given the levels of `previous` points (of the same options), those of
/// every changed tile and, from the first level that may have others on, of
/// every other one in which a depth changed. Only what lies within reach of a
/// difference is made again: whether a point of level i is part of level i + 1
/// depends on the points of level i within the radius of level i + 1 and on
/// nothing else.
///
/// Level by level, units of nodes are loaded with a halo of their radius: a
/// node is a cell of the tiles' level, one level coarser for each level of
/// detail, since it then holds about as many points (given `previous`, from the
/// fourth level on). Neither tiles nor
/// max_unit_points, order, worker count or `previous` show in the depths.
/// Memory: a unit, and one node a level. Errors: kInvalidArgument (options),
/// kCancelled, those of `store` and `previous`.
absl::Status ComputeDepths(LevelStore& store, PreviousLevels* previous,
                           const Lattice& lattice, const SpdfOptions& options,
                           const TilingOptions& tiling,
                           const ExecutionContext& context);

/// The same of points in memory, distinct and in Morton order: one depth a
/// point.
absl::StatusOr<std::vector<uint8_t>> ComputeDepths(
    std::span<const LatticePoint> points, const Lattice& lattice,
    const SpdfOptions& options, const ExecutionContext& context = {});

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_LEVELS_H_
