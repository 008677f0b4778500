#include "tests/testing/memory_catalogue.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "storage/names.h"
#include "storage/record_checks.h"
#include "storage/tile_order.h"

namespace mapsieve::testing {
namespace {

using core::CellKey;
using core::CellKeyLess;
using core::LatticeBox;
using storage::ChunkKind;
using storage::ChunkRef;
using storage::MapRecord;
using storage::OperationRecord;
using storage::RevisionRecord;
using storage::RevisionTotals;
using storage::UploadRecord;
using storage::UploadState;

absl::Status NotFound(const char* what, const std::string& name) {
  return absl::NotFoundError(
      absl::StrCat(what, " ", storage::Quoted(name), " does not exist"));
}

absl::Status CheckIs(const UploadRecord& upload, UploadState expected) {
  if (upload.state == expected) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("upload ", upload.spec.id, " is in another state"));
}

absl::Status CheckCell(const CellKey& cell) {
  if (storage::IsValidCell(cell)) return absl::OkStatus();
  return absl::InvalidArgumentError("no cell of the octree");
}

// An empty region intersects nothing.
bool Intersects(const ChunkRef& chunk,
                const std::optional<LatticeBox>& region) {
  if (!region.has_value()) return true;
  const auto& [min, max] = *region;
  const bool is_empty = min.x >= max.x || min.y >= max.y || min.z >= max.z;
  return !is_empty && chunk.bounds.Intersects(*region);
}

template <typename Record>
void CutToPage(std::vector<Record>& records, int64_t max_count) {
  if (std::ssize(records) > max_count) {
    records.resize(static_cast<size_t>(max_count));
  }
}

}  // namespace

absl::StatusOr<const MemoryCatalogue::Map*> MemoryCatalogue::FindMap(
    const std::string& uid) const {
  const auto map = maps_.find(uid);
  if (map == maps_.end()) return NotFound("map", uid);
  return &map->second;
}

absl::StatusOr<MemoryCatalogue::Map*> MemoryCatalogue::FindLivingMap(
    const std::string& uid) {
  const auto map = maps_.find(uid);
  if (map == maps_.end() || map->second.deleted) return NotFound("map", uid);
  return &map->second;
}

absl::StatusOr<const MemoryCatalogue::Map*> MemoryCatalogue::FindMapById(
    const std::string& id) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckMapId(id));
  for (const auto& [uid, map] : maps_) {
    if (map.record.spec.id == id && !map.deleted) return &map;
  }
  return NotFound("map", id);
}

absl::StatusOr<const MemoryCatalogue::Revision*> MemoryCatalogue::FindRevision(
    const std::string& map_uid, int64_t number) const {
  MAPSIEVE_ASSIGN_OR_RETURN(const Map* map, FindMap(map_uid));
  const auto revision = map->revisions.find(number);
  if (revision != map->revisions.end()) return &revision->second;
  return absl::OutOfRangeError(
      absl::StrCat("map ", map->record.spec.id, " has no revision ", number,
                   ": expected 1 to ", map->record.newest_revision));
}

absl::StatusOr<const MemoryCatalogue::Revision*>
MemoryCatalogue::FindKeptRevision(const std::string& map_uid,
                                  int64_t number) const {
  MAPSIEVE_ASSIGN_OR_RETURN(const Revision* revision,
                            FindRevision(map_uid, number));
  if (!revision->record.is_expired) return revision;
  return absl::OutOfRangeError(absl::StrCat(
      "revision ", number, " expired; the oldest one that is kept is ",
      maps_.at(map_uid).record.oldest_revision));
}

int64_t MemoryCatalogue::LastAddition(const Map& map, int64_t number,
                                      const std::string& upload_id) {
  const auto additions = map.upload_revisions.find(upload_id);
  if (additions == map.upload_revisions.end()) return 0;
  while (number != 0 && !additions->second.contains(number)) {
    const RevisionRecord& revision = map.revisions.at(number).record;
    number = revision.restored_revision != 0 ? revision.restored_revision
                                             : revision.parent;
  }
  return number;
}

absl::StatusOr<UploadRecord*> MemoryCatalogue::FindUpload(
    const std::string& uid) {
  const auto upload = uploads_.find(uid);
  if (upload == uploads_.end()) return NotFound("upload", uid);
  return &upload->second;
}

