#include "server/engine/stored_tiles.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/geometry/morton.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/product_chunk.h"

namespace mapsieve::engine {
namespace {

using core::CellKey;
using core::LatticeCloud;
using core::LatticePoint;
using storage::ChunkKind;
using storage::ChunkRef;

/// Catalogue rows read at a time.
constexpr int64_t kPageSize = 1000;
/// More tiles are not written at once: their bookkeeping is not counted.
constexpr size_t kMaxPendingTiles = 64;
constexpr size_t kConfidenceCount = 65536;

std::string StateName(const CellKey& key, core::TileStateKind kind) {
  return std::to_string(static_cast<int>(kind)) + "-" + key.ToString();
}

/// Rows of `points` whose position is among `positions`; both in Morton order.
std::vector<uint32_t> RowsAt(std::span<const LatticePoint> points,
                             std::span<const LatticePoint> positions) {
  std::vector<uint32_t> rows;
  size_t next = 0;
  for (uint32_t row = 0; row < points.size(); ++row) {
    while (next < positions.size() &&
           core::MortonLess(positions[next], points[row])) {
      ++next;
    }
    if (next == positions.size()) break;
    if (positions[next] == points[row]) rows.push_back(row);
  }
  return rows;
}

}  // namespace

StoredTiles::StoredTiles(const storage::ReadSnapshot& snapshot,
                         storage::Scratch& scratch, ChunkWriter& products,
                         int64_t max_pending_bytes, std::stop_token stop)
    : snapshot_(snapshot),
      scratch_(scratch),
      products_(products),
      max_pending_bytes_(max_pending_bytes),
      stop_(std::move(stop)) {
  for (std::vector<int64_t>& counts : histogram_) {
    counts.resize(kConfidenceCount);
  }
}

absl::StatusOr<std::unique_ptr<StoredTiles>> StoredTiles::Open(
    const storage::ReadSnapshot& snapshot, storage::Scratch& scratch,
    ChunkWriter& products, int64_t max_pending_bytes, std::stop_token stop) {
  std::unique_ptr<StoredTiles> tiles(new StoredTiles(
      snapshot, scratch, products, max_pending_bytes, std::move(stop)));
  std::optional<CellKey> after;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<storage::TileSummary> page,
        snapshot.ListTiles(ChunkKind::kRaw, std::nullopt, after, kPageSize));
    for (const storage::TileSummary& tile : page) {
      tiles->tiles_.push_back({tile.tile, tile.point_count});
    }
    if (page.empty()) return tiles;
    after = page.back().tile;
  }
}

absl::StatusOr<int64_t> StoredTiles::LoadPoints(const CellKey& key,
                                                std::span<LatticePoint> room) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> chunks,
                            snapshot_.ListTileChunks(ChunkKind::kRaw, key));
  std::vector<LatticePoint> points;
  for (const ChunkRef& chunk : chunks) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const LatticeCloud cloud,
        ReadPoints(snapshot_, chunk,
                   {.attributes = std::vector<std::string>()}));
    points.insert(points.end(), cloud.positions.begin(), cloud.positions.end());
  }
  points = core::DistinctPoints(points);
  if (points.size() > room.size()) {
    return absl::DataLossError(
        absl::StrCat("tile ", key.ToString(), ": expected up to ", room.size(),
                     " points in its raw chunks, found ", points.size()));
  }
  std::copy(points.begin(), points.end(), room.begin());
  return static_cast<int64_t>(points.size());
}

absl::Status StoredTiles::StoreState(const CellKey& key,
                                     core::TileStateKind kind,
                                     std::span<const std::byte> bytes) {
  return scratch_.Write(StateName(key, kind), bytes);
}

absl::StatusOr<std::vector<std::byte>> StoredTiles::LoadState(
    const CellKey& key, core::TileStateKind kind) {
  return scratch_.Read(StateName(key, kind));
}

absl::StatusOr<LatticeCloud> StoredTiles::CollectRepresentatives(
    const CellKey& tile, std::span<const LatticePoint> positions) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> chunks,
                            snapshot_.ListTileChunks(ChunkKind::kRaw, tile));
  LatticeCloud collected{.lattice =
                             core::Lattice(snapshot_.map().spec.step_nm)};
  for (const ChunkRef& chunk : chunks) {
    MAPSIEVE_ASSIGN_OR_RETURN(const LatticeCloud cloud,
                              ReadPoints(snapshot_, chunk));
    const LatticeCloud part = cloud.Select(RowsAt(cloud.positions, positions));
    MAPSIEVE_RETURN_IF_ERROR(collected.attributes.AppendAll(
        collected.size(), part.attributes, part.size()));
    collected.positions.insert(collected.positions.end(),
                               part.positions.begin(), part.positions.end());
    // However many points lie in one place, one of them is kept.
    if (collected.size() > positions.size()) {
      collected = collected.Select(core::MergeDuplicates(collected));
    }
  }
  collected = collected.Select(core::MergeDuplicates(collected));
  if (collected.size() != positions.size()) {
    return absl::DataLossError(absl::StrCat(
        "tile ", tile.ToString(), ": expected ", positions.size(),
        " of its points in its raw chunks, found ", collected.size()));
  }
  return collected;
}

absl::Status StoredTiles::Emit(const core::TileResult& result) {
  if (result.rows.empty()) return absl::OkStatus();
  MAPSIEVE_ASSIGN_OR_RETURN(
      LatticeCloud points,
      CollectRepresentatives(result.key, result.positions));
  const core::LabelSpans& labels = result.columns;
  for (size_t i = 0; i < labels.size(); ++i) {
    ++histogram_[static_cast<size_t>(labels.label[i])][labels.confidence[i]];
  }
  LatticeCloud product = MakeProductCloud(std::move(points), labels);
  pending_bytes_ +=
      static_cast<int64_t>(product.size()) * DecodedPointBytes(product);
  pending_.push_back({result.key, std::move(product)});
  if (pending_bytes_ < max_pending_bytes_ &&
      pending_.size() < kMaxPendingTiles) {
    return absl::OkStatus();
  }
  return Flush();
}

absl::Status StoredTiles::Flush() {
  pending_bytes_ = 0;
  return products_.Write(std::exchange(pending_, {}), stop_);
}

core::LabelCounts StoredTiles::CountKept(const core::OutlierTest& test) const {
  core::LabelCounts kept{};
  for (size_t l = 0; l < core::kLabelCount; ++l) {
    for (size_t c = 0; c < kConfidenceCount; ++c) {
      if (test.Keeps(static_cast<core::Label>(l), static_cast<uint16_t>(c))) {
        kept[l] += histogram_[l][c];
      }
    }
  }
  return kept;
}

}  // namespace mapsieve::engine
