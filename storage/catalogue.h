#ifndef MAPSIEVE_STORAGE_CATALOGUE_H_
#define MAPSIEVE_STORAGE_CATALOGUE_H_

#include <cstdint>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "storage/records.h"

namespace mapsieve::storage {

/// What a commit changes.
struct RevisionChange {
  RevisionSpec spec;
  /// New references, whose blobs are durable already; numbers are ignored.
  std::vector<ChunkRef> added;
  /// Numbers of references of the parent revision that the new one lacks.
  std::vector<int64_t> removed;
  /// The new revision has no product and no history chunk of its parent, as if
  /// `removed` listed them all.
  bool removes_product = false;
  /// Uid of an upload of the map in state kFinalizing: it becomes kFinalized
  /// in the same transaction, with `upload_report`.
  std::string finalized_upload_uid;
  std::string upload_report;
  /// The map's from then on, whatever it is rolled back to; empty: as before.
  std::string crs_wkt;
  std::string frame_id;
};

/// Where a page of chunks goes on: behind the chunk `number` of `tile`.
struct ChunkPosition {
  core::CellKey tile;
  int64_t number = 0;
};

/// Maps, revisions, references to chunks, uploads and operations. Every call
/// but PurgeMap is one transaction: it happens whole or not at all, and what a
/// call that returned OK changed survives any crash. Thread-safe; readers do
/// not wait for a commit under way.
///
/// A revision never changes. It shares the references that it did not touch
/// with its parent: a reference belongs to the revisions from the one that
/// added it up to the one that removed it.
///
/// The history of a revision are the revisions whose changes made it what it
/// is: itself and that of its parent, or of a rollback, that of the revision
/// that it restored.
///
/// Maps are named by id where they may be named anew, and by uid where the very
/// same map is meant. Errors besides those named below: kInvalidArgument for
/// an ill-formed id, a page size below 1 or a record that breaks the limits of
/// records.h; kDataLoss: the catalogue is damaged; kResourceExhausted: the disk
/// is full; kUnavailable: the medium failed.
class Catalogue {
 public:
  virtual ~Catalogue() = default;

  // Maps.

  /// Makes an empty map with its revision 1. kAlreadyExists.
  virtual absl::StatusOr<MapRecord> CreateMap(const MapSpec& spec) = 0;
  /// kNotFound.
  virtual absl::StatusOr<MapRecord> GetMap(const std::string& id) const = 0;
  /// Up to `max_count` maps by ascending id, those after `after`.
  virtual absl::StatusOr<std::vector<MapRecord>> ListMaps(
      const std::string& after, int64_t max_count) const = 0;
  /// Deletes a map and its uploads: its id is free at once. Revisions and
  /// references stay for readers, by uid, until PurgeMap. kNotFound.
  virtual absl::Status DeleteMap(const std::string& id) = 0;
  /// Uids of deleted maps that are not purged yet, at most `max_count`, those
  /// after `after`.
  virtual absl::StatusOr<std::vector<std::string>> ListDeletedMaps(
      const std::string& after, int64_t max_count) const = 0;
  /// Forgets the revisions and references of a deleted map, in several
  /// transactions: after an error it may be half done, and can be repeated.
  /// kNotFound; kFailedPrecondition: the map is not deleted. Called by Store,
  /// which knows its readers.
  virtual absl::Status PurgeMap(const std::string& map_uid) = 0;

  // Revisions and chunks.

