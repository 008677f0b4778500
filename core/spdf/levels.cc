#include "core/spdf/levels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <map>
#include <numbers>
#include <optional>
#include <unordered_map>
#include <utility>

#include "core/base/bulk_vector.h"
#include "core/base/status.h"
#include "core/geometry/morton.h"
#include "core/spdf/integer_root.h"
#include "core/spdf/memory_tiles.h"
#include "core/spdf/tile_units.h"
#include "core/spdf/work_unit.h"

namespace mapsieve::core {
namespace {

/// What both hold; of boxes that intersect.
LatticeBox Intersection(const LatticeBox& a, const LatticeBox& b) {
  return {{std::max(a.min.x, b.min.x), std::max(a.min.y, b.min.y),
           std::max(a.min.z, b.min.z)},
          {std::min(a.max.x, b.max.x), std::min(a.max.y, b.max.y),
           std::min(a.max.z, b.max.z)}};
}

bool IsInAny(std::span<const LatticeBox> boxes, const LatticePoint& q) {
  return std::any_of(boxes.begin(), boxes.end(),
                     [&q](const LatticeBox& box) { return box.Contains(q); });
}

/// Points of one level of detail in one place: in a cell that the run made, or
/// as they were before in a tile.
struct LevelPart {
  TileInfo cell;
  bool is_previous = false;
};

/// The parts of one level of detail as the nodes of the next one.
class LevelNodes final : public PointTiles {
 public:
  /// `parts`: in Morton order, at most as coarse as nodes are. `cells`: the
  /// nodes, in Morton order, those without parts too.
  LevelNodes(LevelStore& store, PreviousLevels* previous, int level,
             std::vector<LevelPart> parts, std::span<const CellKey> cells)
      : store_(store),
        previous_(previous),
        level_(level),
        parts_(std::move(parts)) {
    size_t p = 0;
    for (const CellKey& cell : cells) {
      TileInfo node = {cell, 0};
      const size_t first = p;
      for (;
           p < parts_.size() && parts_[p].cell.key.Ancestor(cell.level) == cell;
           ++p) {
        node.point_count += parts_[p].cell.point_count;
      }
      nodes_.push_back(node);
      parts_of_[cell] = {first, p};
    }
  }

  std::vector<TileInfo> Tiles() const override { return nodes_; }

  absl::StatusOr<int64_t> LoadPoints(const CellKey& key,
                                     std::span<LatticePoint> room) override {
    const auto [begin, end] = parts_of_.at(key);
    size_t size = 0;
    for (size_t p = begin; p < end; ++p) {
      const auto& [cell, is_previous] = parts_[p];
      const std::span<LatticePoint> part_room =
          room.subspan(size, static_cast<size_t>(cell.point_count));
      MAPSIEVE_ASSIGN_OR_RETURN(
          const int64_t count,
          is_previous ? previous_->Load(level_, cell.key, part_room)
                      : store_.LoadPoints(level_, cell.key, part_room));
      size += static_cast<size_t>(count);
    }
    return static_cast<int64_t>(size);
  }

  /// Its parts are not to be had in part.
  absl::Status LoadPointRows(const CellKey& key, std::span<const RowRange> rows,
                             std::span<LatticePoint> room) override {
    const auto [begin, end] = parts_of_.at(key);
    int64_t point_count = 0;
    for (size_t p = begin; p < end; ++p) {
      point_count += parts_[p].cell.point_count;
    }
    BulkVector<LatticePoint> all(static_cast<size_t>(point_count));
    MAPSIEVE_RETURN_IF_ERROR(LoadPoints(key, all).status());
    CopyRows<LatticePoint>(all, rows, room);
    return absl::OkStatus();
  }

