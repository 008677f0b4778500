#ifndef MAPSIEVE_SERVER_ENGINE_ENGINE_H_
#define MAPSIEVE_SERVER_ENGINE_ENGINE_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <stop_token>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "core/spdf/spdf_options.h"
#include "server/engine/query.h"
#include "server/engine/sync.h"
#include "server/engine/types.h"
#include "server/engine/verify.h"

namespace mapsieve::storage {
class FileSystem;
}  // namespace mapsieve::storage

namespace mapsieve::engine {

inline constexpr int64_t kMinMemoryBytes = int64_t{256} << 20;

struct EngineOptions {
  /// Directory of all data; made if absent. One process at a time has it.
  std::string data_dir;
  /// What points in memory may take in all, at least kMinMemoryBytes: half for
  /// the filter, an eighth for uploads being finalized, a quarter for queries;
  /// the rest is for buffers that are not counted.
  int64_t memory_bytes = int64_t{2} << 30;
  /// Threads of the filter, 1 to 1024.
  int worker_count = 1;
  /// Operations that may wait at the same time, at least 1; beyond,
  /// kResourceExhausted.
  int max_queued_operations = 1000;
  /// Where the data directory is; outlives the engine. Nothing: the file system
  /// of the operating system.
  storage::FileSystem* file_system = nullptr;
  /// Finished operations remembered, at least 1; older ones are forgotten.
  int max_finished_operations = 1000;
  /// Newest revisions of each map that are kept; 0: all. Others expire soon
  /// after a commit, but for those that made the products of kept ones.
  int64_t kept_revision_count = 0;
  /// Hear of what no caller may be there to be told of: operations that ran and
  /// ended, and collections of garbage and expiries of revisions that failed,
  /// which are tried again within the hour. Called from threads of the engine;
  /// quick, and call no method of it. Nothing: nobody hears of them.
  std::function<void(const Operation& operation)> on_operation_end;
  std::function<void(const absl::Status& error)> on_collection_failure;

  /// kInvalidArgument, naming the field and its limits.
  absl::Status Validate() const;
};

/// Appends bytes to one upload, which no other writer can meanwhile. Used by
/// one thread at a time; destroyed before its Engine.
class UploadWriter {
 public:
  virtual ~UploadWriter() = default;

  /// Takes `bytes`, whose first has number `offset` in the upload. Bytes that
  /// are there already are dropped. kOutOfRange: a gap before `offset`, or
  /// more than expected_bytes; kFailedPrecondition: the upload is not active
  /// any more; kResourceExhausted: disk full.
  virtual absl::Status Append(int64_t offset,
                              std::span<const std::byte> bytes) = 0;

  /// Makes what was appended durable and returns the length of the durable
  /// prefix of the upload.
  virtual absl::StatusOr<int64_t> Commit() = 0;
};

/// The revisions of a map in order, those to come included. Used by one thread
/// at a time; destroyed before its Engine.
class RevisionCursor {
 public:
  virtual ~RevisionCursor() = default;

  /// The next revision, an expired one too; nothing while it is not committed.
  /// kNotFound: the map was deleted, even if revisions of it were not given
  /// yet.
  virtual absl::StatusOr<std::optional<RevisionInfo>> Next() = 0;
};

/// Maps on one machine: everything that the service does, without the network.
/// All methods are thread-safe and validate what they are given.
///
/// Errors that any method may give: kInvalidArgument for an id that is none;
/// kNotFound for a map, upload or operation that does not exist;
/// kResourceExhausted (disk full, where something is written that is no
/// deletion); kUnavailable, kDataLoss (storage); kInternal. Methods may wait
/// for the disk, so reactors do not call them.
class Engine {
 public:
  /// Opens the data directory and goes on with the operations that waited or
  /// ran when it was last closed or its process died.
  /// kInvalidArgument (options); kAborted: another process has the directory.
  static absl::StatusOr<std::unique_ptr<Engine>> Open(
      const EngineOptions& options);

  /// Shutdown.
  virtual ~Engine() = default;

  /// kResourceExhausted while the disk is so full that uploads are refused.
  virtual absl::Status CheckSpace() = 0;

  /// Stops the operations that run, so that the next Open goes on with them,
  /// and refuses new ones with kUnavailable. Returns when none runs. All other
  /// calls work as before.
  virtual void Shutdown() = 0;

  // Maps.

