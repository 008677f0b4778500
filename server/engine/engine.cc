#include "server/engine/engine.h"

#include <algorithm>
#include <atomic>
#include <charconv>
#include <string_view>
#include <utility>
#include <vector>

#include "core/base/executor.h"
#include "core/base/mutex.h"
#include "core/base/status.h"
#include "server/engine/edit_map.h"
#include "server/engine/garbage_collector.h"
#include "server/engine/ingest.h"
#include "server/engine/job_manager.h"
#include "server/engine/memory_pool.h"
#include "server/engine/opaque_records.h"
#include "server/engine/process_map.h"
#include "server/engine/region_query.h"
#include "server/engine/repair_map.h"
#include "server/engine/request_checks.h"
#include "server/engine/revision_report.h"
#include "server/engine/revision_watch.h"
#include "server/engine/sync_region.h"
#include "server/engine/verify_map.h"
#include "storage/file_system.h"
#include "storage/names.h"
#include "storage/store.h"

namespace mapsieve::engine {
namespace {

/// Threads that store chunks: they wait for the disk most of the time.
constexpr int kIoThreads = 4;
constexpr int kMaxWorkers = 1024;
/// How long an answer waits for the memory that others hold.
constexpr absl::Duration kMaxMemoryWait = absl::Seconds(10);
/// The largest message of an upload.
constexpr int64_t kMessageBytes = int64_t{1} << 20;

absl::StatusOr<UploadInfo> ToInfo(const storage::UploadRecord& record) {
  UploadInfo info = {
      .spec = {.upload_id = record.spec.id,
               .expected_bytes = record.spec.expected_bytes.value_or(0),
               .content_hash = record.spec.content_hash},
      .committed_bytes = record.committed_bytes,
      .create_time = record.create_time};
  switch (record.state) {
    case storage::UploadState::kActive:
      info.state = UploadState::kActive;
      break;
    case storage::UploadState::kFinalizing:
      info.state = UploadState::kFinalizing;
      break;
    case storage::UploadState::kFinalized:
      info.state = UploadState::kFinalized;
      break;
    case storage::UploadState::kFailed:
      info.state = UploadState::kFailed;
      break;
  }
  if (!record.report.empty()) {
    MAPSIEVE_ASSIGN_OR_RETURN(UploadNotes notes,
                              ParseUploadNotes(record.report));
    info.spec.refused = notes.report.refused;
    info.spec.source = std::move(notes.source);
    if (info.state == UploadState::kFinalized) {
      info.report = std::move(notes.report);
    }
  }
  return info;
}

class StoredUploadWriter final : public UploadWriter {
 public:
  explicit StoredUploadWriter(std::unique_ptr<storage::UploadWriter> writer)
      : writer_(std::move(writer)) {}

  absl::Status Append(int64_t offset,
                      std::span<const std::byte> bytes) override {
    return writer_->Append(offset, bytes);
  }
  absl::StatusOr<int64_t> Commit() override { return writer_->Commit(); }

 private:
  const std::unique_ptr<storage::UploadWriter> writer_;
};

class LocalEngine final : public Engine {
 public:
  explicit LocalEngine(const EngineOptions& options)
      : process_limits_(ProcessLimits::Of(options.memory_bytes / 2)),
        ingest_limits_(IngestLimits::Of(options.memory_bytes / 8)),
        query_memory_(options.memory_bytes / 4, kMaxMemoryWait),
        filter_workers_(MakeWorkerPool(options.worker_count)),
        io_workers_(MakeWorkerPool(kIoThreads)) {}

  ~LocalEngine() override { Shutdown(); }