absl::StatusOr<OperationRecord> MemoryCatalogue::FindOperation(
    const std::string& id) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckResourceId(id));
  const auto operation = operations_.find(id);
  if (operation == operations_.end()) return NotFound("operation", id);
  return operation->second;
}

std::string MemoryCatalogue::NewUid() {
  return ContentHash(TextBytes(std::to_string(++last_uid_)));
}

absl::StatusOr<MapRecord> MemoryCatalogue::CreateMap(
    const storage::MapSpec& spec) {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckMapSpec(spec));
  MutexLock lock(mutex_);
  if (FindMapById(spec.id).ok()) {
    return absl::AlreadyExistsError(
        absl::StrCat("map ", spec.id, " exists already"));
  }
  Map map;
  map.record.spec = spec;
  map.record.uid = NewUid();
  Revision first;
  first.record.number = 1;
  first.record.spec.kind = storage::RevisionKind::kCreate;
  first.record.create_time = absl::Now();
  map.record.create_time = first.record.create_time;
  Append(map, first, "");
  return maps_.emplace(map.record.uid, map).first->second.record;
}

absl::StatusOr<MapRecord> MemoryCatalogue::GetMap(const std::string& id) const {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Map* map, FindMapById(id));
  return map->record;
}

absl::StatusOr<std::vector<MapRecord>> MemoryCatalogue::ListMaps(
    const std::string& after, int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  MutexLock lock(mutex_);
  std::map<std::string, MapRecord> by_id;
  for (const auto& [uid, map] : maps_) {
    if (!map.deleted && map.record.spec.id > after) {
      by_id.emplace(map.record.spec.id, map.record);
    }
  }
  std::vector<MapRecord> page;
  for (const auto& [id, map] : by_id) page.push_back(map);
  CutToPage(page, max_count);
  return page;
}

absl::Status MemoryCatalogue::DeleteMap(const std::string& id) {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Map* map, FindMapById(id));
  const std::string uid = map->record.uid;
  maps_.at(uid).deleted = true;
  std::erase_if(uploads_,
                [&](const auto& entry) { return entry.second.map_uid == uid; });
  return absl::OkStatus();
}

absl::StatusOr<std::vector<std::string>> MemoryCatalogue::ListDeletedMaps(
    const std::string& after, int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  MutexLock lock(mutex_);
  std::vector<std::string> page;
  for (const auto& [uid, map] : maps_) {
    if (map.deleted && uid > after) page.push_back(uid);
  }
  CutToPage(page, max_count);
  return page;
}

absl::Status MemoryCatalogue::PurgeMap(const std::string& map_uid) {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Map* map, FindMap(map_uid));
  if (!map->deleted) {
    return absl::FailedPreconditionError("the map is not deleted");
  }
  maps_.erase(map_uid);
  return absl::OkStatus();
}

const RevisionRecord& MemoryCatalogue::Append(
    Map& map, Revision revision, const std::string& process_options) {
  RevisionTotals& totals = revision.record.totals;
  totals = {};
  Tiles tiles;
  for (const auto& [number, chunk] : revision.chunks) {
    map.references.emplace(number, chunk);
    totals.stored_bytes += chunk.stored_bytes;
    if (chunk.kind == ChunkKind::kRaw) {
      totals.bounds = totals.raw_chunk_count == 0
                          ? chunk.bounds
                          : totals.bounds.Union(chunk.bounds);
      ++totals.raw_chunk_count;
      totals.raw_point_count += chunk.point_count;
      tiles.insert(chunk.tile);
    }
    if (chunk.kind == ChunkKind::kProduct) {
      ++totals.product_chunk_count;
      totals.product_point_count += chunk.point_count;
      for (size_t label = 0; label < core::kLabelCount; ++label) {
        totals.label_counts[label] += chunk.label_counts[label];
      }
    }
  }
  if (revision.record.spec.product.has_value()) {
    revision.changed_tiles.clear();
    revision.product_tiles = tiles;
  }
  // A tile without points, of which no product knows, is none.
  std::erase_if(revision.changed_tiles, [&](const CellKey& tile) {
    return !tiles.contains(tile) && !revision.product_tiles.contains(tile);
  });
  totals.tile_count = std::ssize(tiles);
  totals.stale_tile_count = std::ssize(revision.changed_tiles);

  const int64_t number = revision.record.number;
  if (number == 1) map.record.oldest_revision = 1;
  map.record.newest_revision = number;
  map.record.update_time = revision.record.create_time;
  map.record.process_options = process_options;
  return map.revisions.emplace(number, std::move(revision))
      .first->second.record;
}