 private:
  LevelStore& store_;
  PreviousLevels* const previous_;
  const int level_;
  const std::vector<LevelPart> parts_;
  std::vector<TileInfo> nodes_;
  /// Each node's parts [first, second).
  std::unordered_map<CellKey, std::pair<size_t, size_t>, CellKeyHash> parts_of_;
};

/// One computation of depths.
class DepthsRun {
 public:
  DepthsRun(LevelStore& store, PreviousLevels* previous, const Lattice& lattice,
            const SpdfOptions& options, const TilingOptions& tiling,
            const ExecutionContext& context)
      : store_(store),
        previous_(previous),
        lattice_(lattice),
        options_(options),
        tiling_(tiling),
        context_(context),
        constants_(MakeSpdfConstants(options, lattice)),
        tiles_(store.Tiles()) {
    for (const TileInfo& tile : tiles_) known_tiles_.push_back(tile.key);
    if (previous_ == nullptr) return;
    const std::vector<CellKey> changed = previous_->ChangedTiles();
    for (const CellKey& tile : changed) to_emit_.emplace(tile, 0);
    std::vector<CellKey> all;
    std::set_union(known_tiles_.begin(), known_tiles_.end(), changed.begin(),
                   changed.end(), std::back_inserter(all), CellKeyLess());
    known_tiles_ = std::move(all);
  }

  absl::Status Run() {
    if (known_tiles_.empty()) return absl::OkStatus();
    MAPSIEVE_RETURN_IF_ERROR(FindFirstChanges());
    std::vector<LevelPart> parts;
    for (const TileInfo& tile : tiles_) parts.push_back({tile, false});
    int node_level = known_tiles_[0].level;
    for (int level = 1; level <= kMaxDepth; ++level) {
      MAPSIEVE_RETURN_IF_ERROR(MakeLevel(level, node_level, std::move(parts)));
      parts = PartsOf(levels_.back(), level);
      // What is made anew is little where nodes are small; deeper levels have
      // few points anyway.
      constexpr int kLevelsByTile = 3;
      if (previous_ == nullptr || level >= kLevelsByTile) {
        node_level =
            std::max(node_level, std::min(node_level + 1, kMaxMemoryTileLevel));
      }
      context_.ReportProgress(level, kMaxDepth);
    }
    return EmitDepths();
  }

 private:
  /// What the run made of one level of detail.
  struct MadeLevel {
    int node_level = 0;
    /// How many points each of the nodes that were made holds.
    std::unordered_map<CellKey, int64_t, CellKeyHash> made;
    /// The last one loaded.
    CellKey loaded_node;
    BulkVector<LatticePoint> loaded;
  };

  /// The differences of level 0, from here on those of the newest level.
  absl::Status FindFirstChanges() {
    if (previous_ == nullptr) return absl::OkStatus();
    std::unordered_map<CellKey, int64_t, CellKeyHash> counts;
    for (const TileInfo& tile : tiles_) {
      if (to_emit_.contains(tile.key)) counts[tile.key] = tile.point_count;
    }
    BulkVector<LatticePoint> now;
    for (const CellKey& tile : previous_->ChangedTiles()) {
      MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
      const auto count = counts.find(tile);
      now.resize(count == counts.end() ? 0
                                       : static_cast<size_t>(count->second));
      if (!now.empty()) {
        MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size,
                                  store_.LoadPoints(0, tile, now));
        now.resize(static_cast<size_t>(size));
      }
      MAPSIEVE_RETURN_IF_ERROR(LoadBefore(0, {&tile, 1}));
      Compare(0, now);
    }
    return absl::OkStatus();
  }

  /// Sets before_ to the points of level `level` that the adjacent `tiles`
  /// held; none without a previous run.
  absl::Status LoadBefore(int level, std::span<const CellKey> tiles) {
    before_.clear();
    if (previous_ == nullptr) return absl::OkStatus();
    for (const CellKey& tile : tiles) {
      MAPSIEVE_RETURN_IF_ERROR(AppendPrevious(level, tile, before_));
    }
    return absl::OkStatus();
  }

  /// Notes where the points `now` of level `level` differ from before_.
  void Compare(int level, std::span<const LatticePoint> now) {
    std::optional<LatticeBox> box;
    ForEachDifference(now, before_, [&](const LatticePoint& q) {
      box = box.has_value() ? box->Union(BoxOf(q)) : BoxOf(q);
      to_emit_.emplace(CellKey::Of(q, known_tiles_[0].level), level);
    });
    if (box.has_value()) changes_.push_back(*box);
  }