  /// kInvalidArgument naming the field; kAlreadyExists.
  virtual absl::StatusOr<MapInfo> CreateMap(const MapSpec& spec) = 0;
  virtual absl::StatusOr<MapInfo> GetMap(const std::string& map_id) = 0;
  /// By id.
  virtual absl::StatusOr<Page<MapInfo>> ListMaps(const PageRequest& page) = 0;
  /// Removes the map with its revisions, uploads and operations. Queries under
  /// way go on.
  /// kFailedPrecondition: it has uploads that are neither finalized nor failed,
  /// or an operation that waits or runs, and not `force`; with it, the uploads
  /// are dropped, the operations cancelled and waited for.
  virtual absl::Status DeleteMap(const std::string& map_id, bool force) = 0;
  virtual absl::StatusOr<MapStats> GetMapStats(const std::string& map_id) = 0;
  /// Newest first.
  virtual absl::StatusOr<Page<RevisionInfo>> ListRevisions(
      const std::string& map_id, const PageRequest& page) = 0;
  /// The revisions of a map from `from_revision` on, 0: from the newest one.
  /// `wake` is called after every commit to the map and after its deletion,
  /// from a thread of the engine, until the cursor is destroyed, which waits
  /// for a call under way; it must be quick, and call neither the engine nor
  /// the cursor. kOutOfRange: the map is more than one revision short of
  /// `from_revision`.
  virtual absl::StatusOr<std::unique_ptr<RevisionCursor>> WatchRevisions(
      const std::string& map_id, int64_t from_revision,
      std::function<void()> wake) = 0;
  /// Tiles that differ between two revisions, a page at a time. kOutOfRange: a
  /// revision that the map has not, or not any more.
  virtual absl::StatusOr<RevisionComparison> CompareRevisions(
      const std::string& map_id, int64_t base, int64_t target,
      const PageRequest& page) = 0;

  // Edits.

  /// Starts the operation that takes the raw points of a region, those that a
  /// raw query of it gives, out of the map as one new revision; tiles that lost
  /// points are stale. Where there are no points, no revision is made.
  /// kInvalidArgument naming the field; kResourceExhausted: too many operations
  /// wait. Errors of the operation: kCancelled, kUnavailable, kDataLoss;
  /// kResourceExhausted: disk full, or points of more chunks than one revision
  /// takes. The map is as before in every case.
  virtual absl::StatusOr<Operation> DeleteRegion(const std::string& map_id,
                                                 const RegionShape& region) = 0;
  /// Makes a new revision that equals `revision`: raw points, what queries
  /// answer, stale tiles, options of the filter. Nothing is made, and the
  /// newest revision returned, if that is `revision` or a rollback to it.
  /// Uploads that it takes out of the map can be made again. kOutOfRange: no
  /// such revision, or it expired; kAborted: an operation on the map waits or
  /// runs.
  virtual absl::StatusOr<RevisionInfo> RollBack(const std::string& map_id,
                                                int64_t revision) = 0;

  // Uploads.

  /// Opens an upload, or returns the one of this id and the same spec, whatever
  /// its state; but one whose points a rollback took out of the map begins
  /// anew. kInvalidArgument; kAlreadyExists: the id is taken by an upload
  /// with another spec (the figures of both in the message).
  virtual absl::StatusOr<UploadInfo> CreateUpload(const std::string& map_id,
                                                  const UploadSpec& spec) = 0;
  virtual absl::StatusOr<UploadInfo> GetUpload(
      const std::string& map_id, const std::string& upload_id) = 0;
  /// By id.
  virtual absl::StatusOr<Page<UploadInfo>> ListUploads(
      const std::string& map_id, const PageRequest& page) = 0;
  /// Forgets an upload and its staged bytes; the points of a finalized one stay
  /// in the map. A writer of it is of no further use. kFailedPrecondition: it
  /// is being finalized.
  virtual absl::Status DeleteUpload(const std::string& map_id,
                                    const std::string& upload_id) = 0;
  /// kFailedPrecondition: the upload is not active; kAborted: it has a writer.
  virtual absl::StatusOr<std::unique_ptr<UploadWriter>> OpenUploadWriter(
      const std::string& map_id, const std::string& upload_id) = 0;
  /// Starts the operation that adds the upload's points to the map as one new
  /// revision; a repeat returns the operation of the first call, done or not,
  /// unless that one failed in a way that a repeat may mend. `region`: the raw
  /// points that it has by then are taken out in the same revision.
  /// kInvalidArgument: the region; kFailedPrecondition: bytes are missing, or
  /// the upload failed before and its operation is forgotten;
  /// kResourceExhausted: too many operations wait. Errors of the operation:
  /// kDataLoss: the bytes are not those of content_hash, or a block is damaged
  /// (with its offset); kInvalidArgument: a block with another step than the
  /// map's, an attribute with another type than the map's (both are named), too
  /// many attributes, too large a block — the upload is then kFailed;
  /// kDataLoss: a chunk of the map that `region` cuts is damaged;
  /// kResourceExhausted, kUnavailable, kInternal, kCancelled — it is kActive
  /// again. The map is as before in every case.
  virtual absl::StatusOr<Operation> FinalizeUpload(
      const std::string& map_id, const std::string& upload_id,
      const std::optional<RegionShape>& region = std::nullopt) = 0;

