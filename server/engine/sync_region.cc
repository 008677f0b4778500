#include "server/engine/sync_region.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "server/engine/answer_columns.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/field_error.h"
#include "server/engine/point_filter.h"
#include "server/engine/query_checks.h"
#include "server/engine/region.h"
#include "server/engine/region_query.h"

namespace mapsieve::engine {
namespace {

using core::CellKey;
using storage::ChunkKind;
using storage::ChunkRef;
using storage::ReadSnapshot;

/// Of a tile of the region: its key and the ids of its chunk, twice.
constexpr int64_t kTileBytes = 256;
/// Tiles whose memory is asked for together: only the first time does an answer
/// wait for it, and few have more.
constexpr size_t kTilesAtOnce = 1024;

/// Exactly the lattice points of a tile: positions grow with coordinates.
Box BoxOfTile(const CellKey& tile, const core::Lattice& lattice) {
  const core::LatticeBox box = tile.box();
  return {lattice.Position(box.min), lattice.Position(box.max)};
}

/// What the chunks of a revision have in common and that their points depend
/// on: what was asked for, and which survivors are outliers.
std::string CommonKey(const SyncSpec& spec, const ReadSnapshot& snapshot) {
  ByteWriter key;
  key.PutBytes(TextBytes(spec.query_key));
  const auto& product = snapshot.revision().spec.product;
  if (!spec.query.raw && product.has_value()) {
    key.PutBytes(TextBytes(product->options));
    for (const uint16_t confidence : product->max_confidence) {
      key.Put(confidence);
    }
  }
  return ContentHash(key.bytes());
}

class RegionSync final : public SyncCursor {
 public:
  RegionSync(MemoryPool& memory, SyncSpec spec,
             std::shared_ptr<const ReadSnapshot> snapshot,
             AnswerColumns columns, std::stop_token stop)
      : names_memory_(memory),
        answer_memory_(memory),
        spec_(std::move(spec)),
        snapshot_(std::move(snapshot)),
        lattice_(snapshot_->map().spec.step_nm),
        columns_(std::move(columns)),
        stop_(std::move(stop)) {
    header_ = {.revision = snapshot_->revision().number,
               .step_nm = snapshot_->map().spec.step_nm,
               .tile_level = snapshot_->map().spec.tile_level,
               .columns = columns_.specs()};
  }

  /// Names the chunks of the region, compares them with those held, and
  /// reserves what the largest one needs that is not.
  absl::Status Prepare() {
    std::set<std::string> held(spec_.held_chunk_ids.begin(),
                               spec_.held_chunk_ids.end());
    std::set<std::string> current;
    const std::string common = CommonKey(spec_, *snapshot_);
    std::optional<Region> region;
    std::optional<core::LatticeBox> bounds;
    if (spec_.query.region.has_value()) {
      MAPSIEVE_ASSIGN_OR_RETURN(region,
                                Region::Make(*spec_.query.region, lattice_));
      bounds = region->bounds();
    }
    std::optional<CellKey> after;
    int64_t largest = 0;
    while (true) {
      constexpr int64_t kPageSize = 256;
      MAPSIEVE_ASSIGN_OR_RETURN(
          const std::vector<storage::TileSummary> page,
          snapshot_->ListTiles(kind(), bounds, after, kPageSize));
      for (const storage::TileSummary& tile : page) {
        if (stop_.stop_requested()) return absl::CancelledError("cancelled");
        if (region.has_value() && !region->Intersects(tile.bounds)) continue;
        if (current.size() % kTilesAtOnce == 0) {
          MAPSIEVE_RETURN_IF_ERROR(
              names_memory_.Grow(kTilesAtOnce * kTileBytes,
                                 "naming the chunks of the region", stop_));
        }
        MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<ChunkRef> chunks,
                                  snapshot_->ListTileChunks(kind(), tile.tile));
        std::string id = IdOf(tile.tile, chunks, common);
        current.insert(id);
        if (held.contains(id)) continue;
        wanted_.push_back({tile.tile, std::move(id)});
        for (const ChunkRef& chunk : chunks) {
          largest = std::max(largest, chunk.point_count);
        }
      }
      if (std::ssize(page) < kPageSize) break;
      after = page.back().tile;
    }
    summary_.chunk_count = static_cast<int64_t>(current.size());
    for (const std::string& id : spec_.held_chunk_ids) {
      if (!current.contains(id) && held.erase(id) > 0) {
        summary_.dropped_chunk_ids.push_back(id);
      }
    }
    if (wanted_.empty()) return absl::OkStatus();
    MAPSIEVE_ASSIGN_OR_RETURN(const PointFilter filter,
                              PointFilter::Make(spec_.query, *snapshot_));
    return answer_memory_.Grow(AnswerBytes(columns_, filter, largest),
                               "the largest chunk", stop_);
  }

