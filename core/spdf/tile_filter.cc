#include "core/spdf/tile_filter.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <unordered_set>
#include <utility>
#include <vector>

#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/spdf/tile_units.h"
#include "core/spdf/work_unit.h"

namespace mapsieve::core {
namespace {

/// What a later run needs to know of a visit that it does not make again.
struct Visit {
  /// A round, kVoterVisit or kAllRoundsVisit.
  int32_t round = 0;
  uint32_t unit = 0;
  /// Core points that remain flagged; of a round.
  int64_t flagged = 0;
  /// Rounds until the unit came to rest; of kAllRoundsVisit.
  int32_t round_count = 0;
  /// Tiles of the unit where points died; of a round.
  std::vector<uint32_t> dying_in;

  std::vector<std::byte> Format() const {
    ByteWriter writer;
    writer.Put(round);
    writer.Put(unit);
    writer.Put(flagged);
    writer.Put(round_count);
    for (const uint32_t tile : dying_in) writer.Put(tile);
    return std::move(writer.bytes());
  }
  /// Nothing if the bytes are no visit.
  static std::optional<Visit> Parse(std::span<const std::byte> bytes) {
    constexpr size_t kHeadBytes = 20;
    if (bytes.size() < kHeadBytes || bytes.size() % 4 != 0) return std::nullopt;
    Visit visit = {.round = LoadLittleEndian<int32_t>(bytes.data()),
                   .unit = LoadLittleEndian<uint32_t>(bytes.data() + 4),
                   .flagged = LoadLittleEndian<int64_t>(bytes.data() + 8),
                   .round_count = LoadLittleEndian<int32_t>(bytes.data() + 16)};
    for (size_t at = kHeadBytes; at < bytes.size(); at += 4) {
      visit.dying_in.push_back(LoadLittleEndian<uint32_t>(bytes.data() + at));
    }
    return visit;
  }
};
constexpr int32_t kVoterVisit = -1;
constexpr int32_t kAllRoundsVisit = -2;

/// All tiles, all rounds.
class TileFilter {
 public:
  TileFilter(TileStore& store, const SpdfOptions& options,
             const SpdfConstants& constants, const TilingOptions& tiling,
             const ExecutionContext& context)
      : options_(options),
        constants_(constants),
        context_(context),
        store_(store),
        tiles_(store, options, constants, context) {
    std::vector<size_t> all(tiles_.tiles().size());
    std::iota(all.begin(), all.end(), size_t{0});
    units_ = tiles_.Group(all, tiling.max_unit_points);
    if (IsResident() || options.rule != DensityRule::kPaper ||
        options.max_round_count == 0) {
      return;
    }
    // A unit takes no more memory for its halo.
    std::vector<Unit> smaller = tiles_.Group(
        all, static_cast<int64_t>(static_cast<double>(tiling.max_unit_points) /
                                  (1 + std::min(tiling.max_halo_share, 1.0))));
    makes_all_rounds_at_once_ =
        HaloShare(smaller, WideMargin()) <= tiling.max_halo_share;
    if (makes_all_rounds_at_once_) units_ = std::move(smaller);
  }

  absl::StatusOr<SpdfSummary> Run() {
    if (units_.empty()) return summary_;
    // Of a map that is one unit no state is stored.
    if (!IsResident()) finished_ = store_.FinishedVisits();
    const bool quota = options_.rule == DensityRule::kQuota;
    const int rounds = quota ? 1 : options_.max_round_count;
    const auto tile_count = static_cast<int64_t>(tiles_.tiles().size());
    total_visits_ = tile_count * (rounds + 2);
    if (quota) {
      MAPSIEVE_RETURN_IF_ERROR(RunQuota());
    } else {
      MAPSIEVE_RETURN_IF_ERROR(makes_all_rounds_at_once_ ? RunUnitByUnit()
                                                         : RunInLockStep());
    }
    done_visits_ = tile_count * rounds;
    MAPSIEVE_RETURN_IF_ERROR(ComputeVoters());
    MAPSIEVE_RETURN_IF_ERROR(CastAwareVotes());
    LeaveUnit();
    return summary_;
  }

 private:
  using Unit = TileUnits::Unit;

