#ifndef MAPSIEVE_STORAGE_STORE_H_
#define MAPSIEVE_STORAGE_STORE_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "core/base/mutex.h"
#include "storage/blob_store.h"
#include "storage/catalogue.h"
#include "storage/file_system.h"
#include "storage/scratch_store.h"
#include "storage/space_reserve.h"
#include "storage/upload_store.h"

namespace mapsieve::storage {

struct StoreOptions {
  /// Uploads, blobs and scratch files leave this much of the disk free, so that
  /// a full disk can still be emptied by deleting maps. 0 to 2^50.
  int64_t reserve_bytes = int64_t{64} << 20;
  /// CollectGarbage forgets an unfinished upload when nothing happened to it
  /// for this long; positive.
  absl::Duration upload_lifetime = absl::Hours(7 * 24);
  /// Newest revisions of each map that are kept; 0: all. The others expire with
  /// the next collection, but for those that made the products of kept ones.
  int64_t kept_revision_count = 0;

  /// kInvalidArgument, naming the field and its limits.
  absl::Status Validate() const;
};

/// What a store keeps its maps in. What is absent is in its directory: the
/// catalogue a SQLite database, the blobs files.
struct StoreParts {
  std::unique_ptr<Catalogue> catalogue;
  std::unique_ptr<BlobStore> blobs;
};

/// What CollectGarbage removed.
struct GarbageReport {
  int64_t expired_revision_count = 0;
  int64_t purged_map_count = 0;
  int64_t deleted_blob_count = 0;
  int64_t deleted_blob_bytes = 0;
  int64_t expired_upload_count = 0;
  int64_t deleted_upload_file_count = 0;
};

class Store;

/// One revision of one map, as it was committed: it and the revision that made
/// its product stay readable while this object lives, even if they expire or
/// the map is deleted. Thread-safe.
class ReadSnapshot {
 public:
  ~ReadSnapshot();
  ReadSnapshot(const ReadSnapshot&) = delete;
  ReadSnapshot& operator=(const ReadSnapshot&) = delete;

  /// The map as it was when the snapshot was opened.
  const MapRecord& map() const { return map_; }
  const RevisionRecord& revision() const { return revision_; }

  /// Catalogue::ListChunks, ListTileChunks and ListTiles of the revision.
  absl::StatusOr<std::vector<ChunkRef>> ListChunks(
      ChunkKind kind, const std::optional<core::LatticeBox>& region,
      const std::optional<ChunkPosition>& after, int64_t max_count) const;
  absl::StatusOr<std::vector<ChunkRef>> ListTileChunks(
      ChunkKind kind, const core::CellKey& tile) const;
  absl::StatusOr<std::vector<TileSummary>> ListTiles(
      ChunkKind kind, const std::optional<core::LatticeBox>& region,
      const std::optional<core::CellKey>& after, int64_t max_count) const;

  /// Catalogue::ListAllChunks and CountAllChunks of the map. Chunks of
  /// revisions that expire meanwhile go.
  absl::StatusOr<std::vector<ChunkRef>> ListAllChunks(int64_t after,
                                                      int64_t max_count) const;
  absl::StatusOr<int64_t> CountAllChunks() const;

  /// The bytes of a chunk of this snapshot, or of another revision of its map,
  /// checked. kDataLoss: the blob is missing, or not what was stored; with
  /// Describe, the offsets, and what was expected and found.
  absl::StatusOr<std::vector<std::byte>> ReadChunk(const ChunkRef& chunk) const;

  /// Fills `room` with the bytes of such a chunk at `offset`, not checked:
  /// BlobStore::GetRange. kNotFound and kOutOfRange: the blob is missing, or
  /// shorter than that; with Describe.
  absl::Status ReadChunkRange(const ChunkRef& chunk, int64_t offset,
                              std::span<std::byte> room) const;
  /// Map, revision, tile, chunk and file, for messages.
  std::string Describe(const ChunkRef& chunk) const;

 private:
  friend class Store;
  ReadSnapshot(Store& store, MapRecord map, int64_t number);
  /// Describe without the file.
  std::string NameOf(const ChunkRef& chunk) const;

  Store& store_;
  const MapRecord map_;
  // Its number is set from the beginning.
  RevisionRecord revision_;
};

/// Stores blobs that a commit will refer to. They are safe from collection
/// while the writer lives: destroy it only after the commit. Thread-safe.
class BlobWriter {
 public:
  ~BlobWriter();
  BlobWriter(const BlobWriter&) = delete;
  BlobWriter& operator=(const BlobWriter&) = delete;

  /// BlobStore::PutIfAbsent.
  absl::StatusOr<BlobId> Put(std::span<const std::byte> bytes);

 private:
  friend class Store;
  explicit BlobWriter(Store& store) : store_(store) {}

  Store& store_;
  Mutex mutex_;
  std::vector<BlobId> protected_ ABSL_GUARDED_BY(mutex_);
};

/// A data directory: catalogue, blobs, staged uploads and scratch files, held
/// by one process at a time. FORMAT.md tells its layout, the steps that make
/// things durable, and what is promised after a crash. Thread-safe; outlives
/// the snapshots, writers and scratches that it hands out.
class Store {
 public:
  /// Opens `directory`, which is made if absent, and clears what a crash left
  /// there. `file_system` outlives the store, which takes over `parts`.
  /// kAborted: another process has it, naming its id; kFailedPrecondition: it
  /// holds other things, or was written by a newer version; kDataLoss: the
  /// catalogue is damaged or gone; kInvalidArgument: the options.
  static absl::StatusOr<std::unique_ptr<Store>> Open(
      FileSystem& file_system, const std::string& directory,
      const StoreOptions& options = {}, StoreParts parts = {});
  ~Store();
  Store(const Store&) = delete;
  Store& operator=(const Store&) = delete;

