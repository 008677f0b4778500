#include "core/codec/block_parts.h"

#include <algorithm>

#include "core/base/status.h"
#include "core/codec/block_head.h"

namespace mapsieve::core {

absl::StatusOr<std::vector<BlockPart>> FindParts(
    std::span<const std::byte> bytes, std::span<const std::string> attributes,
    BlockPositions positions) {
  MAPSIEVE_ASSIGN_OR_RETURN(const BlockHead head, ReadBlockHead(bytes));
  std::vector<BlockPart> parts;
  size_t begin = head.head_bytes;
  for (size_t i = 0; i < head.columns.size(); ++i) {
    const ColumnEntry& entry = head.columns[i];
    const size_t end = begin + entry.stored_bytes;
    const bool is_wanted = i < head.position_column_count()
                               ? positions == BlockPositions::kWanted
                               : std::find(attributes.begin(), attributes.end(),
                                           entry.spec.name) != attributes.end();
    if (is_wanted && begin < end) {
      if (!parts.empty() && parts.back().end == begin) {
        parts.back().end = end;
      } else {
        parts.push_back({begin, end});
      }
    }
    begin = end;
  }
  return parts;
}

}  // namespace mapsieve::core
