#include "server/engine/repair_map.h"

#include <algorithm>
#include <memory>
#include <set>
#include <utility>
#include <vector>

#include "core/base/status.h"
#include "server/engine/chunk_repair.h"
#include "server/engine/damaged_chunk.h"

namespace mapsieve::engine {
namespace {

using storage::ChunkKind;
using storage::ChunkRef;
using storage::ReadSnapshot;

constexpr int64_t kPageSize = 1000;

/// Tells a part of the work as `size` units after `begin` others.
class PartProgress final : public ProgressSink {
 public:
  PartProgress(ProgressSink* whole, int64_t begin, int64_t size)
      : whole_(whole), begin_(begin), size_(size) {}

  void Report(int64_t done, int64_t total) override {
    if (whole_ == nullptr || total == 0) return;
    whole_->Report(begin_ + size_ * done / total, begin_ + size_);
  }

 private:
  ProgressSink* const whole_;
  const int64_t begin_;
  const int64_t size_;
};

/// One repair.
class MapRepair {
 public:
  MapRepair(storage::Store& store, std::shared_ptr<const ReadSnapshot> newest,
            const ProcessLimits& limits, Executor& io,
            const ExecutionContext& context)
      : store_(store),
        newest_(std::move(newest)),
        limits_(limits),
        io_(io),
        context_(context) {}

  absl::StatusOr<RepairReport> Run() {
    MAPSIEVE_RETURN_IF_ERROR(FindDamage());
    int64_t before = 0;
    while (!damaged_.empty()) {
      MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<storage::RevisionRecord> page,
                                store_.catalogue().ListRevisions(
                                    newest_->map().uid, before, kPageSize));
      if (page.empty()) break;
      for (const storage::RevisionRecord& revision : page) {
        if (!revision.spec.product.has_value() || revision.is_expired) continue;
        MAPSIEVE_RETURN_IF_ERROR(RepairRevision(revision.number));
      }
      before = page.back().number;
    }
    if (!damaged_.empty() && report_.obstacle.empty()) {
      report_.obstacle = "no revision with its product has the chunk";
    }
    return report_;
  }