  absl::StatusOr<std::optional<SyncPart>> Next() override {
    if (next_ == wanted_.size()) return std::nullopt;
    const auto& [tile, id] = wanted_[next_];
    if (query_ == nullptr) {
      QuerySpec spec = spec_.query;
      spec.region = BoxOfTile(tile, lattice_);
      MAPSIEVE_ASSIGN_OR_RETURN(query_, OpenQuery(snapshot_, spec, stop_));
      MAPSIEVE_ASSIGN_OR_RETURN(ahead_, query_->NextBatch());
    }
    SyncPart part{.chunk_id = id, .tile = tile};
    if (ahead_.has_value()) {
      part.block = *std::move(ahead_);
      MAPSIEVE_ASSIGN_OR_RETURN(ahead_, query_->NextBatch());
    }
    part.is_last = !ahead_.has_value();
    if (part.is_last) {
      query_.reset();
      ++next_;
      ++summary_.sent_chunk_count;
    }
    return part;
  }

  const SyncHeader& header() const override { return header_; }
  bool has_parts() const override { return !wanted_.empty(); }
  const SyncSummary& summary() const override { return summary_; }

 private:
  ChunkKind kind() const {
    return spec_.query.raw ? ChunkKind::kRaw : ChunkKind::kProduct;
  }

  /// The id of the chunk of a tile: a hash of where it is and of all that its
  /// points come from.
  static std::string IdOf(const CellKey& tile, std::span<const ChunkRef> chunks,
                          const std::string& common) {
    ContentHasher hasher;
    hasher.Update(TextBytes(common));
    hasher.Update(TextBytes(tile.ToString()));
    for (const storage::BlobId& id : ContentsOf(chunks)) {
      hasher.Update(TextBytes(id));
    }
    return hasher.HexDigest();
  }

  struct Wanted {
    CellKey tile;
    std::string id;
  };

  Reservation names_memory_;
  Reservation answer_memory_;
  const SyncSpec spec_;
  const std::shared_ptr<const ReadSnapshot> snapshot_;
  const core::Lattice lattice_;
  const AnswerColumns columns_;
  const std::stop_token stop_;
  SyncHeader header_;
  SyncSummary summary_;
  /// Chunks to send, those before next_ sent.
  std::vector<Wanted> wanted_;
  size_t next_ = 0;
  /// Of the chunk that is being sent: its points, and the next block.
  std::unique_ptr<QueryCursor> query_;
  std::optional<std::vector<std::byte>> ahead_;
};

absl::Status CheckSync(const SyncSpec& spec) {
  if (spec.query.max_points > 0 || spec.query.max_bytes > 0) {
    return FieldError("max_point_count", "chunks are whole; leave budgets out");
  }
  if (spec.query.allow_partial) {
    return FieldError("allow_partial", "chunks are whole; leave it out");
  }
  if (!spec.query.resume_token.empty()) {
    return FieldError("resume_token",
                      "the chunks that are held say where to go on");
  }
  if (spec.held_chunk_ids.size() > kMaxHeldChunks) {
    return FieldError(
        "held_chunk_ids",
        absl::StrCat("has ", spec.held_chunk_ids.size(), " entries; at most ",
                     kMaxHeldChunks, " can be given"));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::unique_ptr<SyncCursor>> OpenSync(storage::Store& store,
                                                     MemoryPool& memory,
                                                     const SyncSpec& spec,
                                                     std::stop_token stop) {
  MAPSIEVE_RETURN_IF_ERROR(CheckSync(spec));
  MAPSIEVE_RETURN_IF_ERROR(CheckSpec(spec.query));
  MAPSIEVE_ASSIGN_OR_RETURN(auto snapshot, OpenRevision(store, spec.query));
  MAPSIEVE_ASSIGN_OR_RETURN(
      AnswerColumns columns,
      AnswerColumns::Make(spec.query, snapshot->revision().spec.attributes));
  auto sync = std::make_unique<RegionSync>(memory, spec, std::move(snapshot),
                                           std::move(columns), std::move(stop));
  MAPSIEVE_RETURN_IF_ERROR(sync->Prepare());
  return sync;
}

}  // namespace mapsieve::engine
