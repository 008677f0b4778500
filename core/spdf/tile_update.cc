#include "core/spdf/tile_update.h"

#include <algorithm>
#include <bit>
#include <map>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "core/geometry/morton.h"
#include "core/spdf/tile_cells.h"
#include "core/spdf/tile_units.h"
#include "core/spdf/work_unit.h"

namespace mapsieve::core {
namespace {

class TileUpdate {
 public:
  TileUpdate(TileStore& store, PreviousRun& previous,
             std::span<const TileChange> changes, const SpdfOptions& options,
             const SpdfConstants& constants, const TilingOptions& tiling,
             const ExecutionContext& context)
      : previous_(previous),
        changes_(changes),
        options_(options),
        constants_(constants),
        tiling_(tiling),
        context_(context),
        tiles_(store, options, constants, context),
        tile_count_(static_cast<int64_t>(tiles_.tiles().size())),
        // No finer than what one change reaches.
        cell_level_(static_cast<int>(
            std::bit_width(static_cast<uint64_t>(constants.reach_steps)))) {}

  absl::StatusOr<UpdateSummary> Run() {
    for (const TileChange& change : changes_) {
      if (const auto t = tiles_.Find(change.tile)) CellsOf(*t, to_emit_);
      if (change.box.has_value()) MarkTouched(*change.box, pending_);
    }
    while (!pending_.empty()) {
      // The first unit's worth of them; its changes may add others.
      const Unit unit =
          tiles_.Group(TilesOf(pending_), tiling_.max_unit_points).front();
      MAPSIEVE_RETURN_IF_ERROR(UpdateDeaths(unit));
      ReportVisits(unit, tile_count_);
    }
    done_ = tile_count_;
    for (const Unit& unit :
         tiles_.Group(TilesOf(to_emit_), tiling_.max_unit_points)) {
      MAPSIEVE_RETURN_IF_ERROR(EmitAnew(unit));
      ReportVisits(unit, 2 * tile_count_);
    }
    context_.ReportProgress(2 * tile_count_, 2 * tile_count_);
    summary_.emitted_tile_count = static_cast<int64_t>(to_emit_.size());
    return summary_;
  }

 private:
  using Unit = TileUnits::Unit;
  /// Cells of some tiles, by the tiles' numbers.
  using CellSet = std::map<size_t, TileCells>;

  static std::vector<size_t> TilesOf(const CellSet& cells) {
    std::vector<size_t> tiles;
    for (const auto& [t, of_tile] : cells) tiles.push_back(t);
    return tiles;
  }

  TileGrid GridOf(size_t t) const {
    return TileGrid(tiles_.tiles()[t].key, cell_level_);
  }

  TileCells& CellsOf(size_t t, CellSet& cells) const {
    return cells.try_emplace(t, GridOf(t)).first->second;
  }

  /// What holds the cells of each tile that has any.
  static std::vector<LatticeBox> BoundsOf(const CellSet& cells) {
    std::vector<LatticeBox> bounds;
    for (const auto& [t, of_tile] : cells) {
      if (of_tile.Any()) bounds.push_back(of_tile.Bounds());
    }
    return bounds;
  }

  /// Adds the cells that intersect `box`.
  void Add(const LatticeBox& box, CellSet& cells) const {
    for (const size_t t : tiles_.TilesIn(box)) CellsOf(t, cells).Add(box);
  }

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

  /// Points or deaths changed inside `box`: adds to `to_filter` what is in
  /// reach, and to what is to be emitted anew what has votes that see it.
  void MarkTouched(const LatticeBox& box, CellSet& to_filter) {
    Add(box.Grown(DeathReach()), to_filter);
    Add(box.Grown(2 * constants_.reach_steps), to_emit_);
  }

  /// Which points of the unit, before its first step, are in `cells`.
  BulkVector<uint8_t> PointsIn(const CellSet& cells,
                               const LoadedUnit& loaded) const {
    const WorkUnit& work = *loaded.work;
    BulkVector<uint8_t> is_in(work.size());
    context_.executor->ParallelFor(
        static_cast<int64_t>(loaded.tiles.size()), [&](int64_t n) {
          const LoadedTile& tile = loaded.tiles[static_cast<size_t>(n)];
          const auto of_tile = cells.find(tile.tile);
          if (of_tile == cells.end()) return;
          for (size_t i = tile.begin; i < tile.end; ++i) {
            is_in[i] = of_tile->second.Contains(work.Position(i)) ? 1 : 0;
          }
        });
    return is_in;
  }

