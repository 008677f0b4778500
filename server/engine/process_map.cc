#include "server/engine/process_map.h"

#include <algorithm>
#include <functional>
#include <memory>
#include <numeric>
#include <optional>
#include <span>
#include <unordered_set>
#include <utility>
#include <vector>

#include "core/base/status.h"
#include "core/spdf/levels.h"
#include "core/spdf/tile_filter.h"
#include "core/spdf/tile_update.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/chunk_walk.h"
#include "server/engine/map_changes.h"
#include "server/engine/opaque_records.h"
#include "server/engine/product_chunk.h"
#include "server/engine/product_levels.h"
#include "server/engine/run_checkpoint.h"
#include "server/engine/stored_tiles.h"

namespace mapsieve::engine {
namespace {

/// Measured: the filter's memory for a point of a unit with its halo.
constexpr int64_t kFilterBytesPerPoint = 150;
/// Of a tile that is a unit of its own, which may take somewhat more than its
/// part.
constexpr int64_t kTileBytesPerPoint = 90;

using storage::ChunkKind;
using storage::ChunkRef;
using storage::ReadSnapshot;

/// Sums over a whole product.
struct ProductTotals {
  int64_t distinct_point_count = 0;
  /// Outliers included.
  int64_t survivor_count = 0;
  int round_count = 0;
  core::MaxConfidence max_confidence{};
};

/// The previous product, if what changed since can be filtered by itself.
struct Previous {
  std::shared_ptr<const ReadSnapshot> snapshot;
  ProcessReport report;
  /// Tiles that hold something else now.
  std::vector<core::CellKey> changed_tiles;
};

/// Calls use(chunk) for all chunks of a kind.
absl::Status ForEachChunk(
    const ReadSnapshot& snapshot, ChunkKind kind,
    const std::function<absl::Status(const ChunkRef&)>& use) {
  const std::optional<Region> everywhere;
  ChunkWalk walk(snapshot, kind, everywhere);
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<ChunkRef> chunk, walk.Next());
    if (!chunk.has_value()) return absl::OkStatus();
    MAPSIEVE_RETURN_IF_ERROR(use(*chunk));
  }
}

/// The larger one of each label.
core::MaxConfidence Larger(core::MaxConfidence a,
                           const core::MaxConfidence& b) {
  for (size_t l = 0; l < core::kLabelCount; ++l) a[l] = std::max(a[l], b[l]);
  return a;
}

/// Of the points of a product chunk.
absl::StatusOr<core::MaxConfidence> MaxConfidenceOf(
    const ReadSnapshot& snapshot, const ChunkRef& chunk) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const core::ColumnSet columns,
      ReadColumns(snapshot, chunk,
                  {std::string(kLabelColumn), std::string(kConfidenceColumn)}));
  MAPSIEVE_ASSIGN_OR_RETURN(const LabelColumnView labels,
                            LabelColumnView::Of(columns));
  core::MaxConfidence largest{};
  for (size_t i = 0; i < labels.size(); ++i) {
    uint16_t& of_label = largest[static_cast<size_t>(labels.label(i))];
    of_label = std::max(of_label, labels.confidence(i));
  }
  return largest;
}

/// Tells the progress of the filter and of the levels of detail after it as
/// that of one piece of work, in visits of tiles: the levels take about a
/// quarter of the filter's time.
class RunProgress {
 public:
  explicit RunProgress(ProgressSink* sink)
      : filter_(*this, &RunProgress::ReportFilter),
        levels_(*this, &RunProgress::ReportLevels),
        sink_(sink) {}

  ProgressSink* filter() { return &filter_; }
  ProgressSink* levels() { return &levels_; }

 private:
  class Part final : public ProgressSink {
   public:
    using Method = void (RunProgress::*)(int64_t done, int64_t total);
    Part(RunProgress& whole, Method report) : whole_(whole), report_(report) {}
    void Report(int64_t done, int64_t total) override {
      (whole_.*report_)(done, total);
    }

   private:
    RunProgress& whole_;
    const Method report_;
  };

