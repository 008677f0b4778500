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

std::string ProductName(const CellKey& tile) {
  return "product-" + tile.ToString();
}
std::string LevelName(int level, const CellKey& cell) {
  return "level-" + std::to_string(level) + "-" + cell.ToString();
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
  for (const TileCloud& cloud : clouds) {
    Tile& tile = tiles_[cloud.tile];
    tile.is_new = true;
    tile.point_count = static_cast<int64_t>(cloud.points.size());
  }
  return TryParallelFor(
      *options_.io, static_cast<int64_t>(clouds.size()),
      [&](int64_t i) -> absl::Status {
        if (options_.stop.stop_requested()) {
          return absl::CancelledError("cancelled");
        }
        const TileCloud& cloud = clouds[static_cast<size_t>(i)];
        MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                                  core::EncodePoints(cloud.points));
        return scratch_.Write(ProductName(cloud.tile), block);
      });
}

void ProductLevels::AddPrevious(const ChunkRef& chunk, bool is_kept) {
  Tile& tile = tiles_[chunk.tile];
  tile.is_kept = is_kept;
  if (is_kept) tile.point_count += chunk.point_count;
  tile.before.push_back(chunk);
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
  for (const ChunkRef& chunk : found->second.before) {
    if (chunk.max_depth >= level) count += chunk.point_count;
  }
  return count;
}

/// The product of a tile in Morton order.
absl::StatusOr<LatticeCloud> ProductLevels::LoadNow(
    const CellKey& tile, const core::DecodeOptions& options) const {
  if (tiles_.at(tile).is_kept) return LoadBefore(tile, 0, options);
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                            scratch_.Read(ProductName(tile)));
  return core::DecodePoints(block, options);
}

/// The points of level `min_depth` in the tile as it was, in Morton order.
/// `options` name kDepthColumn if min_depth is not 0.
absl::StatusOr<LatticeCloud> ProductLevels::LoadBefore(
    const CellKey& tile, int min_depth,
    const core::DecodeOptions& options) const {
  std::vector<ChunkRef> chunks = tiles_.at(tile).before;
  std::erase_if(chunks, [&](const ChunkRef& chunk) {
    return chunk.max_depth < min_depth;
  });
  MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud points,
                            ReadPoints(snapshot_, chunks, options));
  const bool holds_finer = std::any_of(
      chunks.begin(), chunks.end(),
      [&](const ChunkRef& chunk) { return chunk.min_depth < min_depth; });
  if (!holds_finer) return points;
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> depths,
                            DepthsOf(points));
  std::vector<uint32_t> rows;
  for (uint32_t row = 0; row < depths.size(); ++row) {
    if (depths[row] >= min_depth) rows.push_back(row);
  }
  return points.Select(rows);
}

absl::StatusOr<int64_t> ProductLevels::LoadPoints(
    int level, const CellKey& cell, std::span<LatticePoint> room) {
  LatticeCloud points;
  if (level == 0) {
    MAPSIEVE_ASSIGN_OR_RETURN(points, LoadNow(cell, Only({})));
  } else {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                              scratch_.Read(LevelName(level, cell)));
    MAPSIEVE_ASSIGN_OR_RETURN(points, core::DecodePoints(block, Only({})));
  }
  if (points.size() != room.size()) {
    return absl::DataLossError(absl::StrCat(
        "level ", level, " of cell ", cell.ToString(), ": expected ",
        room.size(), " points, found ", points.size()));
  }
  std::copy(points.positions.begin(), points.positions.end(), room.begin());
  return static_cast<int64_t>(points.size());
}

absl::StatusOr<int64_t> ProductLevels::Load(int level, const CellKey& tile,
                                            std::span<LatticePoint> room) {
  MAPSIEVE_ASSIGN_OR_RETURN(const LatticeCloud points,
                            LoadBefore(tile, level, Only({kDepthColumn})));
  std::copy(points.positions.begin(), points.positions.end(), room.begin());
  return static_cast<int64_t>(points.size());
}

absl::Status ProductLevels::StorePoints(int level, const CellKey& cell,
                                        std::span<const LatticePoint> points) {
  const LatticeCloud cloud = {
      .lattice = core::Lattice(snapshot_.map().spec.step_nm),
      .positions = {points.begin(), points.end()}};
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                            core::EncodePoints(cloud));
  return scratch_.Write(LevelName(level, cell), block);
}

