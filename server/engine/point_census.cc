#include "server/engine/point_census.h"

#include <algorithm>
#include <bit>
#include <cstddef>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_set.h"
#include "core/base/status.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/chunk_writer.h"

namespace mapsieve::engine {
namespace {

using core::CellKey;
using core::LatticePoint;
using storage::ChunkRef;

/// log2 of the most density cells along a tile's edge.
constexpr int kMaxCellBits = 6;
/// Of a lattice cell in a set with room for it.
constexpr int64_t kSetBytes = 24;

/// The chunks of one tile.
struct TileChunks {
  CellKey tile;
  std::span<const ChunkRef* const> added;
  /// Those before that may hold a point where `added` has one.
  std::vector<ChunkRef> before;
  core::LatticeBox added_box;
  int64_t added_count = 0;
};

/// The counts of one tile.
struct TileCounts {
  int64_t distinct = 0;
  int64_t overlapping = 0;
  bool is_compared = true;
  /// As PointCensus::density_histogram.
  std::vector<int64_t> histogram;
};

void AddTo(std::vector<int64_t>& histogram, size_t bin, int64_t count) {
  if (histogram.size() <= bin) histogram.resize(bin + 1);
  histogram[bin] += count;
}

/// Counts the points of one tile. The set of its lattice cells is made in as
/// many parts as it takes for each to fit `max_set_bytes`.
class TileCounter {
 public:
  TileCounter(const storage::ReadSnapshot& base, const TileChunks& chunks,
              int cell_level, int64_t max_set_bytes)
      : base_(base),
        chunks_(chunks),
        corner_(chunks.tile.corner()),
        cell_level_(cell_level),
        part_count_(static_cast<uint64_t>(1 + chunks.added_count * kSetBytes /
                                                  max_set_bytes)),
        points_of_cell_(size_t{1} << (3 * cell_bits())) {}

  absl::StatusOr<TileCounts> Count() {
    for (uint64_t part = 0; part < part_count_; ++part) {
      MAPSIEVE_RETURN_IF_ERROR(CountPart(part));
    }
    for (const int64_t count : points_of_cell_) {
      if (count == 0) continue;
      AddTo(counts_.histogram,
            std::bit_width(static_cast<uint64_t>(count)) - size_t{1}, 1);
    }
    return std::move(counts_);
  }

 private:
  int cell_bits() const { return chunks_.tile.level - cell_level_; }

  /// Calls visit(offset of the point in the tile, its lattice cell's number).
  template <typename Visit>
  absl::Status VisitPart(const ChunkRef& chunk, uint64_t part,
                         const Visit& visit) const {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<LatticePoint> positions,
                              ReadPositions(base_, chunk));
    const int level = chunks_.tile.level;
    for (const LatticePoint& q : positions) {
      const LatticePoint offset = {q.x - corner_.x, q.y - corner_.y,
                                   q.z - corner_.z};
      const auto number = static_cast<uint64_t>(
          (((offset.x << level) | offset.y) << level) | offset.z);
      if (part_count_ > 1 &&
          ((number * 0x9e3779b97f4a7c15) >> 32) % part_count_ != part) {
        continue;
      }
      visit(offset, number);
    }
    return absl::OkStatus();
  }

  absl::Status CountPart(uint64_t part) {
    absl::flat_hash_set<uint64_t> cells;
    cells.reserve(static_cast<size_t>(chunks_.added_count) / part_count_);
    const int bits = cell_bits();
    for (const ChunkRef* chunk : chunks_.added) {
      const absl::Status status = VisitPart(
          *chunk, part, [&](const LatticePoint& offset, uint64_t number) {
            cells.insert(number);
            ++points_of_cell_[static_cast<size_t>(
                ((((offset.x >> cell_level_) << bits) |
                  (offset.y >> cell_level_))
                 << bits) |
                (offset.z >> cell_level_))];
          });
      // Nothing of the map is lost: the upload is still there.
      if (absl::IsDataLoss(status)) {
        return absl::UnavailableError(status.message());
      }
      MAPSIEVE_RETURN_IF_ERROR(status);
    }
    counts_.distinct += static_cast<int64_t>(cells.size());
    for (const ChunkRef& chunk : chunks_.before) {
      if (!counts_.is_compared) break;
      const absl::Status status =
          VisitPart(chunk, part, [&](const LatticePoint&, uint64_t number) {
            counts_.overlapping += static_cast<int64_t>(cells.erase(number));
          });
      // Old damage does not keep new points out.
      if (absl::IsDataLoss(status)) {
        counts_.is_compared = false;
      } else if (!status.ok()) {
        return status;
      }
    }
    return absl::OkStatus();
  }