  void ReportFilter(int64_t done, int64_t total) {
    filter_total_ = total;
    Send(done);
  }
  void ReportLevels(int64_t done, int64_t total) {
    Send(filter_total_ + LevelsTotal() * done / total);
  }
  int64_t LevelsTotal() const { return filter_total_ / 4; }
  void Send(int64_t done) const {
    if (sink_ != nullptr) sink_->Report(done, filter_total_ + LevelsTotal());
  }

  Part filter_;
  Part levels_;
  ProgressSink* const sink_;
  int64_t filter_total_ = 0;
};

/// One run of the filter over a stored revision.
class MapRun {
 public:
  MapRun(storage::Store& store, const ReadSnapshot& snapshot,
         const core::SpdfOptions& options, const ProcessLimits& limits,
         Executor& io, const ExecutionContext& context)
      : store_(store),
        snapshot_(snapshot),
        options_(options),
        limits_(limits),
        io_(io),
        progress_(context.progress),
        context_{.executor = context.executor,
                 .stop = context.stop,
                 .progress = progress_.filter()},
        lattice_(snapshot.map().spec.step_nm),
        tiling_{.max_unit_points = limits.unit_points} {}

  /// The revision's product was made with these options and has a history, and
  /// less than half of the map changed since.
  absl::StatusOr<std::optional<Previous>> FindPrevious() {
    const storage::RevisionRecord& base = snapshot_.revision();
    if (base.processed_revision == 0 ||
        snapshot_.map().process_options != FormatSpdfOptions(options_)) {
      return std::nullopt;
    }
    Previous previous;
    MAPSIEVE_ASSIGN_OR_RETURN(previous.snapshot, store_.OpenProduct(snapshot_));
    const storage::RevisionRecord& then = previous.snapshot->revision();
    MAPSIEVE_ASSIGN_OR_RETURN(previous.report,
                              ParseProcessReport(then.spec.description));
    int64_t remembered = 0;
    MAPSIEVE_RETURN_IF_ERROR(ForEachChunk(
        *previous.snapshot, ChunkKind::kHistory, [&](const ChunkRef& chunk) {
          remembered += chunk.point_count;
          return absl::OkStatus();
        }));
    if (remembered != then.spec.product->distinct_point_count) {
      return std::nullopt;
    }
    MAPSIEVE_ASSIGN_OR_RETURN(
        previous.changed_tiles,
        FindChangedTiles(store_.catalogue(), *previous.snapshot, snapshot_));
    if (2 * static_cast<int64_t>(previous.changed_tiles.size()) >
        then.totals.tile_count) {
      return std::nullopt;
    }
    return previous;
  }

  /// Filters all tiles.
  absl::StatusOr<ProcessReport> FilterAll() {
    MAPSIEVE_ASSIGN_OR_RETURN(
        checkpoint_, RunCheckpoint::Open(
                         store_.OpenRunScratch(snapshot_.map().uid), RunKey()));
    MAPSIEVE_RETURN_IF_ERROR(OpenTiles(nullptr, nullptr));
    MAPSIEVE_ASSIGN_OR_RETURN(
        const core::SpdfSummary summary,
        core::FilterTiles(*tiles_, lattice_, options_, tiling_, context_));
    MAPSIEVE_RETURN_IF_ERROR(tiles_->Flush());
    const ProductTotals totals = {.distinct_point_count = summary.point_count,
                                  .survivor_count = summary.survivor_count,
                                  .round_count = summary.round_count,
                                  .max_confidence = summary.max_confidence};
    return Commit(totals, {.removes_product = true}, nullptr);
  }

  /// Filters what has changed.
  absl::StatusOr<ProcessReport> Update(const Previous& previous) {
    // The other half of the memory is for the new tiles.
    tiling_.max_unit_points = std::max(limits_.unit_points / 2, int64_t{1});
    MAPSIEVE_RETURN_IF_ERROR(OpenTiles(&previous, nullptr));
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<core::TileChange> changes,
        tiles_->CompareTiles(previous.changed_tiles, context_));
    MAPSIEVE_ASSIGN_OR_RETURN(
        const core::UpdateSummary update,
        core::UpdateTiles(*tiles_, *tiles_, changes, lattice_, options_,
                          tiling_, context_));
    MAPSIEVE_RETURN_IF_ERROR(tiles_->Flush());
    std::unordered_set<core::CellKey, core::CellKeyHash> replaced =
        tiles_->emitted();
    replaced.insert(previous.changed_tiles.begin(),
                    previous.changed_tiles.end());

