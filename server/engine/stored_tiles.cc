#include "server/engine/stored_tiles.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <iterator>
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

/// Of a point from its tile's corner, as scratch files hold them.
using Offsets = std::array<int32_t, 3>;

std::string StateName(const CellKey& key, core::TileStateKind kind) {
  return std::to_string(static_cast<int>(kind)) + "-" + key.ToString();
}

std::string PointsName(const CellKey& key) {
  return "points-" + key.ToString();
}

/// As many points as there is room for, from the bytes of their offsets.
void TakePoints(std::span<const std::byte> bytes, const LatticePoint& corner,
                std::span<LatticePoint> room) {
  for (size_t i = 0; i < room.size(); ++i) {
    Offsets offsets;
    std::memcpy(&offsets, bytes.data() + i * sizeof(Offsets), sizeof(Offsets));
    room[i] = {corner.x + offsets[0], corner.y + offsets[1],
               corner.z + offsets[2]};
  }
}

/// Where rows of `row_bytes` each lie in a file.
std::vector<storage::ByteRange> BytesOf(std::span<const core::RowRange> rows,
                                        size_t row_bytes) {
  const auto size = static_cast<int64_t>(row_bytes);
  std::vector<storage::ByteRange> parts;
  parts.reserve(rows.size());
  for (const core::RowRange& part : rows) {
    parts.push_back({part.begin * size, part.end * size});
  }
  return parts;
}

/// Calls use(i, j) for every place that a[i] and b[j] share; both distinct and
/// in Morton order.
template <typename Use>
void ForEachCommon(std::span<const LatticePoint> a,
                   std::span<const LatticePoint> b, const Use& use) {
  size_t j = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    while (j < b.size() && core::MortonLess(b[j], a[i])) ++j;
    if (j == b.size()) return;
    if (b[j] == a[i]) use(i, j);
  }
}

struct DividedChunks {
  std::vector<ChunkRef> shared;
  std::vector<ChunkRef> others;
};

/// The `chunks` of a tile that are also among `of`, and those that are not;
/// all in order of their numbers.
DividedChunks Divide(const std::vector<ChunkRef>& chunks,
                     const std::vector<ChunkRef>& of) {
  DividedChunks divided;
  for (const ChunkRef& chunk : chunks) {
    const bool is_shared = std::binary_search(
        of.begin(), of.end(), chunk, [](const ChunkRef& a, const ChunkRef& b) {
          return a.number < b.number;
        });
    (is_shared ? divided.shared : divided.others).push_back(chunk);
  }
  return divided;
}

/// The distinct points of two lists of such; all in Morton order.
std::vector<LatticePoint> Union(std::vector<LatticePoint> a,
                                std::vector<LatticePoint> b) {
  if (b.empty()) return a;
  if (a.empty()) return b;
  std::vector<LatticePoint> both;
  both.reserve(a.size() + b.size());
  std::set_union(a.begin(), a.end(), b.begin(), b.end(),
                 std::back_inserter(both),
                 [](const LatticePoint& p, const LatticePoint& q) {
                   return core::MortonLess(p, q);
                 });
  return both;
}

}  // namespace

StoredTiles::StoredTiles(storage::Store& store,
                         const storage::ReadSnapshot& snapshot,
                         const storage::ReadSnapshot* previous,
                         storage::Scratch& scratch, ProductLevels& products,
                         const Options& options)
    : snapshot_(snapshot),
      previous_(previous),
      scratch_(scratch),
      options_(options),
      products_(products),
      history_(store),
      point_bytes_(ProductPointBytes(snapshot.revision().spec.attributes)) {}

absl::StatusOr<std::unique_ptr<StoredTiles>> StoredTiles::Open(
    storage::Store& store, const storage::ReadSnapshot& snapshot,
    const storage::ReadSnapshot* previous, storage::Scratch& scratch,
    ProductLevels& products, const Options& options) {
  std::unique_ptr<StoredTiles> tiles(
      new StoredTiles(store, snapshot, previous, scratch, products, options));
  MAPSIEVE_RETURN_IF_ERROR(tiles->ReadTileList());
  return tiles;
}

