#include "server/engine/product_levels.h"

#include <algorithm>
#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>

#include "core/base/status.h"
#include "server/engine/chunk_reader.h"

namespace mapsieve::engine {
namespace {

using core::CellKey;
using core::LatticeCloud;
using core::LatticePoint;
using storage::ChunkRef;

/// The attributes of a new tile; its points are those of level 0.
std::string AttributesName(const CellKey& tile) {
  return "attributes-" + tile.ToString();
}
std::string LevelName(int level, const CellKey& cell) {
  return "level-" + std::to_string(level) + "-" + cell.ToString();
}

/// The points of this level and above, which one group of depths holds, are
/// kept when that was read: every coarser level asks for them.
constexpr int kCoarseLevel = kDepthGroups.front().min + 1;

/// The group of depths of the chunk holds some of level `level`.
bool IsInGroupOf(const ChunkRef& chunk, int level) {
  return kDepthGroups[DepthGroupOf(chunk.max_depth)].max >= level;
}

/// No attributes but `names`.
core::DecodeOptions Only(std::initializer_list<std::string_view> names) {
  return {.attributes = std::vector<std::string>(names.begin(), names.end())};
}

}  // namespace

ProductLevels::ProductLevels(storage::Store& store,
                             const storage::ReadSnapshot& snapshot,
                             storage::Scratch& scratch, const Options& options)
    : snapshot_(snapshot),
      scratch_(scratch),
      options_(options),
      point_bytes_(ProductPointBytes(snapshot.revision().spec.attributes)),
      chunks_(store, storage::ChunkKind::kProduct, options.max_chunk_bytes,
              *options.io) {}

absl::Status ProductLevels::Add(std::vector<TileCloud> clouds) {
  for (TileCloud& cloud : clouds) {
    Tile& tile = tiles_[cloud.tile];
    tile.is_new = true;
    tile.point_count = static_cast<int64_t>(cloud.points.size());
    if (!TakeRoom(tile.point_count * DecodedPointBytes(cloud.points))) {
      continue;
    }
    tile.points = std::exchange(cloud.points, LatticeCloud());
  }
  std::erase_if(
      clouds, [](const TileCloud& cloud) { return cloud.points.size() == 0; });
  return TryParallelFor(
      *options_.io, static_cast<int64_t>(clouds.size()),
      [&](int64_t i) -> absl::Status {
        if (options_.stop.stop_requested()) {
          return absl::CancelledError("cancelled");
        }
        auto& [tile, points] = clouds[static_cast<size_t>(i)];
        MAPSIEVE_RETURN_IF_ERROR(WriteScratch(
            LevelName(0, tile),
            {.lattice = points.lattice, .positions = points.positions}));
        std::fill(points.positions.begin(), points.positions.end(),
                  tile.corner());
        return WriteScratch(AttributesName(tile), points);
      });
}

void ProductLevels::AddPrevious(const ChunkRef& chunk, bool is_kept) {
  Tile& tile = tiles_[chunk.tile];
  tile.is_kept = is_kept;
  if (is_kept) tile.point_count += chunk.point_count;
  tile.before.push_back({.ref = chunk});
}

void ProductLevels::StartCounts(
    const core::OutlierTest& outliers,
    const std::optional<LevelCounts>& counts_before) {
  outliers_ = outliers;
  counts_differences_ = counts_before.has_value();
  level_counts_ = counts_before.value_or(LevelCounts());
}

std::vector<core::TileInfo> ProductLevels::Tiles() const {
  std::vector<core::TileInfo> tiles;
  for (const auto& [key, tile] : tiles_) {
    if (tile.is_new || tile.is_kept) tiles.push_back({key, tile.point_count});
  }
  return tiles;
}

std::vector<CellKey> ProductLevels::ChangedTiles() const {
  std::vector<CellKey> changed;
  for (const auto& [key, tile] : tiles_) {
    if (!tile.is_kept) changed.push_back(key);
  }
  return changed;
}

int64_t ProductLevels::CountAtMost(int level, const CellKey& tile) const {
  const auto found = tiles_.find(tile);
  if (found == tiles_.end()) return 0;
  int64_t count = 0;
  for (const PreviousChunk& chunk : found->second.before) {
    if (chunk.ref.max_depth >= level) count += chunk.ref.point_count;
  }
  return count;
}

/// Whether `bytes` more of what is new may stay in memory; if so, they count.
bool ProductLevels::TakeRoom(int64_t bytes) {
  if (new_bytes_ + bytes > max_new_bytes_) return false;
  new_bytes_ += bytes;
  return true;
}

absl::Status ProductLevels::WriteScratch(const std::string& name,
                                         const LatticeCloud& points) const {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<std::byte> block,
      core::EncodePoints(points,
                         {.compression = options_.scratch_compression}));
  return scratch_.Write(name, block);
}

