// Feeds bytes to the decoder, as they are and under right checksums, and what
// it accepts back to the encoder.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/base/bytes.h"
#include "core/codec/block_head.h"
#include "core/codec/points_codec.h"
#include "tests/codec/codec_test_util.h"
#include "tests/fuzz/check.h"

namespace mapsieve::core {
namespace {

using mapsieve::testing::Check;

void Decode(std::span<const std::byte> block) {
  const DecodeOptions options{.max_decoded_bytes = 256 << 10};
  const auto cloud = DecodePoints(block, options);
  if (!cloud.ok()) {
    Check(absl::IsDataLoss(cloud.status()) ||
              absl::IsResourceExhausted(cloud.status()),
          "a refusal is DATA_LOSS or RESOURCE_EXHAUSTED");
    return;
  }
  const auto header = ReadBlockHeader(block);
  Check(
      header.ok() && header->point_count == static_cast<int64_t>(cloud->size()),
      "the header of a block that decodes is read, and right");
  const auto length = ReadBlockLength(block.first(kBlockPrefixBytes));
  Check(length.ok() && *length == static_cast<int64_t>(block.size()),
        "the first bytes of a block that decodes tell its length");
  const auto bare =
      DecodePoints(block, {.attributes = std::vector<std::string>()});
  Check(bare.ok() && bare->positions == cloud->positions &&
            bare->attributes.columns().empty(),
        "points do not depend on the columns that are wanted");
  for (const Compression compression : kCompressions) {
    const auto again = EncodePoints(*cloud, {.compression = compression});
    Check(again.ok(), "what was decoded is encoded");
    const auto back = DecodePoints(*again);
    Check(back.ok() && back->lattice == cloud->lattice &&
              back->positions == cloud->positions &&
              back->attributes == cloud->attributes,
          "what was encoded is decoded to the same");
  }
}

/// Makes the checksums of head and columns right where that can be done.
void Seal(std::vector<std::byte>& block) {
  if (block.size() < 20) return;
  const auto head_bytes = LoadLittleEndian<uint32_t>(block.data() + 16);
  if (head_bytes < 24 || head_bytes > block.size()) return;
  SealHead(block, head_bytes);
  const auto head = ReadBlockHead(block);
  if (!head.ok() || head->block_bytes != block.size()) return;
  block = BlockParts::Of(block).Join();
}

}  // namespace
}  // namespace mapsieve::core

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const auto bytes = std::as_bytes(std::span(data, size));
  std::vector<std::byte> block(bytes.begin(), bytes.end());
  mapsieve::core::Decode(block);
  mapsieve::core::Seal(block);
  mapsieve::core::Decode(block);
  return 0;
}