  bool IsResident() const { return units_.size() == 1; }

  /// The unit with its halo; the one held in memory if the map is one unit.
  absl::StatusOr<LoadedUnit*> LoadUnit(const Unit& unit, int64_t margin) {
    if (IsResident() && visited_.work != nullptr) return &visited_;
    LeaveUnit();
    MAPSIEVE_ASSIGN_OR_RETURN(visited_, tiles_.Load(unit, margin));
    return &visited_;
  }

  void LeaveUnit() {
    if (visited_.work != nullptr) {
      summary_.vote_count += visited_.work->vote_count();
    }
    visited_ = {};
  }

  template <typename T>
  absl::Status LoadStates(const LoadedUnit& loaded, TileStateKind kind,
                          bool with_halo, BulkVector<T>& states) {
    if (IsResident()) return absl::OkStatus();
    return tiles_.LoadStates(loaded, kind, with_halo, states);
  }
  template <typename T>
  absl::Status StoreStates(const LoadedUnit& loaded, TileStateKind kind,
                           const BulkVector<T>& states) {
    if (IsResident()) return absl::OkStatus();
    return tiles_.StoreStates(loaded, kind, states);
  }

  void CountVisit(const Unit& unit) {
    done_visits_ += static_cast<int64_t>(unit.size());
    context_.ReportProgress(done_visits_, total_visits_);
  }

  /// The visit of `unit` in `round` that an earlier run made, if it did.
  std::optional<Visit> TakeFinished(int32_t round, size_t unit) {
    if (next_finished_ == finished_.size()) return std::nullopt;
    std::optional<Visit> visit = Visit::Parse(finished_[next_finished_]);
    if (!visit.has_value() || visit->round != round || visit->unit != unit) {
      return std::nullopt;
    }
    ++next_finished_;
    return visit;
  }
  absl::Status Finish(const Visit& visit) {
    if (IsResident()) return absl::OkStatus();
    return store_.FinishVisit(visit.Format());
  }

  absl::Status RunQuota() {
    for (size_t u = 0; u < units_.size(); ++u) {
      const Unit& unit = units_[u];
      if (TakeFinished(1, u).has_value()) {
        CountVisit(unit);
        continue;
      }
      // The unit kept in memory serves the votes too, whose halo is wider.
      MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit * loaded,
                                LoadUnit(unit, constants_.density_steps));
      MAPSIEVE_RETURN_IF_ERROR(
          loaded->work->RunQuota(constants_.density_d2, context_));
      MAPSIEVE_RETURN_IF_ERROR(
          StoreStates(*loaded, TileStateKind::kDeaths, loaded->work->deaths()));
      MAPSIEVE_RETURN_IF_ERROR(
          Finish({.round = 1, .unit = static_cast<uint32_t>(u)}));
      CountVisit(unit);
    }
    summary_.round_count = 1;
    return absl::OkStatus();
  }

  /// What decides which points of a unit survive all rounds: each looks one
  /// reach farther.
  int64_t WideMargin() const {
    return int64_t{options_.max_round_count} * constants_.reach_steps;
  }

  /// About how many points lie within `margin` of units over how many there
  /// are.
  double HaloShare(const std::vector<Unit>& units, int64_t margin) const {
    double core = 0;
    double halo = 0;
    for (const Unit& unit : units) {
      for (const size_t t : unit) {
        core += static_cast<double>(tiles_.tiles()[t].point_count);
      }
      for (const auto& [t, near] :
           tiles_.HaloTiles(unit, tiles_.BoxesOf(unit), margin)) {
        const auto& [key, count] = tiles_.tiles()[t];
        halo +=
            static_cast<double>(count) *
            std::min(1.0, std::ldexp(static_cast<double>(margin), -key.level));
      }
    }
    return halo / core;
  }

  absl::Status RunUnitByUnit() {
    for (size_t u = 0; u < units_.size(); ++u) {
      std::optional<Visit> visit = TakeFinished(kAllRoundsVisit, u);
      if (!visit.has_value()) {
        MAPSIEVE_ASSIGN_OR_RETURN(visit, RunAllRounds(u));
      }
      summary_.round_count = std::max(summary_.round_count, visit->round_count);
      done_visits_ =
          static_cast<int64_t>(units_[u].back() + 1) * options_.max_round_count;
      context_.ReportProgress(done_visits_, total_visits_);
    }
    return absl::OkStatus();
  }