absl::StatusOr<RevisionRecord> MemoryCatalogue::CommitRevision(
    const std::string& map_uid, int64_t expected_parent,
    const storage::RevisionChange& change) {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(Map * map, FindLivingMap(map_uid));
  if (expected_parent != map->record.newest_revision) {
    return absl::AbortedError(absl::StrCat(
        "map ", map->record.spec.id, ": expected revision ", expected_parent,
        " to be the newest, revision ", map->record.newest_revision, " is"));
  }
  MAPSIEVE_RETURN_IF_ERROR(
      storage::CheckRevisionChange(change, map->record.spec.tile_level));
  Revision revision = map->newest();
  const auto remember_change = [&](const ChunkRef& chunk) {
    if (chunk.kind == ChunkKind::kRaw) {
      revision.changed_tiles.insert(chunk.tile);
    }
  };
  for (const int64_t number : change.removed) {
    const auto chunk = revision.chunks.find(number);
    if (chunk == revision.chunks.end()) {
      return absl::InvalidArgumentError(
          absl::StrCat("chunk ", number, " is not in the parent"));
    }
    remember_change(chunk->second);
    revision.chunks.erase(chunk);
  }
  UploadRecord* upload = nullptr;
  if (!change.finalized_upload_uid.empty()) {
    MAPSIEVE_ASSIGN_OR_RETURN(upload, FindUpload(change.finalized_upload_uid));
    if (upload->map_uid != map_uid) return NotFound("upload", upload->uid);
    MAPSIEVE_RETURN_IF_ERROR(CheckIs(*upload, UploadState::kFinalizing));
  }
  // Nothing is refused from here on.
  if (change.removes_product) {
    std::erase_if(revision.chunks, [](const auto& entry) {
      return entry.second.kind != ChunkKind::kRaw;
    });
  }
  for (ChunkRef chunk : change.added) {
    remember_change(chunk);
    chunk.number = ++last_chunk_;
    revision.chunks.emplace(chunk.number, chunk);
  }
  RevisionRecord& record = revision.record;
  record.number = expected_parent + 1;
  record.parent = expected_parent;
  record.create_time = absl::Now();
  record.spec = change.spec;
  record.restored_revision = 0;
  storage::MapSpec& spec = map->record.spec;
  if (!change.crs_wkt.empty()) spec.crs_wkt = change.crs_wkt;
  if (!change.frame_id.empty()) spec.frame_id = change.frame_id;
  std::string options = map->record.process_options;
  if (change.spec.product.has_value()) {
    record.processed_revision = record.number;
    options = change.spec.product->options;
  }
  if (upload != nullptr) {
    upload->state = UploadState::kFinalized;
    upload->revision = record.number;
    upload->report = change.upload_report;
    upload->update_time = record.create_time;
    map->upload_revisions[upload->spec.id][record.number] =
        change.upload_report;
  }
  return Append(*map, std::move(revision), options);
}

absl::StatusOr<RevisionRecord> MemoryCatalogue::RollBack(
    const std::string& map_uid, int64_t number) {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(Map * map, FindLivingMap(map_uid));
  MAPSIEVE_RETURN_IF_ERROR(FindRevision(map_uid, number).status());
  const Revision& newest = map->newest();
  if (newest.record.number == number ||
      newest.record.restored_revision == number) {
    return newest.record;
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const Revision* target,
                            FindKeptRevision(map_uid, number));
  for (auto& [uid, upload] : uploads_) {
    if (upload.map_uid != map_uid || upload.state == UploadState::kFinalized) {
      continue;
    }
    const std::string& id = upload.spec.id;
    const int64_t restored = LastAddition(*map, number, id);
    if (restored == 0 || LastAddition(*map, newest.record.number, id) != 0) {
      continue;
    }
    upload.state = UploadState::kFinalized;
    upload.revision = restored;
    upload.report = map->upload_revisions.at(id).at(restored);
    upload.update_time = absl::Now();
  }
  // Where one chunk of a kind and tile is gone, all of them get new numbers, so
  // that their order stays.
  const auto group = [](const ChunkRef& chunk) {
    return std::pair(chunk.kind, storage::TileOrderKey(chunk.tile));
  };
  std::set<std::pair<ChunkKind, std::string>> renewed;
  for (const auto& [chunk_number, chunk] : target->chunks) {
    if (!newest.chunks.contains(chunk_number)) renewed.insert(group(chunk));
  }
  Revision revision = *target;
  revision.chunks.clear();
  for (const auto& [chunk_number, chunk] : target->chunks) {
    ChunkRef copy = chunk;
    if (renewed.contains(group(chunk))) copy.number = ++last_chunk_;
    revision.chunks.emplace(copy.number, copy);
  }
  revision.record.number = newest.record.number + 1;
  revision.record.parent = newest.record.number;
  revision.record.create_time = absl::Now();
  revision.record.spec = {.kind = storage::RevisionKind::kRollback,
                          .attributes = target->record.spec.attributes};
  revision.record.restored_revision = number;
  const int64_t processed = target->record.processed_revision;
  const std::string options =
      processed == 0
          ? ""
          : map->revisions.at(processed).record.spec.product->options;
  return Append(*map, std::move(revision), options);
}