  const storage::ReadSnapshot& base_;
  const TileChunks& chunks_;
  const LatticePoint corner_;
  const int cell_level_;
  const uint64_t part_count_;
  /// By density cell of the tile.
  std::vector<int64_t> points_of_cell_;
  TileCounts counts_;
};

class Census {
 public:
  Census(const storage::ReadSnapshot& base, std::span<const ChunkRef> added,
         const RegionCut& cut, std::span<const ChunkRef> rest,
         const IngestLimits& limits, const ExecutionContext& context)
      : base_(base),
        removed_(cut.removed_chunks),
        limits_(limits),
        context_(context),
        cell_level_(DensityCellLevel(base.map().spec.step_nm,
                                     base.map().spec.tile_level)) {
    std::sort(removed_.begin(), removed_.end());
    for (const ChunkRef& chunk : rest) rest_[chunk.tile].push_back(chunk);
    added_.reserve(added.size());
    for (const ChunkRef& chunk : added) {
      added_.push_back(&chunk);
      added_count_ += chunk.point_count;
    }
    std::sort(added_.begin(), added_.end(),
              [](const ChunkRef* a, const ChunkRef* b) {
                return core::CellKeyLess()(a->tile, b->tile);
              });
  }

  absl::StatusOr<PointCensus> Take() {
    MAPSIEVE_ASSIGN_OR_RETURN(is_compared_, IsWorthComparing());
    census_.density_cell_level = cell_level_;
    std::vector<TileChunks> batch;
    int64_t batch_bytes = 0;
    for (size_t done = 0; done < added_.size();) {
      MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
      TileChunks tile = TileFrom(done);
      done += tile.added.size();
      if (is_compared_) {
        MAPSIEVE_ASSIGN_OR_RETURN(tile.before, ListBefore(tile.tile));
        std::erase_if(tile.before, [&tile](const ChunkRef& chunk) {
          return !chunk.bounds.Intersects(tile.added_box);
        });
      }
      const int64_t bytes = BytesOf(tile);
      if (!batch.empty() && (batch_bytes + bytes > limits_.bucket_bytes ||
                             batch.size() == kMaxPendingTiles)) {
        MAPSIEVE_RETURN_IF_ERROR(CountTiles(std::exchange(batch, {})));
        batch_bytes = 0;
      }
      batch_bytes += bytes;
      batch.push_back(std::move(tile));
    }
    MAPSIEVE_RETURN_IF_ERROR(CountTiles(std::move(batch)));
    census_.duplicate_point_count = added_count_ - distinct_count_;
    if (is_compared_) census_.overlapping_point_count = overlapping_count_;
    return std::move(census_);
  }

 private:
  int64_t max_set_bytes() const { return limits_.bucket_bytes / 2; }

  /// The tile of added_[begin], all of whose chunks follow; without `before`.
  TileChunks TileFrom(size_t begin) const {
    TileChunks tile = {.tile = added_[begin]->tile,
                       .added_box = added_[begin]->bounds};
    size_t end = begin;
    for (; end < added_.size() && added_[end]->tile == tile.tile; ++end) {
      tile.added_box = tile.added_box.Union(added_[end]->bounds);
      tile.added_count += added_[end]->point_count;
    }
    tile.added = std::span(added_).subspan(begin, end - begin);
    return tile;
  }