/// Of one tile.
LevelCounts ProductLevels::CountLevels(const LabelColumnView& labels,
                                       std::span<const uint8_t> depths) const {
  LevelCounts counts{};
  for (size_t i = 0; i < depths.size(); ++i) {
    const core::Label label = labels.label(i);
    if (outliers_.has_value() &&
        !outliers_->Keeps(label, labels.confidence(i))) {
      continue;
    }
    for (size_t level = 0; level <= depths[i]; ++level) {
      ++counts[level][static_cast<size_t>(label)];
    }
  }
  return counts;
}

/// Of one tile as it was.
absl::StatusOr<LevelCounts> ProductLevels::CountLevelsBefore(
    const CellKey& tile) const {
  LevelCounts counts{};
  if (tiles_.at(tile).before.empty()) return counts;
  MAPSIEVE_ASSIGN_OR_RETURN(
      const LatticeCloud points,
      LoadBefore(tile, 0,
                 Only({kDepthColumn, kLabelColumn, kConfidenceColumn})));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> depths,
                            DepthsOf(points));
  MAPSIEVE_ASSIGN_OR_RETURN(const LabelColumnView labels,
                            LabelColumnView::Of(points));
  return CountLevels(labels, depths);
}

void ProductLevels::AddToCounts(const LevelCounts& counts, int64_t sign) {
  for (size_t level = 0; level < counts.size(); ++level) {
    for (size_t label = 0; label < core::kLabelCount; ++label) {
      level_counts_[level][label] += sign * counts[level][label];
    }
  }
}

absl::Status ProductLevels::EmitDepths(const CellKey& tile,
                                       std::span<const uint8_t> depths) {
  pending_.push_back({tile, {depths.begin(), depths.end()}});
  // The tile as it is, and divided.
  pending_bytes_ += static_cast<int64_t>(depths.size()) * 2 * point_bytes_;
  if (pending_bytes_ < options_.max_pending_bytes &&
      pending_.size() < kMaxPendingTiles) {
    return absl::OkStatus();
  }
  return Flush();
}

absl::Status ProductLevels::Flush() {
  using Groups = std::array<LatticeCloud, kDepthGroups.size()>;
  pending_bytes_ = 0;
  const std::vector<Pending> pending = std::exchange(pending_, {});
  std::vector<Groups> divided(pending.size());
  std::vector<LevelCounts> now(pending.size());
  std::vector<LevelCounts> before(pending.size());
  MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
      *options_.io, static_cast<int64_t>(pending.size()),
      [&](int64_t n) -> absl::Status {
        if (options_.stop.stop_requested()) {
          return absl::CancelledError("cancelled");
        }
        const auto i = static_cast<size_t>(n);
        const auto& [tile, depths] = pending[i];
        if (counts_differences_) {
          MAPSIEVE_ASSIGN_OR_RETURN(before[i], CountLevelsBefore(tile));
        }
        MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud points, LoadNow(tile, {}));
        MAPSIEVE_ASSIGN_OR_RETURN(const LabelColumnView labels,
                                  LabelColumnView::Of(points));
        now[i] = CountLevels(labels, depths);
        divided[i] = SplitByDepth(std::move(points), depths);
        return absl::OkStatus();
      }));
  std::vector<TileCloud> clouds;
  for (size_t i = 0; i < pending.size(); ++i) {
    AddToCounts(now[i], 1);
    AddToCounts(before[i], -1);
    Tile& tile = tiles_.at(pending[i].tile);
    tile.is_emitted = true;
    for (const ChunkRef& chunk : tile.before) {
      if (tile.is_kept) replaced_.push_back(chunk.number);
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
  // What a tile that is gone held is a difference; what a tile holds that no
  // depth changed in is not.
  std::vector<CellKey> uncounted;
  for (const auto& [key, tile] : tiles_) {
    const bool is_gone = !tile.is_kept && !tile.is_new;
    if (!tile.is_emitted && is_gone == counts_differences_) {
      uncounted.push_back(key);
    }
  }
  std::vector<LevelCounts> counts(uncounted.size());
  MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
      *options_.io, static_cast<int64_t>(uncounted.size()),
      [&](int64_t n) -> absl::Status {
        if (options_.stop.stop_requested()) {
          return absl::CancelledError("cancelled");
        }
        const auto i = static_cast<size_t>(n);
        MAPSIEVE_ASSIGN_OR_RETURN(counts[i], CountLevelsBefore(uncounted[i]));
        return absl::OkStatus();
      }));
  for (const LevelCounts& tile : counts) {
    AddToCounts(tile, counts_differences_ ? -1 : 1);
  }
  return absl::OkStatus();
}

}  // namespace mapsieve::engine
