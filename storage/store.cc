#include "storage/store.h"

#include <algorithm>
#include <string_view>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "storage/local_blob_store.h"
#include "storage/names.h"
#include "storage/sqlite_catalogue.h"

namespace mapsieve::storage {
namespace {

constexpr char kLockFile[] = "lock";
constexpr char kCatalogueFile[] = "catalogue.db";
constexpr char kBlobDirectory[] = "blobs";
constexpr char kUploadDirectory[] = "uploads";
constexpr char kScratchDirectory[] = "scratch";
constexpr char kRunDirectory[] = "runs";
// The root of an ext file system has it.
constexpr char kLostAndFound[] = "lost+found";

constexpr int64_t kMaxReserveBytes = int64_t{1} << 50;
constexpr int64_t kCollectionPage = 1000;
// A reference with its entries in indices, in the log and in the database.
constexpr int64_t kCommitBytesPerChunk = 1024;

std::string_view ChunkKindName(ChunkKind kind) {
  switch (kind) {
    case ChunkKind::kRaw:
      return "raw";
    case ChunkKind::kProduct:
      return "product";
    case ChunkKind::kHistory:
      return "history";
  }
  return "";
}

absl::Status CheckIsDataDirectory(FileSystem& file_system,
                                  const std::string& directory) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::string> names,
                            file_system.List(directory));
  if (std::find(names.begin(), names.end(), kCatalogueFile) != names.end()) {
    return absl::OkStatus();
  }
  for (const std::string& name : names) {
    if (name != kLockFile && name != kBlobDirectory &&
        name != kUploadDirectory && name != kScratchDirectory &&
        name != kRunDirectory && name != kLostAndFound) {
      return absl::FailedPreconditionError(absl::StrCat(
          directory, ": holds ", Quoted(name), " and no ", kCatalogueFile,
          ", so it is no data directory; name an empty or a new one"));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckStop(const std::stop_token& stop) {
  if (!stop.stop_requested()) return absl::OkStatus();
  return absl::CancelledError("garbage collection was stopped");
}

}  // namespace

absl::Status StoreOptions::Validate() const {
  if (reserve_bytes < 0 || reserve_bytes > kMaxReserveBytes) {
    return absl::InvalidArgumentError(absl::StrCat(
        "reserve_bytes ", reserve_bytes, ": expected 0 to ", kMaxReserveBytes));
  }
  if (upload_lifetime <= absl::ZeroDuration()) {
    return absl::InvalidArgumentError(
        absl::StrCat("upload_lifetime ", absl::FormatDuration(upload_lifetime),
                     ": expected more than 0"));
  }
  if (kept_revision_count < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("kept_revision_count ", kept_revision_count,
                     ": expected 0 (all) or more"));
  }
  return absl::OkStatus();
}

ReadSnapshot::ReadSnapshot(Store& store, MapRecord map, int64_t number)
    : store_(store), map_(std::move(map)), revision_{.number = number} {}

ReadSnapshot::~ReadSnapshot() { store_.Unpin(map_.uid, revision_.number); }

absl::StatusOr<std::vector<ChunkRef>> ReadSnapshot::ListChunks(
    ChunkKind kind, const std::optional<core::LatticeBox>& region,
    const std::optional<ChunkPosition>& after, int64_t max_count) const {
  return store_.catalogue_->ListChunks(map_.uid, revision_.number, kind, region,
                                       after, max_count);
}

absl::StatusOr<std::vector<ChunkRef>> ReadSnapshot::ListTileChunks(
    ChunkKind kind, const core::CellKey& tile) const {
  return store_.catalogue_->ListTileChunks(map_.uid, revision_.number, kind,
                                           tile);
}

absl::StatusOr<std::vector<ChunkRef>> ReadSnapshot::ListAllChunks(
    int64_t after, int64_t max_count) const {
  return store_.catalogue_->ListAllChunks(map_.uid, after, max_count);
}

absl::StatusOr<int64_t> ReadSnapshot::CountAllChunks() const {
  return store_.catalogue_->CountAllChunks(map_.uid);
}

absl::StatusOr<std::vector<TileSummary>> ReadSnapshot::ListTiles(
    ChunkKind kind, const std::optional<core::LatticeBox>& region,
    const std::optional<core::CellKey>& after, int64_t max_count) const {
  return store_.catalogue_->ListTiles(map_.uid, revision_.number, kind, region,
                                      after, max_count);
}

absl::StatusOr<std::vector<std::byte>> ReadSnapshot::ReadChunk(
    const ChunkRef& chunk) const {
  auto bytes = store_.blobs_->Get(chunk.blob_id);
  const absl::StatusOr<int64_t> size = bytes.ok()
                                           ? static_cast<int64_t>(bytes->size())
                                           : store_.blobs_->Size(chunk.blob_id);
  if (absl::IsNotFound(size.status())) {
    return absl::DataLossError(absl::StrCat(Describe(chunk), ": expected ",
                                            chunk.stored_bytes,
                                            " bytes, found no file"));
  }
  if (!size.ok()) return Annotate(size.status(), Describe(chunk));
  if (*size != chunk.stored_bytes) {
    return absl::DataLossError(
        absl::StrCat(Describe(chunk), ": expected ", chunk.stored_bytes,
                     " bytes, found the end of the file at offset ", *size));
  }
  if (!bytes.ok()) return Annotate(bytes.status(), NameOf(chunk));
  return bytes;
}

absl::Status ReadSnapshot::ReadChunkRange(const ChunkRef& chunk, int64_t offset,
                                          std::span<std::byte> room) const {
  const absl::Status status =
      store_.blobs_->GetRange(chunk.blob_id, offset, room);
  return status.ok() ? status : Annotate(status, Describe(chunk));
}

std::string ReadSnapshot::NameOf(const ChunkRef& chunk) const {
  return absl::StrCat("map ", map_.spec.id, ", revision ", revision_.number,
                      ", tile ", chunk.tile.ToString(), ", ",
                      ToAbsl(ChunkKindName(chunk.kind)), " chunk ",
                      chunk.number);
}

std::string ReadSnapshot::Describe(const ChunkRef& chunk) const {
  return absl::StrCat(NameOf(chunk), ": ",
                      store_.blobs_->Location(chunk.blob_id));
}

BlobWriter::~BlobWriter() {
  MutexLock lock(mutex_);
  store_.Unprotect(protected_);
}

absl::StatusOr<BlobId> BlobWriter::Put(std::span<const std::byte> bytes) {
  // Protected before anyone looks whether it is there: a collection cannot
  // remove it in between.
  const BlobId id = ContentHash(bytes);
  {
    MutexLock lock(mutex_);
    store_.Protect(id);
    protected_.push_back(id);
  }
  return store_.blobs_->PutIfAbsent(bytes);
}

Store::Store(FileSystem& file_system, std::string directory,
             const StoreOptions& options, StoreParts parts)
    : file_system_(file_system),
      directory_(std::move(directory)),
      options_(options),
      reserve_(file_system, directory_, options.reserve_bytes),
      catalogue_(std::move(parts.catalogue)),
      blobs_(std::move(parts.blobs)) {}

Store::~Store() = default;

absl::StatusOr<std::unique_ptr<Store>> Store::Open(FileSystem& file_system,
                                                   const std::string& directory,
                                                   const StoreOptions& options,
                                                   StoreParts parts) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  std::unique_ptr<Store> store(
      new Store(file_system, directory, options, std::move(parts)));
  MAPSIEVE_RETURN_IF_ERROR(store->OpenParts());
  return store;
}