  absl::Status Start(const EngineOptions& options) {
    storage::FileSystem& file_system = options.file_system != nullptr
                                           ? *options.file_system
                                           : storage::PosixFileSystem();
    MAPSIEVE_ASSIGN_OR_RETURN(
        store_, storage::Store::Open(
                    file_system, options.data_dir,
                    {.kept_revision_count = options.kept_revision_count}));
    MAPSIEVE_RETURN_IF_ERROR(RemoveStaleRuns());
    garbage_ = std::make_unique<GarbageCollector>(
        *store_, options.on_collection_failure);
    MAPSIEVE_ASSIGN_OR_RETURN(
        jobs_, JobManager::Open(
                   store_->catalogue(),
                   {.max_queued = options.max_queued_operations,
                    .max_finished = options.max_finished_operations},
                   [this](const std::string& map_id, const JobSpec& spec,
                          const ExecutionContext& context) {
                     return RunJob(map_id, spec, context);
                   },
                   options.on_operation_end));
    return absl::OkStatus();
  }

  absl::Status CheckSpace() override {
    return store_->CheckSpace(kMessageBytes);
  }

  void Shutdown() override {
    is_shut_down_ = true;
    if (jobs_ != nullptr) jobs_->Shutdown();
    if (garbage_ != nullptr) garbage_->Stop();
  }

  // Maps.

  absl::StatusOr<MapInfo> CreateMap(const MapSpec& spec) override {
    MAPSIEVE_RETURN_IF_ERROR(storage::CheckMapId(spec.map_id));
    if (spec.step_nm < 1 || spec.step_nm > core::kMaxStepNm) {
      return absl::InvalidArgumentError(absl::StrCat(
          "step_nm is ", spec.step_nm, "; it must be 1 to ", core::kMaxStepNm));
    }
    MAPSIEVE_RETURN_IF_ERROR(CheckSpace());
    MAPSIEVE_ASSIGN_OR_RETURN(const int tile_level, TileLevel(spec));
    MAPSIEVE_RETURN_IF_ERROR(
        CheckLength("display_name", spec.display_name, kMaxDisplayNameBytes));
    MAPSIEVE_RETURN_IF_ERROR(
        CheckLength("crs_wkt", spec.crs_wkt, kMaxCrsWktBytes));
    MAPSIEVE_RETURN_IF_ERROR(
        CheckName("frame_id", spec.frame_id, kMaxFrameIdBytes));
    MAPSIEVE_ASSIGN_OR_RETURN(
        const storage::MapRecord record,
        catalogue().CreateMap({.id = spec.map_id,
                               .display_name = spec.display_name,
                               .step_nm = spec.step_nm,
                               .tile_level = tile_level,
                               .crs_wkt = spec.crs_wkt,
                               .frame_id = spec.frame_id}));
    return DescribeMap(record);
  }

  absl::StatusOr<MapInfo> GetMap(const std::string& map_id) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord record,
                              catalogue().GetMap(map_id));
    return DescribeMap(record);
  }