  /// The chunks of a tile without those of `added`.
  absl::StatusOr<std::vector<ChunkRef>> ListBefore(const CellKey& tile) const {
    MAPSIEVE_ASSIGN_OR_RETURN(
        std::vector<ChunkRef> chunks,
        base_.ListTileChunks(storage::ChunkKind::kRaw, tile));
    std::erase_if(chunks, [this](const ChunkRef& chunk) {
      return std::binary_search(removed_.begin(), removed_.end(), chunk.number);
    });
    if (const auto rest = rest_.find(tile); rest != rest_.end()) {
      chunks.insert(chunks.end(), rest->second.begin(), rest->second.end());
    }
    return chunks;
  }

  /// By whole tiles: how points are divided into chunks plays no part.
  absl::StatusOr<bool> IsWorthComparing() const {
    if (base_.revision().totals.raw_point_count == 0) return true;
    const int64_t limit =
        kMaxComparedShare * std::max(added_count_, kMinComparedPoints);
    int64_t count = 0;
    for (size_t i = 0; i < added_.size(); ++i) {
      if (i > 0 && added_[i]->tile == added_[i - 1]->tile) continue;
      MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
      MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> chunks,
                                ListBefore(added_[i]->tile));
      for (const ChunkRef& chunk : chunks) count += chunk.point_count;
      if (count > limit) return false;
    }
    return true;
  }

  int64_t BytesOf(const TileChunks& tile) const {
    const int cell_bits = 3 * (tile.tile.level - cell_level_);
    return std::min(tile.added_count * kSetBytes, max_set_bytes()) +
           (int64_t{8} << cell_bits) +
           static_cast<int64_t>(tile.before.size() * sizeof(ChunkRef));
  }

  absl::Status CountTiles(std::vector<TileChunks> batch) {
    std::vector<TileCounts> counts(batch.size());
    MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
        *context_.executor, static_cast<int64_t>(batch.size()),
        [&](int64_t n) -> absl::Status {
          const auto i = static_cast<size_t>(n);
          TileCounter counter(base_, batch[i], cell_level_, max_set_bytes());
          MAPSIEVE_ASSIGN_OR_RETURN(counts[i], counter.Count());
          return absl::OkStatus();
        }));
    for (const TileCounts& tile : counts) {
      distinct_count_ += tile.distinct;
      overlapping_count_ += tile.overlapping;
      is_compared_ = is_compared_ && tile.is_compared;
      for (size_t bin = 0; bin < tile.histogram.size(); ++bin) {
        AddTo(census_.density_histogram, bin, tile.histogram[bin]);
      }
    }
    return absl::OkStatus();
  }

  const storage::ReadSnapshot& base_;
  std::vector<int64_t> removed_;
  const IngestLimits limits_;
  const ExecutionContext& context_;
  const int cell_level_;
  std::map<CellKey, std::vector<ChunkRef>, core::CellKeyLess> rest_;
  /// By tile.
  std::vector<const ChunkRef*> added_;
  int64_t added_count_ = 0;
  bool is_compared_ = true;
  int64_t distinct_count_ = 0;
  int64_t overlapping_count_ = 0;
  PointCensus census_;
};

}  // namespace

int DensityCellLevel(int64_t step_nm, int tile_level) {
  constexpr uint64_t kUnitNm = 1'000'000'000;
  const auto steps_of_unit = (kUnitNm + static_cast<uint64_t>(step_nm) - 1) /
                             static_cast<uint64_t>(step_nm);
  // The least power of two from there on.
  const int unit_level = static_cast<int>(std::bit_width(steps_of_unit - 1));
  return std::clamp(unit_level, std::max(tile_level - kMaxCellBits, 0),
                    tile_level);
}

absl::StatusOr<PointCensus> TakeCensus(const storage::ReadSnapshot& base,
                                       std::span<const ChunkRef> added,
                                       const RegionCut& cut,
                                       std::span<const ChunkRef> rest,
                                       const IngestLimits& limits,
                                       const ExecutionContext& context) {
  return Census(base, added, cut, rest, limits, context).Take();
}

}  // namespace mapsieve::engine