  absl::Status AppendPrevious(int level, const CellKey& tile,
                              BulkVector<LatticePoint>& points) {
    const int64_t room = previous_->CountAtMost(level, tile);
    if (room == 0) return absl::OkStatus();
    const size_t begin = points.size();
    points.resize(begin + static_cast<size_t>(room));
    MAPSIEVE_ASSIGN_OR_RETURN(
        const int64_t size,
        previous_->Load(level, tile, std::span(points).subspan(begin)));
    points.resize(begin + static_cast<size_t>(size));
    return absl::OkStatus();
  }

  /// The tiles, points or not, in a node.
  std::span<const CellKey> KnownTilesIn(const CellKey& node) const {
    const auto in_node = std::equal_range(
        known_tiles_.begin(), known_tiles_.end(), node,
        [&](const CellKey& a, const CellKey& b) {
          return CellKeyLess()(a.Ancestor(node.level), b.Ancestor(node.level));
        });
    return {in_node.first, in_node.second};
  }

  /// Makes those nodes of level `level` that lie within reach of a change of
  /// the finer one, which `parts` are: what is out of reach in them is as it
  /// was.
  absl::Status MakeLevel(int level, int node_level,
                         std::vector<LevelPart> parts) {
    std::vector<CellKey> cells;
    for (const CellKey& tile : known_tiles_) {
      const CellKey cell = tile.Ancestor(node_level);
      if (cells.empty() || cells.back() != cell) cells.push_back(cell);
    }
    LevelNodes nodes(store_, previous_, level - 1, std::move(parts), cells);
    PointUnits units(nodes, options_, constants_, context_);
    const int64_t radius_d2 = LevelRadiusD2(options_, lattice_, level);
    const int64_t radius = CeilRoot(radius_d2);

    // The part of each node within reach.
    std::map<size_t, std::vector<LatticeBox>> in_reach;
    for (size_t n = 0; n < cells.size() && previous_ == nullptr; ++n) {
      in_reach[n].push_back(cells[n].box());
    }
    for (const LatticeBox& change : std::exchange(changes_, {})) {
      const LatticeBox near = change.Grown(radius);
      for (const size_t n : units.TilesIn(near)) {
        in_reach[n].push_back(Intersection(near, cells[n].box()));
      }
    }
    MadeLevel& made = levels_.emplace_back();
    made.node_level = node_level;
    std::vector<size_t> wanted;
    for (const auto& [n, boxes] : in_reach) {
      if (units.tiles()[n].point_count > 0) {
        wanted.push_back(n);
      } else {
        MAPSIEVE_RETURN_IF_ERROR(LoadBefore(level, KnownTilesIn(cells[n])));
        MAPSIEVE_RETURN_IF_ERROR(AddNode(level, cells[n], {}, made));
      }
    }
    for (const PointUnits::Unit& unit :
         units.Group(wanted, tiling_.max_unit_points)) {
      std::vector<LatticeBox> boxes;
      for (const size_t n : unit) {
        boxes.insert(boxes.end(), in_reach[n].begin(), in_reach[n].end());
      }
      MAPSIEVE_ASSIGN_OR_RETURN(const LoadedUnit loaded,
                                previous_ == nullptr
                                    ? units.Load(unit, radius)
                                    : units.LoadNear(unit, boxes, radius));
      WorkUnit& work = *loaded.work;
      if (previous_ != nullptr) ChoosePoints(in_reach, loaded);
      MAPSIEVE_RETURN_IF_ERROR(work.RunQuota(radius_d2, context_));
      for (const LoadedTile& tile : loaded.tiles) {
        if (!tile.is_core) continue;
        const CellKey& node = cells[tile.tile];
        MAPSIEVE_RETURN_IF_ERROR(LoadBefore(level, KnownTilesIn(node)));
        MAPSIEVE_RETURN_IF_ERROR(AddNode(
            level, node, MembersOf(tile, in_reach.at(tile.tile), work), made));
      }
    }
    return absl::OkStatus();
  }