  absl::StatusOr<Visit> RunAllRounds(size_t number) {
    const Unit& unit = units_[number];
    MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit * loaded,
                              LoadUnit(unit, WideMargin()));
    WorkUnit& work = *loaded->work;
    // The halo is filtered too: it goes wrong from its outer border inwards, by
    // one reach a round, which never gets as far as the core.
    std::fill(work.core().begin(), work.core().end(), uint8_t{1});
    Visit visit = {.round = kAllRoundsVisit,
                   .unit = static_cast<uint32_t>(number),
                   .round_count = 1};
    for (int round = 1; round <= options_.max_round_count; ++round) {
      MAPSIEVE_ASSIGN_OR_RETURN(const WorkUnit::RoundCounts counts,
                                work.RunPaperRound(round, context_));
      if (counts.died == 0 && counts.flagged == 0) break;
      if (IsCoreActive(*loaded, round)) {
        visit.round_count = std::min(round + 1, options_.max_round_count);
      }
    }
    MAPSIEVE_RETURN_IF_ERROR(
        StoreStates(*loaded, TileStateKind::kDeaths, work.deaths()));
    MAPSIEVE_RETURN_IF_ERROR(Finish(visit));
    return visit;
  }

  /// Whether core points died in `round` or are flagged after it.
  static bool IsCoreActive(const LoadedUnit& loaded, int round) {
    WorkUnit& work = *loaded.work;
    for (const LoadedTile& tile : loaded.tiles) {
      if (!tile.is_core) continue;
      for (size_t i = tile.begin; i < tile.end; ++i) {
        if (work.deaths()[i] == round || work.round_states()[i].flags != 0) {
          return true;
        }
      }
    }
    return false;
  }

  absl::Status RunInLockStep() {
    // Per unit: whether core points are flagged, and tiles where some died in
    // the round before.
    std::vector<int64_t> flagged(units_.size(), 1);
    std::unordered_set<size_t> died_in;
    for (int round = 1; round <= options_.max_round_count; ++round) {
      std::unordered_set<size_t> dying_in;
      for (size_t u = 0; u < units_.size(); ++u) {
        const Unit& unit = units_[u];
        if (round == 1 || flagged[u] > 0 || IsNear(unit, died_in)) {
          std::optional<Visit> visit = TakeFinished(round, u);
          if (!visit.has_value()) {
            MAPSIEVE_ASSIGN_OR_RETURN(visit, RunRound(u, round));
          }
          flagged[u] = visit->flagged;
          dying_in.insert(visit->dying_in.begin(), visit->dying_in.end());
        }
        CountVisit(unit);
      }
      summary_.round_count = round;
      const bool any_flagged =
          std::any_of(flagged.begin(), flagged.end(),
                      [](int64_t count) { return count > 0; });
      if (dying_in.empty() && !any_flagged) break;
      died_in = std::move(dying_in);
    }
    return absl::OkStatus();
  }

  bool IsNear(const Unit& unit, const std::unordered_set<size_t>& tiles) const {
    for (const size_t t : tiles) {
      if (std::binary_search(unit.begin(), unit.end(), t)) return true;
    }
    for (const auto& [t, near] :
         tiles_.HaloTiles(unit, tiles_.BoxesOf(unit), constants_.reach_steps)) {
      if (tiles.contains(t)) return true;
    }
    return false;
  }

