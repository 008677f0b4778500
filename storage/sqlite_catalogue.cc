#include "storage/sqlite_catalogue.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/mutex.h"
#include "core/base/status.h"
#include "storage/record_checks.h"
#include "storage/sqlite_chunks.h"
#include "storage/sqlite_database.h"
#include "storage/sqlite_maps.h"
#include "storage/sqlite_migration.h"
#include "storage/sqlite_operations.h"
#include "storage/sqlite_retention.h"
#include "storage/sqlite_schema.h"
#include "storage/sqlite_uploads.h"

namespace mapsieve::storage {
namespace {

// Now, as precisely as the tables keep it.
absl::Time TimeOfTables() {
  return absl::FromUnixMicros(absl::ToUnixMicros(absl::Now()));
}

absl::StatusOr<RevisionRecord> Commit(SqliteDatabase& database,
                                      const std::string& map_uid,
                                      int64_t expected_parent,
                                      const RevisionChange& change) {
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadLivingMap(database, map_uid));
  if (map.record.newest_revision != expected_parent) {
    return absl::AbortedError(
        absl::StrCat("map ", map.record.spec.id, ": expected revision ",
                     expected_parent, " to be the newest, revision ",
                     map.record.newest_revision, " is; read the map again"));
  }
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRevisionChange(change, map.record.spec.tile_level));
  MAPSIEVE_ASSIGN_OR_RETURN(const RevisionRecord parent,
                            ReadRevision(database, map, expected_parent));
  RevisionRecord revision;
  revision.number = expected_parent + 1;
  revision.parent = expected_parent;
  revision.create_time = TimeOfTables();
  revision.spec = change.spec;
  revision.processed_revision = change.spec.product.has_value()
                                    ? revision.number
                                    : parent.processed_revision;
  MAPSIEVE_ASSIGN_OR_RETURN(revision.totals,
                            ApplyChange(database, map, parent.totals, change));
  MAPSIEVE_RETURN_IF_ERROR(InsertRevision(database, map.key, revision));
  MAPSIEVE_RETURN_IF_ERROR(SetNewestRevision(database, map.key, revision));
  if (!change.crs_wkt.empty() || !change.frame_id.empty()) {
    MAPSIEVE_RETURN_IF_ERROR(
        SetPlace(database, map.key, change.crs_wkt, change.frame_id));
  }
  if (change.spec.product.has_value()) {
    MAPSIEVE_RETURN_IF_ERROR(
        SetProcessOptions(database, map.key, change.spec.product->options));
  }
  if (!change.finalized_upload_uid.empty()) {
    MAPSIEVE_RETURN_IF_ERROR(FinalizeUpload(database, map_uid,
                                            change.finalized_upload_uid,
                                            revision, change.upload_report));
  }
  return revision;
}

absl::StatusOr<RevisionRecord> RollBackTo(SqliteDatabase& database,
                                          const std::string& map_uid,
                                          int64_t number) {
  MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadLivingMap(database, map_uid));
  MAPSIEVE_RETURN_IF_ERROR(CheckRevisionNumber(map, number));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const RevisionRecord newest,
      ReadRevision(database, map, map.record.newest_revision));
  // A repeat finds it even if the target expired since.
  if (newest.number == number || newest.restored_revision == number) {
    return newest;
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const RevisionRecord target,
                            ReadKeptRevision(database, map, number));
  std::string options;
  if (target.processed_revision != 0) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const RevisionRecord processed,
        ReadRevision(database, map, target.processed_revision));
    options = processed.spec.product.value_or(ProductSummary()).options;
  }
  const RevisionRecord revision = {
      .number = newest.number + 1,
      .parent = newest.number,
      .create_time = TimeOfTables(),
      .spec = {.kind = RevisionKind::kRollback,
               .attributes = target.spec.attributes},
      .totals = target.totals,
      .processed_revision = target.processed_revision,
      .restored_revision = number};
  MAPSIEVE_RETURN_IF_ERROR(RestoreChunks(database, map, target));
  MAPSIEVE_RETURN_IF_ERROR(FinalizeRestoredUploads(database, map, number));
  MAPSIEVE_RETURN_IF_ERROR(InsertRevision(database, map.key, revision));
  MAPSIEVE_RETURN_IF_ERROR(SetNewestRevision(database, map.key, revision));
  MAPSIEVE_RETURN_IF_ERROR(SetProcessOptions(database, map.key, options));
  return revision;
}

