#include "core/spdf/tile_units.h"

#include <algorithm>
#include <utility>

namespace mapsieve::core {
namespace {

/// Coordinates of a unit are relative to its first tile's corner; the rest of
/// PointIndex::kMaxCoordinate is for the halo.
constexpr int64_t kMaxUnitExtent = int64_t{1} << 29;

bool IsTooWide(const LatticeBox& box) {
  return box.max.x - box.min.x > kMaxUnitExtent ||
         box.max.y - box.min.y > kMaxUnitExtent ||
         box.max.z - box.min.z > kMaxUnitExtent;
}

}  // namespace

PointUnits::PointUnits(PointTiles& source, const SpdfOptions& options,
                       const SpdfConstants& constants,
                       const ExecutionContext& context)
    : context_(context),
      tiles_(source.Tiles()),
      source_(source),
      options_(options),
      constants_(constants),
      directories_(tiles_.size()) {
  for (size_t t = 0; t < tiles_.size(); ++t) {
    tile_numbers_.emplace(tiles_[t].key, t);
  }
}

std::optional<size_t> PointUnits::Find(const CellKey& key) const {
  const auto found = tile_numbers_.find(key);
  if (found == tile_numbers_.end()) return std::nullopt;
  return found->second;
}

std::vector<size_t> PointUnits::TilesIn(const LatticeBox& box) const {
  std::vector<size_t> found;
  if (tiles_.empty()) return found;
  const int level = tiles_[0].key.level;
  const CellKey low = CellKey::Of(box.min, level);
  const CellKey high =
      CellKey::Of({box.max.x - 1, box.max.y - 1, box.max.z - 1}, level);
  const auto limit = static_cast<double>(tiles_.size());
  if (static_cast<double>(high.x - low.x + 1) *
          static_cast<double>(high.y - low.y + 1) *
          static_cast<double>(high.z - low.z + 1) <=
      limit) {
    for (int64_t z = low.z; z <= high.z; ++z) {
      for (int64_t y = low.y; y <= high.y; ++y) {
        for (int64_t x = low.x; x <= high.x; ++x) {
          if (const auto t = Find({level, x, y, z})) found.push_back(*t);
        }
      }
    }
    std::sort(found.begin(), found.end());
    return found;
  }
  for (size_t t = 0; t < tiles_.size(); ++t) {
    if (box.Intersects(tiles_[t].key.box())) found.push_back(t);
  }
  return found;
}

std::vector<PointUnits::Unit> PointUnits::Group(std::span<const size_t> wanted,
                                                int64_t max_unit_points) const {
  std::vector<Unit> units;
  int64_t points = 0;
  LatticeBox box;
  for (const size_t t : wanted) {
    const LatticeBox tile = tiles_[t].key.box();
    const LatticeBox grown = units.empty() ? tile : box.Union(tile);
    points += tiles_[t].point_count;
    if (units.empty() || points > max_unit_points || IsTooWide(grown)) {
      units.emplace_back();
      points = tiles_[t].point_count;
      box = tile;
    } else {
      box = grown;
    }
    units.back().push_back(t);
  }
  return units;
}

std::vector<LatticeBox> PointUnits::BoxesOf(const Unit& unit) const {
  std::vector<LatticeBox> boxes;
  for (const size_t t : unit) boxes.push_back(tiles_[t].key.box());
  return boxes;
}

std::unordered_map<size_t, std::vector<LatticeBox>> PointUnits::HaloTiles(
    const Unit& unit, std::span<const LatticeBox> boxes, int64_t margin) const {
  HaloOf halo;
  if (unit.size() == tiles_.size()) return halo;
  for (const LatticeBox& box : boxes) {
    const LatticeBox grown = box.Grown(margin);
    for (const size_t t : TilesIn(grown)) {
      if (!std::binary_search(unit.begin(), unit.end(), t)) {
        halo[t].push_back(grown);
      }
    }
  }
  return halo;
}

absl::StatusOr<LoadedUnit> PointUnits::Load(const Unit& unit,
                                            std::span<const LatticeBox> boxes,
                                            int64_t margin) {
  return Load(unit, HaloTiles(unit, boxes, margin), /*whole_core=*/true);
}

absl::StatusOr<LoadedUnit> PointUnits::LoadNear(
    const Unit& unit, std::span<const LatticeBox> boxes, int64_t margin) {
  return Load(unit, HaloTiles({}, boxes, margin), /*whole_core=*/false);
}

/// The points of `near`, and all of the unit's tiles if asked for.
absl::StatusOr<LoadedUnit> PointUnits::Load(const Unit& unit,
                                            const HaloOf& near,
                                            bool whole_core) {
  LoadedUnit loaded;
  std::vector<size_t> wanted = unit;
  for (const auto& [tile, boxes] : near) {
    if (!std::binary_search(unit.begin(), unit.end(), tile)) {
      wanted.push_back(tile);
    }
  }
  std::sort(wanted.begin(), wanted.end());
  loaded.work = std::make_unique<WorkUnit>(tiles_[unit.front()].key.corner(),
                                           options_, constants_);
  WorkUnit& work = *loaded.work;
  // Room that is not filled costs nothing.
  size_t core_points = 0;
  for (const size_t t : wanted) {
    const bool is_core = std::binary_search(unit.begin(), unit.end(), t);
    const bool is_whole = is_core && whole_core;
    loaded.tiles.push_back(
        {.tile = t, .is_core = is_core, .is_whole = is_whole});
    if (is_core) core_points += static_cast<size_t>(tiles_[t].point_count);
  }
  work.Reserve(core_points);
  const absl::Status status =
      ForEachBatch(loaded.tiles, [&](std::span<LoadedTile> batch) {
        return LoadBatch(near, batch, work);
      });
  if (!status.ok()) return status;
  return loaded;
}

absl::StatusOr<BulkVector<LatticePoint>> PointUnits::LoadPoints(
    size_t tile) const {
  BulkVector<LatticePoint> points(
      static_cast<size_t>(tiles_[tile].point_count));
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size,
                            source_.LoadPoints(tiles_[tile].key, points));
  points.resize(static_cast<size_t>(size));
  return points;
}