absl::StatusOr<RevisionRecord> MemoryCatalogue::GetRevision(
    const std::string& map_uid, int64_t number) const {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Revision* revision,
                            FindRevision(map_uid, number));
  return revision->record;
}

absl::StatusOr<RevisionRecord> MemoryCatalogue::GetKeptRevision(
    const std::string& map_uid, int64_t number) const {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Revision* revision,
                            FindKeptRevision(map_uid, number));
  return revision->record;
}

absl::StatusOr<int64_t> MemoryCatalogue::ExpireRevisions(
    const std::string& map_uid, int64_t kept_count) {
  if (kept_count < 1) {
    return absl::InvalidArgumentError("revisions to keep: at least 1");
  }
  MutexLock lock(mutex_);
  MAPSIEVE_RETURN_IF_ERROR(FindMap(map_uid).status());
  Map& map = maps_.at(map_uid);
  std::set<int64_t> kept;
  for (const auto& [number, revision] : map.revisions) {
    if (number <= map.record.newest_revision - kept_count) continue;
    kept.insert(number);
    kept.insert(revision.record.processed_revision);
  }
  int64_t count = 0;
  for (auto& [number, revision] : map.revisions) {
    if (kept.contains(number) || revision.record.is_expired) continue;
    revision.record.is_expired = true;
    ++count;
  }
  for (const auto& [number, revision] : map.revisions) {
    map.record.oldest_revision = number;
    if (!revision.record.is_expired) break;
  }
  return count;
}

absl::StatusOr<std::vector<storage::BlobId>> MemoryCatalogue::ForgetExpired(
    const std::string& map_uid, const std::set<int64_t>& pinned) {
  MutexLock lock(mutex_);
  MAPSIEVE_RETURN_IF_ERROR(FindMap(map_uid).status());
  Map& map = maps_.at(map_uid);
  std::set<int64_t> readable = pinned;
  for (const auto& [number, revision] : map.revisions) {
    if (!revision.record.is_expired) readable.insert(number);
  }
  for (const int64_t number : pinned) {
    MAPSIEVE_ASSIGN_OR_RETURN(const Revision* revision,
                              FindRevision(map_uid, number));
    readable.insert(revision->record.processed_revision);
  }
  Chunks still_referenced;
  for (auto& [number, revision] : map.revisions) {
    if (readable.contains(number)) {
      still_referenced.insert(revision.chunks.begin(), revision.chunks.end());
    } else {
      revision.chunks.clear();
    }
  }
  std::vector<storage::BlobId> forgotten;
  for (const auto& [number, chunk] : map.references) {
    if (!still_referenced.contains(number)) {
      forgotten.push_back(chunk.blob_id);
    }
  }
  map.references = std::move(still_referenced);
  return forgotten;
}

absl::StatusOr<int64_t> MemoryCatalogue::MeasureReclaimable(
    const std::string& map_uid) const {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Map* map, FindMap(map_uid));
  std::map<storage::BlobId, int64_t> bytes_of;
  for (const auto& [number, chunk] : map->references) {
    bytes_of[chunk.blob_id] = chunk.stored_bytes;
  }
  const auto keep = [&](const Chunks& chunks) {
    for (const auto& [number, chunk] : chunks) bytes_of.erase(chunk.blob_id);
  };
  keep(map->newest().chunks);
  const int64_t processed = map->newest().record.processed_revision;
  if (processed != 0) keep(map->revisions.at(processed).chunks);
  for (const auto& [uid, other] : maps_) {
    if (uid != map_uid) keep(other.references);
  }
  int64_t bytes = 0;
  for (const auto& [id, size] : bytes_of) bytes += size;
  return bytes;
}