// A connection for those who write and one for those who read: with a
// write-ahead log a reader sees the last commit while the next one is made.
class Connections {
 public:
  Connections(std::unique_ptr<SqliteDatabase> writer,
              std::unique_ptr<SqliteDatabase> reader)
      : writer_(std::move(writer)), reader_(std::move(reader)) {}

  template <typename Work>
  auto Write(const Work& work) {
    MutexLock lock(writer_mutex_);
    return Run(*writer_, SqliteTransaction::Kind::kWrite, work);
  }
  template <typename Work>
  auto Read(const Work& work) const {
    MutexLock lock(reader_mutex_);
    return Run(*reader_, SqliteTransaction::Kind::kRead, work);
  }

 private:
  static const absl::Status& StatusOf(const absl::Status& status) {
    return status;
  }
  template <typename T>
  static const absl::Status& StatusOf(const absl::StatusOr<T>& result) {
    return result.status();
  }

  // What `work` returns, after its changes were committed if that is OK.
  template <typename Work>
  static auto Run(SqliteDatabase& database, SqliteTransaction::Kind kind,
                  const Work& work) -> decltype(work(database)) {
    SqliteTransaction transaction(database);
    MAPSIEVE_RETURN_IF_ERROR(transaction.Begin(kind));
    auto result = work(database);
    MAPSIEVE_RETURN_IF_ERROR(StatusOf(result));
    MAPSIEVE_RETURN_IF_ERROR(transaction.Commit());
    return result;
  }

  Mutex writer_mutex_;
  const std::unique_ptr<SqliteDatabase> writer_
      ABSL_PT_GUARDED_BY(writer_mutex_);
  mutable Mutex reader_mutex_;
  const std::unique_ptr<SqliteDatabase> reader_
      ABSL_PT_GUARDED_BY(reader_mutex_);
};

class SqliteCatalogue final : public Catalogue, private Connections {
 public:
  using Connections::Connections;