  /// Filters the pending cells of the unit's tiles through all rounds, given
  /// the deaths around them.
  absl::Status UpdateDeaths(const Unit& unit) {
    CellSet filtered;
    for (const size_t t : unit) filtered.insert(pending_.extract(t));
    MAPSIEVE_ASSIGN_OR_RETURN(
        LoadedUnit loaded,
        tiles_.LoadNear(unit, BoundsOf(filtered), DeathReach()));
    WorkUnit& work = *loaded.work;
    work.core() = PointsIn(filtered, loaded);
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
    summary_.emitted.vote_count += work.vote_count();
    CellSet touched;
    for (const LoadedTile& tile : loaded.tiles) {
      if (!tile.is_core) continue;
      const std::span<const DeathRound> now =
          std::span(deaths).subspan(tile.begin, tile.end - tile.begin);
      const DeathRound* const then = before.data() + tile.begin;
      if (std::equal(now.begin(), now.end(), then)) continue;
      MAPSIEVE_ASSIGN_OR_RETURN(const BulkVector<LatticePoint> points,
                                tiles_.LoadPoints(tile.tile));
      MAPSIEVE_ASSIGN_OR_RETURN(
          BulkVector<DeathRound> of_tile,
          tiles_.LoadTileStates<DeathRound>(tile.tile, TileStateKind::kDeaths,
                                            points.size()));
      TileCells changed(GridOf(tile.tile));
      size_t i = 0;
      for (const RowRange& part : tile.rows) {
        for (uint32_t row = part.begin; row < part.end; ++row, ++i) {
          if (now[i] == then[i]) continue;
          of_tile[row] = now[i];
          changed.Add(BoxOf(points[row]));
        }
      }
      MAPSIEVE_RETURN_IF_ERROR(tiles_.StoreTileStates<DeathRound>(
          tile.tile, TileStateKind::kDeaths, of_tile));
      changed.ForEach(
          [&](const LatticeBox& box) { MarkTouched(box, touched); });
    }
    // What was filtered together has seen these changes.
    for (auto& [t, cells] : touched) {
      const auto seen = filtered.find(t);
      if (seen != filtered.end()) cells.Remove(seen->second);
      if (cells.Any()) CellsOf(t, pending_).Add(cells);
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

  /// Both votes and labels of the touched cells of the unit's tiles; the rest
  /// of the tiles is emitted as it was.
  absl::Status EmitAnew(const Unit& unit) {
    const int64_t reach = constants_.reach_steps;
    CellSet labeled;
    CellSet voting;
    for (const size_t t : unit) {
      const TileCells& cells = to_emit_.at(t);
      labeled.emplace(t, cells);
      cells.ForEach(
          [&](const LatticeBox& box) { Add(box.Grown(reach), voting); });
    }
    MAPSIEVE_ASSIGN_OR_RETURN(
        LoadedUnit loaded, tiles_.LoadNear(unit, BoundsOf(labeled), 2 * reach));
    WorkUnit& work = *loaded.work;
    MAPSIEVE_RETURN_IF_ERROR(tiles_.LoadStates(loaded, TileStateKind::kDeaths,
                                               /*with_halo=*/true,
                                               work.deaths()));
    // Voters around the labeled are computed with them, from what is beyond.
    BulkVector<uint8_t> is_labeled = PointsIn(labeled, loaded);
    work.core() = PointsIn(voting, loaded);
    MAPSIEVE_RETURN_IF_ERROR(work.ComputeVoters(context_));
    work.core() = std::move(is_labeled);
    MAPSIEVE_ASSIGN_OR_RETURN(WorkUnit::Labeled labels,
                              work.CastAwareVotes(context_));
    summary_.emitted.vote_count += work.vote_count();
    std::vector<LoadedTile> core;
    for (const LoadedTile& tile : loaded.tiles) {
      if (tile.is_core) core.push_back(tile);
    }
    return tiles_.ForEachBatch(
        core, [&](std::span<LoadedTile> batch) -> absl::Status {
          std::vector<Answer> answers(batch.size());
          MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
              *context_.executor, static_cast<int64_t>(batch.size()),
              [&](int64_t n) -> absl::Status {
                const auto t = static_cast<size_t>(n);
                MAPSIEVE_ASSIGN_OR_RETURN(
                    answers[t], AnswerOf(batch[t], *loaded.work, labels));
                return absl::OkStatus();
              }));
          for (size_t t = 0; t < batch.size(); ++t) {
            const Answer& answer = answers[t];
            MAPSIEVE_RETURN_IF_ERROR(tiles_.Emit(
                {.key = tiles_.tiles()[batch[t].tile].key,
                 .point_count = static_cast<int64_t>(answer.deaths.size()),
                 .deaths = answer.deaths,
                 .rows = answer.rows,
                 .positions = answer.positions,
                 .columns = answer.columns.All()},
                summary_.emitted));
          }
          return absl::OkStatus();
        });
  }

