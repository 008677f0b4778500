#include "client/api/block_source.h"

#include <algorithm>
#include <numeric>

#include "core/base/status.h"
#include "core/codec/points_codec.h"

namespace mapsieve::client {

size_t UploadBlockPoints(std::span<const core::ColumnSpec> attributes) {
  constexpr size_t kMaxPoints = 65536;
  constexpr size_t kMaxBytes = size_t{4} << 20;
  size_t point_bytes = sizeof(core::LatticePoint);
  for (const core::ColumnSpec& spec : attributes) {
    // A byte more for the flag of a missing value.
    point_bytes += core::ScalarSize(spec.type) + 1;
  }
  return std::clamp(kMaxBytes / point_bytes, size_t{1}, kMaxPoints);
}

CloudBlocks::CloudBlocks(const core::LatticeCloud& cloud)
    : cloud_(cloud),
      block_points_(UploadBlockPoints(cloud.attributes.specs())) {}

absl::Status CloudBlocks::Rewind() {
  next_ = 0;
  return absl::OkStatus();
}

absl::StatusOr<std::vector<std::byte>> CloudBlocks::NextBlock() {
  if (next_ == cloud_.size()) return std::vector<std::byte>();
  std::vector<uint32_t> rows(std::min(block_points_, cloud_.size() - next_));
  std::iota(rows.begin(), rows.end(), static_cast<uint32_t>(next_));
  next_ += rows.size();
  return core::EncodePoints(cloud_.Select(rows));
}

absl::Status KeptBlocks::Rewind() {
  next_ = 0;
  if (keeping_ == Keeping::kAll) return absl::OkStatus();
  kept_.clear();
  kept_bytes_ = 0;
  keeping_ = Keeping::kSoFar;
  return source_.Rewind();
}

absl::StatusOr<std::vector<std::byte>> KeptBlocks::NextBlock() {
  if (keeping_ == Keeping::kAll) {
    if (next_ == kept_.size()) return std::vector<std::byte>();
    return kept_[next_++];
  }
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<std::byte> block, source_.NextBlock());
  if (keeping_ != Keeping::kSoFar) return block;
  if (block.empty()) {
    keeping_ = Keeping::kAll;
    next_ = kept_.size();
    return block;
  }
  kept_bytes_ += static_cast<int64_t>(block.size());
  if (kept_bytes_ > max_bytes_) {
    keeping_ = Keeping::kNothing;
    kept_ = {};
    return block;
  }
  kept_.push_back(block);
  return block;
}

}  // namespace mapsieve::client