absl::StatusOr<std::vector<RevisionRecord>> MemoryCatalogue::ListRevisions(
    const std::string& map_uid, int64_t before, int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Map* map, FindMap(map_uid));
  std::vector<RevisionRecord> page;
  for (const auto& [number, revision] : map->revisions) {
    if (before == 0 || number < before) page.push_back(revision.record);
  }
  std::reverse(page.begin(), page.end());
  CutToPage(page, max_count);
  return page;
}

absl::StatusOr<std::vector<ChunkRef>> MemoryCatalogue::Select(
    const std::string& map_uid, int64_t revision, ChunkKind kind,
    const std::optional<LatticeBox>& region) const {
  MAPSIEVE_ASSIGN_OR_RETURN(const Revision* found,
                            FindRevision(map_uid, revision));
  std::vector<ChunkRef> selected;
  for (const auto& [number, chunk] : found->chunks) {
    if (chunk.kind == kind && Intersects(chunk, region)) {
      selected.push_back(chunk);
    }
  }
  // By number already.
  std::stable_sort(selected.begin(), selected.end(),
                   [](const ChunkRef& a, const ChunkRef& b) {
                     return CellKeyLess()(a.tile, b.tile);
                   });
  return selected;
}

absl::StatusOr<std::vector<ChunkRef>> MemoryCatalogue::ListChunks(
    const std::string& map_uid, int64_t revision, ChunkKind kind,
    const std::optional<LatticeBox>& region,
    const std::optional<storage::ChunkPosition>& after,
    int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  if (after.has_value()) MAPSIEVE_RETURN_IF_ERROR(CheckCell(after->tile));
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<ChunkRef> page,
                            Select(map_uid, revision, kind, region));
  std::erase_if(page, [&](const ChunkRef& chunk) {
    return after.has_value() &&
           (CellKeyLess()(chunk.tile, after->tile) ||
            (chunk.tile == after->tile && chunk.number <= after->number));
  });
  CutToPage(page, max_count);
  return page;
}

absl::StatusOr<std::vector<ChunkRef>> MemoryCatalogue::ListTileChunks(
    const std::string& map_uid, int64_t revision, ChunkKind kind,
    const CellKey& tile) const {
  MAPSIEVE_RETURN_IF_ERROR(CheckCell(tile));
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<ChunkRef> chunks,
                            Select(map_uid, revision, kind, std::nullopt));
  std::erase_if(chunks,
                [&](const ChunkRef& chunk) { return chunk.tile != tile; });
  return chunks;
}

absl::StatusOr<std::vector<storage::TileSummary>> MemoryCatalogue::ListTiles(
    const std::string& map_uid, int64_t revision, ChunkKind kind,
    const std::optional<LatticeBox>& region,
    const std::optional<CellKey>& after, int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  if (after.has_value()) MAPSIEVE_RETURN_IF_ERROR(CheckCell(*after));
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> chunks,
                            Select(map_uid, revision, kind, region));
  std::vector<storage::TileSummary> page;
  for (const ChunkRef& chunk : chunks) {
    if (after.has_value() && !CellKeyLess()(*after, chunk.tile)) continue;
    if (page.empty() || page.back().tile != chunk.tile) {
      page.push_back({.tile = chunk.tile, .bounds = chunk.bounds});
    }
    storage::TileSummary& tile = page.back();
    ++tile.chunk_count;
    tile.point_count += chunk.point_count;
    tile.stored_bytes += chunk.stored_bytes;
    for (size_t label = 0; label < core::kLabelCount; ++label) {
      tile.label_counts[label] += chunk.label_counts[label];
    }
    tile.bounds = tile.bounds.Union(chunk.bounds);
  }
  CutToPage(page, max_count);
  return page;
}

absl::StatusOr<std::vector<ChunkRef>> MemoryCatalogue::ListAllChunks(
    const std::string& map_uid, int64_t after, int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Map* map, FindMap(map_uid));
  std::vector<ChunkRef> page;
  for (const auto& [number, chunk] : map->references) {
    if (number > after) page.push_back(chunk);
  }
  CutToPage(page, max_count);
  return page;
}

