#include "server/engine/product_levels.h"

#include <algorithm>
#include <string>
#include <utility>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/product_chunk.h"

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
    tiles_[cloud.tile].point_count = static_cast<int64_t>(cloud.points.size());
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

void ProductLevels::Keep(const ChunkRef& chunk) {
  Source& source = tiles_[chunk.tile];
  source.point_count += chunk.point_count;
  source.kept.push_back(chunk);
}

std::vector<core::TileInfo> ProductLevels::Tiles() const {
  std::vector<core::TileInfo> tiles;
  for (const auto& [tile, source] : tiles_) {
    tiles.push_back({tile, source.point_count});
  }
  return tiles;
}

/// The product of a tile in Morton order.
absl::StatusOr<LatticeCloud> ProductLevels::Load(
    const CellKey& tile, const core::DecodeOptions& options) const {
  const std::vector<ChunkRef>& kept = tiles_.at(tile).kept;
  if (kept.empty()) {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                              scratch_.Read(ProductName(tile)));
    return core::DecodePoints(block, options);
  }
  LatticeCloud points;
  for (const ChunkRef& chunk : kept) {
    MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud part,
                              ReadPoints(snapshot_, chunk, options));
    points.lattice = part.lattice;
    MAPSIEVE_RETURN_IF_ERROR(points.attributes.AppendAll(
        points.size(), part.attributes, part.size()));
    points.positions.insert(points.positions.end(), part.positions.begin(),
                            part.positions.end());
  }
  return points.Select(core::MortonOrder(points.positions));
}

absl::StatusOr<int64_t> ProductLevels::LoadPoints(
    int level, const CellKey& cell, std::span<LatticePoint> room) {
  const core::DecodeOptions positions = {.attributes =
                                             std::vector<std::string>()};
  LatticeCloud points;
  if (level == 0) {
    MAPSIEVE_ASSIGN_OR_RETURN(points, Load(cell, positions));
  } else {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                              scratch_.Read(LevelName(level, cell)));
    MAPSIEVE_ASSIGN_OR_RETURN(points, core::DecodePoints(block, positions));
  }
  if (points.size() != room.size()) {
    return absl::DataLossError(absl::StrCat(
        "level ", level, " of cell ", cell.ToString(), ": expected ",
        room.size(), " points, found ", points.size()));
  }
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
absl::StatusOr<LevelCounts> ProductLevels::CountLevels(
    const LatticeCloud& points, std::span<const uint8_t> depths) const {
  MAPSIEVE_ASSIGN_OR_RETURN(const LabelColumnView labels,
                            LabelColumnView::Of(points));
  LevelCounts counts{};
  for (size_t i = 0; i < points.size(); ++i) {
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
  std::vector<LevelCounts> counts(pending.size());
  MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
      *options_.io, static_cast<int64_t>(pending.size()),
      [&](int64_t i) -> absl::Status {
        if (options_.stop.stop_requested()) {
          return absl::CancelledError("cancelled");
        }
        const auto& [tile, depths] = pending[static_cast<size_t>(i)];
        if (!tiles_.at(tile).kept.empty()) {
          MAPSIEVE_ASSIGN_OR_RETURN(
              const LatticeCloud before,
              Load(tile,
                   {.attributes = std::vector<std::string>{
                        std::string(kDepthColumn), std::string(kLabelColumn),
                        std::string(kConfidenceColumn)}}));
          MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> old_depths,
                                    DepthsOf(before));
          if (old_depths == depths) {
            MAPSIEVE_ASSIGN_OR_RETURN(counts[static_cast<size_t>(i)],
                                      CountLevels(before, depths));
            return absl::OkStatus();
          }
        }
        MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud points, Load(tile, {}));
        MAPSIEVE_ASSIGN_OR_RETURN(counts[static_cast<size_t>(i)],
                                  CountLevels(points, depths));
        divided[static_cast<size_t>(i)] =
            SplitByDepth(std::move(points), depths);
        return absl::OkStatus();
      }));
  for (const LevelCounts& tile : counts) {
    for (size_t level = 0; level < tile.size(); ++level) {
      for (size_t label = 0; label < core::kLabelCount; ++label) {
        level_counts_[level][label] += tile[level][label];
      }
    }
  }
  std::vector<TileCloud> clouds;
  for (size_t i = 0; i < pending.size(); ++i) {
    const size_t first = clouds.size();
    for (LatticeCloud& group : divided[i]) {
      if (group.size() == 0) continue;
      clouds.push_back({pending[i].tile, std::move(group)});
    }
    if (clouds.size() == first) continue;
    for (const ChunkRef& chunk : tiles_.at(pending[i].tile).kept) {
      replaced_.push_back(chunk.number);
    }
  }
  return chunks_.Write(std::move(clouds), options_.stop);
}

}  // namespace mapsieve::engine
