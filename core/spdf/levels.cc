#include "core/spdf/levels.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <numeric>
#include <unordered_map>
#include <utility>

#include "core/base/bulk_vector.h"
#include "core/base/status.h"
#include "core/spdf/integer_root.h"
#include "core/spdf/memory_tiles.h"
#include "core/spdf/tile_units.h"
#include "core/spdf/work_unit.h"

namespace mapsieve::core {
namespace {

/// The points of one level, given in cells, as the nodes of the next one.
class LevelNodes final : public PointTiles {
 public:
  /// `parts`: cells of `level`, in Morton order, at most as coarse as nodes
  /// are.
  LevelNodes(LevelStore& store, int level, std::vector<TileInfo> parts,
             int node_level)
      : store_(store), level_(level), parts_(std::move(parts)) {
    for (size_t p = 0; p < parts_.size(); ++p) {
      const CellKey node = parts_[p].key.Ancestor(node_level);
      if (nodes_.empty() || nodes_.back().key != node) {
        nodes_.push_back({node, 0});
        parts_of_[node].first = p;
      }
      nodes_.back().point_count += parts_[p].point_count;
      parts_of_[node].second = p + 1;
    }
  }

  std::vector<TileInfo> Tiles() const override { return nodes_; }

  absl::StatusOr<int64_t> LoadPoints(const CellKey& key,
                                     std::span<LatticePoint> room) override {
    const auto [begin, end] = parts_of_.at(key);
    size_t size = 0;
    for (size_t p = begin; p < end; ++p) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          const int64_t count,
          store_.LoadPoints(
              level_, parts_[p].key,
              room.subspan(size, static_cast<size_t>(parts_[p].point_count))));
      size += static_cast<size_t>(count);
    }
    return static_cast<int64_t>(size);
  }

 private:
  LevelStore& store_;
  const int level_;
  const std::vector<TileInfo> parts_;
  std::vector<TileInfo> nodes_;
  /// Each node's parts [first, second).
  std::unordered_map<CellKey, std::pair<size_t, size_t>, CellKeyHash> parts_of_;
};

/// Makes level `level` of the points of the finer one that `nodes` hold, and
/// returns the nodes that have any.
absl::StatusOr<std::vector<TileInfo>> MakeLevel(
    int level, LevelNodes& nodes, LevelStore& store, const Lattice& lattice,
    const SpdfOptions& options, const TilingOptions& tiling,
    const ExecutionContext& context) {
  const SpdfConstants constants = MakeSpdfConstants(options, lattice);
  PointUnits units(nodes, options, constants, context);
  std::vector<size_t> all(units.tiles().size());
  std::iota(all.begin(), all.end(), size_t{0});
  const int64_t radius_d2 = LevelRadiusD2(options, lattice, level);
  std::vector<TileInfo> cells;
  BulkVector<LatticePoint> points;
  for (const PointUnits::Unit& unit :
       units.Group(all, tiling.max_unit_points)) {
    MAPSIEVE_ASSIGN_OR_RETURN(const LoadedUnit loaded,
                              units.Load(unit, CeilRoot(radius_d2)));
    WorkUnit& work = *loaded.work;
    MAPSIEVE_RETURN_IF_ERROR(work.RunQuota(radius_d2, context));
    for (const LoadedTile& tile : loaded.tiles) {
      if (!tile.is_core) continue;
      points.resize(tile.end - tile.begin);
      size_t size = 0;
      for (size_t i = tile.begin; i < tile.end; ++i) {
        points[size] = work.SurvivorPosition(i);
        size += work.deaths()[i] == kAlive ? 1 : 0;
      }
      points.resize(size);
      if (points.empty()) continue;
      const CellKey& cell = units.tiles()[tile.tile].key;
      MAPSIEVE_RETURN_IF_ERROR(store.StorePoints(level, cell, points));
      cells.push_back({cell, static_cast<int64_t>(points.size())});
    }
  }
  return cells;
}

/// The points of one level one after the other, in Morton order.
class LevelStream {
 public:
  LevelStream(LevelStore& store, int level, std::vector<TileInfo> cells)
      : store_(store), level_(level), cells_(std::move(cells)) {}

  /// Goes to the first point.
  absl::Status Start() { return LoadCell(); }
  bool IsAt(const LatticePoint& q) const {
    return next_ < points_.size() && points_[next_] == q;
  }
  absl::Status Advance() {
    return ++next_ < points_.size() ? absl::OkStatus() : LoadCell();
  }
  bool IsAtEnd() const { return next_ == points_.size(); }

 private:
  absl::Status LoadCell() {
    points_.clear();
    next_ = 0;
    if (next_cell_ == cells_.size()) return absl::OkStatus();
    const TileInfo& cell = cells_[next_cell_++];
    points_.resize(static_cast<size_t>(cell.point_count));
    return store_.LoadPoints(level_, cell.key, points_).status();
  }

  LevelStore& store_;
  const int level_;
  const std::vector<TileInfo> cells_;
  size_t next_cell_ = 0;
  BulkVector<LatticePoint> points_;
  size_t next_ = 0;
};