absl::StatusOr<int64_t> MemoryCatalogue::CountAllChunks(
    const std::string& map_uid) const {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Map* map, FindMap(map_uid));
  return std::ssize(map->references);
}

absl::StatusOr<std::vector<CellKey>> MemoryCatalogue::ListChangedTiles(
    const std::string& map_uid, int64_t revision, int64_t other, ChunkKind kind,
    const std::optional<CellKey>& after, int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  if (after.has_value()) MAPSIEVE_RETURN_IF_ERROR(CheckCell(*after));
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const Revision* one,
                            FindRevision(map_uid, revision));
  MAPSIEVE_ASSIGN_OR_RETURN(const Revision* two, FindRevision(map_uid, other));
  Tiles tiles;
  const auto compare = [&](const Chunks& chunks, const Chunks& others) {
    for (const auto& [number, chunk] : chunks) {
      if (chunk.kind == kind && !others.contains(number)) {
        tiles.insert(chunk.tile);
      }
    }
  };
  compare(one->chunks, two->chunks);
  compare(two->chunks, one->chunks);
  std::vector<CellKey> page(
      after.has_value() ? tiles.upper_bound(*after) : tiles.begin(),
      tiles.end());
  CutToPage(page, max_count);
  return page;
}

absl::StatusOr<std::vector<bool>> MemoryCatalogue::AreBlobsReferenced(
    std::span<const storage::BlobId> ids) const {
  MutexLock lock(mutex_);
  std::set<storage::BlobId> known;
  for (const auto& [uid, map] : maps_) {
    for (const auto& [number, chunk] : map.references) {
      known.insert(chunk.blob_id);
    }
  }
  std::vector<bool> referenced;
  for (const storage::BlobId& id : ids)
    referenced.push_back(known.contains(id));
  return referenced;
}

absl::StatusOr<UploadRecord> MemoryCatalogue::CreateUpload(
    const std::string& map_uid, const storage::UploadSpec& spec) {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckUploadSpec(spec));
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(Map * map, FindLivingMap(map_uid));
  const auto existing =
      std::find_if(uploads_.begin(), uploads_.end(), [&](const auto& entry) {
        return entry.second.map_uid == map_uid &&
               entry.second.spec.id == spec.id;
      });
  if (existing != uploads_.end()) {
    UploadRecord& upload = existing->second;
    if (!(upload.spec == spec)) {
      return absl::AlreadyExistsError(
          absl::StrCat("upload ", spec.id, " exists already"));
    }
    if (upload.state != UploadState::kFinalized) return upload;
    const int64_t revision =
        LastAddition(*map, map->record.newest_revision, spec.id);
    if (revision != 0) {
      upload.revision = revision;
      return upload;
    }
    uploads_.erase(existing);
  }
  UploadRecord upload;
  upload.spec = spec;
  upload.uid = NewUid();
  upload.map_uid = map_uid;
  upload.create_time = absl::Now();
  upload.update_time = upload.create_time;
  return uploads_.emplace(upload.uid, upload).first->second;
}

absl::StatusOr<UploadRecord> MemoryCatalogue::GetUpload(
    const std::string& map_uid, const std::string& id) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckResourceId(id));
  MutexLock lock(mutex_);
  for (const auto& [uid, upload] : uploads_) {
    if (upload.map_uid == map_uid && upload.spec.id == id) return upload;
  }
  return NotFound("upload", id);
}

absl::StatusOr<UploadRecord> MemoryCatalogue::GetUploadByUid(
    const std::string& upload_uid) const {
  MutexLock lock(mutex_);
  const auto upload = uploads_.find(upload_uid);
  if (upload == uploads_.end()) return NotFound("upload", upload_uid);
  return upload->second;
}

absl::StatusOr<std::vector<UploadRecord>> MemoryCatalogue::ListUploads(
    const std::string& map_uid, const std::string& after,
    int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  MutexLock lock(mutex_);
  std::map<std::string, UploadRecord> by_id;
  for (const auto& [uid, upload] : uploads_) {
    if (upload.map_uid == map_uid && upload.spec.id > after) {
      by_id.emplace(upload.spec.id, upload);
    }
  }
  std::vector<UploadRecord> page;
  for (const auto& [id, upload] : by_id) page.push_back(upload);
  CutToPage(page, max_count);
  return page;
}

