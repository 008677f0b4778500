#ifndef MAPSIEVE_CORE_CODEC_POINTS_CODEC_H_
#define MAPSIEVE_CORE_CODEC_POINTS_CODEC_H_

#include <cstddef>
#include <cstdint>
#include <map>
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

/// The numbers are part of the format.
enum class Compression : uint8_t { kNone = 0, kLz4 = 1, kZstd = 2 };

/// Limits of a block; beyond them it is refused before anything is allocated.
inline constexpr int64_t kMaxBlockPoints = 16'777'216;
/// Position columns (at most three) and attributes together.
inline constexpr size_t kMaxBlockColumns = 1024;
/// Bytes of an attribute's name, at least 1.
inline constexpr size_t kMaxColumnNameBytes = 255;
/// BlockHeader::decoded_bytes of a block.
inline constexpr int64_t kMaxDecodedBytes = int64_t{1} << 31;

/// The numbers are part of the format; transforms.h says what they are.
enum class Transform : uint8_t;

/// Which transforms are worth trying on the columns of clouds that are alike:
/// trying all takes as long as coding some ten thousand points.
struct EncodePlan {
  struct Entry {
    /// At least one, the best for the cloud that the plan was made for first.
    std::vector<Transform> transforms;
    /// Of a value, somewhat more than in that cloud.
    double max_value_bytes = 0;
  };
  /// Of the columns of positions, by axis; of points in Morton order there are
  /// none.
  std::map<std::string, Entry, std::less<>> axes;
  std::map<std::string, Entry, std::less<>> attributes;
};

/// What a plan is for: blocks that stay, or such that are soon decoded. kSpeed
/// has one transform a column, for blocks some percent larger.
enum class PlanAim { kSize, kSpeed };

/// The plan for clouds like `cloud`. Columns of one value are left out.
/// Deterministic.
EncodePlan PlanEncoding(const LatticeCloud& cloud,
                        Compression compression = Compression::kLz4,
                        PlanAim aim = PlanAim::kSize);

struct EncodeOptions {
  /// kZstd is smaller by a few percent and slower to write. kNone writes every
  /// column plain, for readers that know no transform: some four times larger.
  Compression compression = Compression::kLz4;
  /// Made for the same compression; outlives the call. All transforms are
  /// tried on a column that the plan lacks, or that takes more than it
  /// says, as on all columns without a plan.
  const EncodePlan* plan = nullptr;
};

/// Encodes `cloud` in its order; losslessly, attributes and missing values
/// included. The same cloud and options give the same bytes, except across
/// versions of the compression library. Points in Morton order compress best.
/// kInvalidArgument: a limit above, a coordinate outside the lattice, a step
/// outside 1 to kMaxStepNm, columns of unequal length, two of one name.
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
  /// The attributes, in the order of the block.
  std::vector<ColumnSpec> columns;
  /// Memory of the decoded cloud: 24 bytes a point, its values, and a byte for
  /// each value of a column that lacks some.
  int64_t decoded_bytes = 0;
};

/// Reads and checks the head of the block that `bytes` starts with; more bytes
/// may follow the head. kDataLoss: damage, with offset, expected and actual;
/// kOutOfRange: `bytes` ends inside the head, so more are needed (the message
/// says how many, 300 kB at most).
absl::StatusOr<BlockHeader> ReadBlockHeader(std::span<const std::byte> bytes);

/// Bytes that are always enough for ReadBlockHeader to know block_bytes.
inline constexpr size_t kBlockPrefixBytes = 16;

/// The length of the block whose first kBlockPrefixBytes are `prefix`, at
/// least kBlockPrefixBytes; kDataLoss if that is no block.
absl::StatusOr<int64_t> ReadBlockLength(std::span<const std::byte> prefix);

/// The blocks that fill `bytes`, back to back; kDataLoss: it is anything else,
/// with the offset.
absl::StatusOr<std::vector<std::span<const std::byte>>> SplitBlocks(
    std::span<const std::byte> bytes);

struct DecodeOptions {
  /// Attributes wanted; those the block lacks are left out. Nothing: all.
  std::optional<std::vector<std::string>> attributes;
  /// Blocks whose wanted columns need more memory are refused: a few bytes
  /// that a stranger compressed may stand for very many.
  int64_t max_decoded_bytes = kMaxDecodedBytes;
};

/// Decodes the block that fills `bytes`, without reading the columns that are
/// not wanted. Every length is checked before memory is allocated for it,
/// every column's checksum before it is used; the points obey the header's min
/// and max. Memory beyond the result: less than the result.
/// kDataLoss: damage, with offset, expected and actual; kResourceExhausted:
/// options.max_decoded_bytes.
absl::StatusOr<LatticeCloud> DecodePoints(std::span<const std::byte> bytes,
                                          const DecodeOptions& options = {});

/// The attributes `names` of the block that fills `bytes`, without reading the
/// positions or any other column: one value a point, in the block's order.
/// Those that the block lacks are left out. Checks what it reads, and fails,
/// as DecodePoints does.
absl::StatusOr<ColumnSet> DecodeColumns(std::span<const std::byte> bytes,
                                        const std::vector<std::string>& names);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CODEC_POINTS_CODEC_H_
