#include "client/api/block_source.h"

#include <algorithm>
#include <numeric>

#include "core/codec/points_codec.h"

namespace mapsieve::client {

absl::Status CloudBlocks::Rewind() {
  next_ = 0;
  return absl::OkStatus();
}

absl::StatusOr<std::vector<std::byte>> CloudBlocks::NextBlock() {
  if (next_ == cloud_.size()) return std::vector<std::byte>();
  std::vector<uint32_t> rows(
      std::min(kUploadBlockPoints, cloud_.size() - next_));
  std::iota(rows.begin(), rows.end(), static_cast<uint32_t>(next_));
  next_ += rows.size();
  return core::EncodePoints(cloud_.Select(rows));
}

}  // namespace mapsieve::client
