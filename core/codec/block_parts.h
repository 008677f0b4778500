#ifndef MAPSIEVE_CORE_CODEC_BLOCK_PARTS_H_
#define MAPSIEVE_CORE_CODEC_BLOCK_PARTS_H_

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace mapsieve::core {

/// Bytes [begin, end) of a block.
struct BlockPart {
  size_t begin = 0;
  size_t end = 0;

  friend bool operator==(const BlockPart&, const BlockPart&) = default;
};

enum class BlockPositions { kWanted, kNotWanted };

/// Where in a block, behind its head, what DecodePoints (positions kWanted) or
/// DecodeColumns reads of it for `attributes` lies: parts in ascending order,
/// none of which begins where another one ends. Both may be given a block in
/// which these parts and the head alone have values, and find damage in them.
/// `bytes`: the head of the block, more may follow it. Thread-safe. Errors of
/// ReadBlockHeader.
absl::StatusOr<std::vector<BlockPart>> FindParts(
    std::span<const std::byte> bytes, std::span<const std::string> attributes,
    BlockPositions positions);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CODEC_BLOCK_PARTS_H_
