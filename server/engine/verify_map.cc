#include "server/engine/verify_map.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "core/base/status.h"
#include "server/engine/damaged_chunk.h"
#include "server/engine/opaque_records.h"
#include "server/engine/tile_check.h"

namespace mapsieve::engine {
namespace {

using storage::ChunkKind;
using storage::ChunkRef;
using storage::ReadSnapshot;

constexpr int64_t kPageSize = 1000;
/// Without findings, the progress is told that often.
constexpr absl::Duration kProgressInterval = absl::Milliseconds(200);

class MapVerification final : public VerifyCursor {
 public:
  MapVerification(std::shared_ptr<const ReadSnapshot> snapshot,
                  std::shared_ptr<const ReadSnapshot> processed,
                  MemoryPool& memory, std::stop_token stop)
      : snapshot_(std::move(snapshot)),
        processed_(std::move(processed)),
        memory_(memory),
        stop_(std::move(stop)) {}

  absl::Status Open(const VerifySpec& spec) {
    MAPSIEVE_ASSIGN_OR_RETURN(progress_.total_count,
                              snapshot_->CountAllChunks());
    if (spec.compared_tile_count == 0) return absl::OkStatus();
    MAPSIEVE_ASSIGN_OR_RETURN(
        options_,
        ParseSpdfOptions(processed_->revision().spec.product->options));
    MAPSIEVE_RETURN_IF_ERROR(ChooseTiles(spec.compared_tile_count));
    progress_.total_count += static_cast<int64_t>(tiles_.size());
    return absl::OkStatus();
  }

  absl::StatusOr<std::optional<VerifyEvent>> Next() override {
    const absl::Time start = absl::Now();
    while (absl::Now() - start < kProgressInterval) {
      if (stop_.stop_requested()) return absl::CancelledError("cancelled");
      if (next_chunk_ == page_.size() && !all_chunks_read_) {
        MAPSIEVE_RETURN_IF_ERROR(ReadPage());
        continue;
      }
      if (next_chunk_ < page_.size()) {
        const ChunkRef& chunk = page_[next_chunk_++];
        ++progress_.done_count;
        MAPSIEVE_ASSIGN_OR_RETURN(auto damaged, VisitChunk(chunk));
        if (damaged.has_value()) return VerifyEvent(*std::move(damaged));
        continue;
      }
      if (next_tile_ == tiles_.size()) {
        if (std::exchange(is_complete_, true)) return std::nullopt;
        return VerifyEvent(progress_);
      }
      const core::CellKey& tile = tiles_[next_tile_++];
      ++progress_.done_count;
      MAPSIEVE_ASSIGN_OR_RETURN(auto differing, VisitTile(tile));
      if (differing.has_value()) return VerifyEvent(*std::move(differing));
    }
    return VerifyEvent(progress_);
  }

  VerifySummary summary() const override { return summary_; }

 private:
  /// Those of the product, or of its raw points, at even distances.
  absl::Status ChooseTiles(int64_t count) {
    std::vector<core::CellKey> all;
    while (true) {
      std::optional<core::CellKey> after;
      if (!all.empty()) after = all.back();
      MAPSIEVE_ASSIGN_OR_RETURN(
          const std::vector<storage::TileSummary> tiles,
          processed_->ListTiles(ChunkKind::kRaw, std::nullopt, after,
                                kPageSize));
      if (tiles.empty()) break;
      for (const storage::TileSummary& tile : tiles) all.push_back(tile.tile);
    }
    const auto size = static_cast<int64_t>(all.size());
    count = std::min(count, size);
    for (int64_t i = 0; i < count; ++i) {
      tiles_.push_back(
          all[static_cast<size_t>((2 * i + 1) * size / count / 2)]);
    }
    return absl::OkStatus();
  }

  absl::Status ReadPage() {
    const int64_t after = page_.empty() ? 0 : page_.back().number;
    MAPSIEVE_ASSIGN_OR_RETURN(page_,
                              snapshot_->ListAllChunks(after, kPageSize));
    next_chunk_ = 0;
    all_chunks_read_ = page_.empty();
    return absl::OkStatus();
  }

  absl::StatusOr<std::optional<VerifyEvent>> VisitChunk(const ChunkRef& chunk) {
    ++summary_.chunk_count;
    summary_.stored_bytes += chunk.stored_bytes;
    const absl::Status status = CheckChunk(*snapshot_, chunk);
    if (status.ok()) return std::nullopt;
    if (!absl::IsDataLoss(status)) return status;
    ++summary_.damaged_chunk_count;
    return MakeDamagedChunk(chunk, status);
  }

  absl::StatusOr<std::optional<VerifyEvent>> VisitTile(
      const core::CellKey& tile) {
    Reservation reservation(memory_);
    const absl::StatusOr<TileCheck> check =
        CheckTile(*processed_, options_, tile, reservation, {.stop = stop_});
    if (absl::IsResourceExhausted(check.status()) ||
        absl::IsDataLoss(check.status())) {
      ++summary_.skipped_tile_count;
      return std::nullopt;
    }
    MAPSIEVE_RETURN_IF_ERROR(check.status());
    ++summary_.compared_tile_count;
    summary_.compared_point_count += check->point_count;
    if (check->difference.empty()) return std::nullopt;
    ++summary_.differing_tile_count;
    return DifferingTile{tile, check->difference};
  }

  const std::shared_ptr<const ReadSnapshot> snapshot_;
  /// The revision that made the product; null if no tile is compared.
  const std::shared_ptr<const ReadSnapshot> processed_;
  MemoryPool& memory_;
  const std::stop_token stop_;
  core::SpdfOptions options_;
  std::vector<core::CellKey> tiles_;
  size_t next_tile_ = 0;
  std::vector<ChunkRef> page_;
  size_t next_chunk_ = 0;
  bool all_chunks_read_ = false;
  bool is_complete_ = false;
  VerifyProgress progress_;
  VerifySummary summary_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<VerifyCursor>> OpenVerification(
    storage::Store& store, MemoryPool& memory, const VerifySpec& spec,
    std::stop_token stop) {
  if (spec.compared_tile_count < 0 ||
      spec.compared_tile_count > kMaxComparedTiles) {
    return absl::InvalidArgumentError(
        absl::StrCat("compared_tile_count: expected 0 to ", kMaxComparedTiles,
                     ", got ", spec.compared_tile_count));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(auto snapshot, store.OpenSnapshot(spec.map_id));
  std::shared_ptr<const ReadSnapshot> processed;
  if (spec.compared_tile_count > 0) {
    if (snapshot->revision().processed_revision == 0) {
      return absl::FailedPreconditionError(
          absl::StrCat("map ", spec.map_id,
                       " was never processed, so it has no tiles to compare; "
                       "process it first"));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(processed, store.OpenProduct(*snapshot));
  }
  auto verification = std::make_unique<MapVerification>(
      std::move(snapshot), std::move(processed), memory, std::move(stop));
  MAPSIEVE_RETURN_IF_ERROR(verification->Open(spec));
  return verification;
}

}  // namespace mapsieve::engine
