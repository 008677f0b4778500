#ifndef MAPSIEVE_TESTS_TESTING_MEMORY_CATALOGUE_H_
#define MAPSIEVE_TESTS_TESTING_MEMORY_CATALOGUE_H_

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/mutex.h"
#include "core/geometry/cell_key.h"
#include "storage/catalogue.h"

namespace mapsieve::testing {

/// A Catalogue that lives as long as the object: what the interface says, as
/// plainly as possible. Every revision is a copy of all that it has, and what
/// is told of it is counted anew. Numbers of chunks and operations are 1, 2, …
class MemoryCatalogue final : public storage::Catalogue {
 public:
  absl::StatusOr<storage::MapRecord> CreateMap(
      const storage::MapSpec& spec) override;
  absl::StatusOr<storage::MapRecord> GetMap(
      const std::string& id) const override;
  absl::StatusOr<std::vector<storage::MapRecord>> ListMaps(
      const std::string& after, int64_t max_count) const override;
  absl::Status DeleteMap(const std::string& id) override;
  absl::StatusOr<std::vector<std::string>> ListDeletedMaps(
      const std::string& after, int64_t max_count) const override;
  absl::Status PurgeMap(const std::string& map_uid) override;

  absl::StatusOr<storage::RevisionRecord> CommitRevision(
      const std::string& map_uid, int64_t expected_parent,
      const storage::RevisionChange& change) override;
  absl::StatusOr<storage::RevisionRecord> RollBack(const std::string& map_uid,
                                                   int64_t number) override;
  absl::StatusOr<storage::RevisionRecord> GetRevision(
      const std::string& map_uid, int64_t number) const override;
  absl::StatusOr<storage::RevisionRecord> GetKeptRevision(
      const std::string& map_uid, int64_t number) const override;
  absl::StatusOr<std::vector<storage::RevisionRecord>> ListRevisions(
      const std::string& map_uid, int64_t before,
      int64_t max_count) const override;
  absl::StatusOr<int64_t> ExpireRevisions(const std::string& map_uid,
                                          int64_t kept_count) override;
  absl::StatusOr<std::vector<storage::BlobId>> ForgetExpired(
      const std::string& map_uid, const std::set<int64_t>& pinned) override;
  absl::StatusOr<int64_t> MeasureReclaimable(
      const std::string& map_uid) const override;

  absl::StatusOr<std::vector<storage::ChunkRef>> ListChunks(
      const std::string& map_uid, int64_t revision, storage::ChunkKind kind,
      const std::optional<core::LatticeBox>& region,
      const std::optional<storage::ChunkPosition>& after,
      int64_t max_count) const override;
  absl::StatusOr<std::vector<storage::ChunkRef>> ListTileChunks(
      const std::string& map_uid, int64_t revision, storage::ChunkKind kind,
      const core::CellKey& tile) const override;
  absl::StatusOr<std::vector<storage::TileSummary>> ListTiles(
      const std::string& map_uid, int64_t revision, storage::ChunkKind kind,
      const std::optional<core::LatticeBox>& region,
      const std::optional<core::CellKey>& after,
      int64_t max_count) const override;
  absl::StatusOr<std::vector<storage::ChunkRef>> ListAllChunks(
      const std::string& map_uid, int64_t after,
      int64_t max_count) const override;
  absl::StatusOr<int64_t> CountAllChunks(
      const std::string& map_uid) const override;
  absl::StatusOr<std::vector<core::CellKey>> ListChangedTiles(
      const std::string& map_uid, int64_t revision, int64_t other,
      storage::ChunkKind kind, const std::optional<core::CellKey>& after,
      int64_t max_count) const override;
  absl::StatusOr<std::vector<bool>> AreBlobsReferenced(
      std::span<const storage::BlobId> ids) const override;

