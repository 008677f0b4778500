#ifndef MAPSIEVE_CORE_CODEC_POINTS_CODEC_H_
#define MAPSIEVE_CORE_CODEC_POINTS_CODEC_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"

/// The one codec of disk and wire: a self-delimiting block of lattice points
/// with their attributes. A stored chunk, a batch of an upload and a batch of
/// an answer are all such blocks. FORMAT.md beside this file is the byte
/// table. All functions are thread-safe.
namespace mapsieve::core {

enum class Compression : uint8_t { kNone = 0, kLz4 = 1, kZstd = 2 };

/// Points of a block at most; a block is refused beyond it, before anything is
/// allocated.
inline constexpr int64_t kMaxBlockPoints = 16'777'216;

struct EncodeOptions {
  Compression compression = Compression::kLz4;
};

/// Encodes `cloud` in its order; losslessly, attributes and missing values
/// included. The same cloud and options give the same bytes, except across
/// versions of the compression library. Points in Morton order compress best.
/// kInvalidArgument: more than kMaxBlockPoints points, a coordinate outside
/// the lattice, columns of unequal length, a name longer than 255 bytes.
absl::StatusOr<std::vector<std::byte>> EncodePoints(
    const LatticeCloud& cloud, const EncodeOptions& options = {});

/// What the head of a block says.
struct BlockHeader {
  int64_t step_nm = 0;
  int64_t point_count = 0;
  /// Bytes of the whole block, head included.
  int64_t block_bytes = 0;
  /// Smallest and largest coordinates of the points (inclusive); equal to the
  /// origin for an empty block.
  LatticePoint min;
  LatticePoint max;
  std::vector<ColumnSpec> columns;
};

/// Reads and checks the head of the block that `bytes` starts with; more bytes
/// may follow the block. kDataLoss: damage, with offset, expected and actual;
/// kOutOfRange: `bytes` ends inside the head, so more are needed.
absl::StatusOr<BlockHeader> ReadBlockHeader(std::span<const std::byte> bytes);

/// Bytes that are always enough for ReadBlockHeader to know block_bytes.
inline constexpr size_t kBlockPrefixBytes = 16;

/// The length of the block whose first kBlockPrefixBytes are `prefix`, at
/// least kBlockPrefixBytes; kDataLoss if that is no block.
absl::StatusOr<int64_t> ReadBlockLength(std::span<const std::byte> prefix);

struct DecodeOptions {
  /// Attributes wanted; those the block lacks are left out. Nothing: all.
  std::optional<std::vector<std::string>> attributes;
};

/// Decodes the block that fills `bytes`. Every length is checked before
/// memory is allocated for it, every column's checksum before it is used.
/// kDataLoss: damage, with offset, expected and actual.
absl::StatusOr<LatticeCloud> DecodePoints(std::span<const std::byte> bytes,
                                          const DecodeOptions& options = {});

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CODEC_POINTS_CODEC_H_