  absl::StatusOr<MapRecord> CreateMap(const MapSpec& spec) override {
    return Write([&](auto& db) { return storage::CreateMap(db, spec); });
  }
  absl::StatusOr<MapRecord> GetMap(const std::string& id) const override {
    return Read([&](auto& db) { return storage::GetMap(db, id); });
  }
  absl::StatusOr<std::vector<MapRecord>> ListMaps(
      const std::string& after, int64_t max_count) const override {
    return Read(
        [&](auto& db) { return storage::ListMaps(db, after, max_count); });
  }
  absl::Status DeleteMap(const std::string& id) override {
    return Write([&](auto& db) { return storage::DeleteMap(db, id); });
  }
  absl::StatusOr<std::vector<std::string>> ListDeletedMaps(
      const std::string& after, int64_t max_count) const override {
    return Read([&](auto& db) {
      return storage::ListDeletedMaps(db, after, max_count);
    });
  }
  absl::Status PurgeMap(const std::string& map_uid) override {
    // In parts: the log stays short, and others can write in between.
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(const bool done, Write([&](auto& db) {
                                  return PurgePart(db, map_uid);
                                }));
      if (done) return absl::OkStatus();
    }
  }

  absl::StatusOr<RevisionRecord> CommitRevision(
      const std::string& map_uid, int64_t expected_parent,
      const RevisionChange& change) override {
    return Write(
        [&](auto& db) { return Commit(db, map_uid, expected_parent, change); });
  }
  absl::StatusOr<RevisionRecord> RollBack(const std::string& map_uid,
                                          int64_t number) override {
    return Write([&](auto& db) { return RollBackTo(db, map_uid, number); });
  }
  absl::StatusOr<RevisionRecord> GetRevision(const std::string& map_uid,
                                             int64_t number) const override {
    return Read([&](auto& db) -> absl::StatusOr<RevisionRecord> {
      MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadMap(db, map_uid));
      return ReadRevision(db, map, number);
    });
  }
  absl::StatusOr<RevisionRecord> GetKeptRevision(
      const std::string& map_uid, int64_t number) const override {
    return Read([&](auto& db) -> absl::StatusOr<RevisionRecord> {
      MAPSIEVE_ASSIGN_OR_RETURN(const MapRow map, ReadMap(db, map_uid));
      return ReadKeptRevision(db, map, number);
    });
  }
  absl::StatusOr<std::vector<RevisionRecord>> ListRevisions(
      const std::string& map_uid, int64_t before,
      int64_t max_count) const override {
    return Read([&](auto& db) {
      return storage::ListRevisions(db, map_uid, before, max_count);
    });
  }

  absl::StatusOr<std::vector<ChunkRef>> ListChunks(
      const std::string& map_uid, int64_t revision, ChunkKind kind,
      const std::optional<core::LatticeBox>& region,
      const std::optional<ChunkPosition>& after,
      int64_t max_count) const override {
    return Read([&](auto& db) {
      return storage::ListChunks(db, map_uid, revision, kind, region, after,
                                 max_count);
    });
  }
  absl::StatusOr<std::vector<ChunkRef>> ListTileChunks(
      const std::string& map_uid, int64_t revision, ChunkKind kind,
      const core::CellKey& tile) const override {
    return Read([&](auto& db) {
      return storage::ListTileChunks(db, map_uid, revision, kind, tile);
    });
  }
  absl::StatusOr<std::vector<TileSummary>> ListTiles(
      const std::string& map_uid, int64_t revision, ChunkKind kind,
      const std::optional<core::LatticeBox>& region,
      const std::optional<core::CellKey>& after,
      int64_t max_count) const override {
    return Read([&](auto& db) {
      return storage::ListTiles(db, map_uid, revision, kind, region, after,
                                max_count);
    });
  }
  absl::StatusOr<std::vector<ChunkRef>> ListAllChunks(
      const std::string& map_uid, int64_t after,
      int64_t max_count) const override {
    return Read([&](auto& db) {
      return storage::ListAllChunks(db, map_uid, after, max_count);
    });
  }
  absl::StatusOr<int64_t> CountAllChunks(
      const std::string& map_uid) const override {
    return Read([&](auto& db) { return storage::CountAllChunks(db, map_uid); });
  }
  absl::StatusOr<std::vector<core::CellKey>> ListChangedTiles(
      const std::string& map_uid, int64_t revision, int64_t other,
      ChunkKind kind, const std::optional<core::CellKey>& after,
      int64_t max_count) const override {
    return Read([&](auto& db) {
      return storage::ListChangedTiles(db, map_uid, revision, other, kind,
                                       after, max_count);
    });
  }
  absl::StatusOr<int64_t> ExpireRevisions(const std::string& map_uid,
                                          int64_t kept_count) override {
    return Write([&](auto& db) {
      return storage::ExpireRevisions(db, map_uid, kept_count);
    });
  }
  absl::StatusOr<std::vector<BlobId>> ForgetExpired(
      const std::string& map_uid, const std::set<int64_t>& pinned) override {
    return Write(
        [&](auto& db) { return storage::ForgetExpired(db, map_uid, pinned); });
  }
  absl::StatusOr<int64_t> MeasureReclaimable(
      const std::string& map_uid) const override {
    ReclaimablePart part;
    while (!part.is_last) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          part, Read([&](auto& db) { return MeasurePart(db, map_uid, part); }));
    }
    return part.bytes;
  }

  absl::StatusOr<std::vector<bool>> AreBlobsReferenced(
      std::span<const BlobId> ids) const override {
    return Read([&](auto& db) { return storage::AreBlobsReferenced(db, ids); });
  }

  absl::StatusOr<UploadRecord> CreateUpload(const std::string& map_uid,
                                            const UploadSpec& spec) override {
    return Write(
        [&](auto& db) { return storage::CreateUpload(db, map_uid, spec); });
  }
  absl::StatusOr<UploadRecord> GetUpload(const std::string& map_uid,
                                         const std::string& id) const override {
    return Read([&](auto& db) { return storage::GetUpload(db, map_uid, id); });
  }
  absl::StatusOr<UploadRecord> GetUploadByUid(
      const std::string& upload_uid) const override {
    return Read(
        [&](auto& db) { return storage::GetUploadByUid(db, upload_uid); });
  }
  absl::StatusOr<std::vector<UploadRecord>> ListUploads(
      const std::string& map_uid, const std::string& after,
      int64_t max_count) const override {
    return Read([&](auto& db) {
      return storage::ListUploads(db, map_uid, after, max_count);
    });
  }
  absl::Status SetCommittedBytes(const std::string& upload_uid,
                                 int64_t bytes) override {
    return Write([&](auto& db) {
      return storage::SetCommittedBytes(db, upload_uid, bytes);
    });
  }
  absl::StatusOr<UploadRecord> SetUploadState(
      const std::string& upload_uid, UploadState from, UploadState to,
      const std::string& report) override {
    return Write([&](auto& db) {
      return storage::SetUploadState(db, upload_uid, from, to, report);
    });
  }
  absl::Status DeleteUpload(const std::string& upload_uid) override {
    return Write(
        [&](auto& db) { return storage::DeleteUpload(db, upload_uid); });
  }
  absl::StatusOr<int64_t> DeleteIdleUploads(absl::Time idle_since) override {
    return Write(
        [&](auto& db) { return storage::DeleteIdleUploads(db, idle_since); });
  }

  absl::StatusOr<OperationRecord> CreateOperation(
      const OperationRecord& operation) override {
    return Write(
        [&](auto& db) { return storage::CreateOperation(db, operation); });
  }
  absl::StatusOr<OperationRecord> GetOperation(
      const std::string& id) const override {
    return Read([&](auto& db) { return storage::GetOperation(db, id); });
  }
  absl::StatusOr<std::vector<OperationRecord>> ListOperations(
      const std::string& target, bool unfinished_only, int64_t after,
      int64_t max_count) const override {
    return Read([&](auto& db) {
      return storage::ListOperations(db, target, unfinished_only, after,
                                     max_count);
    });
  }
  absl::Status UpdateOperation(const OperationRecord& operation) override {
    return Write(
        [&](auto& db) { return storage::UpdateOperation(db, operation); });
  }
  absl::Status DeleteOperation(const std::string& id) override {
    return Write([&](auto& db) { return storage::DeleteOperation(db, id); });
  }
};

}  // namespace