  /// What TileResult refers to.
  struct Answer {
    BulkVector<DeathRound> deaths;
    std::vector<uint32_t> rows;
    std::vector<LatticePoint> positions;
    LabelColumns columns;
  };

  /// Of a tile of the unit `work`: the labels of its core points are new, those
  /// of all others as they were.
  absl::StatusOr<Answer> AnswerOf(const LoadedTile& tile, WorkUnit& work,
                                  const WorkUnit::Labeled& labels) {
    MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
    MAPSIEVE_ASSIGN_OR_RETURN(const BulkVector<LatticePoint> points,
                              tiles_.LoadPoints(tile.tile));
    Answer answer;
    MAPSIEVE_ASSIGN_OR_RETURN(
        answer.deaths, tiles_.LoadTileStates<DeathRound>(
                           tile.tile, TileStateKind::kDeaths, points.size()));
    for (uint32_t row = 0; row < points.size(); ++row) {
      if (answer.deaths[row] != kAlive) continue;
      answer.rows.push_back(row);
      answer.positions.push_back(points[row]);
    }
    answer.columns.Resize(answer.rows.size());
    std::vector<size_t> old;
    std::span<const RowRange> loaded = tile.rows;
    // The point of the unit that the first of those rows is.
    size_t first = tile.begin;
    auto label = std::lower_bound(labels.points.begin(), labels.points.end(),
                                  tile.begin);
    for (size_t s = 0; s < answer.rows.size(); ++s) {
      const uint32_t row = answer.rows[s];
      while (!loaded.empty() && loaded.front().end <= row) {
        first += loaded.front().end - loaded.front().begin;
        loaded = loaded.subspan(1);
      }
      const bool is_loaded = !loaded.empty() && loaded.front().begin <= row;
      const size_t i = is_loaded ? first + row - loaded.front().begin : 0;
      if (!is_loaded || work.core()[i] == 0) {
        old.push_back(s);
        continue;
      }
      while (*label < i) ++label;
      answer.columns.Set(s, labels.columns,
                         static_cast<size_t>(label - labels.points.begin()));
    }
    MAPSIEVE_RETURN_IF_ERROR(
        FillPrevious(tiles_.tiles()[tile.tile].key, old, answer));
    return answer;
  }

  /// Gives the survivors `old` of a tile the labels of before.
  absl::Status FillPrevious(const CellKey& key, std::span<const size_t> old,
                            Answer& answer) {
    if (old.empty()) return absl::OkStatus();
    MAPSIEVE_ASSIGN_OR_RETURN(const LabeledSurvivors before,
                              previous_.LoadSurvivors(key));
    size_t row = 0;
    for (const size_t s : old) {
      const LatticePoint& q = answer.positions[s];
      while (row < before.positions.size() &&
             MortonLess(before.positions[row], q)) {
        ++row;
      }
      if (row == before.positions.size() || before.positions[row] != q) {
        return absl::DataLossError(
            absl::StrCat("tile ", key.ToString(),
                         ": the result of before lacks the "
                         "point at lattice coordinates ",
                         q.x, ", ", q.y, ", ", q.z));
      }
      answer.columns.Set(s, before.columns, row);
    }
    return absl::OkStatus();
  }

  PreviousRun& previous_;
  const std::span<const TileChange> changes_;
  const SpdfOptions& options_;
  const SpdfConstants& constants_;
  const TilingOptions& tiling_;
  const ExecutionContext& context_;
  TileUnits tiles_;
  const int64_t tile_count_;
  const int cell_level_;
  /// To be filtered through all rounds.
  CellSet pending_;
  /// To be labeled anew, and tiles to be emitted.
  CellSet to_emit_;
  UpdateSummary summary_;
  int64_t done_ = 0;
};

}  // namespace

absl::StatusOr<UpdateSummary> UpdateTiles(TileStore& store,
                                          PreviousRun& previous,
                                          std::span<const TileChange> changes,
                                          const Lattice& lattice,
                                          const SpdfOptions& options,
                                          const TilingOptions& tiling,
                                          const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate(lattice));
  const SpdfConstants constants = MakeSpdfConstants(options, lattice);
  return TileUpdate(store, previous, changes, options, constants, tiling,
                    context)
      .Run();
}

}  // namespace mapsieve::core