  // The filter.

  /// Starts the operation that filters the whole map and makes the result
  /// visible as one new revision. `options`: nothing means those of the map's
  /// last run, or the defaults. Nothing is done if the result for these points
  /// and options is there. kInvalidArgument naming the field;
  /// kFailedPrecondition: no points; kAborted: a run waits or is going on (it
  /// is named); kResourceExhausted: too many operations wait.
  /// Errors of the operation: kCancelled, kResourceExhausted, kUnavailable,
  /// kDataLoss; the map is as before.
  virtual absl::StatusOr<Operation> ProcessMap(
      const std::string& map_id,
      const std::optional<core::SpdfOptions>& options) = 0;

  // Operations.

  virtual absl::StatusOr<Operation> GetOperation(
      const std::string& operation_id) = 0;
  /// Newest first; `map_id`: only those of this map, empty: all.
  virtual absl::StatusOr<Page<Operation>> ListOperations(
      const std::string& map_id, const PageRequest& page) = 0;
  /// Asks it to stop: it ends as kCancelled soon, unless it is done before.
  /// OK if it is done.
  virtual absl::Status CancelOperation(const std::string& operation_id) = 0;
  /// Returns when it is done or after `timeout`, whichever comes first.
  virtual absl::StatusOr<Operation> WaitOperation(
      const std::string& operation_id, absl::Duration timeout) = 0;
  /// Calls `callback` once, from a thread of the engine, when the operation is
  /// done (before this returns if it is done already) or the engine shuts
  /// down. It must be quick and may not call the engine. Returns a number for
  /// StopWatching.
  virtual absl::StatusOr<int64_t> WatchOperation(
      const std::string& operation_id, std::function<void()> callback) = 0;
  /// The callback will not be called any more if it has not been: it may be
  /// running at this moment. Unknown numbers are ignored.
  virtual void StopWatching(int64_t watch) = 0;

  // Queries.

  /// Checks `spec` and begins its answer, which stops within one chunk once
  /// `stop` asks for it. kInvalidArgument naming the field; kNotFound: the map
  /// or an attribute, naming those there are; kFailedPrecondition: never
  /// processed and not `raw`; kOutOfRange: no such revision, it expired, or
  /// nothing was processed up to it; kResourceExhausted: the answer needs more
  /// than the memory for queries, or more than other answers left of it for 10
  /// s, with the figures.
  virtual absl::StatusOr<std::unique_ptr<QueryCursor>> Query(
      const QuerySpec& spec, std::stop_token stop) = 0;

  /// Checks `spec` and begins to bring a client's chunks up to date; stops soon
  /// once `stop` asks for it. Errors as Query; kInvalidArgument: a budget,
  /// allow_partial or a resume token in the query, or too many held chunks.
  virtual absl::StatusOr<std::unique_ptr<SyncCursor>> Sync(
      const SyncSpec& spec, std::stop_token stop) = 0;

  // Verification.

  /// Begins to read every stored chunk of a map, of all revisions, and to
  /// filter some tiles again; stops soon once `stop` asks for it.
  /// kInvalidArgument; kFailedPrecondition: tiles are to be compared, and the
  /// map was never processed.
  virtual absl::StatusOr<std::unique_ptr<VerifyCursor>> Verify(
      const VerifySpec& spec, std::stop_token stop) = 0;
  /// Starts the operation that reads every stored chunk of a map and makes the
  /// damaged and missing ones of products and histories, of all revisions,
  /// again from raw points, byte for byte. It makes no revision; queries go on
  /// beside it. What cannot be made again is in its report and no error.
  /// kAborted: a repair of the map waits or is going on (it is named);
  /// kResourceExhausted: too many operations wait. Errors of the operation:
  /// kCancelled, kUnavailable, kDataLoss (the catalogue); what was repaired by
  /// then stays.
  virtual absl::StatusOr<Operation> RepairMap(const std::string& map_id) = 0;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_ENGINE_H_