absl::Status StoredTiles::ReadTileList() {
  std::optional<CellKey> after;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<storage::TileSummary> page,
        snapshot_.ListTiles(ChunkKind::kRaw, std::nullopt, after, kPageSize));
    for (const storage::TileSummary& tile : page) {
      tiles_.push_back({tile.tile, tile.point_count});
    }
    if (page.empty()) return absl::OkStatus();
    after = page.back().tile;
  }
}

/// A tile is visited many times: its points are kept in a scratch file, ready
/// to be used, after the first.
absl::StatusOr<int64_t> StoredTiles::LoadPoints(const CellKey& key,
                                                std::span<LatticePoint> room) {
  const std::string name = PointsName(key);
  const LatticePoint corner = key.corner();
  const auto kept = scratch_.Read(name);
  if (kept.ok()) {
    const size_t count = std::min(kept->size() / sizeof(Offsets), room.size());
    TakePoints(*kept, corner, room.first(count));
    return static_cast<int64_t>(count);
  }
  if (!absl::IsNotFound(kept.status())) return kept.status();
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<LatticePoint> points,
                            ReadDistinctPoints(snapshot_, key));
  if (points.size() > room.size()) {
    return absl::DataLossError(
        absl::StrCat("tile ", key.ToString(), ": expected up to ", room.size(),
                     " points in its raw chunks, found ", points.size()));
  }
  MAPSIEVE_RETURN_IF_ERROR(KeepPoints(key, points));
  std::copy(points.begin(), points.end(), room.begin());
  return static_cast<int64_t>(points.size());
}

absl::Status StoredTiles::KeepPoints(const CellKey& key,
                                     std::span<const LatticePoint> points) {
  const LatticePoint corner = key.corner();
  std::vector<Offsets> offsets;
  offsets.reserve(points.size());
  for (const LatticePoint& q : points) {
    offsets.push_back({static_cast<int32_t>(q.x - corner.x),
                       static_cast<int32_t>(q.y - corner.y),
                       static_cast<int32_t>(q.z - corner.z)});
  }
  return scratch_.Write(PointsName(key), std::as_bytes(std::span(offsets)));
}

absl::Status StoredTiles::LoadPointRows(const CellKey& key,
                                        std::span<const core::RowRange> rows,
                                        std::span<LatticePoint> room) {
  std::vector<std::byte> bytes(room.size() * sizeof(Offsets));
  MAPSIEVE_RETURN_IF_ERROR(scratch_.ReadParts(
      PointsName(key), BytesOf(rows, sizeof(Offsets)), bytes));
  TakePoints(bytes, key.corner(), room);
  return absl::OkStatus();
}

absl::Status StoredTiles::StoreState(const CellKey& key,
                                     core::TileStateKind kind,
                                     std::span<const std::byte> bytes) {
  if (options_.checkpoint != nullptr) {
    return options_.checkpoint->Store(StateName(key, kind), bytes);
  }
  MAPSIEVE_RETURN_IF_ERROR(scratch_.Write(StateName(key, kind), bytes));
  if (kind == core::TileStateKind::kDeaths) {
    const MutexLock lock(mutex_);
    stored_deaths_.insert(key);
  }
  return absl::OkStatus();
}

bool StoredTiles::HasStoredDeaths(const CellKey& key) const {
  const MutexLock lock(mutex_);
  return stored_deaths_.contains(key);
}