absl::StatusOr<LatticeCloud> ProductLevels::ReadScratch(
    const std::string& name) const {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                            scratch_.Read(name));
  return core::DecodePoints(block);
}

/// The product of a tile in Morton order; to be asked for once.
absl::StatusOr<LatticeCloud> ProductLevels::TakeNow(const CellKey& tile) {
  Tile& now = tiles_.at(tile);
  if (now.is_kept) return LoadBefore(tile, 0, {});
  if (now.points.has_value()) return *std::exchange(now.points, std::nullopt);
  MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud points,
                            ReadScratch(LevelName(0, tile)));
  MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud attributes,
                            ReadScratch(AttributesName(tile)));
  points.attributes = std::move(attributes.attributes);
  return points;
}

/// The points of level `min_depth` in the tile as it was, in Morton order.
/// `options` name kDepthColumn if min_depth is not 0.
absl::StatusOr<LatticeCloud> ProductLevels::LoadBefore(
    const CellKey& tile, int min_depth,
    const core::DecodeOptions& options) const {
  std::vector<ChunkRef> chunks;
  for (const PreviousChunk& chunk : tiles_.at(tile).before) {
    if (chunk.ref.max_depth >= min_depth) chunks.push_back(chunk.ref);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud points,
                            ReadPoints(snapshot_, chunks, options));
  const bool holds_finer = std::any_of(
      chunks.begin(), chunks.end(),
      [&](const ChunkRef& chunk) { return chunk.min_depth < min_depth; });
  if (!holds_finer) return points;
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> depths,
                            DepthsOf(points.attributes));
  std::vector<uint32_t> rows;
  for (uint32_t row = 0; row < depths.size(); ++row) {
    if (depths[row] >= min_depth) rows.push_back(row);
  }
  return points.Select(rows);
}

absl::StatusOr<int64_t> ProductLevels::LoadPoints(
    int level, const CellKey& cell, std::span<LatticePoint> room) {
  LatticeCloud read;
  std::span<const LatticePoint> points;
  const auto& made = made_[static_cast<size_t>(level)];
  const auto in_memory = made.find(cell);
  const Tile* const tile = level == 0 ? &tiles_.at(cell) : nullptr;
  if (in_memory != made.end()) {
    points = in_memory->second;
  } else if (tile != nullptr && tile->points.has_value()) {
    points = tile->points->positions;
  } else {
    MAPSIEVE_ASSIGN_OR_RETURN(read, tile != nullptr && tile->is_kept
                                        ? LoadBefore(cell, 0, Only({}))
                                        : ReadScratch(LevelName(level, cell)));
    points = read.positions;
  }
  if (points.size() != room.size()) {
    return absl::DataLossError(absl::StrCat(
        "level ", level, " of cell ", cell.ToString(), ": expected ",
        room.size(), " points, found ", points.size()));
  }
  std::copy(points.begin(), points.end(), room.begin());
  return static_cast<int64_t>(points.size());
}

absl::StatusOr<int64_t> ProductLevels::Load(int level, const CellKey& tile,
                                            std::span<LatticePoint> room) {
  const auto copy_level = [&](std::span<const LatticePoint> positions,
                              std::span<const uint8_t> depths) {
    size_t count = 0;
    for (size_t i = 0; i < positions.size(); ++i) {
      if (depths[i] >= level) room[count++] = positions[i];
    }
    return static_cast<int64_t>(count);
  };
  if (level >= kCoarseLevel) {
    const CoarsePoints* const kept = FindCoarse(tile);
    if (kept != nullptr) return copy_level(kept->positions, kept->depths);
  }
  const int min_depth = std::min(level, kDepthGroups.front().min);
  MAPSIEVE_ASSIGN_OR_RETURN(const LatticeCloud points,
                            LoadBefore(tile, min_depth, Only({kDepthColumn})));
  if (points.size() == 0) return 0;
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> depths,
                            DepthsOf(points.attributes));
  if (min_depth == kDepthGroups.front().min) {
    KeepCoarse(tile, points.positions, depths);
  }
  return copy_level(points.positions, depths);
}