  absl::StatusOr<Visit> RunRound(size_t number, int round) {
    const Unit& unit = units_[number];
    Visit visit = {.round = round, .unit = static_cast<uint32_t>(number)};
    MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit * loaded,
                              LoadUnit(unit, constants_.reach_steps));
    WorkUnit& work = *loaded->work;
    if (round > 1) {
      MAPSIEVE_RETURN_IF_ERROR(LoadStates(*loaded, TileStateKind::kDeaths,
                                          /*with_halo=*/true, work.deaths()));
      MAPSIEVE_RETURN_IF_ERROR(LoadStates(*loaded, TileStateKind::kRounds,
                                          /*with_halo=*/false,
                                          work.round_states()));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const WorkUnit::RoundCounts counts,
                              work.RunPaperRound(round, context_));
    visit.flagged = counts.flagged;
    if (counts.died > 0) {
      for (const LoadedTile& tile : loaded->tiles) {
        if (!tile.is_core) continue;
        const auto deaths = work.deaths().begin();
        if (std::any_of(deaths + static_cast<ptrdiff_t>(tile.begin),
                        deaths + static_cast<ptrdiff_t>(tile.end),
                        [round](DeathRound d) { return d == round; })) {
          visit.dying_in.push_back(static_cast<uint32_t>(tile.tile));
        }
      }
    }
    MAPSIEVE_RETURN_IF_ERROR(
        StoreStates(*loaded, TileStateKind::kDeaths, work.deaths()));
    MAPSIEVE_RETURN_IF_ERROR(
        StoreStates(*loaded, TileStateKind::kRounds, work.round_states()));
    MAPSIEVE_RETURN_IF_ERROR(Finish(visit));
    return visit;
  }

  /// Deaths of core and halo; without rounds nobody died.
  absl::Status LoadFinalDeaths(LoadedUnit& loaded) {
    if (summary_.round_count == 0) return absl::OkStatus();
    return LoadStates(loaded, TileStateKind::kDeaths, /*with_halo=*/true,
                      loaded.work->deaths());
  }

  absl::Status ComputeVoters() {
    for (size_t u = 0; u < units_.size(); ++u) {
      const Unit& unit = units_[u];
      if (TakeFinished(kVoterVisit, u).has_value()) {
        CountVisit(unit);
        continue;
      }
      MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit * loaded,
                                LoadUnit(unit, constants_.reach_steps));
      MAPSIEVE_RETURN_IF_ERROR(LoadFinalDeaths(*loaded));
      MAPSIEVE_RETURN_IF_ERROR(loaded->work->ComputeVoters(context_));
      MAPSIEVE_RETURN_IF_ERROR(
          StoreStates(*loaded, TileStateKind::kVoters, loaded->work->voters()));
      MAPSIEVE_RETURN_IF_ERROR(
          Finish({.round = kVoterVisit, .unit = static_cast<uint32_t>(u)}));
      CountVisit(unit);
    }
    return absl::OkStatus();
  }

  absl::Status CastAwareVotes() {
    for (const Unit& unit : units_) {
      MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit * loaded,
                                LoadUnit(unit, constants_.reach_steps));
      WorkUnit& work = *loaded->work;
      MAPSIEVE_RETURN_IF_ERROR(LoadFinalDeaths(*loaded));
      MAPSIEVE_RETURN_IF_ERROR(LoadStates(*loaded, TileStateKind::kVoters,
                                          /*with_halo=*/true, work.voters()));
      MAPSIEVE_ASSIGN_OR_RETURN(const WorkUnit::Labeled labeled,
                                work.CastAwareVotes(context_));
      MAPSIEVE_RETURN_IF_ERROR(tiles_.Emit(*loaded, labeled, summary_));
      CountVisit(unit);
    }
    return absl::OkStatus();
  }

  const SpdfOptions& options_;
  const SpdfConstants& constants_;
  const ExecutionContext& context_;
  TileStore& store_;
  TileUnits tiles_;
  std::vector<Unit> units_;
  bool makes_all_rounds_at_once_ = false;
  /// Visits of an earlier run, and which of them comes next.
  std::vector<std::vector<std::byte>> finished_;
  size_t next_finished_ = 0;
  LoadedUnit visited_;
  SpdfSummary summary_;
  int64_t done_visits_ = 0;
  int64_t total_visits_ = 0;
};

}  // namespace

absl::StatusOr<SpdfSummary> FilterTiles(TileStore& store,
                                        const Lattice& lattice,
                                        const SpdfOptions& options,
                                        const TilingOptions& tiling,
                                        const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate(lattice));
  const SpdfConstants constants = MakeSpdfConstants(options, lattice);
  return TileFilter(store, options, constants, tiling, context).Run();
}

}  // namespace mapsieve::core
