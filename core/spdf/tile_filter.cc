#include "core/spdf/tile_filter.h"

#include <algorithm>
#include <cstring>
#include <memory>
#include <optional>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/spdf/work_unit.h"

namespace mapsieve::core {
namespace {

/// Coordinates of a unit are int32 relative to its first tile's corner.
constexpr int64_t kMaxUnitExtent = PointIndex::kMaxCoordinate;

/// Points of tiles that are loaded, or answered for, at a time.
constexpr int64_t kBatchPointsPerWorker = 1 << 16;

/// One tile's part of a loaded unit.
struct LoadedTile {
  size_t tile = 0;
  bool is_core = false;
  /// The tile's points in the unit: [begin, end).
  size_t begin = 0;
  size_t end = 0;
  /// Of a halo tile, the rows of its points that were loaded.
  std::vector<uint32_t> rows;
};

struct LoadedUnit {
  std::vector<LoadedTile> tiles;
  std::unique_ptr<WorkUnit> unit;
};

class LockStepFilter {
 public:
  LockStepFilter(TileStore& store, const SpdfOptions& options,
                 const SpdfConstants& constants, const TilingOptions& tiling,
                 const ExecutionContext& context)
      : store_(store),
        options_(options),
        constants_(constants),
        context_(context),
        tiles_(store.Tiles()) {
    for (size_t t = 0; t < tiles_.size(); ++t) {
      tile_numbers_.emplace(tiles_[t].key, t);
    }
    MakeUnits(tiling.max_unit_points);
  }

  absl::StatusOr<SpdfSummary> Run() {
    if (tiles_.empty()) return summary_;
    const bool quota = options_.rule == DensityRule::kQuota;
    const int rounds = quota ? 1 : options_.max_round_count;
    total_visits_ = static_cast<int64_t>(tiles_.size()) * (rounds + 2);
    if (quota) {
      MAPSIEVE_RETURN_IF_ERROR(RunQuota());
    } else {
      MAPSIEVE_RETURN_IF_ERROR(RunRounds());
    }
    done_visits_ = static_cast<int64_t>(tiles_.size()) * rounds;
    MAPSIEVE_RETURN_IF_ERROR(ComputeVoters());
    MAPSIEVE_RETURN_IF_ERROR(CastAwareVotes());
    return summary_;
  }

 private:
  using Unit = std::pair<size_t, size_t>;  // tiles [first, second)

  void MakeUnits(int64_t max_unit_points) {
    size_t begin = 0;
    int64_t points = 0;
    LatticeBox box;
    for (size_t t = 0; t < tiles_.size(); ++t) {
      const LatticeBox tile = tiles_[t].key.box();
      if (t > begin) {
        LatticeBox grown = Union(box, tile);
        if (points + tiles_[t].point_count > max_unit_points ||
            IsTooWide(grown)) {
          units_.emplace_back(begin, t);
          begin = t;
          points = 0;
          box = tile;
        } else {
          box = grown;
        }
      } else {
        box = tile;
      }
      points += tiles_[t].point_count;
    }
    if (begin < tiles_.size()) units_.emplace_back(begin, tiles_.size());
  }

  static LatticeBox Union(const LatticeBox& a, const LatticeBox& b) {
    return {{std::min(a.min.x, b.min.x), std::min(a.min.y, b.min.y),
             std::min(a.min.z, b.min.z)},
            {std::max(a.max.x, b.max.x), std::max(a.max.y, b.max.y),
             std::max(a.max.z, b.max.z)}};
  }
  static bool IsTooWide(const LatticeBox& box) {
    return box.max.x - box.min.x > kMaxUnitExtent ||
           box.max.y - box.min.y > kMaxUnitExtent ||
           box.max.z - box.min.z > kMaxUnitExtent;
  }

  bool IsResident() const { return units_.size() == 1; }

