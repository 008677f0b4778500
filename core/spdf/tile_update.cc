#include "core/spdf/tile_update.h"

#include <algorithm>
#include <set>
#include <vector>

#include "core/base/status.h"
#include "core/spdf/tile_units.h"
#include "core/spdf/work_unit.h"

namespace mapsieve::core {
namespace {

class TileUpdate {
 public:
  TileUpdate(TileStore& store, std::span<const TileChange> changes,
             const SpdfOptions& options, const SpdfConstants& constants,
             const TilingOptions& tiling, const ExecutionContext& context)
      : changes_(changes),
        options_(options),
        constants_(constants),
        tiling_(tiling),
        context_(context),
        tiles_(store, options, constants, context),
        tile_count_(static_cast<int64_t>(tiles_.tiles().size())) {}

  absl::StatusOr<UpdateSummary> Run() {
    for (const TileChange& change : changes_) {
      if (const auto t = tiles_.Find(change.tile)) {
        pending_.insert(*t);
        to_emit_.insert(*t);
      }
      if (change.box.has_value()) MarkTouched(*change.box, {});
    }
    while (!pending_.empty()) {
      // The first unit's worth of them; its changes may add others.
      const std::vector<size_t> wanted(pending_.begin(), pending_.end());
      const Unit unit = tiles_.Group(wanted, tiling_.max_unit_points).front();
      for (const size_t t : unit) pending_.erase(t);
      MAPSIEVE_RETURN_IF_ERROR(UpdateDeaths(unit));
      ReportVisits(unit, tile_count_);
    }
    done_ = tile_count_;
    const std::vector<size_t> to_emit(to_emit_.begin(), to_emit_.end());
    for (const Unit& unit : tiles_.Group(to_emit, tiling_.max_unit_points)) {
      MAPSIEVE_RETURN_IF_ERROR(EmitAnew(unit));
      ReportVisits(unit, 2 * tile_count_);
    }
    context_.ReportProgress(2 * tile_count_, 2 * tile_count_);
    summary_.emitted_tile_count = static_cast<int64_t>(to_emit.size());
    return summary_;
  }

 private:
  using Unit = TileUnits::Unit;

  bool IsQuota() const { return options_.rule == DensityRule::kQuota; }

  /// How far a change of points shows in deaths.
  int64_t DeathReach() const {
    return IsQuota() ? constants_.density_steps : constants_.reach_steps;
  }

  /// How many visits a run takes is known at its end only: the tiles of the
  /// map stand for those of each of its two steps.
  void ReportVisits(const Unit& unit, int64_t limit) {
    done_ = std::min(done_ + static_cast<int64_t>(unit.size()), limit - 1);
    context_.ReportProgress(done_, 2 * tile_count_);
  }

  /// Points or deaths changed inside `box`: tiles in reach, but those of
  /// `unit`, which has seen it, are to be filtered, those whose votes see it to
  /// be emitted.
  void MarkTouched(const LatticeBox& box, const Unit& unit) {
    for (const size_t t : tiles_.TilesIn(box.Grown(DeathReach()))) {
      if (!std::binary_search(unit.begin(), unit.end(), t)) pending_.insert(t);
    }
    const int64_t two_votes = 2 * constants_.reach_steps;
    for (const size_t t : tiles_.TilesIn(box.Grown(two_votes))) {
      to_emit_.insert(t);
    }
  }