/// Appends the points of `batch` to `work`; of a tile that is not wanted as a
/// whole, those in its boxes of `near`.
absl::Status PointUnits::LoadBatch(const HaloOf& near,
                                   std::span<LoadedTile> batch,
                                   WorkUnit& work) {
  const auto count = static_cast<int64_t>(batch.size());
  size_t room = 0;
  std::vector<size_t> begins;
  for (LoadedTile& tile : batch) {
    begins.push_back(room);
    const TileDirectory& directory = directories_[tile.tile];
    if (!tile.is_whole && !near.contains(tile.tile)) continue;
    if (!tile.is_whole && directory.IsMade()) {
      tile.rows = directory.RowsIn(near.at(tile.tile));
      room += RowCount(tile.rows);
    } else {
      room += static_cast<size_t>(tiles_[tile.tile].point_count);
    }
  }
  begins.push_back(room);
  batch_points_.resize(std::max(batch_points_.size(), room));
  std::vector<std::span<LatticePoint>> points(batch.size());
  MAPSIEVE_RETURN_IF_ERROR(
      TryParallelFor(*context_.executor, count, [&](int64_t i) {
        const auto b = static_cast<size_t>(i);
        points[b] = std::span(batch_points_)
                        .subspan(begins[b], begins[b + 1] - begins[b]);
        return LoadTile(near, batch[b], points[b]);
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

/// Loads the wanted points of a tile into `points`, which it shortens to them,
/// and sets their rows. `tile.rows`: all that are needed of a tile in part;
/// none if that is not known yet.
absl::Status PointUnits::LoadTile(const HaloOf& near, LoadedTile& tile,
                                  std::span<LatticePoint>& points) {
  if (points.empty()) return absl::OkStatus();
  const CellKey& key = tiles_[tile.tile].key;
  TileDirectory& directory = directories_[tile.tile];
  if (tile.is_whole || !directory.IsMade()) {
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size,
                              source_.LoadPoints(key, points));
    points = points.first(static_cast<size_t>(size));
    // Tiles without a halo are in nobody else's, at this margin.
    if (!directory.IsMade() && !near.empty()) {
      directory = TileDirectory(key, points);
    }
    tile.rows.clear();
    if (size > 0) tile.rows.push_back({0, static_cast<uint32_t>(size)});
  } else {
    MAPSIEVE_RETURN_IF_ERROR(source_.LoadPointRows(key, tile.rows, points));
  }
  if (tile.is_whole) return absl::OkStatus();

  const std::vector<LatticeBox>& boxes = near.at(tile.tile);
  std::vector<RowRange> kept;
  size_t from = 0;
  size_t to = 0;
  for (const RowRange& part : tile.rows) {
    for (uint32_t row = part.begin; row < part.end; ++row) {
      const LatticePoint q = points[from++];
      if (std::none_of(boxes.begin(), boxes.end(), [&](const LatticeBox& box) {
            return box.Contains(q);
          })) {
        continue;
      }
      points[to++] = q;
      if (!kept.empty() && kept.back().end == row) {
        ++kept.back().end;
      } else {
        kept.push_back({row, row + 1});
      }
    }
  }
  tile.rows = std::move(kept);
  points = points.first(to);
  return absl::OkStatus();
}

absl::Status TileUnits::Emit(const LoadedUnit& loaded,
                             const WorkUnit::Labeled& labeled,
                             SpdfSummary& summary) {
  std::vector<LoadedTile> core;
  for (const LoadedTile& tile : loaded.tiles) {
    if (tile.is_core) core.push_back(tile);
  }
  return ForEachBatch(core, [&](std::span<LoadedTile> batch) {
    return EmitBatch(*loaded.work, batch, labeled, summary);
  });
}

absl::Status TileUnits::EmitBatch(WorkUnit& unit,
                                  std::span<const LoadedTile> tiles,
                                  const WorkUnit::Labeled& labeled,
                                  SpdfSummary& summary) {
  const auto survivor_at = [&](size_t point) {
    return static_cast<size_t>(
        std::lower_bound(labeled.points.begin(), labeled.points.end(), point) -
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
        const size_t point_count = tile.end - tile.begin;
        results[static_cast<size_t>(t)] = {
            .key = tiles_[tile.tile].key,
            .point_count = static_cast<int64_t>(point_count),
            .deaths = std::span(unit.deaths()).subspan(tile.begin, point_count),
            .rows = std::span(batch_rows_).subspan(begin - first, end - begin),
            .positions =
                std::span(batch_points_).subspan(begin - first, end - begin),
            .columns = labeled.columns.Slice(begin, end)};
      });
  for (const TileResult& result : results) {
    MAPSIEVE_RETURN_IF_ERROR(Emit(result, summary));
  }
  return absl::OkStatus();
}

absl::Status TileUnits::Emit(const TileResult& result, SpdfSummary& summary) {
  summary.point_count += result.point_count;
  summary.survivor_count += static_cast<int64_t>(result.rows.size());
  for (const Label label : result.columns.label) {
    ++summary.label_counts[static_cast<size_t>(label)];
  }
  summary.max_confidence =
      UpdateMaxConfidence(result.columns, summary.max_confidence);
  return store_.Emit(result);
}

}  // namespace mapsieve::core
