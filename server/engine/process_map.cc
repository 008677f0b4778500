#include "server/engine/process_map.h"

#include <algorithm>
#include <memory>
#include <numeric>
#include <vector>

#include "core/base/status.h"
#include "core/spdf/tile_filter.h"
#include "server/engine/chunk_writer.h"
#include "server/engine/opaque_records.h"
#include "server/engine/stored_tiles.h"

namespace mapsieve::engine {
namespace {

/// Measured: the filter's memory for a point of a unit with its halo.
constexpr int64_t kFilterBytesPerPoint = 150;

ProcessReport MakeReport(int64_t revision, const core::SpdfSummary& summary,
                         const core::LabelCounts& kept) {
  ProcessReport report = {.revision = revision,
                          .distinct_point_count = summary.point_count,
                          .label_counts = kept,
                          .round_count = summary.round_count};
  report.point_count = std::accumulate(kept.begin(), kept.end(), int64_t{0});
  report.outlier_count = summary.survivor_count - report.point_count;
  return report;
}

}  // namespace

ProcessLimits ProcessLimits::Of(int64_t memory_bytes) {
  return {.unit_points = memory_bytes / kFilterBytesPerPoint,
          .pending_bytes = memory_bytes / 16,
          .chunk_bytes = std::min(memory_bytes / 128, int64_t{16} << 20)};
}

absl::StatusOr<ProcessReport> ProcessStoredMap(
    storage::Store& store, const std::string& map_id,
    const std::string& map_uid, const core::SpdfOptions& options,
    const ProcessLimits& limits, Executor& io,
    const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto snapshot, store.OpenSnapshot(map_id));
  const storage::MapRecord& map = snapshot->map();
  const storage::RevisionRecord& base = snapshot->revision();
  if (map.uid != map_uid) {
    return absl::NotFoundError(
        absl::StrCat("map ", map_id, " is another one than at the request"));
  }
  if (base.totals.raw_point_count == 0) {
    return absl::FailedPreconditionError(absl::StrCat(
        "map ", map_id, " has no points; upload some and finalize them"));
  }
  const std::string stored_options = FormatSpdfOptions(options);
  if (base.processed_revision != 0 && base.totals.stale_tile_count == 0 &&
      map.process_options == stored_options) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const storage::RevisionRecord processed,
        store.catalogue().GetRevision(map_uid, base.processed_revision));
    return ParseProcessReport(processed.spec.description);
  }

  const core::Lattice lattice(map.spec.step_nm);
  MAPSIEVE_ASSIGN_OR_RETURN(const auto scratch, store.NewScratch());
  ChunkWriter products(store, storage::ChunkKind::kProduct, limits.chunk_bytes,
                       io);
  MAPSIEVE_ASSIGN_OR_RETURN(
      const auto tiles, StoredTiles::Open(*snapshot, *scratch, products,
                                          limits.pending_bytes, context.stop));
  const core::TilingOptions tiling = {.max_unit_points = limits.unit_points};
  MAPSIEVE_ASSIGN_OR_RETURN(
      const core::SpdfSummary summary,
      core::FilterTiles(*tiles, lattice, options, tiling, context));
  MAPSIEVE_RETURN_IF_ERROR(tiles->Flush());
  MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());

  const core::LabelCounts kept = tiles->CountKept(
      core::OutlierTest(summary.max_confidence, options.outlier_share));
  const ProcessReport report = MakeReport(base.number + 1, summary, kept);
  const storage::RevisionChange change = {
      .spec = {.kind = storage::RevisionKind::kProcess,
               .description = FormatProcessReport(report),
               .attributes = base.spec.attributes,
               .product =
                   storage::ProductSummary{
                       .options = stored_options,
                       .distinct_point_count = summary.point_count,
                       .kept_counts = kept,
                       .max_confidence = summary.max_confidence}},
      .added = products.chunks(),
      .removes_product = true};
  MAPSIEVE_RETURN_IF_ERROR(
      store.catalogue().CommitRevision(map_uid, base.number, change).status());
  return report;
}

}  // namespace mapsieve::engine