    const storage::ProductSummary& before =
        *previous.snapshot->revision().spec.product;
    ProductTotals totals = {
        .distinct_point_count =
            before.distinct_point_count + update.emitted.point_count,
        .survivor_count =
            previous.snapshot->revision().totals.product_point_count +
            update.emitted.survivor_count,
        .round_count =
            std::max(previous.report.round_count, update.emitted.round_count)};
    storage::RevisionChange change;
    std::vector<ChunkRef> gone;
    std::vector<ChunkRef> kept;
    MAPSIEVE_RETURN_IF_ERROR(ForEachChunk(
        snapshot_, ChunkKind::kHistory, [&](const ChunkRef& chunk) {
          if (replaced.contains(chunk.tile)) {
            change.removed.push_back(chunk.number);
            totals.distinct_point_count -= chunk.point_count;
          }
          return absl::OkStatus();
        }));
    MAPSIEVE_RETURN_IF_ERROR(ForEachChunk(
        snapshot_, ChunkKind::kProduct, [&](const ChunkRef& chunk) {
          const bool is_kept = !replaced.contains(chunk.tile);
          levels_->AddPrevious(chunk, is_kept);
          (is_kept ? kept : gone).push_back(chunk);
          if (is_kept) return absl::OkStatus();
          change.removed.push_back(chunk.number);
          totals.survivor_count -= chunk.point_count;
          return absl::OkStatus();
        }));
    MAPSIEVE_ASSIGN_OR_RETURN(
        totals.max_confidence,
        UpdateMaxConfidences(before.max_confidence,
                             update.emitted.max_confidence, gone, kept));
    return Commit(totals, std::move(change), &previous);
  }

  /// Filters all tiles and gives them to `repair`.
  absl::Status Repair(const ChunkRepair& repair) {
    MAPSIEVE_RETURN_IF_ERROR(OpenTiles(nullptr, &repair));
    MAPSIEVE_RETURN_IF_ERROR(
        core::FilterTiles(*tiles_, lattice_, options_, tiling_, context_)
            .status());
    MAPSIEVE_RETURN_IF_ERROR(tiles_->Flush());
    return WriteLevels(nullptr);
  }

 private:
  absl::Status OpenTiles(const Previous* previous, const ChunkRepair* repair) {
    MAPSIEVE_ASSIGN_OR_RETURN(scratch_, store_.NewScratch());
    levels_ = std::make_unique<ProductLevels>(
        store_, snapshot_, *scratch_,
        ProductLevels::Options{
            .max_pending_bytes = limits_.pending_bytes,
            .max_chunk_bytes = limits_.chunk_bytes,
            .io = &io_,
            .scratch_compression = previous == nullptr
                                       ? core::Compression::kLz4
                                       : core::Compression::kNone,
            .stop = context_.stop,
            .repair = repair});
    MAPSIEVE_ASSIGN_OR_RETURN(
        tiles_, StoredTiles::Open(
                    store_, snapshot_,
                    previous == nullptr ? nullptr : previous->snapshot.get(),
                    *scratch_, *levels_,
                    {.max_pending_bytes = limits_.pending_bytes,
                     .io = &io_,
                     .stop = context_.stop,
                     .checkpoint = checkpoint_.get(),
                     .repair = repair}));
    levels_->KeepInMemory(previous == nullptr ? limits_.pending_bytes
                                              : UpdateBytes());
    return CheckTiles();
  }

  /// ProcessLimits::update_bytes, less what a tile that is larger than a unit
  /// takes beyond that.
  int64_t UpdateBytes() const {
    int64_t largest = tiling_.max_unit_points;
    for (const core::TileInfo& tile : tiles_->Tiles()) {
      largest = std::max(largest, tile.point_count);
    }
    return limits_.update_bytes -
           (largest - tiling_.max_unit_points) * kFilterBytesPerPoint;
  }

  /// Runs of one key make the same visits.
  std::string RunKey() const {
    return absl::StrCat("1 revision ", snapshot_.revision().number, " units ",
                        tiling_.max_unit_points, " ",
                        FormatSpdfOptions(options_));
  }

  absl::Status CheckTiles() const {
    for (const core::TileInfo& tile : tiles_->Tiles()) {
      if (tile.point_count <= limits_.tile_points) continue;
      return absl::ResourceExhaustedError(absl::StrCat(
          "tile ", tile.key.ToString(), " holds ", tile.point_count,
          " points, more than the ", limits_.tile_points,
          " that the server's memory can filter at once; give it at least ",
          (tile.point_count + limits_.tile_points - 1) / limits_.tile_points,
          " times the --memory, or make the map with smaller tiles"));
    }
    return absl::OkStatus();
  }

  /// Of the points of product chunks.
  absl::StatusOr<core::MaxConfidence> MaxConfidenceOfAll(
      std::span<const ChunkRef> chunks) const {
    std::vector<core::MaxConfidence> of_chunk(chunks.size());
    MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
        io_, static_cast<int64_t>(chunks.size()),
        [&](int64_t n) -> absl::Status {
          MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
          const auto i = static_cast<size_t>(n);
          MAPSIEVE_ASSIGN_OR_RETURN(of_chunk[i],
                                    MaxConfidenceOf(snapshot_, chunks[i]));
          return absl::OkStatus();
        }));
    return std::accumulate(of_chunk.begin(), of_chunk.end(),
                           core::MaxConfidence{}, Larger);
  }

  /// The largest confidences after those of `before` and `added`, without the
  /// chunks that are `gone`: what the `kept` ones hold is read only where a
  /// label may have lost its largest.
  absl::StatusOr<core::MaxConfidence> UpdateMaxConfidences(
      const core::MaxConfidence& before, const core::MaxConfidence& added,
      std::span<const ChunkRef> gone, std::span<const ChunkRef> kept) const {
    const core::MaxConfidence largest = Larger(before, added);
    if (largest == added) return largest;
    MAPSIEVE_ASSIGN_OR_RETURN(const core::MaxConfidence max_gone,
                              MaxConfidenceOfAll(gone));
    bool is_lost = false;
    for (size_t l = 0; l < core::kLabelCount; ++l) {
      is_lost |= max_gone[l] == before[l] && added[l] < before[l];
    }
    if (!is_lost) return largest;
    MAPSIEVE_ASSIGN_OR_RETURN(const core::MaxConfidence max_kept,
                              MaxConfidenceOfAll(kept));
    return Larger(max_kept, added);
  }

  /// `previous`: null for none.
  absl::Status WriteLevels(const Previous* previous) {
    MAPSIEVE_RETURN_IF_ERROR(core::ComputeDepths(
        *levels_, previous == nullptr ? nullptr : levels_.get(), lattice_,
        options_, tiling_,
        {.executor = context_.executor,
         .stop = context_.stop,
         .progress = progress_.levels()}));
    return levels_->Finish();
  }

  /// `previous`: null for none.
  absl::StatusOr<ProcessReport> Commit(const ProductTotals& totals,
                                       storage::RevisionChange change,
                                       const Previous* previous) {
    std::optional<LevelCounts> counts_before;
    if (previous != nullptr &&
        totals.max_confidence ==
            previous->snapshot->revision().spec.product->max_confidence) {
      counts_before = previous->report.level_counts;
    }
    levels_->StartCounts(
        core::OutlierTest(totals.max_confidence, options_.outlier_share),
        counts_before);
    MAPSIEVE_RETURN_IF_ERROR(WriteLevels(previous));
    MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
    const storage::RevisionRecord& base = snapshot_.revision();
    const core::LabelCounts& kept = levels_->level_counts().front();
    ProcessReport report = {
        .revision = base.number + 1,
        .distinct_point_count = totals.distinct_point_count,
        .label_counts = kept,
        .level_counts = levels_->level_counts(),
        .round_count = totals.round_count,
        .updated_tile_count = static_cast<int64_t>(tiles_->emitted().size())};
    report.point_count = std::accumulate(kept.begin(), kept.end(), int64_t{0});
    report.outlier_count = totals.survivor_count - report.point_count;
    change.spec = {.kind = storage::RevisionKind::kProcess,
                   .description = FormatProcessReport(report),
                   .attributes = base.spec.attributes,
                   .product = storage::ProductSummary{
                       .options = FormatSpdfOptions(options_),
                       .distinct_point_count = totals.distinct_point_count,
                       .kept_counts = kept,
                       .max_confidence = totals.max_confidence}};
    change.added = levels_->chunks();
    change.added.insert(change.added.end(), tiles_->chunks().begin(),
                        tiles_->chunks().end());
    change.removed.insert(change.removed.end(), levels_->replaced().begin(),
                          levels_->replaced().end());
    MAPSIEVE_RETURN_IF_ERROR(
        store_.CommitRevision(snapshot_.map().uid, base.number, change)
            .status());
    return report;
  }

  storage::Store& store_;
  const ReadSnapshot& snapshot_;
  const core::SpdfOptions& options_;
  const ProcessLimits& limits_;
  Executor& io_;
  RunProgress progress_;
  const ExecutionContext context_;
  const core::Lattice lattice_;
  core::TilingOptions tiling_;
  std::unique_ptr<storage::Scratch> scratch_;
  std::unique_ptr<RunCheckpoint> checkpoint_;
  std::unique_ptr<ProductLevels> levels_;
  std::unique_ptr<StoredTiles> tiles_;
};

}  // namespace