  /// Filters the unit through all rounds, given the deaths around it.
  absl::Status UpdateDeaths(const Unit& unit) {
    MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit loaded,
                              tiles_.Load(unit, DeathReach()));
    WorkUnit& work = *loaded.work;
    BulkVector<DeathRound>& deaths = work.deaths();
    MAPSIEVE_RETURN_IF_ERROR(tiles_.LoadStates(loaded, TileStateKind::kDeaths,
                                               /*with_halo=*/true, deaths));
    const BulkVector<DeathRound> before = deaths;
    DeathRound last_around = 0;
    for (size_t i = 0; i < work.size(); ++i) {
      if (work.core()[i] != 0) {
        deaths[i] = kAlive;
      } else if (deaths[i] != kAlive) {
        last_around = std::max(last_around, deaths[i]);
      }
    }
    if (IsQuota()) {
      MAPSIEVE_RETURN_IF_ERROR(work.RunQuota(constants_.density_d2, context_));
      summary_.emitted.round_count = 1;
    } else {
      MAPSIEVE_RETURN_IF_ERROR(RunRounds(last_around, work));
    }
    for (const LoadedTile& tile : loaded.tiles) {
      if (!tile.is_core) continue;
      const std::span<const DeathRound> now =
          std::span(deaths).subspan(tile.begin, tile.end - tile.begin);
      const DeathRound* const then = before.data() + tile.begin;
      if (std::equal(now.begin(), now.end(), then)) continue;
      MAPSIEVE_RETURN_IF_ERROR(
          tiles_.StoreTileStates(tile, TileStateKind::kDeaths, deaths));
      MAPSIEVE_ASSIGN_OR_RETURN(const std::span<const LatticePoint> points,
                                tiles_.LoadPoints(tile.tile));
      std::optional<LatticeBox> changed;
      for (size_t i = 0; i < now.size(); ++i) {
        if (now[i] == then[i]) continue;
        const LatticeBox box = BoxOf(points[i]);
        changed = changed.has_value() ? changed->Union(box) : box;
      }
      MarkTouched(*changed, unit);
    }
    return absl::OkStatus();
  }

  /// `last_around`: the last round in which a point of the halo dies.
  absl::Status RunRounds(DeathRound last_around, WorkUnit& work) {
    for (int round = 1; round <= options_.max_round_count; ++round) {
      MAPSIEVE_ASSIGN_OR_RETURN(const WorkUnit::RoundCounts counts,
                                work.RunPaperRound(round, context_));
      summary_.emitted.round_count =
          std::max(summary_.emitted.round_count, round);
      if (counts.died == 0 && counts.flagged == 0 && round > last_around) break;
    }
    return absl::OkStatus();
  }

  /// Both votes and labels of the unit's tiles.
  absl::Status EmitAnew(const Unit& unit) {
    const int64_t reach = constants_.reach_steps;
    MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit loaded, tiles_.Load(unit, 2 * reach));
    WorkUnit& work = *loaded.work;
    MAPSIEVE_RETURN_IF_ERROR(tiles_.LoadStates(loaded, TileStateKind::kDeaths,
                                               /*with_halo=*/true,
                                               work.deaths()));
    // Voters around the unit are computed with it, from the halo beyond them.
    const BulkVector<uint8_t> core = work.core();
    const auto halo = tiles_.HaloTiles(unit, reach);
    for (const LoadedTile& tile : loaded.tiles) {
      const auto near = halo.find(tile.tile);
      if (tile.is_core || near == halo.end()) continue;
      for (size_t i = tile.begin; i < tile.end; ++i) {
        const LatticePoint q = work.Position(i);
        work.core()[i] = std::any_of(
            near->second.begin(), near->second.end(), [&](size_t t) {
              return tiles_.tiles()[t].key.box().Grown(reach).Contains(q);
            });
      }
    }
    MAPSIEVE_RETURN_IF_ERROR(work.ComputeVoters(context_));
    work.core() = core;
    MAPSIEVE_ASSIGN_OR_RETURN(const WorkUnit::Labeled labeled,
                              work.CastAwareVotes(context_));
    return tiles_.Emit(loaded, labeled, summary_.emitted);
  }

  const std::span<const TileChange> changes_;
  const SpdfOptions& options_;
  const SpdfConstants& constants_;
  const TilingOptions& tiling_;
  const ExecutionContext& context_;
  TileUnits tiles_;
  const int64_t tile_count_;
  /// Tiles to be filtered through all rounds.
  std::set<size_t> pending_;
  std::set<size_t> to_emit_;
  UpdateSummary summary_;
  int64_t done_ = 0;
};

}  // namespace

absl::StatusOr<UpdateSummary> UpdateTiles(TileStore& store,
                                          std::span<const TileChange> changes,
                                          const Lattice& lattice,
                                          const SpdfOptions& options,
                                          const TilingOptions& tiling,
                                          const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate(lattice));
  const SpdfConstants constants = MakeSpdfConstants(options, lattice);
  return TileUpdate(store, changes, options, constants, tiling, context).Run();
}

}  // namespace mapsieve::core