absl::Status Store::OpenParts() {
  MAPSIEVE_RETURN_IF_ERROR(file_system_.MakeDirectories(directory_));
  MAPSIEVE_RETURN_IF_ERROR(CheckIsDataDirectory(file_system_, directory_));
  auto lock = file_system_.Lock(JoinPath(directory_, kLockFile));
  if (absl::IsAborted(lock.status())) {
    return Annotate(lock.status(),
                    "the data directory is in use; stop that process or name "
                    "another directory");
  }
  MAPSIEVE_RETURN_IF_ERROR(lock.status());
  lock_ = *std::move(lock);

  MAPSIEVE_RETURN_IF_ERROR(
      file_system_.RemoveTree(JoinPath(directory_, kScratchDirectory)));
  if (catalogue_ == nullptr) {
    // A new catalogue over existing blobs would end in their collection.
    MAPSIEVE_ASSIGN_OR_RETURN(const bool holds_blobs, HoldsBlobs());
    MAPSIEVE_ASSIGN_OR_RETURN(
        catalogue_,
        OpenSqliteCatalogue(file_system_, JoinPath(directory_, kCatalogueFile),
                            holds_blobs ? IfAbsent::kFail : IfAbsent::kCreate));
    MAPSIEVE_RETURN_IF_ERROR(file_system_.SyncDirectory(directory_));
  }
  if (blobs_ == nullptr) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        blobs_,
        OpenLocalBlobStore(file_system_, JoinPath(directory_, kBlobDirectory),
                           reserve_));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      uploads_,
      UploadStore::Open(file_system_, JoinPath(directory_, kUploadDirectory),
                        *catalogue_, reserve_));
  return absl::OkStatus();
}