  /// Makes the revision expected_parent + 1 the newest of its map.
  /// kAborted: expected_parent is not the newest revision; the message says
  /// which is. kNotFound: the map (or it is deleted), the upload.
  /// kFailedPrecondition: the upload is not kFinalizing. kInvalidArgument: a
  /// chunk outside its tile or not of the map's tile level, a removed number
  /// that the parent does not have.
  virtual absl::StatusOr<RevisionRecord> CommitRevision(
      const std::string& map_uid, int64_t expected_parent,
      const RevisionChange& change) = 0;
  /// Makes a newest revision of kind kRollback that equals revision `number` of
  /// the map: the same blobs for every kind of chunk in the same order,
  /// attributes, totals and processed_revision, the same tiles stale, and the
  /// options of its product as MapRecord::process_options. Chunks that it
  /// does not share with the newest revision get new references. An upload that
  /// was begun anew and whose points the rollback brings back is kFinalized, as
  /// it was when they were added. If the newest
  /// revision is `number` or a rollback to it, nothing is made and that one is
  /// returned. kNotFound: the map (or it is deleted); kOutOfRange: the
  /// revision, or it is expired. Cost: all references that the map ever had.
  virtual absl::StatusOr<RevisionRecord> RollBack(const std::string& map_uid,
                                                  int64_t number) = 0;
  /// Also of an expired one. kNotFound: the map; kOutOfRange: the revision.
  virtual absl::StatusOr<RevisionRecord> GetRevision(const std::string& map_uid,
                                                     int64_t number) const = 0;
  /// The same, and kOutOfRange, naming the oldest one that is kept, if it is
  /// expired.
  virtual absl::StatusOr<RevisionRecord> GetKeptRevision(
      const std::string& map_uid, int64_t number) const = 0;
  /// Up to `max_count` revisions, newest first, those below `before`; 0: from
  /// the newest. kNotFound.
  virtual absl::StatusOr<std::vector<RevisionRecord>> ListRevisions(
      const std::string& map_uid, int64_t before, int64_t max_count) const = 0;

  /// Up to `max_count` chunks of a revision, by tile in Morton order
  /// (CellKeyLess), then by number; those after `after`. `region`: only chunks
  /// whose bounds intersect it. kNotFound; kOutOfRange: the revision.
  virtual absl::StatusOr<std::vector<ChunkRef>> ListChunks(
      const std::string& map_uid, int64_t revision, ChunkKind kind,
      const std::optional<core::LatticeBox>& region,
      const std::optional<ChunkPosition>& after, int64_t max_count) const = 0;
  /// All chunks of one tile by number; empty if it has none. kNotFound;
  /// kOutOfRange: the revision.
  virtual absl::StatusOr<std::vector<ChunkRef>> ListTileChunks(
      const std::string& map_uid, int64_t revision, ChunkKind kind,
      const core::CellKey& tile) const = 0;
  /// Up to `max_count` tiles that have chunks of `kind`, in Morton order, those
  /// after `after`. `region`: sums over the chunks that intersect it only, and
  /// no tile without such a chunk. kNotFound; kOutOfRange: the revision.
  virtual absl::StatusOr<std::vector<TileSummary>> ListTiles(
      const std::string& map_uid, int64_t revision, ChunkKind kind,
      const std::optional<core::LatticeBox>& region,
      const std::optional<core::CellKey>& after, int64_t max_count) const = 0;

  /// Up to `max_count` chunks of all revisions of a map, by number, those above
  /// `after`. kNotFound.
  virtual absl::StatusOr<std::vector<ChunkRef>> ListAllChunks(
      const std::string& map_uid, int64_t after, int64_t max_count) const = 0;
  /// How many ListAllChunks gives in all. kNotFound.
  virtual absl::StatusOr<int64_t> CountAllChunks(
      const std::string& map_uid) const = 0;

  /// Up to `max_count` tiles, in Morton order, those after `after`, where one
  /// of two revisions has a reference of `kind` that the other has not.
  /// Different references may name the same blobs. kNotFound; kOutOfRange: a
  /// revision.
  virtual absl::StatusOr<std::vector<core::CellKey>> ListChangedTiles(
      const std::string& map_uid, int64_t revision, int64_t other,
      ChunkKind kind, const std::optional<core::CellKey>& after,
      int64_t max_count) const = 0;

