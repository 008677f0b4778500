#include "server/engine/chunk_walk.h"

#include <cstdint>
#include <utility>

#include "core/base/status.h"
#include "server/engine/product_chunk.h"

namespace mapsieve::engine {
namespace {

/// Catalogue rows read at a time.
constexpr int64_t kPageSize = 256;

}  // namespace

absl::StatusOr<std::optional<storage::ChunkRef>> ChunkWalk::Next() {
  while (true) {
    if (next_ == page_.size()) {
      if (is_last_page_ && !GoToNextGroup()) return std::nullopt;
      MAPSIEVE_RETURN_IF_ERROR(ReadPage());
      continue;
    }
    storage::ChunkRef& chunk = page_[next_++];
    if (IsInGroup(chunk) &&
        (!region_.has_value() || region_->Intersects(chunk.bounds))) {
      return std::move(chunk);
    }
  }
}

bool ChunkWalk::IsInGroup(const storage::ChunkRef& chunk) const {
  return kind_ != storage::ChunkKind::kProduct ||
         (chunk.min_depth >= kDepthGroups[group_].min &&
          chunk.max_depth <= kDepthGroups[group_].max &&
          chunk.max_depth >= min_depth_);
}

bool ChunkWalk::GoToNextGroup() {
  if (kind_ != storage::ChunkKind::kProduct ||
      group_ + 1 == kDepthGroups.size() ||
      kDepthGroups[group_ + 1].max < min_depth_) {
    return false;
  }
  ++group_;
  after_.reset();
  return true;
}

absl::Status ChunkWalk::ReadPage() {
  std::optional<core::LatticeBox> bounds;
  if (region_.has_value()) bounds = region_->bounds();
  MAPSIEVE_ASSIGN_OR_RETURN(
      page_, snapshot_.ListChunks(kind_, bounds, after_, kPageSize));
  next_ = 0;
  is_last_page_ = static_cast<int64_t>(page_.size()) < kPageSize;
  if (!page_.empty()) {
    after_ = storage::ChunkPosition{page_.back().tile, page_.back().number};
  }
  return absl::OkStatus();
}

}  // namespace mapsieve::engine