/// Tells the store the depths of its points. `streams`: the levels from 1 on.
absl::StatusOr<DepthCounts> EmitDepths(LevelStore& store,
                                       std::vector<LevelStream>& streams,
                                       const ExecutionContext& context) {
  for (LevelStream& stream : streams) {
    MAPSIEVE_RETURN_IF_ERROR(stream.Start());
  }
  DepthCounts counts{};
  BulkVector<LatticePoint> points;
  std::vector<uint8_t> depths;
  for (const TileInfo& tile : store.Tiles()) {
    MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
    points.resize(static_cast<size_t>(tile.point_count));
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size,
                              store.LoadPoints(0, tile.key, points));
    depths.clear();
    for (size_t i = 0; i < static_cast<size_t>(size); ++i) {
      // Levels are nested and in one order: a point is the next of each level
      // that it is part of.
      size_t depth = 0;
      for (; depth < streams.size() && streams[depth].IsAt(points[i]);
           ++depth) {
        MAPSIEVE_RETURN_IF_ERROR(streams[depth].Advance());
      }
      ++counts[depth];
      depths.push_back(static_cast<uint8_t>(depth));
    }
    MAPSIEVE_RETURN_IF_ERROR(store.EmitDepths(tile.key, depths));
  }
  for (size_t i = 0; i < streams.size(); ++i) {
    if (!streams[i].IsAtEnd()) {
      return absl::InternalError(absl::StrCat(
          "level ", i + 1, " holds a point that its tile does not have"));
    }
  }
  return counts;
}

/// Points in memory as tiles that are one unit.
class MemoryLevelStore final : public LevelStore {
 public:
  MemoryLevelStore(std::span<const LatticePoint> points, Executor& executor) {
    for (const MemoryTile& tile : MakeMemoryTiles(
             points.size(),
             [&](size_t i) -> const LatticePoint& { return points[i]; },
             executor)) {
      const size_t size = tile.end - tile.begin;
      tiles_.push_back({tile.key, static_cast<int64_t>(size)});
      levels_[0][tile.key] = points.subspan(tile.begin, size);
    }
    depths_.reserve(points.size());
  }

  std::vector<TileInfo> Tiles() const override { return tiles_; }

  absl::StatusOr<int64_t> LoadPoints(int level, const CellKey& cell,
                                     std::span<LatticePoint> room) override {
    const auto points = levels_[static_cast<size_t>(level)].at(cell);
    std::copy(points.begin(), points.end(), room.begin());
    return static_cast<int64_t>(points.size());
  }

  absl::Status StorePoints(int level, const CellKey& cell,
                           std::span<const LatticePoint> points) override {
    stored_.emplace_back(points.begin(), points.end());
    levels_[static_cast<size_t>(level)][cell] = stored_.back();
    return absl::OkStatus();
  }

  absl::Status EmitDepths(const CellKey&,
                          std::span<const uint8_t> depths) override {
    depths_.insert(depths_.end(), depths.begin(), depths.end());
    return absl::OkStatus();
  }

  std::vector<uint8_t> TakeDepths() { return std::move(depths_); }

 private:
  std::vector<TileInfo> tiles_;
  std::vector<BulkVector<LatticePoint>> stored_;
  std::array<std::map<CellKey, std::span<const LatticePoint>, CellKeyLess>,
             kMaxDepth + 1>
      levels_;
  std::vector<uint8_t> depths_;
};

}  // namespace

int64_t LevelRadiusD2(const SpdfOptions& options, const Lattice& lattice,
                      int level) {
  // Doubling is exact, so that level 0 has the filter's own radius.
  return RadiusD2(std::ldexp(options.density_radius_m, level), lattice);
}

double LevelSpacing(const SpdfOptions& options, int level) {
  return std::ldexp(options.density_radius_m, level) *
         std::sqrt(std::numbers::pi / options.neighbor_count);
}

int LevelOfSpacing(const SpdfOptions& options, double spacing_m) {
  int level = 0;
  while (level < kMaxDepth && LevelSpacing(options, level + 1) <= spacing_m) {
    ++level;
  }
  return level;
}

absl::StatusOr<DepthCounts> ComputeDepths(LevelStore& store,
                                          const Lattice& lattice,
                                          const SpdfOptions& options,
                                          const TilingOptions& tiling,
                                          const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate(lattice));
  std::vector<TileInfo> cells = store.Tiles();
  int node_level = cells.empty() ? 0 : cells[0].key.level;
  std::vector<LevelStream> streams;
  for (int level = 1; level <= kMaxDepth; ++level) {
    LevelNodes nodes(store, level - 1, std::move(cells), node_level);
    MAPSIEVE_ASSIGN_OR_RETURN(cells, MakeLevel(level, nodes, store, lattice,
                                               options, tiling, context));
    streams.emplace_back(store, level, cells);
    node_level =
        std::max(node_level, std::min(node_level + 1, kMaxMemoryTileLevel));
    context.ReportProgress(level, kMaxDepth);
  }
  return EmitDepths(store, streams, context);
}

absl::StatusOr<std::vector<uint8_t>> ComputeDepths(
    std::span<const LatticePoint> points, const Lattice& lattice,
    const SpdfOptions& options, const ExecutionContext& context) {
  MemoryLevelStore store(points, *context.executor);
  const TilingOptions tiling = {.max_unit_points =
                                    static_cast<int64_t>(points.size())};
  MAPSIEVE_RETURN_IF_ERROR(
      ComputeDepths(store, lattice, options, tiling, context).status());
  return store.TakeDepths();
}

}  // namespace mapsieve::core