  absl::StatusOr<storage::UploadRecord> CreateUpload(
      const std::string& map_uid, const storage::UploadSpec& spec) override;
  absl::StatusOr<storage::UploadRecord> GetUpload(
      const std::string& map_uid, const std::string& id) const override;
  absl::StatusOr<storage::UploadRecord> GetUploadByUid(
      const std::string& upload_uid) const override;
  absl::StatusOr<std::vector<storage::UploadRecord>> ListUploads(
      const std::string& map_uid, const std::string& after,
      int64_t max_count) const override;
  absl::Status SetCommittedBytes(const std::string& upload_uid,
                                 int64_t bytes) override;
  absl::StatusOr<storage::UploadRecord> SetUploadState(
      const std::string& upload_uid, storage::UploadState from,
      storage::UploadState to, const std::string& report) override;
  absl::Status DeleteUpload(const std::string& upload_uid) override;
  absl::StatusOr<int64_t> DeleteIdleUploads(absl::Time idle_since) override;

  absl::StatusOr<storage::OperationRecord> CreateOperation(
      const storage::OperationRecord& operation) override;
  absl::StatusOr<storage::OperationRecord> GetOperation(
      const std::string& id) const override;
  absl::StatusOr<std::vector<storage::OperationRecord>> ListOperations(
      const std::string& target, bool unfinished_only, int64_t after,
      int64_t max_count) const override;
  absl::Status UpdateOperation(
      const storage::OperationRecord& operation) override;
  absl::Status DeleteOperation(const std::string& id) override;

 private:
  using Tiles = std::set<core::CellKey, core::CellKeyLess>;
  // By number.
  using Chunks = std::map<int64_t, storage::ChunkRef>;

  struct Revision {
    storage::RevisionRecord record;
    Chunks chunks;
    // Tiles whose raw points changed after the product was made.
    Tiles changed_tiles;
    // Tiles whose points the product took in.
    Tiles product_tiles;
  };
  struct Map {
    storage::MapRecord record;
    bool deleted = false;
    // Of all revisions.
    Chunks references;
    std::map<int64_t, Revision> revisions;
    // Of each upload, by id, the revisions that added its points, with the
    // reports of then.
    std::map<std::string, std::map<int64_t, std::string>> upload_revisions;

    const Revision& newest() const {
      return revisions.at(record.newest_revision);
    }
  };

  absl::StatusOr<const Map*> FindMap(const std::string& uid) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<const Map*> FindMapById(const std::string& id) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<Map*> FindLivingMap(const std::string& uid)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<const Revision*> FindRevision(const std::string& map_uid,
                                               int64_t number) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // FindRevision of one that is not expired.
  absl::StatusOr<const Revision*> FindKeptRevision(const std::string& map_uid,
                                                   int64_t number) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // The last revision in the history of `number` that added the points of an
  // upload; 0 if none did.
  static int64_t LastAddition(const Map& map, int64_t number,
                              const std::string& upload_id);
  absl::StatusOr<storage::UploadRecord*> FindUpload(const std::string& uid)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::StatusOr<storage::OperationRecord> FindOperation(
      const std::string& id) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // The chunks of a kind that intersect a region, by tile and number.
  absl::StatusOr<std::vector<storage::ChunkRef>> Select(
      const std::string& map_uid, int64_t revision, storage::ChunkKind kind,
      const std::optional<core::LatticeBox>& region) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Makes `revision` the newest of its map.
  const storage::RevisionRecord& Append(Map& map, Revision revision,
                                        const std::string& process_options)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  std::string NewUid() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  mutable Mutex mutex_;
  // By uid.
  std::map<std::string, Map> maps_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, storage::UploadRecord> uploads_ ABSL_GUARDED_BY(mutex_);
  // By id.
  std::map<std::string, storage::OperationRecord> operations_
      ABSL_GUARDED_BY(mutex_);
  int64_t last_uid_ ABSL_GUARDED_BY(mutex_) = 0;
  int64_t last_chunk_ ABSL_GUARDED_BY(mutex_) = 0;
  int64_t last_operation_ ABSL_GUARDED_BY(mutex_) = 0;
};

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_MEMORY_CATALOGUE_H_