 private:
  absl::Status FindDamage() {
    MAPSIEVE_ASSIGN_OR_RETURN(chunk_count_, newest_->CountAllChunks());
    int64_t after = 0;
    int64_t done = 0;
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> page,
                                newest_->ListAllChunks(after, kPageSize));
      if (page.empty()) break;
      for (const ChunkRef& chunk : page) {
        MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
        MAPSIEVE_ASSIGN_OR_RETURN(const bool is_sound, IsSound(chunk));
        context_.ReportProgress(++done, chunk_count_);
        if (is_sound) continue;
        (chunk.kind == ChunkKind::kRaw ? raw_ : damaged_).push_back(chunk);
      }
      after = page.back().number;
    }
    report_.raw_chunk_count = static_cast<int64_t>(raw_.size());
    report_.damaged_chunk_count =
        static_cast<int64_t>(raw_.size() + damaged_.size());
    return absl::OkStatus();
  }

  absl::StatusOr<bool> IsSound(const ChunkRef& chunk) const {
    const absl::Status status = CheckChunk(*newest_, chunk);
    if (!status.ok() && !absl::IsDataLoss(status)) return status;
    return status.ok();
  }

  /// Those of `chunks` whose blobs the revision has too.
  static absl::StatusOr<std::vector<ChunkRef>> PartOf(
      const ReadSnapshot& snapshot, const std::vector<ChunkRef>& chunks) {
    std::vector<ChunkRef> part;
    for (const ChunkRef& chunk : chunks) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          const std::vector<ChunkRef> own,
          snapshot.ListTileChunks(chunk.kind, chunk.tile));
      if (std::any_of(own.begin(), own.end(), [&](const ChunkRef& other) {
            return other.blob_id == chunk.blob_id;
          })) {
        part.push_back(chunk);
      }
    }
    return part;
  }

  absl::Status RepairRevision(int64_t number) {
    const auto opened = store_.OpenSnapshot(newest_->map().spec.id, number);
    // It expired meanwhile.
    if (absl::IsOutOfRange(opened.status())) return absl::OkStatus();
    MAPSIEVE_ASSIGN_OR_RETURN(const auto snapshot, opened);
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> wanted,
                              PartOf(*snapshot, damaged_));
    if (wanted.empty()) return absl::OkStatus();
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> raw,
                              PartOf(*snapshot, raw_));
    absl::Status status = raw.empty() ? Refilter(*snapshot, wanted)
                                      : CheckChunk(*snapshot, raw.front());
    // Of what the filter needs: the points are damaged, or too many.
    const bool is_obstacle =
        absl::IsDataLoss(status) || absl::IsResourceExhausted(status);
    if (!status.ok() && !is_obstacle) return status;
    MAPSIEVE_RETURN_IF_ERROR(DropRepaired(wanted));
    if (status.ok() && IsAnyLeft(wanted)) {
      status = absl::DataLossError(
          "the filter makes other bytes of its points: the chunk was written "
          "by another version");
    }
    if (!status.ok() && report_.obstacle.empty()) {
      report_.obstacle = absl::StrCat(
          "revision ", number, " cannot be made again: ", status.message());
    }
    return absl::OkStatus();
  }

  absl::Status Refilter(const ReadSnapshot& snapshot,
                        const std::vector<ChunkRef>& wanted) {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto repair,
                              ChunkRepair::Make(store_, snapshot, wanted));
    PartProgress progress(context_.progress, ++run_count_ * chunk_count_,
                          chunk_count_);
    return RepairProduct(store_, snapshot, *repair, limits_, io_,
                         {.executor = context_.executor,
                          .stop = context_.stop,
                          .progress = &progress});
  }

  /// Forgets the chunks with one of these blobs that are sound now.
  absl::Status DropRepaired(const std::vector<ChunkRef>& wanted) {
    std::set<storage::BlobId> blobs;
    for (const ChunkRef& chunk : wanted) blobs.insert(chunk.blob_id);
    std::vector<ChunkRef> left;
    for (ChunkRef& chunk : damaged_) {
      if (blobs.contains(chunk.blob_id)) {
        MAPSIEVE_ASSIGN_OR_RETURN(const bool is_sound, IsSound(chunk));
        if (is_sound) {
          ++report_.repaired_chunk_count;
          continue;
        }
      }
      left.push_back(std::move(chunk));
    }
    damaged_ = std::move(left);
    return absl::OkStatus();
  }

  bool IsAnyLeft(const std::vector<ChunkRef>& wanted) const {
    return std::any_of(
        wanted.begin(), wanted.end(), [&](const ChunkRef& chunk) {
          return std::find(damaged_.begin(), damaged_.end(), chunk) !=
                 damaged_.end();
        });
  }

  storage::Store& store_;
  const std::shared_ptr<const ReadSnapshot> newest_;
  const ProcessLimits& limits_;
  Executor& io_;
  const ExecutionContext& context_;
  int64_t chunk_count_ = 0;
  int64_t run_count_ = 0;
  std::vector<ChunkRef> raw_;
  /// Of products and histories, and not repaired.
  std::vector<ChunkRef> damaged_;
  RepairReport report_;
};

}  // namespace

absl::StatusOr<RepairReport> RepairStoredMap(storage::Store& store,
                                             const std::string& map_id,
                                             const std::string& map_uid,
                                             const ProcessLimits& limits,
                                             Executor& io,
                                             const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(auto snapshot, store.OpenSnapshot(map_id));
  MAPSIEVE_RETURN_IF_ERROR(CheckUid(*snapshot, map_uid));
  return MapRepair(store, std::move(snapshot), limits, io, context).Run();
}

}  // namespace mapsieve::engine
