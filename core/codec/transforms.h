#ifndef MAPSIEVE_CORE_CODEC_TRANSFORMS_H_
#define MAPSIEVE_CORE_CODEC_TRANSFORMS_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "absl/status/status.h"

/// Reversible rearrangements of a column of values that make it compress, or
/// that are the compression. They see values as unsigned little-endian
/// integers of 1, 2, 4 or 8 bytes, floating point included, so every bit
/// pattern survives. FORMAT.md describes the bytes. All functions are
/// thread-safe.
namespace mapsieve::core {

/// The numbers are part of the format.
enum class Transform : uint8_t {
  /// The values as they are.
  kPlain = 0,
  /// First bytes of all values, then second bytes, ….
  kShuffle = 1,
  /// kShuffle of the zigzag differences of successive values.
  kDeltaShuffle = 2,
  /// The zigzag differences in as many bits as they need, by 16 size classes.
  kDeltaPacked = 3,
  /// kDeltaPacked without the zigzag, for values that seldom decrease.
  kAscendingPacked = 4,
  /// The values, entropy-coded (token_code.h).
  kCoded = 5,
  /// The zigzag differences of successive values, entropy-coded.
  kDeltaCoded = 6,
  /// kDeltaCoded without the zigzag, for values that seldom decrease.
  kAscendingCoded = 7,
  /// How far each difference is from the median of the three before it,
  /// entropy-coded, for values along scan lines.
  kMedianCoded = 8,
  /// The zigzag differences of the low halves of successive values and those
  /// of the high halves, taking turns, entropy-coded; for two numbers in one
  /// value, of at least 2 bytes.
  kHalvesCoded = 9,
  /// kHalvesCoded of the halves without the low bits that are 0 in all.
  kScaledHalvesCoded = 10,
};

inline constexpr std::array kTransforms = {Transform::kPlain,
                                           Transform::kShuffle,
                                           Transform::kDeltaShuffle,
                                           Transform::kDeltaPacked,
                                           Transform::kAscendingPacked,
                                           Transform::kCoded,
                                           Transform::kDeltaCoded,
                                           Transform::kAscendingCoded,
                                           Transform::kMedianCoded,
                                           Transform::kHalvesCoded,
                                           Transform::kScaledHalvesCoded};

/// Whether a transform sees two numbers in each value.
constexpr bool IsOfHalves(Transform transform) {
  return transform == Transform::kHalvesCoded ||
         transform == Transform::kScaledHalvesCoded;
}

/// Whether values of `width` bytes can be transformed so.
constexpr bool SuitsWidth(Transform transform, size_t width) {
  return !IsOfHalves(transform) || width > 1;
}

/// Whether the transform is an entropy code, whose bytes no compressor makes
/// smaller.
constexpr bool IsCoded(Transform transform) {
  return transform >= Transform::kCoded;
}

/// "plain", "shuffle", …; empty for a number that is not a Transform.
std::string_view TransformName(Transform transform);

/// Fewest and most bytes that `count` values of `width` bytes become.
struct CodedSizeRange {
  uint64_t min = 0;
  uint64_t max = 0;
};
CodedSizeRange CodedSizes(Transform transform, uint64_t count, size_t width);

/// Appends the transformed `values`, of `width` bytes each, to `coded`.
/// The transform suits the width. Deterministic. Memory: a few copies of
/// `values`.
void AppendTransformed(Transform transform, std::span<const std::byte> values,
                       size_t width, std::vector<std::byte>& coded);

/// Bytes that AppendTransformed would append; quickly for an entropy code.
uint64_t CodedBytes(Transform transform, std::span<const std::byte> values,
                    size_t width);

/// The inverse of AppendTransformed: fills `values`, whose size says how many
/// are expected. kDataLoss if `coded` is not the form of that many values;
/// nothing outside `values` is written, whatever `coded` holds.
absl::Status InvertTransform(Transform transform,
                             std::span<const std::byte> coded, size_t width,
                             std::span<std::byte> values);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CODEC_TRANSFORMS_H_