/// Null: they were not read yet, or had no room.
const ProductLevels::CoarsePoints* ProductLevels::FindCoarse(
    const CellKey& tile) const {
  const MutexLock lock(mutex_);
  const auto found = coarse_.find(tile);
  return found == coarse_.end() ? nullptr : &found->second;
}

/// Keeps those of the points that are coarse, if there is room for them.
void ProductLevels::KeepCoarse(const CellKey& tile,
                               std::span<const LatticePoint> positions,
                               std::span<const uint8_t> depths) {
  CoarsePoints kept;
  for (size_t i = 0; i < positions.size(); ++i) {
    if (depths[i] < kCoarseLevel) continue;
    kept.positions.push_back(positions[i]);
    kept.depths.push_back(depths[i]);
  }
  kept.positions.shrink_to_fit();
  kept.depths.shrink_to_fit();
  // With what the map needs for an entry.
  const auto bytes = static_cast<int64_t>(
      sizeof(CellKey) + sizeof(CoarsePoints) + 4 * sizeof(void*) +
      kept.positions.size() * (sizeof(LatticePoint) + 1));
  const MutexLock lock(mutex_);
  if (coarse_bytes_ + bytes > options_.max_pending_bytes) return;
  if (coarse_.emplace(tile, std::move(kept)).second) coarse_bytes_ += bytes;
}

absl::Status ProductLevels::StorePoints(int level, const CellKey& cell,
                                        std::span<const LatticePoint> points) {
  if (TakeRoom(static_cast<int64_t>(points.size_bytes()))) {
    made_[static_cast<size_t>(level)][cell].assign(points.begin(),
                                                   points.end());
    return absl::OkStatus();
  }
  return WriteScratch(LevelName(level, cell),
                      {.lattice = core::Lattice(snapshot_.map().spec.step_nm),
                       .positions = {points.begin(), points.end()}});
}

/// Of one tile.
LevelCounts ProductLevels::CountLevels(const LabelColumnView& labels,
                                       std::span<const uint8_t> depths) const {
  // By depth, then summed up to levels.
  LevelCounts counts{};
  for (size_t i = 0; i < depths.size(); ++i) {
    const core::Label label = labels.label(i);
    const bool is_kept =
        !outliers_.has_value() || outliers_->Keeps(label, labels.confidence(i));
    counts[depths[i]][static_cast<size_t>(label)] += is_kept ? 1 : 0;
  }
  for (size_t level = counts.size() - 1; level > 0; --level) {
    for (size_t label = 0; label < core::kLabelCount; ++label) {
      counts[level - 1][label] += counts[level][label];
    }
  }
  return counts;
}

/// Of one chunk of before.
absl::StatusOr<LevelCounts> ProductLevels::CountLevelsOf(
    const ChunkRef& chunk) const {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const core::ColumnSet columns,
      ReadColumns(snapshot_, chunk,
                  {std::string(kDepthColumn), std::string(kLabelColumn),
                   std::string(kConfidenceColumn)}));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> depths,
                            DepthsOf(columns));
  MAPSIEVE_ASSIGN_OR_RETURN(const LabelColumnView labels,
                            LabelColumnView::Of(columns));
  return CountLevels(labels, depths);
}

void ProductLevels::AddToCounts(const LevelCounts& counts, int64_t sign) {
  for (size_t level = 0; level < counts.size(); ++level) {
    for (size_t label = 0; label < core::kLabelCount; ++label) {
      level_counts_[level][label] += sign * counts[level][label];
    }
  }
}

absl::Status ProductLevels::EmitDepths(const CellKey& tile, int level,
                                       std::span<const uint8_t> depths) {
  int64_t point_count = static_cast<int64_t>(depths.size());
  if (level > 0) {
    point_count = 0;
    for (const PreviousChunk& chunk : tiles_.at(tile).before) {
      if (IsInGroupOf(chunk.ref, level)) point_count += chunk.ref.point_count;
    }
  }
  pending_.push_back({tile, level, {depths.begin(), depths.end()}});
  // The points as they are, and divided.
  pending_bytes_ += point_count * 2 * point_bytes_;
  if (pending_bytes_ < options_.max_pending_bytes &&
      pending_.size() < kMaxPendingTiles) {
    return absl::OkStatus();
  }
  return Flush();
}