absl::StatusOr<std::unique_ptr<Catalogue>> OpenSqliteCatalogue(
    FileSystem& file_system, const std::string& path, IfAbsent if_absent) {
  MAPSIEVE_RETURN_IF_ERROR(SqliteDatabase::SecureLog(file_system, path));
  MAPSIEVE_ASSIGN_OR_RETURN(auto writer,
                            SqliteDatabase::Open(file_system, path));
  MAPSIEVE_ASSIGN_OR_RETURN(const bool is_old, LacksPageChecksums(*writer));
  if (is_old) {
    MAPSIEVE_RETURN_IF_ERROR(AddPageChecksums(file_system, std::move(writer)));
    MAPSIEVE_ASSIGN_OR_RETURN(writer, SqliteDatabase::Open(file_system, path));
  }
  MAPSIEVE_RETURN_IF_ERROR(PrepareSchema(*writer, if_absent));
  MAPSIEVE_ASSIGN_OR_RETURN(auto reader,
                            SqliteDatabase::Open(file_system, path));
  MAPSIEVE_RETURN_IF_ERROR(reader->Execute("PRAGMA query_only = ON"));
  return std::make_unique<SqliteCatalogue>(std::move(writer),
                                           std::move(reader));
}

}  // namespace mapsieve::storage