ProcessLimits ProcessLimits::Of(int64_t memory_bytes) {
  return {.unit_points = memory_bytes / kFilterBytesPerPoint,
          .tile_points = memory_bytes / kTileBytesPerPoint,
          .pending_bytes = memory_bytes / 16,
          .update_bytes = memory_bytes / 2,
          .chunk_bytes = std::min(memory_bytes / 128, int64_t{16} << 20)};
}

absl::Status CheckUid(const ReadSnapshot& snapshot,
                      const std::string& map_uid) {
  if (snapshot.map().uid == map_uid) return absl::OkStatus();
  return absl::NotFoundError(absl::StrCat(
      "map ", snapshot.map().spec.id, " is another one than at the request"));
}

absl::StatusOr<ProcessReport> ProcessStoredMap(
    storage::Store& store, const std::string& map_id,
    const std::string& map_uid, const core::SpdfOptions& options,
    const ProcessLimits& limits, Executor& io,
    const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto snapshot, store.OpenSnapshot(map_id));
  const storage::MapRecord& map = snapshot->map();
  const storage::RevisionRecord& base = snapshot->revision();
  MAPSIEVE_RETURN_IF_ERROR(CheckUid(*snapshot, map_uid));
  // A map that lost all its points has an empty result.
  if (base.totals.raw_point_count == 0 && base.processed_revision == 0) {
    return absl::FailedPreconditionError(absl::StrCat(
        "map ", map_id, " has no points; upload some and finalize them"));
  }
  if (base.processed_revision != 0 && base.totals.stale_tile_count == 0 &&
      map.process_options == FormatSpdfOptions(options)) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const storage::RevisionRecord processed,
        store.catalogue().GetRevision(map_uid, base.processed_revision));
    return ParseProcessReport(processed.spec.description);
  }
  MapRun run(store, *snapshot, options, limits, io, context);
  MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<Previous> previous,
                            run.FindPrevious());
  return previous.has_value() ? run.Update(*previous) : run.FilterAll();
}

absl::Status RepairProduct(storage::Store& store, const ReadSnapshot& snapshot,
                           const ChunkRepair& repair,
                           const ProcessLimits& limits, Executor& io,
                           const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const core::SpdfOptions options,
      ParseSpdfOptions(snapshot.revision().spec.product->options));
  return MapRun(store, snapshot, options, limits, io, context).Repair(repair);
}

}  // namespace mapsieve::engine