  const StoreOptions& options() const { return options_; }
  Catalogue& catalogue() { return *catalogue_; }
  UploadStore& uploads() { return *uploads_; }

  /// Pins a revision of the map `map_id`; 0: the newest. kNotFound: the map;
  /// kOutOfRange: the revision, or it is expired.
  absl::StatusOr<std::shared_ptr<const ReadSnapshot>> OpenSnapshot(
      const std::string& map_id, int64_t revision = 0);
  /// Pins the revision that made the product of a pinned one, which has one.
  absl::StatusOr<std::shared_ptr<const ReadSnapshot>> OpenProduct(
      const ReadSnapshot& snapshot);

  std::unique_ptr<BlobWriter> NewBlobWriter();

  /// A place for intermediate results, empty and of its own.
  absl::StatusOr<std::unique_ptr<Scratch>> NewScratch();

  /// The place for what a run of the filter over a map puts aside to go on with
  /// after a restart (Scratch::OpenLasting); one object at a time.
  std::unique_ptr<Scratch> OpenRunScratch(const std::string& map_uid);
  /// Removes it; OK if there is none.
  absl::Status RemoveRunScratch(const std::string& map_uid);
  /// Removes those of all maps but these.
  absl::Status RemoveRunScratchesExcept(const std::set<std::string>& map_uids);

  /// Removes what nothing needs: revisions of deleted maps that no snapshot
  /// pins, chunks of expired revisions that no snapshot pins, blobs that no
  /// revision refers to and no BlobWriter protects, uploads idle for
  /// options().upload_lifetime, bytes of uploads that are over. May
  /// run beside anything else; one call runs at a time, a second one waits.
  /// kCancelled within one blob of a stop request; what was removed stays so.
  absl::StatusOr<GarbageReport> CollectGarbage(std::stop_token stop = {});

  /// The part of CollectGarbage that expires revisions and removes what only
  /// they referred to, without a look at every blob of the store.
  absl::StatusOr<GarbageReport> ExpireRevisions(std::stop_token stop = {});

  /// Catalogue::CommitRevision, if the disk has room for what `change` adds.
  absl::StatusOr<RevisionRecord> CommitRevision(const std::string& map_uid,
                                                int64_t expected_parent,
                                                const RevisionChange& change);

  /// kResourceExhausted if `bytes` do not fit on the disk outside the reserve.
  absl::Status CheckSpace(int64_t bytes) const;
  /// Bytes that can still be written to the disk, the reserve included.
  absl::StatusOr<int64_t> FreeBytes() const;

 private:
  friend class ReadSnapshot;
  friend class BlobWriter;
  Store(FileSystem& file_system, std::string directory,
        const StoreOptions& options, StoreParts parts);
  absl::Status OpenParts();
  absl::StatusOr<bool> HoldsBlobs();
  std::shared_ptr<ReadSnapshot> Pin(const MapRecord& map, int64_t revision)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(pin_mutex_);
  void Unpin(const std::string& map_uid, int64_t revision);
  std::set<int64_t> PinnedRevisions(const std::string& map_uid);
  void Protect(const BlobId& id);
  void Unprotect(std::span<const BlobId> ids);
  absl::Status ForgetExpired(const std::stop_token& stop,
                             GarbageReport& report);
  absl::Status ForgetExpiredOf(const MapRecord& map,
                               const std::stop_token& stop,
                               GarbageReport& report);
  absl::Status PurgeDeletedMaps(GarbageReport& report);
  bool BeginPurge(const std::string& map_uid);
  absl::Status DeleteUnreferencedBlobs(const std::stop_token& stop,
                                       GarbageReport& report);
  absl::Status DeleteBlobIfUnused(const BlobId& id, GarbageReport& report);

  FileSystem& file_system_;
  const std::string directory_;
  const StoreOptions options_;
  const SpaceReserve reserve_;
  // Released after all else.
  std::unique_ptr<FileLock> lock_;
  std::unique_ptr<Catalogue> catalogue_;
  std::unique_ptr<BlobStore> blobs_;
  std::unique_ptr<UploadStore> uploads_;
  std::atomic<int64_t> scratch_count_ = 0;

  // Held for the whole of a collection; taken before the mutexes below.
  Mutex collection_mutex_;
  Mutex pin_mutex_;
  // The revisions of the snapshots of each map, by uid.
  std::map<std::string, std::multiset<int64_t>> pins_
      ABSL_GUARDED_BY(pin_mutex_);
  // The map that is being purged: it cannot be pinned any more.
  std::string purging_ ABSL_GUARDED_BY(pin_mutex_);
  Mutex protection_mutex_;
  // Blobs of living BlobWriters, and how often they were put.
  std::map<BlobId, int64_t> protected_ ABSL_GUARDED_BY(protection_mutex_);
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_STORE_H_