  absl::StatusOr<Page<MapInfo>> ListMaps(const PageRequest& page) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, PageSize(page));
    MAPSIEVE_ASSIGN_OR_RETURN(std::vector<storage::MapRecord> records,
                              catalogue().ListMaps(page.page_token, size + 1));
    Page<MapInfo> result;
    result.next_page_token =
        CutPage(records, size, [](const auto& r) { return r.spec.id; });
    for (const storage::MapRecord& record : records) {
      absl::StatusOr<MapInfo> info = DescribeMap(record);
      // Deleted meanwhile.
      if (absl::IsNotFound(info.status())) continue;
      MAPSIEVE_RETURN_IF_ERROR(info.status());
      result.items.push_back(*std::move(info));
    }
    return result;
  }

  absl::Status DeleteMap(const std::string& map_id, bool force) override {
    MutexLock lock(admin_mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              catalogue().GetMap(map_id));
    if (!force) MAPSIEVE_RETURN_IF_ERROR(CheckIdle(map));
    jobs_->CancelAndForget(map.uid);
    MAPSIEVE_RETURN_IF_ERROR(catalogue().DeleteMap(map_id));
    watchers_.Notify(map.uid);
    garbage_->Request();
    return absl::OkStatus();
  }

  absl::StatusOr<MapStats> GetMapStats(const std::string& map_id) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto snapshot,
                              store_->OpenSnapshot(map_id));
    const storage::RevisionRecord& newest = snapshot->revision();
    const storage::RevisionTotals& totals = newest.totals;
    const core::Lattice lattice(snapshot->map().spec.step_nm);
    MapStats stats = {.revision = newest.number,
                      .processed_revision = newest.processed_revision,
                      .raw_point_count = totals.raw_point_count,
                      .oldest_revision = snapshot->map().oldest_revision,
                      .stored_bytes = totals.stored_bytes,
                      .tile_count = totals.tile_count,
                      .stale_tile_count = totals.stale_tile_count,
                      .attributes = newest.spec.attributes};
    MAPSIEVE_ASSIGN_OR_RETURN(
        stats.reclaimable_bytes,
        catalogue().MeasureReclaimable(snapshot->map().uid));
    if (totals.raw_point_count > 0) {
      const core::LatticePoint& max = totals.bounds.max;
      stats.bounds =
          Bounds{lattice.Position(totals.bounds.min),
                 lattice.Position({max.x - 1, max.y - 1, max.z - 1})};
    }
    if (newest.processed_revision == 0) return stats;
    MAPSIEVE_ASSIGN_OR_RETURN(
        const storage::RevisionRecord processed,
        catalogue().GetRevision(snapshot->map().uid,
                                newest.processed_revision));
    if (!processed.spec.product.has_value()) return stats;
    const storage::ProductSummary& product = *processed.spec.product;
    stats.label_counts = product.kept_counts;
    for (const int64_t count : stats.label_counts) stats.point_count += count;
    stats.outlier_count =
        processed.totals.product_point_count - stats.point_count;
    MAPSIEVE_ASSIGN_OR_RETURN(const ProcessReport report,
                              ParseProcessReport(processed.spec.description));
    stats.level_counts = report.level_counts;
    MAPSIEVE_ASSIGN_OR_RETURN(stats.options, ParseSpdfOptions(product.options));
    return stats;
  }

  absl::StatusOr<Page<RevisionInfo>> ListRevisions(
      const std::string& map_id, const PageRequest& page) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, PageSize(page));
    int64_t before = 0;
    const std::string& token = page.page_token;
    const auto [end, error] =
        std::from_chars(token.data(), token.data() + token.size(), before);
    if (!token.empty() && (error != std::errc() || before < 1 ||
                           end != token.data() + token.size())) {
      return absl::InvalidArgumentError(
          absl::StrCat("page_token ", storage::Quoted(token),
                       " is none of a list of revisions"));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              catalogue().GetMap(map_id));
    MAPSIEVE_ASSIGN_OR_RETURN(
        std::vector<storage::RevisionRecord> records,
        catalogue().ListRevisions(map.uid, before, size + 1));
    Page<RevisionInfo> result;
    result.next_page_token = CutPage(
        records, size, [](const auto& r) { return std::to_string(r.number); });
    for (const storage::RevisionRecord& record : records) {
      MAPSIEVE_ASSIGN_OR_RETURN(RevisionInfo info,
                                DescribeRevision(catalogue(), map.uid, record));
      result.items.push_back(std::move(info));
    }
    return result;
  }

  absl::StatusOr<std::unique_ptr<RevisionCursor>> WatchRevisions(
      const std::string& map_id, int64_t from_revision,
      std::function<void()> wake) override {
    return engine::WatchRevisions(catalogue(), watchers_, map_id, from_revision,
                                  std::move(wake));
  }

  absl::StatusOr<RevisionComparison> CompareRevisions(
      const std::string& map_id, int64_t base, int64_t target,
      const PageRequest& page) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, PageSize(page));
    return engine::CompareRevisions(*store_, map_id, base, target, size,
                                    page.page_token);
  }

  // Edits.

  absl::StatusOr<Operation> DeleteRegion(const std::string& map_id,
                                         const RegionShape& region) override {
    MutexLock lock(admin_mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              catalogue().GetMap(map_id));
    MAPSIEVE_RETURN_IF_ERROR(CheckRegion(region, map));
    return jobs_->Start(map_id,
                        {.verb = OperationVerb::kDeleteRegion,
                         .map_uid = map.uid,
                         .region = region,
                         .edit_uid = NewRandomId(),
                         .base_revision = map.newest_revision},
                        /*is_unique=*/false);
  }

  absl::StatusOr<RevisionInfo> RollBack(const std::string& map_id,
                                        int64_t revision) override {
    MutexLock lock(admin_mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              catalogue().GetMap(map_id));
    if (jobs_->IsBusy(map.uid)) {
      return absl::AbortedError(
          absl::StrCat("map ", map_id,
                       " has an operation that is not done; wait for it or "
                       "cancel it"));
    }
    MAPSIEVE_RETURN_IF_ERROR(CheckSpace());
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::RevisionRecord record,
                              catalogue().RollBack(map.uid, revision));
    AfterCommit(map.uid);
    return DescribeRevision(catalogue(), map.uid, record);
  }

  // Uploads.

  absl::StatusOr<UploadInfo> CreateUpload(const std::string& map_id,
                                          const UploadSpec& spec) override {
    MAPSIEVE_RETURN_IF_ERROR(CheckUploadSpec(spec));
    MAPSIEVE_RETURN_IF_ERROR(CheckSpace());
    MutexLock lock(admin_mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              catalogue().GetMap(map_id));
    MAPSIEVE_ASSIGN_OR_RETURN(
        storage::UploadRecord record,
        catalogue().CreateUpload(map.uid,
                                 {.id = spec.upload_id,
                                  .expected_bytes = spec.expected_bytes,
                                  .content_hash = spec.content_hash}));
    if (record.report.empty() &&
        record.state == storage::UploadState::kActive) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          record,
          catalogue().SetUploadState(
              record.uid, record.state, record.state,
              FormatUploadNotes({.source = spec.source,
                                 .report = {.refused = spec.refused}})));
    }
    return ToInfo(record);
  }

  absl::StatusOr<UploadInfo> GetUpload(const std::string& map_id,
                                       const std::string& upload_id) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::UploadRecord record,
                              FindUpload(map_id, upload_id));
    return ToInfo(record);
  }

  absl::StatusOr<Page<UploadInfo>> ListUploads(
      const std::string& map_id, const PageRequest& page) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, PageSize(page));
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              catalogue().GetMap(map_id));
    MAPSIEVE_ASSIGN_OR_RETURN(
        std::vector<storage::UploadRecord> records,
        catalogue().ListUploads(map.uid, page.page_token, size + 1));
    Page<UploadInfo> result;
    result.next_page_token =
        CutPage(records, size, [](const auto& r) { return r.spec.id; });
    for (const storage::UploadRecord& record : records) {
      MAPSIEVE_ASSIGN_OR_RETURN(UploadInfo info, ToInfo(record));
      result.items.push_back(std::move(info));
    }
    return result;
  }

  absl::Status DeleteUpload(const std::string& map_id,
                            const std::string& upload_id) override {
    MutexLock lock(admin_mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::UploadRecord record,
                              FindUpload(map_id, upload_id));
    if (const auto operation = jobs_->FindFinalize(record.uid);
        operation.has_value() && !operation->done()) {
      return absl::FailedPreconditionError(absl::StrCat(
          "upload ", upload_id, " is being finalized by operation ",
          operation->operation_id, "; cancel that first"));
    }
    MAPSIEVE_RETURN_IF_ERROR(catalogue().DeleteUpload(record.uid));
    // What stays behind is collected as garbage.
    store_->uploads().Remove(record.uid).IgnoreError();
    return absl::OkStatus();
  }

  absl::StatusOr<std::unique_ptr<UploadWriter>> OpenUploadWriter(
      const std::string& map_id, const std::string& upload_id) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::UploadRecord record,
                              FindUpload(map_id, upload_id));
    MAPSIEVE_ASSIGN_OR_RETURN(auto writer,
                              store_->uploads().OpenWriter(record.uid));
    return std::make_unique<StoredUploadWriter>(std::move(writer));
  }

  absl::StatusOr<Operation> FinalizeUpload(
      const std::string& map_id, const std::string& upload_id,
      const std::optional<RegionShape>& region) override {
    MutexLock lock(admin_mutex_);
    if (region.has_value()) {
      MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                                catalogue().GetMap(map_id));
      MAPSIEVE_RETURN_IF_ERROR(CheckRegion(*region, map));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::UploadRecord upload,
                              FindUpload(map_id, upload_id));
    const auto earlier = jobs_->FindFinalize(upload.uid);
    const bool is_over = upload.state == storage::UploadState::kFinalized ||
                         upload.state == storage::UploadState::kFailed;
    if (earlier.has_value() && (!earlier->done() || is_over)) return *earlier;
    const JobSpec spec = {.verb = OperationVerb::kFinalizeUpload,
                          .map_uid = upload.map_uid,
                          .upload_id = upload_id,
                          .upload_uid = upload.uid,
                          .region = region};
    if (upload.state == storage::UploadState::kFinalized) {
      MAPSIEVE_ASSIGN_OR_RETURN(const UploadNotes notes, NotesOf(upload));
      return jobs_->RecordSuccess(map_id, spec, notes.report);
    }
    MAPSIEVE_RETURN_IF_ERROR(CheckComplete(upload));
    return jobs_->Start(map_id, spec, /*is_unique=*/false);
  }

  // The filter.

  absl::StatusOr<Operation> ProcessMap(
      const std::string& map_id,
      const std::optional<core::SpdfOptions>& options) override {
    MutexLock lock(admin_mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const auto snapshot,
                              store_->OpenSnapshot(map_id));
    const storage::MapRecord& map = snapshot->map();
    JobSpec spec = {.verb = OperationVerb::kProcessMap, .map_uid = map.uid};
    if (options.has_value()) {
      spec.options = *options;
    } else if (!map.process_options.empty()) {
      MAPSIEVE_ASSIGN_OR_RETURN(spec.options,
                                ParseSpdfOptions(map.process_options));
    }
    MAPSIEVE_RETURN_IF_ERROR(
        spec.options.Validate(core::Lattice(map.spec.step_nm)));
    if (snapshot->revision().totals.raw_point_count == 0 &&
        snapshot->revision().processed_revision == 0) {
      return absl::FailedPreconditionError(absl::StrCat(
          "map ", map_id, " has no points; upload some and finalize them"));
    }
    return jobs_->Start(map_id, spec, /*is_unique=*/true);
  }

  // Operations.

  absl::StatusOr<Operation> GetOperation(
      const std::string& operation_id) override {
    return jobs_->Get(operation_id);
  }

  absl::StatusOr<Page<Operation>> ListOperations(
      const std::string& map_id, const PageRequest& page) override {
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, PageSize(page));
    if (!map_id.empty()) {
      MAPSIEVE_RETURN_IF_ERROR(storage::CheckMapId(map_id));
    }
    Page<Operation> result;
    MAPSIEVE_ASSIGN_OR_RETURN(result.items,
                              jobs_->List(map_id, page.page_token, size + 1));
    result.next_page_token = CutPage(
        result.items, size, [](const auto& o) { return o.operation_id; });
    return result;
  }

  absl::Status CancelOperation(const std::string& operation_id) override {
    return jobs_->Cancel(operation_id);
  }

  absl::StatusOr<Operation> WaitOperation(const std::string& operation_id,
                                          absl::Duration timeout) override {
    return jobs_->Wait(operation_id, timeout);
  }

  absl::StatusOr<int64_t> WatchOperation(
      const std::string& operation_id,
      std::function<void()> callback) override {
    return jobs_->Watch(operation_id, std::move(callback));
  }

  void StopWatching(int64_t watch) override { jobs_->StopWatching(watch); }

  // Queries.

  absl::StatusOr<std::unique_ptr<QueryCursor>> Query(
      const QuerySpec& spec, std::stop_token stop) override {
    return OpenQuery(*store_, query_memory_, spec, std::move(stop));
  }

  absl::StatusOr<std::unique_ptr<SyncCursor>> Sync(
      const SyncSpec& spec, std::stop_token stop) override {
    return OpenSync(*store_, query_memory_, spec, std::move(stop));
  }

  // Verification.

  absl::StatusOr<std::unique_ptr<VerifyCursor>> Verify(
      const VerifySpec& spec, std::stop_token stop) override {
    return OpenVerification(*store_, query_memory_, spec, std::move(stop));
  }

  absl::StatusOr<Operation> RepairMap(const std::string& map_id) override {
    MutexLock lock(admin_mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              catalogue().GetMap(map_id));
    return jobs_->Start(map_id,
                        {.verb = OperationVerb::kRepairMap, .map_uid = map.uid},
                        /*is_unique=*/true);
  }

 private:
  storage::Catalogue& catalogue() { return store_->catalogue(); }

  absl::StatusOr<MapInfo> DescribeMap(const storage::MapRecord& record) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const storage::RevisionRecord revision,
        catalogue().GetRevision(record.uid, record.newest_revision));
    return MapInfo{.map_id = record.spec.id,
                   .uid = record.uid,
                   .display_name = record.spec.display_name,
                   .step_nm = record.spec.step_nm,
                   .tile_level = record.spec.tile_level,
                   .crs_wkt = record.spec.crs_wkt,
                   .frame_id = record.spec.frame_id,
                   .revision = record.newest_revision,
                   .processed_revision = revision.processed_revision,
                   .create_time = record.create_time,
                   .update_time = record.update_time};
  }

  /// Whether nothing is lost by deleting the map but the map.
  absl::Status CheckIdle(const storage::MapRecord& map) {
    if (jobs_->IsBusy(map.uid)) {
      return absl::FailedPreconditionError(
          absl::StrCat("map ", map.spec.id,
                       " has an operation that is not done; wait for it, or "
                       "force the deletion"));
    }
    std::string after;
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          const std::vector<storage::UploadRecord> page,
          catalogue().ListUploads(map.uid, after, kMaxPageSize));
      if (page.empty()) return absl::OkStatus();
      for (const storage::UploadRecord& upload : page) {
        if (upload.state == storage::UploadState::kActive ||
            upload.state == storage::UploadState::kFinalizing) {
          return absl::FailedPreconditionError(absl::StrCat(
              "map ", map.spec.id, " has the unfinished upload ",
              upload.spec.id, "; finish or delete it, or force the deletion"));
        }
      }
      after = page.back().spec.id;
    }
  }

  static absl::Status CheckRegion(const RegionShape& region,
                                  const storage::MapRecord& map) {
    return Region::OfEdit(region, core::Lattice(map.spec.step_nm)).status();
  }

  absl::StatusOr<storage::UploadRecord> FindUpload(
      const std::string& map_id, const std::string& upload_id) {
    MAPSIEVE_RETURN_IF_ERROR(storage::CheckResourceId(upload_id));
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              catalogue().GetMap(map_id));
    return catalogue().GetUpload(map.uid, upload_id);
  }

  static absl::Status CheckComplete(const storage::UploadRecord& upload) {
    if (upload.state == storage::UploadState::kFailed) {
      return absl::FailedPreconditionError(
          absl::StrCat("upload ", upload.spec.id,
                       " failed before; delete it and upload again"));
    }
    const int64_t expected = upload.spec.expected_bytes.value_or(0);
    if (upload.committed_bytes != expected) {
      return absl::FailedPreconditionError(absl::StrCat(
          "upload ", upload.spec.id, " has ", upload.committed_bytes, " of ",
          expected, " bytes; send the rest"));
    }
    return absl::OkStatus();
  }

  /// What runs put aside that nobody will go on with.
  absl::Status RemoveStaleRuns() {
    std::set<std::string> going_on;
    int64_t after = 0;
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          const std::vector<storage::OperationRecord> page,
          catalogue().ListOperations("", /*unfinished_only=*/true, after,
                                     kMaxPageSize));
      if (page.empty()) break;
      for (const storage::OperationRecord& record : page) {
        const auto spec = ParseJobSpec(record.request);
        if (spec.ok() && spec->verb == OperationVerb::kProcessMap) {
          going_on.insert(spec->map_uid);
        }
      }
      after = page.back().number;
    }
    return store_->RemoveRunScratchesExcept(going_on);
  }

  absl::StatusOr<JobResult> RunJob(const std::string& map_id,
                                   const JobSpec& spec,
                                   const ExecutionContext& context) {
    absl::StatusOr<JobResult> result = RunVerb(map_id, spec, context);
    // A run that a shutdown stops goes on at the next start.
    if (spec.verb == OperationVerb::kProcessMap &&
        !(is_shut_down_ && absl::IsCancelled(result.status()))) {
      store_->RemoveRunScratch(spec.map_uid).IgnoreError();
    }
    // Chunks that no commit refers to.
    if (!result.ok()) garbage_->Request();
    AfterCommit(spec.map_uid);
    return result;
  }

  void AfterCommit(const std::string& map_uid) {
    watchers_.Notify(map_uid);
    if (store_->options().kept_revision_count > 0) garbage_->RequestExpiry();
  }

  absl::StatusOr<JobResult> RunVerb(const std::string& map_id,
                                    const JobSpec& spec,
                                    ExecutionContext context) {
    const bool filters = spec.verb == OperationVerb::kProcessMap ||
                         spec.verb == OperationVerb::kRepairMap;
    context.executor = filters ? filter_workers_.get() : io_workers_.get();
    switch (spec.verb) {
      case OperationVerb::kFinalizeUpload:
        return ResultOf(AddUpload(*store_, map_id, spec.upload_uid, spec.region,
                                  ingest_limits_, context));
      case OperationVerb::kProcessMap:
        return ResultOf(ProcessStoredMap(*store_, map_id, spec.map_uid,
                                         spec.options, process_limits_,
                                         *io_workers_, context));
      case OperationVerb::kDeleteRegion:
        return ResultOf(
            DeleteStoredRegion(*store_, map_id, spec, ingest_limits_, context));
      case OperationVerb::kRepairMap:
        return ResultOf(RepairStoredMap(*store_, map_id, spec.map_uid,
                                        process_limits_, *io_workers_,
                                        context));
    }
    return absl::InternalError("an operation of no verb");
  }

  template <typename Report>
  static absl::StatusOr<JobResult> ResultOf(
      const absl::StatusOr<Report>& report) {
    MAPSIEVE_RETURN_IF_ERROR(report.status());
    return JobResult(*report);
  }

  const ProcessLimits process_limits_;
  const IngestLimits ingest_limits_;
  MemoryPool query_memory_;
  const std::unique_ptr<Executor> filter_workers_;
  const std::unique_ptr<Executor> io_workers_;
  std::unique_ptr<storage::Store> store_;
  RevisionWatchers watchers_;
  std::unique_ptr<GarbageCollector> garbage_;
  std::unique_ptr<JobManager> jobs_;
  std::atomic<bool> is_shut_down_ = false;
  // What is checked when something is begun stays true until it has begun: no
  // map is deleted below a new upload or operation.
  Mutex admin_mutex_;
};

}  // namespace

absl::Status EngineOptions::Validate() const {
  if (data_dir.empty()) {
    return absl::InvalidArgumentError("data_dir is empty; name a directory");
  }
  if (memory_bytes < kMinMemoryBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("memory_bytes is ", memory_bytes, "; it must be at least ",
                     kMinMemoryBytes));
  }
  if (worker_count < 1 || worker_count > kMaxWorkers) {
    return absl::InvalidArgumentError(absl::StrCat(
        "worker_count is ", worker_count, "; it must be 1 to ", kMaxWorkers));
  }
  if (kept_revision_count < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("kept_revision_count is ", kept_revision_count,
                     "; it must be 0 (all) or above"));
  }
  MAPSIEVE_RETURN_IF_ERROR(
      CheckAtLeastOne("max_queued_operations", max_queued_operations));
  return CheckAtLeastOne("max_finished_operations", max_finished_operations);
}

absl::StatusOr<std::unique_ptr<Engine>> Engine::Open(
    const EngineOptions& options) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  auto engine = std::make_unique<LocalEngine>(options);
  MAPSIEVE_RETURN_IF_ERROR(engine->Start(options));
  return engine;
}

}  // namespace mapsieve::engine