absl::StatusOr<bool> Store::HoldsBlobs() {
  const auto folders = file_system_.List(JoinPath(directory_, kBlobDirectory));
  if (absl::IsNotFound(folders.status())) return false;
  MAPSIEVE_RETURN_IF_ERROR(folders.status());
  // One for unfinished blobs is made when the store is opened first.
  return folders->size() > 1;
}

absl::StatusOr<std::shared_ptr<const ReadSnapshot>> Store::OpenSnapshot(
    const std::string& map_id, int64_t revision) {
  int64_t expired = 0;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const MapRecord map, catalogue_->GetMap(map_id));
    const int64_t number = revision == 0 ? map.newest_revision : revision;
    // Pinned before the revision is read: whatever is read stays.
    std::shared_ptr<ReadSnapshot> snapshot;
    {
      MutexLock lock(pin_mutex_);
      if (map.uid == purging_) {
        return absl::NotFoundError(
            absl::StrCat("map ", map_id, " was deleted"));
      }
      snapshot = Pin(map, number);
    }
    auto record = catalogue_->GetKeptRevision(map.uid, number);
    if (record.ok()) {
      snapshot->revision_ = *std::move(record);
      return snapshot;
    }
    // The newest one expired after the map was read: a newer one is there.
    if (revision != 0 || number == expired ||
        !absl::IsOutOfRange(record.status())) {
      return record.status();
    }
    expired = number;
  }
}

absl::StatusOr<std::shared_ptr<const ReadSnapshot>> Store::OpenProduct(
    const ReadSnapshot& snapshot) {
  const int64_t number = snapshot.revision().processed_revision;
  std::shared_ptr<ReadSnapshot> product;
  {
    MutexLock lock(pin_mutex_);
    product = Pin(snapshot.map(), number);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      product->revision_, catalogue_->GetRevision(snapshot.map().uid, number));
  return product;
}

std::shared_ptr<ReadSnapshot> Store::Pin(const MapRecord& map,
                                         int64_t revision) {
  pins_[map.uid].insert(revision);
  return std::shared_ptr<ReadSnapshot>(new ReadSnapshot(*this, map, revision));
}

void Store::Unpin(const std::string& map_uid, int64_t revision) {
  MutexLock lock(pin_mutex_);
  const auto pins = pins_.find(map_uid);
  pins->second.erase(pins->second.find(revision));
  if (pins->second.empty()) pins_.erase(pins);
}