  /// Tiles outside `unit` with a cell within `margin` steps of it, and for
  /// each the core tiles that near.
  std::unordered_map<size_t, std::vector<size_t>> HaloTiles(
      const Unit& unit, int64_t margin) const {
    std::unordered_map<size_t, std::vector<size_t>> halo;
    if (IsResident()) return halo;
    const int level = tiles_[0].key.level;
    const int64_t reach = ((margin - 1) >> level) + 1;
    const auto is_core = [&](size_t t) {
      return t >= unit.first && t < unit.second;
    };
    for (size_t core = unit.first; core < unit.second; ++core) {
      const CellKey& key = tiles_[core].key;
      const int64_t side = 2 * reach + 1;
      if (side * side * side <= static_cast<int64_t>(tiles_.size())) {
        for (int64_t dz = -reach; dz <= reach; ++dz) {
          for (int64_t dy = -reach; dy <= reach; ++dy) {
            for (int64_t dx = -reach; dx <= reach; ++dx) {
              const auto found = tile_numbers_.find(
                  {level, key.x + dx, key.y + dy, key.z + dz});
              if (found != tile_numbers_.end() && !is_core(found->second)) {
                halo[found->second].push_back(core);
              }
            }
          }
        }
        continue;
      }
      const LatticeBox near = key.box().Grown(margin);
      for (size_t t = 0; t < tiles_.size(); ++t) {
        if (!is_core(t) && near.Intersects(tiles_[t].key.box())) {
          halo[t].push_back(core);
        }
      }
    }
    return halo;
  }

  absl::StatusOr<LoadedUnit> Load(const Unit& unit, int64_t margin) {
    LoadedUnit loaded;
    auto halo = HaloTiles(unit, margin);
    std::vector<size_t> wanted;
    for (const auto& [tile, near] : halo) wanted.push_back(tile);
    for (size_t t = unit.first; t < unit.second; ++t) wanted.push_back(t);
    std::sort(wanted.begin(), wanted.end());
    loaded.unit = std::make_unique<WorkUnit>(tiles_[unit.first].key.corner(),
                                             options_, constants_);
    WorkUnit& work = *loaded.unit;
    size_t core_points = 0;
    for (size_t t = unit.first; t < unit.second; ++t) {
      core_points += static_cast<size_t>(tiles_[t].point_count);
    }
    work.Reserve(core_points);
    for (const size_t t : wanted) {
      loaded.tiles.push_back(
          {.tile = t, .is_core = t >= unit.first && t < unit.second});
    }
    const absl::Status status =
        ForEachBatch(loaded.tiles, [&](std::span<LoadedTile> batch) {
          return LoadBatch(halo, margin, batch, work);
        });
    if (!status.ok()) return status;
    return loaded;
  }

  /// Appends the points of `batch` to `work`; of a halo tile, those within
  /// `margin` steps of the core tiles that `halo` names.
  absl::Status LoadBatch(
      const std::unordered_map<size_t, std::vector<size_t>>& halo,
      int64_t margin, std::span<LoadedTile> batch, WorkUnit& work) {
    size_t room = 0;
    std::vector<std::span<LatticePoint>> points;
    for (const LoadedTile& tile : batch) {
      const auto count = static_cast<size_t>(tiles_[tile.tile].point_count);
      points.push_back({static_cast<LatticePoint*>(nullptr), count});
      room += count;
    }
    batch_points_.resize(std::max(batch_points_.size(), room));
    room = 0;
    for (std::span<LatticePoint>& part : points) {
      part = std::span(batch_points_).subspan(room, part.size());
      room += part.size();
    }
    const auto count = static_cast<int64_t>(batch.size());
    MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
        *context_.executor, count, [&](int64_t i) -> absl::Status {
          const auto b = static_cast<size_t>(i);
          LoadedTile& tile = batch[b];
          MAPSIEVE_ASSIGN_OR_RETURN(
              const int64_t size,
              store_.LoadPoints(tiles_[tile.tile].key, points[b]));
          points[b] = points[b].first(static_cast<size_t>(size));
          if (!tile.is_core) {
            tile.rows = KeepNear(halo.at(tile.tile), margin, points[b]);
          }
          return absl::OkStatus();
        }));
    for (size_t b = 0; b < batch.size(); ++b) {
      batch[b].begin = work.size();
      work.Grow(points[b].size(), batch[b].is_core);
      batch[b].end = work.size();
    }
    context_.executor->ParallelFor(count, [&](int64_t i) {
      const auto b = static_cast<size_t>(i);
      work.SetPoints(batch[b].begin, points[b]);
    });
    return absl::OkStatus();
  }

