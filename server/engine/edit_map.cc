#include "server/engine/edit_map.h"

#include <optional>
#include <utility>

#include "core/base/status.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/chunk_walk.h"

namespace mapsieve::engine {
namespace {

using storage::ChunkKind;
using storage::ChunkRef;

/// Revisions read at a time.
constexpr int64_t kPageSize = 100;

absl::StatusOr<int64_t> CountChunks(const storage::ReadSnapshot& snapshot,
                                    const std::optional<Region>& region,
                                    const ExecutionContext& context) {
  ChunkWalk walk(snapshot, ChunkKind::kRaw, region);
  for (int64_t count = 0;; ++count) {
    MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
    MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<ChunkRef> chunk, walk.Next());
    if (!chunk.has_value()) return count;
  }
}

/// The points of a chunk outside `region`.
absl::StatusOr<core::LatticeCloud> ReadRest(
    const storage::ReadSnapshot& snapshot, const ChunkRef& chunk,
    const Region& region) {
  core::LatticeCloud points;
  if (region.Encloses(chunk.bounds)) return points;
  MAPSIEVE_ASSIGN_OR_RETURN(points, ReadPoints(snapshot, chunk));
  std::vector<uint32_t> rows;
  for (uint32_t row = 0; row < points.size(); ++row) {
    if (!region.Contains(points.positions[row])) rows.push_back(row);
  }
  return points.Select(rows);
}

/// The report of the revision that `spec` has made, if there is one.
absl::StatusOr<std::optional<DeleteReport>> FindDone(
    const storage::Catalogue& catalogue, const JobSpec& spec) {
  int64_t before = 0;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const auto page,
        catalogue.ListRevisions(spec.map_uid, before, kPageSize));
    for (const storage::RevisionRecord& revision : page) {
      if (revision.number <= spec.base_revision) return std::nullopt;
      if (revision.spec.kind != storage::RevisionKind::kDeleteRegion) continue;
      MAPSIEVE_ASSIGN_OR_RETURN(const EditRecord edit,
                                ParseEditRecord(revision.spec.description));
      if (edit.edit_uid != spec.edit_uid) continue;
      return DeleteReport{.revision = revision.number,
                          .removed_point_count = edit.removed_point_count,
                          .tile_count = edit.tile_count};
    }
    if (page.empty()) return std::nullopt;
    before = page.back().number;
  }
}

}  // namespace

absl::StatusOr<RegionCut> CutRegion(const storage::ReadSnapshot& snapshot,
                                    const Region& region,
                                    const IngestLimits& limits,
                                    const ExecutionContext& context,
                                    ChunkWriter& rest) {
  const std::optional<Region> place = region;
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t total,
                            CountChunks(snapshot, place, context));
  RegionCut cut;
  std::vector<TileCloud> pending;
  int64_t pending_bytes = 0;
  std::optional<core::CellKey> tile;
  ChunkWalk walk(snapshot, ChunkKind::kRaw, place);
  for (int64_t done = 0;; ++done) {
    MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
    context.ReportProgress(done, total);
    MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<ChunkRef> chunk, walk.Next());
    if (!chunk.has_value()) break;
    MAPSIEVE_ASSIGN_OR_RETURN(core::LatticeCloud points,
                              ReadRest(snapshot, *chunk, region));
    const auto kept = static_cast<int64_t>(points.size());
    if (kept == chunk->point_count) continue;
    if (static_cast<int64_t>(cut.removed_chunks.size()) >= limits.chunk_count) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "the region takes points from more than ", limits.chunk_count,
          " chunks, more than one revision takes; do it in parts, or give the "
          "server more memory"));
    }
    cut.removed_chunks.push_back(chunk->number);
    cut.removed_point_count += chunk->point_count - kept;
    if (tile != chunk->tile) ++cut.tile_count;
    tile = chunk->tile;
    if (kept == 0) continue;
    pending_bytes += kept * DecodedPointBytes(points);
    pending.push_back({chunk->tile, std::move(points)});
    if (pending_bytes < limits.bucket_bytes) continue;
    MAPSIEVE_RETURN_IF_ERROR(
        rest.Write(std::exchange(pending, {}), context.stop));
    pending_bytes = 0;
  }
  MAPSIEVE_RETURN_IF_ERROR(rest.Write(std::move(pending), context.stop));
  MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
  return cut;
}

absl::StatusOr<DeleteReport> DeleteStoredRegion(
    storage::Store& store, const std::string& map_id, const JobSpec& spec,
    const IngestLimits& limits, const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto snapshot, store.OpenSnapshot(map_id));
  const storage::MapRecord& map = snapshot->map();
  const storage::RevisionRecord& base = snapshot->revision();
  if (map.uid != spec.map_uid) {
    return absl::NotFoundError(
        absl::StrCat("map ", map_id, " is another one than at the request"));
  }
  if (!spec.region.has_value()) {
    return absl::InvalidArgumentError("region: missing; give a box or sphere");
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const auto before,
                            FindDone(store.catalogue(), spec));
  if (before.has_value()) return *before;
  MAPSIEVE_ASSIGN_OR_RETURN(
      const Region region,
      Region::OfEdit(*spec.region, core::Lattice(map.spec.step_nm)));
  ChunkWriter rest(store, ChunkKind::kRaw, limits.chunk_bytes,
                   *context.executor);
  MAPSIEVE_ASSIGN_OR_RETURN(
      RegionCut cut, CutRegion(*snapshot, region, limits, context, rest));
  if (cut.removed_point_count == 0) {
    return DeleteReport{.revision = base.number};
  }
  const EditRecord edit = {.edit_uid = spec.edit_uid,
                           .region = spec.region,
                           .removed_point_count = cut.removed_point_count,
                           .tile_count = cut.tile_count};
  MAPSIEVE_RETURN_IF_ERROR(
      store
          .CommitRevision(
              map.uid, base.number,
              {.spec = {.kind = storage::RevisionKind::kDeleteRegion,
                        .description = FormatEditRecord(edit),
                        .attributes = base.spec.attributes},
               .added = rest.chunks(),
               .removed = std::move(cut.removed_chunks)})
          .status());
  return DeleteReport{.revision = base.number + 1,
                      .removed_point_count = cut.removed_point_count,
                      .tile_count = cut.tile_count};
}

}  // namespace mapsieve::engine