std::set<int64_t> Store::PinnedRevisions(const std::string& map_uid) {
  MutexLock lock(pin_mutex_);
  const auto pins = pins_.find(map_uid);
  if (pins == pins_.end()) return {};
  return {pins->second.begin(), pins->second.end()};
}

std::unique_ptr<BlobWriter> Store::NewBlobWriter() {
  return std::unique_ptr<BlobWriter>(new BlobWriter(*this));
}

void Store::Protect(const BlobId& id) {
  MutexLock lock(protection_mutex_);
  ++protected_[id];
}

void Store::Unprotect(std::span<const BlobId> ids) {
  MutexLock lock(protection_mutex_);
  for (const BlobId& id : ids) {
    const auto entry = protected_.find(id);
    if (--entry->second == 0) protected_.erase(entry);
  }
}

absl::StatusOr<std::unique_ptr<Scratch>> Store::NewScratch() {
  return Scratch::Create(
      file_system_,
      absl::StrCat(directory_, "/", kScratchDirectory, "/", scratch_count_++),
      reserve_);
}

std::unique_ptr<Scratch> Store::OpenRunScratch(const std::string& map_uid) {
  return Scratch::OpenLasting(
      file_system_, JoinPath(JoinPath(directory_, kRunDirectory), map_uid),
      reserve_);
}

absl::Status Store::RemoveRunScratch(const std::string& map_uid) {
  return file_system_.RemoveTree(
      JoinPath(JoinPath(directory_, kRunDirectory), map_uid));
}

absl::Status Store::RemoveRunScratchesExcept(
    const std::set<std::string>& map_uids) {
  const auto names = file_system_.List(JoinPath(directory_, kRunDirectory));
  if (absl::IsNotFound(names.status())) return absl::OkStatus();
  MAPSIEVE_RETURN_IF_ERROR(names.status());
  for (const std::string& name : *names) {
    if (map_uids.contains(name)) continue;
    MAPSIEVE_RETURN_IF_ERROR(RemoveRunScratch(name));
  }
  return absl::OkStatus();
}

absl::StatusOr<GarbageReport> Store::CollectGarbage(std::stop_token stop) {
  MutexLock lock(collection_mutex_);
  GarbageReport report;
  MAPSIEVE_RETURN_IF_ERROR(ForgetExpired(stop, report));
  MAPSIEVE_RETURN_IF_ERROR(PurgeDeletedMaps(report));
  MAPSIEVE_RETURN_IF_ERROR(DeleteUnreferencedBlobs(stop, report));
  MAPSIEVE_ASSIGN_OR_RETURN(
      report.expired_upload_count,
      catalogue_->DeleteIdleUploads(absl::Now() - options_.upload_lifetime));
  MAPSIEVE_ASSIGN_OR_RETURN(report.deleted_upload_file_count,
                            uploads_->RemoveOrphans());
  return report;
}

absl::StatusOr<GarbageReport> Store::ExpireRevisions(std::stop_token stop) {
  MutexLock lock(collection_mutex_);
  GarbageReport report;
  MAPSIEVE_RETURN_IF_ERROR(ForgetExpired(stop, report));
  return report;
}

absl::Status Store::ForgetExpired(const std::stop_token& stop,
                                  GarbageReport& report) {
  std::string after;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto maps,
                              catalogue_->ListMaps(after, kCollectionPage));
    if (maps.empty()) return absl::OkStatus();
    after = maps.back().spec.id;
    for (const MapRecord& map : maps) {
      const absl::Status status = ForgetExpiredOf(map, stop, report);
      // Deleted and purged by another since it was listed.
      if (!absl::IsNotFound(status)) MAPSIEVE_RETURN_IF_ERROR(status);
    }
  }
}