  /// Makes those points of the loaded nodes the unit's core that lie in the
  /// boxes of their node.
  void ChoosePoints(const std::map<size_t, std::vector<LatticeBox>>& boxes,
                    const LoadedUnit& loaded) const {
    WorkUnit& work = *loaded.work;
    context_.executor->ParallelFor(
        static_cast<int64_t>(loaded.tiles.size()), [&](int64_t t) {
          const LoadedTile& tile = loaded.tiles[static_cast<size_t>(t)];
          if (!tile.is_core) return;
          const std::vector<LatticeBox>& of_node = boxes.at(tile.tile);
          for (size_t i = tile.begin; i < tile.end; ++i) {
            work.core()[i] = IsInAny(of_node, work.Position(i)) ? 1 : 0;
          }
        });
  }

  /// The points of the level that was made in a node: in `boxes` those that
  /// rule kQuota left, elsewhere those of before_. Valid until the next call.
  std::span<const LatticePoint> MembersOf(const LoadedTile& node,
                                          std::span<const LatticeBox> boxes,
                                          WorkUnit& work) {
    members_.clear();
    auto old = before_.begin();
    const auto add_old = [&](const auto& is_next) {
      for (; old != before_.end() && is_next(*old); ++old) {
        if (!IsInAny(boxes, *old)) members_.push_back(*old);
      }
    };
    for (size_t i = node.begin; i < node.end; ++i) {
      if (work.core()[i] == 0 || work.deaths()[i] != kAlive) continue;
      const LatticePoint q = work.SurvivorPosition(i);
      add_old([&q](const LatticePoint& p) { return MortonLess(p, q); });
      members_.push_back(q);
    }
    add_old([](const LatticePoint&) { return true; });
    return members_;
  }

  /// before_: what the node held.
  absl::Status AddNode(int level, const CellKey& node,
                       std::span<const LatticePoint> points, MadeLevel& made) {
    made.made[node] = static_cast<int64_t>(points.size());
    if (previous_ != nullptr) Compare(level, points);
    return points.empty() ? absl::OkStatus()
                          : store_.StorePoints(level, node, points);
  }

  /// Level `level`: made nodes, and tiles as they were elsewhere.
  std::vector<LevelPart> PartsOf(const MadeLevel& level_nodes,
                                 int level) const {
    std::vector<LevelPart> parts;
    for (size_t t = 0; t < known_tiles_.size();) {
      const CellKey node = known_tiles_[t].Ancestor(level_nodes.node_level);
      const auto made = level_nodes.made.find(node);
      if (made == level_nodes.made.end()) {
        const CellKey& tile = known_tiles_[t++];
        const int64_t count = previous_->CountAtMost(level, tile);
        if (count > 0) parts.push_back({{tile, count}, true});
        continue;
      }
      if (made->second > 0) parts.push_back({{node, made->second}, false});
      t += KnownTilesIn(node).size();
    }
    return parts;
  }

  absl::Status EmitDepths() {
    BulkVector<LatticePoint> points;
    std::vector<uint8_t> depths;
    std::array<BulkVector<LatticePoint>, kMaxDepth> buffers;
    for (const TileInfo& tile : tiles_) {
      size_t first = 0;
      if (previous_ != nullptr) {
        const auto found = to_emit_.find(tile.key);
        if (found == to_emit_.end()) continue;
        // What came to a level, or left it, is in the finer one, as it was.
        first = static_cast<size_t>(std::max(found->second - 1, 0));
      }
      MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
      std::array<std::span<const LatticePoint>, kMaxDepth + 1> levels;
      for (size_t level = first; level <= kMaxDepth; ++level) {
        if (level == 0) {
          points.resize(static_cast<size_t>(tile.point_count));
          MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size,
                                    store_.LoadPoints(0, tile.key, points));
          levels[0] = std::span(points).first(static_cast<size_t>(size));
        } else {
          MAPSIEVE_ASSIGN_OR_RETURN(
              levels[level],
              PointsIn(tile.key, static_cast<int>(level), buffers[level - 1]));
        }
      }
      depths.clear();
      for (const LatticePoint& q : levels[first]) {
        // Levels are nested and in one order: a point is the next of each
        // level that it is part of.
        size_t depth = first;
        for (; depth < kMaxDepth; ++depth) {
          std::span<const LatticePoint>& level = levels[depth + 1];
          if (level.empty() || level.front() != q) break;
          level = level.subspan(1);
        }
        depths.push_back(static_cast<uint8_t>(depth));
      }
      for (size_t level = first + 1; level <= kMaxDepth; ++level) {
        if (!levels[level].empty()) {
          return absl::InternalError(
              absl::StrCat("level ", level, " holds a point that tile ",
                           tile.key.ToString(), " does not have"));
        }
      }
      MAPSIEVE_RETURN_IF_ERROR(
          store_.EmitDepths(tile.key, static_cast<int>(first), depths));
    }
    return absl::OkStatus();
  }

