#ifndef MAPSIEVE_CORE_CODEC_BLOCK_HEAD_H_
#define MAPSIEVE_CORE_CODEC_BLOCK_HEAD_H_

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cloud/column.h"
#include "core/codec/points_codec.h"
#include "core/codec/transforms.h"
#include "core/geometry/lattice.h"

/// The head of a block, field by field as in FORMAT.md. Used by the codec
/// alone; points_codec.h is the interface.
namespace mapsieve::core {

/// What the head says of a column.
struct ColumnEntry {
  ColumnSpec spec;
  Transform transform = Transform::kPlain;
  Compression compression = Compression::kNone;
  /// A bitmap of the missing values precedes the values.
  bool has_missing = false;
  /// Bytes before and after compression.
  uint32_t coded_bytes = 0;
  uint32_t stored_bytes = 0;
  /// Hash64 of the stored bytes.
  uint64_t checksum = 0;
};

/// Bytes of the bitmap of `point_count` points.
constexpr uint64_t MissingBitmapBytes(uint64_t point_count) {
  return (point_count + 7) / 8;
}

/// Names of the position columns: either these three, of int32 or int64
/// offsets from the corner, or one of Morton codes of 3 x 21 bits.
inline constexpr std::string_view kAxisNames[] = {"x", "y", "z"};
inline constexpr std::string_view kMortonName = "morton";
inline constexpr int kMortonAxisBits = 21;
/// The coordinates that those three are of.
inline constexpr int64_t LatticePoint::*kAxes[] = {
    &LatticePoint::x, &LatticePoint::y, &LatticePoint::z};

/// Smallest and largest coordinates, inclusive, as the head of a block has
/// them.
struct PointBounds {
  LatticePoint min;
  LatticePoint max;
};

/// Of no points: the origin.
PointBounds BoundsOf(std::span<const LatticePoint> positions);

/// BlockHeader::decoded_bytes for attributes `specs`, of which
/// `columns_with_missing` lack values.
int64_t DecodedBytes(uint64_t point_count, std::span<const ColumnSpec> specs,
                     size_t columns_with_missing);

struct BlockHead {
  int64_t step_nm = 0;
  uint32_t point_count = 0;
  LatticePoint corner;
  LatticePoint min;
  LatticePoint max;
  /// The position columns, then the attributes.
  std::vector<ColumnEntry> columns;
  /// Both filled in by ReadBlockHead; FormatBlockHead computes them.
  uint64_t block_bytes = 0;
  uint32_t head_bytes = 0;

  /// 1 (Morton codes) or 3 (axes).
  size_t position_column_count() const {
    return columns.front().spec.name == kMortonName ? 1 : 3;
  }
  std::span<const ColumnEntry> attributes() const {
    return std::span(columns).subspan(position_column_count());
  }
};

/// A column's name as messages show it, whatever bytes it has.
std::string QuotedName(const std::string& name);

/// The bytes of `head`, which obeys the limits.
std::vector<std::byte> FormatBlockHead(const BlockHead& head);

/// Reads the head that `bytes` starts with and checks it in full: every
/// length and number in a head that was read obeys FORMAT.md, so the lengths
/// of the columns add up to the block. Errors as ReadBlockHeader.
absl::StatusOr<BlockHead> ReadBlockHead(std::span<const std::byte> bytes);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CODEC_BLOCK_HEAD_H_