  /// Leaves in `points`, those of a halo tile, the ones within `margin` steps
  /// of any of the tiles `core`, and returns their rows.
  std::vector<uint32_t> KeepNear(const std::vector<size_t>& core,
                                 int64_t margin,
                                 std::span<LatticePoint>& points) const {
    std::vector<uint32_t> rows;
    for (uint32_t row = 0; row < points.size(); ++row) {
      for (const size_t t : core) {
        if (tiles_[t].key.box().Grown(margin).Contains(points[row])) {
          points[rows.size()] = points[row];
          rows.push_back(row);
          break;
        }
      }
    }
    points = points.first(rows.size());
    return rows;
  }

  /// Calls use(batch) for adjacent `tiles`: enough to keep every worker busy,
  /// few enough for copies of their points to be small beside a unit.
  template <typename Use>
  absl::Status ForEachBatch(std::span<LoadedTile> tiles, const Use& use) const {
    const int64_t batch_points =
        kBatchPointsPerWorker * context_.executor->worker_count();
    size_t begin = 0;
    int64_t points = 0;
    for (size_t t = 0; t < tiles.size(); ++t) {
      points += tiles_[tiles[t].tile].point_count;
      if (points < batch_points && t + 1 < tiles.size()) continue;
      MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
      MAPSIEVE_RETURN_IF_ERROR(use(tiles.subspan(begin, t + 1 - begin)));
      begin = t + 1;
      points = 0;
    }
    return absl::OkStatus();
  }

  /// The unit with its halo; the one held in memory if the map is one unit.
  absl::StatusOr<LoadedUnit*> Visit(const Unit& unit, int64_t margin) {
    if (IsResident() && visited_.unit != nullptr) return &visited_;
    visited_ = {};
    MAPSIEVE_ASSIGN_OR_RETURN(visited_, Load(unit, margin));
    return &visited_;
  }

  template <typename T>
  absl::Status LoadStates(const LoadedUnit& loaded, TileStateKind kind,
                          bool with_halo, BulkVector<T>& states) {
    if (IsResident()) return absl::OkStatus();
    states.resize(loaded.unit->size());
    return TryParallelFor(
        *context_.executor, static_cast<int64_t>(loaded.tiles.size()),
        [&](int64_t i) {
          const LoadedTile& tile = loaded.tiles[static_cast<size_t>(i)];
          if (!tile.is_core && (!with_halo || tile.rows.empty())) {
            return absl::OkStatus();
          }
          return LoadTileStates(tile, kind, states);
        });
  }

