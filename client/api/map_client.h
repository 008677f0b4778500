#ifndef MAPSIEVE_CLIENT_API_MAP_CLIENT_H_
#define MAPSIEVE_CLIENT_API_MAP_CLIENT_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "client/api/block_source.h"
#include "client/api/map_types.h"
#include "core/cloud/point_cloud.h"

namespace mapsieve::client {

/// Called with counts of finished and of all work; the total is 0 until known.
using ProgressCallback = std::function<void(int64_t done, int64_t total)>;

/// A running answer. Not thread-safe.
class QueryStream {
 public:
  virtual ~QueryStream() = default;
  virtual const QueryHeader& header() const = 0;
  /// The next points, on the map's lattice; an empty cloud at the end of a
  /// complete answer. After a break the answer goes on behind the last batch,
  /// from the same revision, if the server can be reached again within some
  /// seconds. Otherwise an answer that breaks off is an error, kDataLoss if the
  /// server sent no summary.
  virtual absl::StatusOr<core::LatticeCloud> Next() = 0;
  /// Set once Next returned an empty cloud.
  virtual const QuerySummary& summary() const = 0;
};

/// Client of a mapsieve server. Errors are the server's, by code; a server that
/// cannot be reached is kUnavailable. Thread-safe.
class MapClient {
 public:
  /// `server`: HOST:PORT. Connects at the first call. `patience`: an upload, or
  /// a wait for what the server works on, that the server or the network goes
  /// away from is gone on with: the server is asked again until the pauses
  /// between, ever longer, are so long together; it goes on with its work when
  /// it is back. Queries and WatchMap have 6.3 s, whatever it is.
  explicit MapClient(const std::string& server, absl::Duration patience = {});
  ~MapClient();
  MapClient(const MapClient&) = delete;
  MapClient& operator=(const MapClient&) = delete;

  /// kAlreadyExists, kInvalidArgument.
  absl::StatusOr<MapInfo> CreateMap(const MapSpec& spec);
  /// kNotFound.
  absl::StatusOr<MapInfo> GetMap(const std::string& map_id);
  /// All maps, by id.
  absl::StatusOr<std::vector<MapInfo>> ListMaps();
  /// kNotFound; kFailedPrecondition (unfinished uploads or a running operation
  /// and no `force`).
  absl::Status DeleteMap(const std::string& map_id, bool force);
  absl::StatusOr<MapStats> GetMapStats(const std::string& map_id);

  /// Adds the points of `source` to a map and returns when they are durable
  /// parts of it. Resumes an upload of the same bytes that broke off, and tries
  /// one that the map refused once more; an upload that was finished before
  /// adds nothing, unless a rollback took its points out again. `progress`
  /// counts durable bytes. `region`: they take the place of the raw points that
  /// the map has there, in one revision; to the map the same points with
  /// another region are another upload. `again`: the points are added whether
  /// an upload of them was finished before or not.
  absl::StatusOr<UploadReport> Upload(const std::string& map_id,
                                      BlockSource& source,
                                      const ProgressCallback& progress = {},
                                      const Region& region = {},
                                      bool again = false);

  /// Up to `max_count` revisions, newest first. kNotFound.
  absl::StatusOr<std::vector<RevisionInfo>> ListRevisions(
      const std::string& map_id, int64_t max_count);
  /// Calls `visit` for each revision of a map, from `from_revision` (0: the
  /// newest) on, in order, none left out, those to come as they are committed.
  /// Goes on by itself when the server goes away and is back within 6 s.
  /// Returns what `visit` returns if that is an error; kNotFound: also once the
  /// map is deleted; kOutOfRange: the map is more than one revision short of
  /// `from_revision`; kUnavailable: there is no server, or it stays away.
  absl::Status WatchMap(
      const std::string& map_id, int64_t from_revision,
      const std::function<absl::Status(const RevisionInfo&)>& visit);
  /// Calls `visit` for each tile that differs between two revisions, in Morton
  /// order. kNotFound; kOutOfRange: a revision that the map has not,
  /// or that expired.
  absl::StatusOr<ComparedRevisions> CompareRevisions(
      const std::string& map_id, int64_t base, int64_t target,
      const std::function<absl::Status(const TileChange&)>& visit);
  /// Takes the raw points of a region out of a map and waits until that is
  /// done. kNotFound, kInvalidArgument. `progress` counts chunks.
  absl::StatusOr<DeleteReport> DeleteRegion(
      const std::string& map_id, const Region& region,
      const ProgressCallback& progress = {});
  /// Makes a revision that equals `revision`; the newest one is returned if it
  /// is that, or a rollback to it. kNotFound; kOutOfRange; kAborted: an
  /// operation on the map is going on.
  absl::StatusOr<RevisionInfo> RollBack(const std::string& map_id,
                                        int64_t revision);

  /// Reads every stored chunk of a map, of all its revisions, on the server,
  /// and filters `compared_tile_count` tiles again, each by itself, to compare.
  /// Damage is in the report and no error. kNotFound, kInvalidArgument;
  /// kFailedPrecondition: tiles are to be compared, and the map was never
  /// processed. `progress` counts chunks and tiles.
  absl::StatusOr<VerifyReport> Verify(const std::string& map_id,
                                      int64_t compared_tile_count,
                                      const ProgressCallback& progress = {});

  /// Makes the damaged and missing chunks of products and histories, of all
  /// revisions, again from raw points and waits until that is done. What cannot
  /// be made again is in the report and no error. kNotFound; kAborted: a repair
  /// of the map is going on. `progress` counts chunks.
  absl::StatusOr<RepairReport> Repair(const std::string& map_id,
                                      const ProgressCallback& progress = {});

  /// Starts the filter over a map and returns the operation's id. No options:
  /// those of the map's last run. kFailedPrecondition (empty map), kAborted (a
  /// run is going on).
  absl::StatusOr<std::string> StartProcess(
      const std::string& map_id, const std::optional<ProcessOptions>& options);
  /// Waits for an operation that StartProcess started.
  absl::StatusOr<ProcessReport> WaitForProcess(
      const std::string& operation_id, const ProgressCallback& progress = {});
  /// kNotFound; finished ones are forgotten in time.
  absl::StatusOr<OperationInfo> GetOperation(const std::string& operation_id);
  /// Asks it to stop; OK if it is done. kNotFound.
  absl::Status CancelOperation(const std::string& operation_id);
  /// Waits until an operation of any kind is done. Its error if it failed or
  /// was cancelled; kNotFound. `progress` counts units of its own.
  absl::Status WaitForOperation(const std::string& operation_id,
                                const ProgressCallback& progress = {});

  /// Starts a query and returns when its header is there.
  absl::StatusOr<std::unique_ptr<QueryStream>> Query(const QuerySpec& spec);
  /// Brings the chunks of a region that the caller does not hold: calls `visit`
  /// for each, in Morton order of tiles, and returns what it is to drop. After
  /// an error the chunks visited by then are good. Returns what `visit` returns
  /// if that is an error.
  absl::StatusOr<SyncSummary> Sync(
      const SyncSpec& spec,
      const std::function<absl::Status(const SyncChunk&)>& visit);
  /// The whole answer in memory, for answers that are known to fit.
  absl::StatusOr<core::LatticeCloud> QueryAll(const QuerySpec& spec);

 private:
  struct Connection;
  std::unique_ptr<Connection> connection_;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_API_MAP_CLIENT_H_