absl::Status StoredTiles::LoadState(const CellKey& key,
                                    core::TileStateKind kind,
                                    std::span<const core::RowRange> rows,
                                    std::span<std::byte> room) {
  const size_t row_bytes = room.size() / core::RowCount(rows);
  if (options_.checkpoint != nullptr) {
    return options_.checkpoint->Load(StateName(key, kind),
                                     BytesOf(rows, row_bytes), room);
  }
  if (kind != core::TileStateKind::kDeaths || previous_ == nullptr ||
      HasStoredDeaths(key)) {
    return scratch_.ReadParts(StateName(key, kind), BytesOf(rows, row_bytes),
                              room);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<core::DeathRound> deaths,
                            ReadDeaths(*previous_, key));
  if (deaths.size() < rows.back().end) {
    return absl::DataLossError(
        absl::StrCat("tile ", key.ToString(), ": expected ", rows.back().end,
                     " or more points in its history, found ", deaths.size()));
  }
  core::CopyRows(std::as_bytes(std::span(deaths)), rows, room);
  return absl::OkStatus();
}

absl::StatusOr<std::vector<core::TileChange>> StoredTiles::CompareTiles(
    std::span<const CellKey> tiles, const ExecutionContext& context) {
  std::vector<core::TileChange> changes(tiles.size());
  MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
      *context.executor, static_cast<int64_t>(tiles.size()),
      [&](int64_t n) -> absl::Status {
        MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
        const auto i = static_cast<size_t>(n);
        MAPSIEVE_ASSIGN_OR_RETURN(changes[i], CompareTile(tiles[i]));
        return absl::OkStatus();
      }));
  return changes;
}

/// Keeps the points of today and their deaths at the previous revision, kAlive
/// for points that were not there.
absl::StatusOr<core::TileChange> StoredTiles::CompareTile(const CellKey& tile) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> old_chunks,
                            previous_->ListTileChunks(ChunkKind::kRaw, tile));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> chunks,
                            snapshot_.ListTileChunks(ChunkKind::kRaw, tile));
  // What both revisions hold is read once.
  const auto [shared, gone] = Divide(old_chunks, chunks);
  const std::vector<ChunkRef> added = Divide(chunks, old_chunks).others;
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<LatticePoint> shared_points,
                            ReadDistinctPoints(snapshot_, shared));
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<LatticePoint> added_points,
                            ReadDistinctPoints(snapshot_, added));
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<LatticePoint> gone_points,
                            ReadDistinctPoints(*previous_, gone));
  const std::vector<LatticePoint> points =
      Union(shared_points, std::move(added_points));
  const std::vector<LatticePoint> old_points =
      Union(std::move(shared_points), std::move(gone_points));
  core::TileChange change = {.tile = tile};
  core::ForEachDifference(points, old_points, [&](const LatticePoint& q) {
    change.box = change.box.has_value() ? change.box->Union(core::BoxOf(q))
                                        : core::BoxOf(q);
  });
  if (points.empty()) return change;
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<core::DeathRound> before,
                            ReadDeaths(*previous_, tile));
  if (before.size() != old_points.size()) {
    return absl::DataLossError(
        absl::StrCat("tile ", tile.ToString(), ": expected ", old_points.size(),
                     " points in its history, found ", before.size()));
  }
  std::vector<core::DeathRound> deaths(points.size(), core::kAlive);
  ForEachCommon(points, old_points,
                [&](size_t i, size_t j) { deaths[i] = before[j]; });
  MAPSIEVE_RETURN_IF_ERROR(KeepPoints(tile, points));
  MAPSIEVE_RETURN_IF_ERROR(StoreState(tile, core::TileStateKind::kDeaths,
                                      std::as_bytes(std::span(deaths))));
  return change;
}