absl::Status Store::ForgetExpiredOf(const MapRecord& map,
                                    const std::stop_token& stop,
                                    GarbageReport& report) {
  const int64_t kept = options_.kept_revision_count;
  const bool has_too_many = kept > 0 && map.newest_revision > kept;
  // The first revision makes no product: it expires before any other.
  if (map.oldest_revision == 1 && !has_too_many) return absl::OkStatus();
  if (has_too_many) {
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t count,
                              catalogue_->ExpireRevisions(map.uid, kept));
    report.expired_revision_count += count;
  }
  // What is pinned from now on is not expired, or has a pin already.
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<BlobId> blobs,
        catalogue_->ForgetExpired(map.uid, PinnedRevisions(map.uid)));
    if (blobs.empty()) return absl::OkStatus();
    for (const BlobId& id : blobs) {
      MAPSIEVE_RETURN_IF_ERROR(CheckStop(stop));
      MAPSIEVE_RETURN_IF_ERROR(DeleteBlobIfUnused(id, report));
    }
  }
}

absl::Status Store::PurgeDeletedMaps(GarbageReport& report) {
  std::string after;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const auto uids, catalogue_->ListDeletedMaps(after, kCollectionPage));
    if (uids.empty()) return absl::OkStatus();
    after = uids.back();
    for (const std::string& uid : uids) {
      if (!BeginPurge(uid)) continue;
      MAPSIEVE_RETURN_IF_ERROR(catalogue_->PurgeMap(uid));
      ++report.purged_map_count;
    }
  }
}

bool Store::BeginPurge(const std::string& map_uid) {
  MutexLock lock(pin_mutex_);
  if (pins_.contains(map_uid)) return false;
  purging_ = map_uid;
  return true;
}

absl::Status Store::DeleteUnreferencedBlobs(const std::stop_token& stop,
                                            GarbageReport& report) {
  BlobId after;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto ids,
                              blobs_->List(after, kCollectionPage));
    if (ids.empty()) return absl::OkStatus();
    after = ids.back();
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<bool> referenced,
                              catalogue_->AreBlobsReferenced(ids));
    for (size_t i = 0; i < ids.size(); ++i) {
      MAPSIEVE_RETURN_IF_ERROR(CheckStop(stop));
      if (referenced[i]) continue;
      MAPSIEVE_RETURN_IF_ERROR(DeleteBlobIfUnused(ids[i], report));
    }
  }
}

absl::Status Store::DeleteBlobIfUnused(const BlobId& id,
                                       GarbageReport& report) {
  // While the lock is held no writer can begin to rely on the blob. One that
  // did before is either still there, so the blob is protected, or has
  // committed or given up, so the catalogue knows by now.
  MutexLock lock(protection_mutex_);
  if (protected_.contains(id)) return absl::OkStatus();
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<bool> referenced,
                            catalogue_->AreBlobsReferenced(std::span(&id, 1)));
  if (referenced[0]) return absl::OkStatus();
  const auto size = blobs_->Size(id);
  if (absl::IsNotFound(size.status())) return absl::OkStatus();
  MAPSIEVE_RETURN_IF_ERROR(size.status());
  MAPSIEVE_RETURN_IF_ERROR(blobs_->Delete(id));
  ++report.deleted_blob_count;
  report.deleted_blob_bytes += *size;
  return absl::OkStatus();
}

absl::StatusOr<RevisionRecord> Store::CommitRevision(
    const std::string& map_uid, int64_t expected_parent,
    const RevisionChange& change) {
  // What adds nothing may use the reserve, as all deletions.
  std::optional<SpaceReserve::Claim> room;
  if (!change.added.empty()) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        auto claim, reserve_.Take(static_cast<int64_t>(change.added.size()) *
                                  kCommitBytesPerChunk));
    room.emplace(std::move(claim));
  }
  return catalogue_->CommitRevision(map_uid, expected_parent, change);
}

absl::Status Store::CheckSpace(int64_t bytes) const {
  return reserve_.Take(bytes).status();
}

absl::StatusOr<int64_t> Store::FreeBytes() const {
  return file_system_.FreeBytes(directory_);
}

}  // namespace mapsieve::storage