absl::Status MemoryCatalogue::SetCommittedBytes(const std::string& upload_uid,
                                                int64_t bytes) {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(UploadRecord * upload, FindUpload(upload_uid));
  MAPSIEVE_RETURN_IF_ERROR(CheckIs(*upload, UploadState::kActive));
  if (bytes < upload->committed_bytes) {
    return absl::InvalidArgumentError("fewer bytes than before");
  }
  upload->committed_bytes = bytes;
  upload->update_time = absl::Now();
  return absl::OkStatus();
}

absl::StatusOr<UploadRecord> MemoryCatalogue::SetUploadState(
    const std::string& upload_uid, UploadState from, UploadState to,
    const std::string& report) {
  if (from == UploadState::kFinalized || to == UploadState::kFinalized) {
    return absl::InvalidArgumentError("only a commit finalizes, for good");
  }
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(UploadRecord * upload, FindUpload(upload_uid));
  MAPSIEVE_RETURN_IF_ERROR(CheckIs(*upload, from));
  upload->state = to;
  upload->report = report;
  upload->update_time = absl::Now();
  return *upload;
}

absl::Status MemoryCatalogue::DeleteUpload(const std::string& upload_uid) {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const UploadRecord* upload, FindUpload(upload_uid));
  maps_.at(upload->map_uid).upload_revisions.erase(upload->spec.id);
  uploads_.erase(upload_uid);
  return absl::OkStatus();
}

absl::StatusOr<int64_t> MemoryCatalogue::DeleteIdleUploads(
    absl::Time idle_since) {
  MutexLock lock(mutex_);
  return static_cast<int64_t>(std::erase_if(uploads_, [&](const auto& entry) {
    const UploadRecord& upload = entry.second;
    return upload.update_time < idle_since &&
           (upload.state == UploadState::kActive ||
            upload.state == UploadState::kFailed);
  }));
}

absl::StatusOr<OperationRecord> MemoryCatalogue::CreateOperation(
    const OperationRecord& operation) {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckOperation(operation));
  MutexLock lock(mutex_);
  if (operations_.contains(operation.id)) {
    return absl::AlreadyExistsError(
        absl::StrCat("operation ", operation.id, " exists already"));
  }
  OperationRecord created = operation;
  created.number = ++last_operation_;
  created.create_time = absl::Now();
  created.update_time = created.create_time;
  return operations_.emplace(created.id, created).first->second;
}

absl::StatusOr<OperationRecord> MemoryCatalogue::GetOperation(
    const std::string& id) const {
  MutexLock lock(mutex_);
  return FindOperation(id);
}

absl::StatusOr<std::vector<OperationRecord>> MemoryCatalogue::ListOperations(
    const std::string& target, bool unfinished_only, int64_t after,
    int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  MutexLock lock(mutex_);
  std::map<int64_t, OperationRecord> by_number;
  for (const auto& [id, operation] : operations_) {
    if (operation.number > after &&
        (target.empty() || operation.target == target) &&
        !(unfinished_only && storage::IsDone(operation.state))) {
      by_number.emplace(operation.number, operation);
    }
  }
  std::vector<OperationRecord> page;
  for (const auto& [number, operation] : by_number) page.push_back(operation);
  CutToPage(page, max_count);
  return page;
}

absl::Status MemoryCatalogue::UpdateOperation(
    const OperationRecord& operation) {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckOperation(operation));
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const OperationRecord before,
                            FindOperation(operation.id));
  if (storage::IsDone(before.state)) {
    return absl::FailedPreconditionError("the operation has ended already");
  }
  OperationRecord& after = operations_.at(operation.id);
  after = operation;
  after.number = before.number;
  after.target = before.target;
  after.verb = before.verb;
  after.request = before.request;
  after.create_time = before.create_time;
  after.update_time = absl::Now();
  return absl::OkStatus();
}

absl::Status MemoryCatalogue::DeleteOperation(const std::string& id) {
  MutexLock lock(mutex_);
  MAPSIEVE_ASSIGN_OR_RETURN(const OperationRecord operation, FindOperation(id));
  if (!storage::IsDone(operation.state)) {
    return absl::FailedPreconditionError("the operation has not ended");
  }
  operations_.erase(id);
  return absl::OkStatus();
}

}  // namespace mapsieve::testing