/// The points of the groups of depths that are written anew.
absl::StatusOr<ProductLevels::DeepPoints> ProductLevels::LoadPending(
    const Pending& pending) {
  DeepPoints loaded;
  if (pending.level == 0) {
    MAPSIEVE_ASSIGN_OR_RETURN(loaded.points, TakeNow(pending.tile));
    loaded.depths = pending.depths;
    return loaded;
  }
  std::vector<ChunkRef> chunks;
  for (const PreviousChunk& chunk : tiles_.at(pending.tile).before) {
    if (IsInGroupOf(chunk.ref, pending.level)) chunks.push_back(chunk.ref);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(loaded.points, ReadPoints(snapshot_, chunks, {}));
  MAPSIEVE_ASSIGN_OR_RETURN(loaded.depths, DepthsOf(loaded.points.attributes));
  size_t next = 0;
  for (uint8_t& depth : loaded.depths) {
    if (depth < pending.level) continue;
    if (next < pending.depths.size()) depth = pending.depths[next];
    ++next;
  }
  if (next != pending.depths.size()) {
    return absl::DataLossError(absl::StrCat(
        "tile ", pending.tile.ToString(), ": expected ", pending.depths.size(),
        " points of level ", pending.level, ", found ", next));
  }
  return loaded;
}

absl::Status ProductLevels::Flush() {
  using Groups = std::array<LatticeCloud, kDepthGroups.size()>;
  pending_bytes_ = 0;
  const std::vector<Pending> pending = std::exchange(pending_, {});
  std::vector<Groups> divided(pending.size());
  std::vector<LevelCounts> counts(pending.size());
  MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
      *options_.io, static_cast<int64_t>(pending.size()),
      [&](int64_t n) -> absl::Status {
        if (options_.stop.stop_requested()) {
          return absl::CancelledError("cancelled");
        }
        const auto i = static_cast<size_t>(n);
        MAPSIEVE_ASSIGN_OR_RETURN(DeepPoints loaded, LoadPending(pending[i]));
        MAPSIEVE_ASSIGN_OR_RETURN(
            const LabelColumnView labels,
            LabelColumnView::Of(loaded.points.attributes));
        counts[i] = CountLevels(labels, loaded.depths);
        divided[i] = SplitByDepth(std::move(loaded.points), loaded.depths);
        return absl::OkStatus();
      }));
  std::vector<TileCloud> clouds;
  for (size_t i = 0; i < pending.size(); ++i) {
    AddToCounts(counts[i], 1);
    Tile& tile = tiles_.at(pending[i].tile);
    for (PreviousChunk& chunk : tile.before) {
      if (!tile.is_kept || !IsInGroupOf(chunk.ref, pending[i].level)) continue;
      chunk.is_replaced = true;
      replaced_.push_back(chunk.ref.number);
    }
    for (LatticeCloud& group : divided[i]) {
      if (group.size() == 0) continue;
      clouds.push_back({pending[i].tile, std::move(group)});
    }
  }
  if (options_.repair != nullptr) {
    return options_.repair->PutProduct(clouds, *options_.io, options_.stop);
  }
  return chunks_.Write(std::move(clouds), options_.stop);
}

absl::Status ProductLevels::Finish() {
  MAPSIEVE_RETURN_IF_ERROR(Flush());
  // Of the chunks of before, those that are gone are a difference; those that
  // stay belong to counts that start from nothing.
  std::vector<ChunkRef> uncounted;
  for (const auto& [key, tile] : tiles_) {
    for (const PreviousChunk& chunk : tile.before) {
      const bool is_gone = !tile.is_kept || chunk.is_replaced;
      if (is_gone == counts_differences_) uncounted.push_back(chunk.ref);
    }
  }
  Mutex mutex;
  return TryParallelFor(*options_.io, static_cast<int64_t>(uncounted.size()),
                        [&](int64_t n) -> absl::Status {
                          if (options_.stop.stop_requested()) {
                            return absl::CancelledError("cancelled");
                          }
                          MAPSIEVE_ASSIGN_OR_RETURN(
                              const LevelCounts counts,
                              CountLevelsOf(uncounted[static_cast<size_t>(n)]));
                          const MutexLock lock(mutex);
                          AddToCounts(counts, counts_differences_ ? -1 : 1);
                          return absl::OkStatus();
                        });
}

}  // namespace mapsieve::engine