  /// Expires the revisions of a map but the newest `kept_count` (at least 1)
  /// and those that made the products of these; returns how many it expired.
  /// A revision never becomes unexpired. Its record stays, and what was told of
  /// it: rollbacks and uploads find the history of a map whole. kNotFound.
  virtual absl::StatusOr<int64_t> ExpireRevisions(const std::string& map_uid,
                                                  int64_t kept_count) = 0;
  /// Forgets some of the references that belong to expired revisions only, and
  /// returns their blobs; nothing if there are none left. Revisions that are
  /// `pinned`, and those that made the products of these, keep theirs. Called
  /// by Store, which knows its readers. kNotFound; kOutOfRange: a pinned
  /// revision.
  virtual absl::StatusOr<std::vector<BlobId>> ForgetExpired(
      const std::string& map_uid, const std::set<int64_t>& pinned) = 0;
  /// Bytes of the blobs that the revisions of a map refer to, but neither its
  /// newest one, the one that made the product of that, nor another map: what
  /// expiring all but the newest revision makes garbage. An estimate if the map
  /// changes meanwhile. kNotFound. Cost: a look-up for each reference that the
  /// newest revision lacks, in several transactions.
  virtual absl::StatusOr<int64_t> MeasureReclaimable(
      const std::string& map_uid) const = 0;

  /// For each id whether any revision of any map, deleted ones that are not
  /// purged included, refers to it.
  virtual absl::StatusOr<std::vector<bool>> AreBlobsReferenced(
      std::span<const BlobId> ids) const = 0;

  // Uploads.

  /// Creates an upload, or returns the one of that id as it is, if its spec is
  /// the same. One whose points a rollback took out of the map again, so that
  /// no revision that added them is in the history of the newest one, is
  /// replaced by a new one. kNotFound: the map; kAlreadyExists: the id is taken
  /// by an upload of another size or hash.
  virtual absl::StatusOr<UploadRecord> CreateUpload(const std::string& map_uid,
                                                    const UploadSpec& spec) = 0;
  /// kNotFound.
  virtual absl::StatusOr<UploadRecord> GetUpload(
      const std::string& map_uid, const std::string& id) const = 0;
  /// kNotFound.
  virtual absl::StatusOr<UploadRecord> GetUploadByUid(
      const std::string& upload_uid) const = 0;
  /// Up to `max_count` uploads of a map by ascending id, those after `after`.
  virtual absl::StatusOr<std::vector<UploadRecord>> ListUploads(
      const std::string& map_uid, const std::string& after,
      int64_t max_count) const = 0;
  /// Records that the first `bytes` bytes are durable. kNotFound;
  /// kFailedPrecondition: the upload is not kActive; kInvalidArgument: fewer
  /// than before. Called by UploadStore, which knows.
  virtual absl::Status SetCommittedBytes(const std::string& upload_uid,
                                         int64_t bytes) = 0;
  /// Moves an upload from one state to another; kFinalized is reached by
  /// CommitRevision alone and never left (kInvalidArgument). kNotFound;
  /// kFailedPrecondition: it is not in state `from`.
  virtual absl::StatusOr<UploadRecord> SetUploadState(
      const std::string& upload_uid, UploadState from, UploadState to,
      const std::string& report) = 0;
  /// Forgets an upload; points that it brought stay, and another upload of its
  /// id is not taken for it. kNotFound.
  virtual absl::Status DeleteUpload(const std::string& upload_uid) = 0;
  /// Forgets uploads in state kActive or kFailed that nothing happened to since
  /// `idle_since`; returns how many.
  virtual absl::StatusOr<int64_t> DeleteIdleUploads(absl::Time idle_since) = 0;

  // Operations.

  /// Creates an operation; its number and times are ignored. kAlreadyExists:
  /// the id.
  virtual absl::StatusOr<OperationRecord> CreateOperation(
      const OperationRecord& operation) = 0;
  /// kNotFound.
  virtual absl::StatusOr<OperationRecord> GetOperation(
      const std::string& id) const = 0;
  /// Up to `max_count` operations in the order of creation, those with a
  /// number above `after` (0: from the first). `target`: only those of that
  /// very target; empty: all. `unfinished_only`: none that is done.
  virtual absl::StatusOr<std::vector<OperationRecord>> ListOperations(
      const std::string& target, bool unfinished_only, int64_t after,
      int64_t max_count) const = 0;
  /// Replaces everything of the operation `operation.id` but what it was asked
  /// and its create time. kNotFound; kFailedPrecondition: it is done already.
  virtual absl::Status UpdateOperation(const OperationRecord& operation) = 0;
  /// Forgets an operation. kNotFound; kFailedPrecondition: it is not done.
  virtual absl::Status DeleteOperation(const std::string& id) = 0;
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_CATALOGUE_H_