absl::StatusOr<LatticeCloud> StoredTiles::CollectRepresentatives(
    const CellKey& tile, std::span<const LatticePoint> positions) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> chunks,
                            snapshot_.ListTileChunks(ChunkKind::kRaw, tile));
  LatticeCloud collected{.lattice =
                             core::Lattice(snapshot_.map().spec.step_nm)};
  for (const ChunkRef& chunk : chunks) {
    MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud part,
                              ReadPointsAt(snapshot_, chunk, positions));
    if (collected.attributes.columns().empty() && collected.size() == 0) {
      collected = std::move(part);
      continue;
    }
    MAPSIEVE_RETURN_IF_ERROR(collected.attributes.AppendAll(
        collected.size(), part.attributes, part.size()));
    collected.positions.insert(collected.positions.end(),
                               part.positions.begin(), part.positions.end());
    // However many points lie in one place, one of them is kept.
    if (collected.size() > positions.size()) {
      collected = collected.Select(core::MergeDuplicates(collected));
    }
  }
  // In their order, one for each of `positions`.
  if (collected.positions.size() == positions.size() &&
      std::equal(positions.begin(), positions.end(),
                 collected.positions.begin())) {
    return collected;
  }
  collected = collected.Select(core::MergeDuplicates(collected));
  if (collected.size() != positions.size()) {
    return absl::DataLossError(absl::StrCat(
        "tile ", tile.ToString(), ": expected ", positions.size(),
        " of its points in its raw chunks, found ", collected.size()));
  }
  return collected;
}

absl::Status StoredTiles::FinishVisit(std::span<const std::byte> record) {
  return options_.checkpoint == nullptr
             ? absl::OkStatus()
             : options_.checkpoint->FinishVisit(record);
}

std::vector<std::vector<std::byte>> StoredTiles::FinishedVisits() {
  if (options_.checkpoint == nullptr) return {};
  return options_.checkpoint->finished();
}

absl::Status StoredTiles::Emit(const core::TileResult& result) {
  const core::LabelSpans& labels = result.columns;
  emitted_.insert(result.key);
  Pending pending = {.tile = result.key};
  pending.deaths.assign(result.deaths.begin(), result.deaths.end());
  pending.positions.assign(result.positions.begin(), result.positions.end());
  pending.columns.Append(labels);
  pending_bytes_ += static_cast<int64_t>(pending.deaths.size()) +
                    static_cast<int64_t>(labels.size()) * 2 * point_bytes_;
  pending_.push_back(std::move(pending));
  if (pending_bytes_ < options_.max_pending_bytes &&
      pending_.size() < kMaxPendingTiles) {
    return absl::OkStatus();
  }
  return Flush();
}

absl::StatusOr<core::LabeledSurvivors> StoredTiles::LoadSurvivors(
    const CellKey& tile) {
  MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud product,
                            ReadProduct(*previous_, tile));
  if (product.size() == 0) return core::LabeledSurvivors();
  MAPSIEVE_ASSIGN_OR_RETURN(core::LabelColumns columns,
                            LabelColumnsOf(product));
  return core::LabeledSurvivors{std::move(product.positions),
                                std::move(columns)};
}

absl::Status StoredTiles::Flush() {
  pending_bytes_ = 0;
  const std::vector<Pending> pending = std::exchange(pending_, {});
  std::vector<TileCloud> clouds(pending.size());
  std::vector<std::vector<ChunkRef>> histories(pending.size());
  MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
      *options_.io, static_cast<int64_t>(pending.size()),
      [&](int64_t i) -> absl::Status {
        if (options_.stop.stop_requested()) {
          return absl::CancelledError("cancelled");
        }
        const Pending& tile = pending[static_cast<size_t>(i)];
        MAPSIEVE_ASSIGN_OR_RETURN(
            LatticeCloud points,
            CollectRepresentatives(tile.tile, tile.positions));
        clouds[static_cast<size_t>(i)] = {
            tile.tile, MakeProductCloud(std::move(points), tile.columns.All())};
        if (options_.repair != nullptr) {
          return options_.repair->PutHistory(tile.tile, tile.deaths);
        }
        MAPSIEVE_ASSIGN_OR_RETURN(histories[static_cast<size_t>(i)],
                                  history_.Write(tile.tile, tile.deaths));
        return absl::OkStatus();
      }));
  for (const std::vector<ChunkRef>& chunks : histories) {
    history_chunks_.insert(history_chunks_.end(), chunks.begin(), chunks.end());
  }
  std::erase_if(
      clouds, [](const TileCloud& cloud) { return cloud.points.size() == 0; });
  return products_.Add(std::move(clouds));
}

}  // namespace mapsieve::engine
