#include "core/spdf/tile_filter.h"

#include <algorithm>
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
  /// A round, or kVoterVisit.
  int32_t round = 0;
  uint32_t unit = 0;
  int64_t flagged = 0;
  /// Tiles of the unit where points died.
  std::vector<uint32_t> dying_in;

  std::vector<std::byte> Format() const {
    ByteWriter writer;
    writer.Put(round);
    writer.Put(unit);
    writer.Put(flagged);
    for (const uint32_t tile : dying_in) writer.Put(tile);
    return std::move(writer.bytes());
  }
  /// Nothing if the bytes are no visit.
  static std::optional<Visit> Parse(std::span<const std::byte> bytes) {
    constexpr size_t kHeadBytes = 16;
    if (bytes.size() < kHeadBytes || bytes.size() % 4 != 0) return std::nullopt;
    Visit visit = {.round = LoadLittleEndian<int32_t>(bytes.data()),
                   .unit = LoadLittleEndian<uint32_t>(bytes.data() + 4),
                   .flagged = LoadLittleEndian<int64_t>(bytes.data() + 8)};
    for (size_t at = kHeadBytes; at < bytes.size(); at += 4) {
      visit.dying_in.push_back(LoadLittleEndian<uint32_t>(bytes.data() + at));
    }
    return visit;
  }
};
constexpr int32_t kVoterVisit = -1;

/// All tiles, all rounds, in lock-step.
class LockStepFilter {
 public:
  LockStepFilter(TileStore& store, const SpdfOptions& options,
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
    // Of a map that is one unit no state is stored.
    if (!IsResident()) finished_ = store.FinishedVisits();
  }

  absl::StatusOr<SpdfSummary> Run() {
    if (units_.empty()) return summary_;
    const bool quota = options_.rule == DensityRule::kQuota;
    const int rounds = quota ? 1 : options_.max_round_count;
    const auto tile_count = static_cast<int64_t>(tiles_.tiles().size());
    total_visits_ = tile_count * (rounds + 2);
    if (quota) {
      MAPSIEVE_RETURN_IF_ERROR(RunQuota());
    } else {
      MAPSIEVE_RETURN_IF_ERROR(RunRounds());
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

  absl::Status RunRounds() {
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
         tiles_.HaloTiles(unit, constants_.reach_steps)) {
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
  return LockStepFilter(store, options, constants, tiling, context).Run();
}

}  // namespace mapsieve::core