  template <typename T>
  absl::Status LoadTileStates(const LoadedTile& tile, TileStateKind kind,
                              BulkVector<T>& states) {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> bytes,
                              store_.LoadState(tiles_[tile.tile].key, kind));
    const size_t count = bytes.size() / sizeof(T);
    const size_t needed =
        tile.is_core ? tile.end - tile.begin : size_t{tile.rows.back()} + 1;
    if (count < needed) {
      return absl::InternalError(
          absl::StrCat("state of tile ", tiles_[tile.tile].key.ToString(),
                       " holds ", count, " points, expected ", needed));
    }
    if (tile.is_core) {
      std::memcpy(states.data() + tile.begin, bytes.data(), needed * sizeof(T));
      return absl::OkStatus();
    }
    for (size_t i = 0; i < tile.rows.size(); ++i) {
      std::memcpy(&states[tile.begin + i],
                  bytes.data() + tile.rows[i] * sizeof(T), sizeof(T));
    }
    return absl::OkStatus();
  }

  template <typename T>
  absl::Status StoreStates(const LoadedUnit& loaded, TileStateKind kind,
                           const BulkVector<T>& states) {
    if (IsResident()) return absl::OkStatus();
    for (const LoadedTile& tile : loaded.tiles) {
      if (!tile.is_core) continue;
      MAPSIEVE_RETURN_IF_ERROR(
          store_.StoreState(tiles_[tile.tile].key, kind,
                            std::as_bytes(std::span(states).subspan(
                                tile.begin, tile.end - tile.begin))));
    }
    return absl::OkStatus();
  }

  void CountVisit(const Unit& unit) {
    done_visits_ += static_cast<int64_t>(unit.second - unit.first);
    context_.ReportProgress(done_visits_, total_visits_);
  }

  absl::Status RunQuota() {
    for (const Unit& unit : units_) {
      // The unit kept in memory serves the votes too, whose halo is wider.
      MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit * loaded,
                                Visit(unit, constants_.density_steps));
      MAPSIEVE_RETURN_IF_ERROR(loaded->unit->RunQuota(context_));
      MAPSIEVE_RETURN_IF_ERROR(
          StoreStates(*loaded, TileStateKind::kDeaths, loaded->unit->deaths()));
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
          MAPSIEVE_RETURN_IF_ERROR(RunRound(unit, round, flagged[u], dying_in));
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
      if (t >= unit.first && t < unit.second) return true;
    }
    for (const auto& [t, near] : HaloTiles(unit, constants_.reach_steps)) {
      if (tiles.contains(t)) return true;
    }
    return false;
  }

  absl::Status RunRound(const Unit& unit, int round, int64_t& flagged,
                        std::unordered_set<size_t>& dying_in) {
    MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit * loaded,
                              Visit(unit, constants_.reach_steps));
    WorkUnit& work = *loaded->unit;
    if (round > 1) {
      MAPSIEVE_RETURN_IF_ERROR(LoadStates(*loaded, TileStateKind::kDeaths,
                                          /*with_halo=*/true, work.deaths()));
      MAPSIEVE_RETURN_IF_ERROR(LoadStates(*loaded, TileStateKind::kRounds,
                                          /*with_halo=*/false,
                                          work.round_states()));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const WorkUnit::RoundCounts counts,
                              work.RunPaperRound(round, context_));
    flagged = counts.flagged;
    if (counts.died > 0) {
      for (const LoadedTile& tile : loaded->tiles) {
        if (!tile.is_core) continue;
        const auto deaths = work.deaths().begin();
        if (std::any_of(deaths + static_cast<ptrdiff_t>(tile.begin),
                        deaths + static_cast<ptrdiff_t>(tile.end),
                        [round](DeathRound d) { return d == round; })) {
          dying_in.insert(tile.tile);
        }
      }
    }
    MAPSIEVE_RETURN_IF_ERROR(
        StoreStates(*loaded, TileStateKind::kDeaths, work.deaths()));
    MAPSIEVE_RETURN_IF_ERROR(
        StoreStates(*loaded, TileStateKind::kRounds, work.round_states()));
    return absl::OkStatus();
  }

  /// Deaths of core and halo; without rounds nobody died.
  absl::Status LoadFinalDeaths(LoadedUnit& loaded) {
    if (summary_.round_count == 0) return absl::OkStatus();
    return LoadStates(loaded, TileStateKind::kDeaths, /*with_halo=*/true,
                      loaded.unit->deaths());
  }

  absl::Status ComputeVoters() {
    for (const Unit& unit : units_) {
      MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit * loaded,
                                Visit(unit, constants_.reach_steps));
      MAPSIEVE_RETURN_IF_ERROR(LoadFinalDeaths(*loaded));
      MAPSIEVE_RETURN_IF_ERROR(loaded->unit->ComputeVoters(context_));
      MAPSIEVE_RETURN_IF_ERROR(
          StoreStates(*loaded, TileStateKind::kVoters, loaded->unit->voters()));
      CountVisit(unit);
    }
    return absl::OkStatus();
  }

  absl::Status CastAwareVotes() {
    for (const Unit& unit : units_) {
      MAPSIEVE_ASSIGN_OR_RETURN(LoadedUnit * loaded,
                                Visit(unit, constants_.reach_steps));
      WorkUnit& work = *loaded->unit;
      MAPSIEVE_RETURN_IF_ERROR(LoadFinalDeaths(*loaded));
      MAPSIEVE_RETURN_IF_ERROR(LoadStates(*loaded, TileStateKind::kVoters,
                                          /*with_halo=*/true, work.voters()));
      MAPSIEVE_ASSIGN_OR_RETURN(const WorkUnit::Labeled labeled,
                                work.CastAwareVotes(context_));
      MAPSIEVE_RETURN_IF_ERROR(Emit(*loaded, labeled));
      CountVisit(unit);
    }
    return absl::OkStatus();
  }

  absl::Status Emit(LoadedUnit& loaded, const WorkUnit::Labeled& labeled) {
    std::vector<LoadedTile> core;
    for (const LoadedTile& tile : loaded.tiles) {
      if (tile.is_core) core.push_back(tile);
    }
    return ForEachBatch(core, [&](std::span<LoadedTile> batch) {
      return EmitBatch(*loaded.unit, batch, labeled);
    });
  }

  absl::Status EmitBatch(const WorkUnit& unit,
                         std::span<const LoadedTile> tiles,
                         const WorkUnit::Labeled& labeled) {
    const auto survivor_at = [&](size_t point) {
      return static_cast<size_t>(std::lower_bound(labeled.points.begin(),
                                                  labeled.points.end(), point) -
                                 labeled.points.begin());
    };
    const size_t first = survivor_at(tiles.front().begin);
    const size_t size = survivor_at(tiles.back().end) - first;
    batch_rows_.resize(std::max(batch_rows_.size(), size));
    batch_points_.resize(std::max(batch_points_.size(), size));
    std::vector<TileResult> results(tiles.size());
    context_.executor->ParallelFor(
        static_cast<int64_t>(tiles.size()), [&](int64_t t) {
          const LoadedTile& tile = tiles[static_cast<size_t>(t)];
          const size_t begin = survivor_at(tile.begin);
          const size_t end = survivor_at(tile.end);
          for (size_t i = begin; i < end; ++i) {
            batch_rows_[i - first] =
                labeled.points[i] - static_cast<uint32_t>(tile.begin);
            batch_points_[i - first] = unit.SurvivorPosition(i);
          }
          results[static_cast<size_t>(t)] = {
              .key = tiles_[tile.tile].key,
              .point_count = static_cast<int64_t>(tile.end - tile.begin),
              .rows =
                  std::span(batch_rows_).subspan(begin - first, end - begin),
              .positions =
                  std::span(batch_points_).subspan(begin - first, end - begin),
              .columns = labeled.columns.Slice(begin, end)};
        });
    for (const TileResult& result : results) {
      summary_.point_count += result.point_count;
      summary_.survivor_count += static_cast<int64_t>(result.rows.size());
      for (const Label label : result.columns.label) {
        ++summary_.label_counts[static_cast<size_t>(label)];
      }
      summary_.max_confidence =
          UpdateMaxConfidence(result.columns, summary_.max_confidence);
      MAPSIEVE_RETURN_IF_ERROR(store_.Emit(result));
    }
    return absl::OkStatus();
  }

  TileStore& store_;
  const SpdfOptions& options_;
  const SpdfConstants& constants_;
  const ExecutionContext& context_;
  const std::vector<TileInfo> tiles_;
  std::unordered_map<CellKey, size_t, CellKeyHash> tile_numbers_;
  std::vector<Unit> units_;
  LoadedUnit visited_;
  /// Of a batch of tiles; kept from batch to batch, since fresh memory is dear.
  BulkVector<LatticePoint> batch_points_;
  BulkVector<uint32_t> batch_rows_;
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