  /// The points of level `level` in a tile, in `buffer` or in the node loaded
  /// last; tiles in order load each node once.
  absl::StatusOr<std::span<const LatticePoint>> PointsIn(
      const CellKey& tile, int level, BulkVector<LatticePoint>& buffer) {
    MadeLevel& nodes = levels_[static_cast<size_t>(level) - 1];
    const CellKey node = tile.Ancestor(nodes.node_level);
    const auto made = nodes.made.find(node);
    if (made == nodes.made.end()) {
      buffer.clear();
      MAPSIEVE_RETURN_IF_ERROR(AppendPrevious(level, tile, buffer));
      return std::span<const LatticePoint>(buffer);
    }
    if (made->second == 0) return std::span<const LatticePoint>();
    if (nodes.loaded.empty() || nodes.loaded_node != node) {
      nodes.loaded_node = node;
      nodes.loaded.resize(static_cast<size_t>(made->second));
      MAPSIEVE_RETURN_IF_ERROR(
          store_.LoadPoints(level, node, nodes.loaded).status());
    }
    // A tile's corner comes before its other points.
    const auto begin = std::lower_bound(
        nodes.loaded.begin(), nodes.loaded.end(), tile.corner(),
        [](const LatticePoint& a, const LatticePoint& b) {
          return MortonLess(a, b);
        });
    const auto end = std::partition_point(
        begin, nodes.loaded.end(), [&](const LatticePoint& q) {
          return CellKey::Of(q, tile.level) == tile;
        });
    return std::span<const LatticePoint>(begin, end);
  }

  LevelStore& store_;
  PreviousLevels* const previous_;
  const Lattice& lattice_;
  const SpdfOptions& options_;
  const TilingOptions& tiling_;
  const ExecutionContext& context_;
  const SpdfConstants constants_;
  const std::vector<TileInfo> tiles_;
  /// And those that hold no points any more, in Morton order.
  std::vector<CellKey> known_tiles_;
  /// Changed tiles, at level 0, and those with a difference in any level, at
  /// the first one.
  std::unordered_map<CellKey, int, CellKeyHash> to_emit_;
  /// Boxes around the differences of the newest level.
  std::vector<LatticeBox> changes_;
  /// From level 1 on.
  std::vector<MadeLevel> levels_;
  BulkVector<LatticePoint> members_;
  BulkVector<LatticePoint> before_;
};

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

  absl::Status EmitDepths(const CellKey&, int /*level*/,
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

absl::Status ComputeDepths(LevelStore& store, PreviousLevels* previous,
                           const Lattice& lattice, const SpdfOptions& options,
                           const TilingOptions& tiling,
                           const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate(lattice));
  return DepthsRun(store, previous, lattice, options, tiling, context).Run();
}

absl::StatusOr<std::vector<uint8_t>> ComputeDepths(
    std::span<const LatticePoint> points, const Lattice& lattice,
    const SpdfOptions& options, const ExecutionContext& context) {
  MemoryLevelStore store(points, *context.executor);
  const TilingOptions tiling = {.max_unit_points =
                                    static_cast<int64_t>(points.size())};
  MAPSIEVE_RETURN_IF_ERROR(
      ComputeDepths(store, nullptr, lattice, options, tiling, context));
  return store.TakeDepths();
}

}  // namespace mapsieve::core
