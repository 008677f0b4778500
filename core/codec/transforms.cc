#include "core/codec/transforms.h"

#include <algorithm>
#include <array>
#include <bit>
#include <concepts>
#include <cstring>
#include <limits>
#include <type_traits>

#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/codec/token_code.h"

namespace mapsieve::core {
namespace {

/// Calls f(U{}) with the unsigned integer of `width` bytes.
template <typename F>
auto VisitWidth(size_t width, F&& f) {
  switch (width) {
    case 1:
      return f(uint8_t{});
    case 2:
      return f(uint16_t{});
    case 4:
      return f(uint32_t{});
    default:
      return f(uint64_t{});
  }
}

template <std::unsigned_integral U>
U Load(const std::byte* values, size_t i) {
  return LoadLittleEndian<U>(values + i * sizeof(U));
}

template <std::unsigned_integral U>
void Store(std::byte* values, size_t i, U value) {
  std::memcpy(values + i * sizeof(U), &value, sizeof(U));
}

/// Small differences of either sign become small numbers: 0, -1, 1, -2, ….
template <std::unsigned_integral U>
U ZigZag(U difference) {
  const U sign = static_cast<U>(difference >> (8 * sizeof(U) - 1));
  return static_cast<U>(static_cast<U>(difference << 1) ^
                        static_cast<U>(U{0} - sign));
}

template <std::unsigned_integral U>
U UnZigZag(U value) {
  return static_cast<U>((value >> 1) ^ static_cast<U>(U{0} - (value & 1)));
}

/// Of three differences, as signed numbers.
template <std::unsigned_integral U>
U Median(U a, U b, U c) {
  using Signed = std::make_signed_t<U>;
  const auto x = static_cast<Signed>(a);
  const auto y = static_cast<Signed>(b);
  const auto z = static_cast<Signed>(c);
  return static_cast<U>(std::max(std::min(x, y), std::min(std::max(x, y), z)));
}

/// The numbers that a transform codes or shuffles, one after the other, and
/// back. Sums and differences are modulo 2^bits.
template <Transform transform, std::unsigned_integral U>
class Residuals {
 public:
  /// `shift`: low bits that are 0 in all values, fewer than U has.
  explicit Residuals(int shift = 0) : shift_(shift) {}

  U Of(U value) {
    if constexpr (kScaled) value = static_cast<U>(value >> shift_);
    if constexpr (transform == Transform::kCoded) return value;
    const U difference = static_cast<U>(value - value_);
    const U residual = static_cast<U>(difference - Expected());
    Advance(value, difference);
    return kZigZag ? ZigZag(residual) : residual;
  }
  U ValueOf(U coded) {
    if constexpr (transform == Transform::kCoded) return coded;
    const U residual = kZigZag ? UnZigZag(coded) : coded;
    const U difference = static_cast<U>(residual + Expected());
    const U value = static_cast<U>(value_ + difference);
    Advance(value, difference);
    if constexpr (kScaled) return static_cast<U>(value << shift_);
    return value;
  }

 private:
  static constexpr bool kZigZag = transform != Transform::kAscendingCoded &&
                                  transform != Transform::kAscendingPacked;
  static constexpr bool kMedian = transform == Transform::kMedianCoded;
  static constexpr bool kHalves = IsOfHalves(transform);
  static constexpr bool kScaled = transform == Transform::kScaledHalvesCoded;

  U Expected() const {
    return kMedian ? Median(before_[0], before_[1], before_[2]) : U{0};
  }
  void Advance(U value, U difference) {
    if constexpr (kHalves) {
      value_ = other_;
      other_ = value;
    } else {
      value_ = value;
    }
    if constexpr (kMedian) before_ = {difference, before_[0], before_[1]};
  }

  const int shift_;
  /// The value that the next one is compared with.
  U value_ = 0;
  /// The last half.
  U other_ = 0;
  /// The last differences, the latest first.
  std::array<U, 3> before_{};
};

/// Low bits that are 0 in all values; 0 if all values are 0.
template <std::unsigned_integral U>
int CommonZeroBits(std::span<const std::byte> values) {
  U bits = 0;
  for (size_t i = 0; i < values.size() / sizeof(U); ++i) {
    bits = static_cast<U>(bits | Load<U>(values.data(), i));
  }
  return bits == 0 ? 0 : std::countr_zero(bits);
}

template <Transform transform, std::unsigned_integral U>
std::vector<U> ResidualsOf(std::span<const std::byte> values, int shift) {
  std::vector<U> result(values.size() / sizeof(U));
  Residuals<transform, U> residuals(shift);
  for (size_t i = 0; i < result.size(); ++i) {
    result[i] = residuals.Of(Load<U>(values.data(), i));
  }
  return result;
}

/// Calls f(std::integral_constant of the transform) for those of residuals.
template <typename F>
auto VisitResiduals(Transform transform, F&& f) {
  const auto call = [&]<Transform kind>() {
    return f(std::integral_constant<Transform, kind>());
  };
  switch (transform) {
    case Transform::kDeltaShuffle:
      return call.template operator()<Transform::kDeltaShuffle>();
    case Transform::kDeltaPacked:
      return call.template operator()<Transform::kDeltaPacked>();
    case Transform::kAscendingPacked:
      return call.template operator()<Transform::kAscendingPacked>();
    case Transform::kDeltaCoded:
      return call.template operator()<Transform::kDeltaCoded>();
    case Transform::kAscendingCoded:
      return call.template operator()<Transform::kAscendingCoded>();
    case Transform::kMedianCoded:
      return call.template operator()<Transform::kMedianCoded>();
    case Transform::kHalvesCoded:
      return call.template operator()<Transform::kHalvesCoded>();
    case Transform::kScaledHalvesCoded:
      return call.template operator()<Transform::kScaledHalvesCoded>();
    default:
      return call.template operator()<Transform::kCoded>();
  }
}

/// Bytes of the numbers that a transform of values of `width` bytes codes.
constexpr size_t CodedWidth(Transform transform, size_t width) {
  return IsOfHalves(transform) ? width / 2 : width;
}

template <std::unsigned_integral U>
void Shuffle(const std::byte* values, size_t count, std::byte* planes) {
  for (size_t i = 0; i < count; ++i) {
    const U value = Load<U>(values, i);
    for (size_t b = 0; b < sizeof(U); ++b) {
      planes[b * count + i] = static_cast<std::byte>(value >> (8 * b));
    }
  }
}

template <std::unsigned_integral U>
U LoadShuffled(const std::byte* planes, size_t count, size_t i) {
  U value = 0;
  for (size_t b = 0; b < sizeof(U); ++b) {
    value = static_cast<U>(
        value |
        static_cast<U>(static_cast<U>(planes[b * count + i]) << (8 * b)));
  }
  return value;
}

// The packed form: 16 upper bit lengths, one class number of 4 bits a value,
// then the bits of the values. A class covers the lengths above those of the
// class before it up to its own upper one.

constexpr size_t kClassCount = 16;
constexpr int kMaxLength = 64;

struct PackClasses {
  std::array<uint8_t, kClassCount> upper_length{};
  /// Bits that a value of the class takes, and what is added to them: a class
  /// of one length need not store the top bit.
  std::array<uint8_t, kClassCount> width{};
  std::array<uint64_t, kClassCount> base{};
};

/// Whether the class of lengths (below, upper] holds one length with a top
/// bit. `below` is -1 before the first class.
constexpr bool TopBitImplied(int below, int upper) {
  return upper == below + 1 && upper > 0;
}

constexpr int ClassWidth(int below, int upper) {
  return TopBitImplied(below, upper) ? upper - 1 : upper;
}

/// Completes `classes` from its upper lengths.
void DeriveWidths(PackClasses& classes) {
  int below = -1;
  for (size_t c = 0; c < kClassCount; ++c) {
    const int upper = classes.upper_length[c];
    classes.width[c] = static_cast<uint8_t>(ClassWidth(below, upper));
    classes.base[c] =
        TopBitImplied(below, upper) ? uint64_t{1} << (upper - 1) : 0;
    below = upper;
  }
}

/// Values of each bit length, 0 to 64.
using LengthCounts = std::array<uint64_t, kMaxLength + 1>;

/// The classes that need the fewest bits, by dynamic programming over (number
/// of classes, upper length of the last one).
PackClasses BestClasses(const LengthCounts& counts) {
  int longest = kMaxLength;
  while (longest > 0 && counts[static_cast<size_t>(longest)] == 0) --longest;
  const size_t end = static_cast<size_t>(longest) + 1;
  LengthCounts up_to = counts;
  for (size_t l = 1; l < end; ++l) up_to[l] += up_to[l - 1];

  std::array<LengthCounts, kClassCount> bits;
  std::array<std::array<uint8_t, kMaxLength + 1>, kClassCount> before;
  for (size_t upper = 0; upper < end; ++upper) {
    bits[0][upper] = up_to[upper] * static_cast<uint64_t>(ClassWidth(
                                        -1, static_cast<int>(upper)));
  }
  for (size_t c = 1; c < kClassCount; ++c) {
    for (size_t upper = c; upper < end; ++upper) {
      uint64_t best = std::numeric_limits<uint64_t>::max();
      for (size_t below = c - 1; below < upper; ++below) {
        const int width =
            ClassWidth(static_cast<int>(below), static_cast<int>(upper));
        const uint64_t total =
            bits[c - 1][below] +
            (up_to[upper] - up_to[below]) * static_cast<uint64_t>(width);
        if (total < best) {
          best = total;
          before[c][upper] = static_cast<uint8_t>(below);
        }
      }
      bits[c][upper] = best;
    }
  }

  const size_t most = std::min(kClassCount, end) - 1;
  size_t last = 0;
  for (size_t c = 1; c <= most; ++c) {
    if (bits[c][end - 1] < bits[last][end - 1]) last = c;
  }
  PackClasses result;
  result.upper_length.fill(static_cast<uint8_t>(longest));
  for (size_t c = last; c > 0; --c) {
    result.upper_length[c - 1] = before[c][result.upper_length[c]];
  }
  DeriveWidths(result);
  return result;
}

template <std::unsigned_integral U>
void AppendPacked(std::span<const U> values, std::vector<std::byte>& coded) {
  LengthCounts counts{};
  for (const U value : values) {
    ++counts[static_cast<size_t>(std::bit_width(value))];
  }
  const PackClasses classes = BestClasses(counts);
  std::array<uint8_t, kMaxLength + 1> class_of{};
  uint64_t bit_count = 0;
  for (size_t l = 0, c = 0; l <= classes.upper_length.back(); ++l) {
    while (l > classes.upper_length[c]) ++c;
    class_of[l] = static_cast<uint8_t>(c);
    bit_count += counts[l] * classes.width[c];
  }

  const size_t at = coded.size();
  const size_t control_bytes = (values.size() + 1) / 2;
  const size_t packed_bytes = static_cast<size_t>((bit_count + 7) / 8);
  // Whole words are stored, so up to 8 bytes more are written for a moment.
  coded.resize(at + kClassCount + control_bytes + packed_bytes + 8);
  std::memcpy(coded.data() + at, classes.upper_length.data(), kClassCount);
  std::byte* const control = coded.data() + at + kClassCount;
  std::byte* packed = control + control_bytes;
  uint64_t word = 0;
  unsigned filled = 0;
  for (size_t i = 0; i < values.size(); ++i) {
    const size_t c = class_of[static_cast<size_t>(std::bit_width(values[i]))];
    control[i / 2] |= static_cast<std::byte>(c << (4 * (i % 2)));
    const uint64_t bits = values[i] - classes.base[c];
    const unsigned width = classes.width[c];
    word |= bits << filled;
    filled += width;
    if (filled >= 64) {
      std::memcpy(packed, &word, 8);
      packed += 8;
      filled -= 64;
      word = filled == 0 ? 0 : bits >> (width - filled);
    }
  }
  std::memcpy(packed, &word, 8);
  coded.resize(at + kClassCount + control_bytes + packed_bytes);
}

absl::Status PackedError(const char* what, uint64_t expected, uint64_t actual) {
  return absl::DataLossError(absl::StrCat("packed values: ", what, " expected ",
                                          expected, ", have ", actual));
}

/// Up to 64 bits at any bit position; the caller guarantees that 9 bytes are
/// readable from the byte of `at` on.
inline uint64_t LoadBits(const std::byte* bytes, uint64_t at, unsigned width) {
  const std::byte* const first = bytes + at / 8;
  const unsigned shift = at % 8;
  uint64_t value = LoadLittleEndian<uint64_t>(first) >> shift;
  if (width + shift > 64) {
    value |= static_cast<uint64_t>(first[8]) << (64 - shift);
  }
  return width < 64 ? value & ((uint64_t{1} << width) - 1) : value;
}

template <std::unsigned_integral U, typename Use>
absl::Status Unpack(std::span<const std::byte> coded, size_t count,
                    const Use& use) {
  const size_t control_bytes = (count + 1) / 2;
  if (coded.size() < kClassCount + control_bytes) {
    return PackedError("bytes at least", kClassCount + control_bytes,
                       coded.size());
  }
  PackClasses classes;
  std::memcpy(classes.upper_length.data(), coded.data(), kClassCount);
  if (classes.upper_length.back() > 8 * sizeof(U)) {
    return PackedError("length at most", 8 * sizeof(U),
                       classes.upper_length.back());
  }
  if (!std::is_sorted(classes.upper_length.begin(),
                      classes.upper_length.end())) {
    return absl::DataLossError("packed values: class lengths decrease");
  }
  DeriveWidths(classes);

  const std::byte* const control = coded.data() + kClassCount;
  std::array<uint32_t, 256> pairs{};
  for (size_t i = 0; i < count / 2; ++i)
    ++pairs[static_cast<size_t>(control[i])];
  uint64_t bit_count = 0;
  for (size_t pair = 0; pair < pairs.size(); ++pair) {
    bit_count += uint64_t{pairs[pair]} * (uint64_t{classes.width[pair % 16]} +
                                          classes.width[pair / 16]);
  }
  if (count % 2 != 0) {
    const auto last = static_cast<size_t>(control[count / 2]);
    if (last >= kClassCount) {
      return PackedError("last class at most", kClassCount - 1, last);
    }
    bit_count += classes.width[last];
  }
  const auto packed = coded.subspan(kClassCount + control_bytes);
  if (packed.size() != (bit_count + 7) / 8) {
    return PackedError("bytes", (bit_count + 7) / 8, packed.size());
  }
  if (bit_count % 8 != 0 &&
      (static_cast<unsigned>(packed.back()) >> (bit_count % 8)) != 0) {
    return absl::DataLossError("packed values: the last bits are not zero");
  }

  uint64_t at = 0;
  const auto unpack_from = [&](const std::byte* bytes, size_t i) {
    const size_t c =
        (static_cast<size_t>(control[i / 2]) >> (4 * (i % 2))) & 0xf;
    const unsigned width = classes.width[c];
    use(i, static_cast<U>(classes.base[c] + LoadBits(bytes, at, width)));
    at += width;
  };
  size_t i = 0;
  // Nine bytes are readable below this bit.
  const uint64_t fast_end = packed.size() < 9 ? 0 : 8 * (packed.size() - 8);
  for (; i < count && at < fast_end; ++i) unpack_from(packed.data(), i);
  // The rest of the bits, with room behind them.
  std::array<std::byte, 24> tail{};
  const size_t tail_at = static_cast<size_t>(at / 8);
  std::memcpy(tail.data(), packed.data() + tail_at, packed.size() - tail_at);
  at %= 8;
  for (; i < count; ++i) unpack_from(tail.data(), i);
  return absl::OkStatus();
}

absl::Status CheckSize(std::span<const std::byte> coded,
                       std::span<std::byte> values) {
  if (coded.size() == values.size()) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat("values: expected ", values.size(),
                                          " bytes, have ", coded.size()));
}

/// The zero bits that scaled halves begin with.
template <std::unsigned_integral U>
absl::StatusOr<int> TakeShift(std::span<const std::byte>& coded) {
  constexpr int kBits = 8 * sizeof(U);
  const int shift = coded.empty() ? kBits : static_cast<int>(coded.front());
  if (shift >= kBits) {
    return absl::DataLossError(absl::StrCat(
        "scaled halves: expected fewer than ", kBits, " zero bits, have ",
        coded.empty() ? "no bytes" : absl::StrCat(shift)));
  }
  coded = coded.subspan(1);
  return shift;
}

}  // namespace

std::string_view TransformName(Transform transform) {
  switch (transform) {
    case Transform::kPlain:
      return "plain";
    case Transform::kShuffle:
      return "shuffle";
    case Transform::kDeltaShuffle:
      return "delta-shuffle";
    case Transform::kDeltaPacked:
      return "delta-packed";
    case Transform::kAscendingPacked:
      return "ascending-packed";
    case Transform::kCoded:
      return "coded";
    case Transform::kDeltaCoded:
      return "delta-coded";
    case Transform::kAscendingCoded:
      return "ascending-coded";
    case Transform::kMedianCoded:
      return "median-coded";
    case Transform::kHalvesCoded:
      return "halves-coded";
    case Transform::kScaledHalvesCoded:
      return "scaled-halves-coded";
  }
  return {};
}

CodedSizeRange CodedSizes(Transform transform, uint64_t count, size_t width) {
  const uint64_t bytes = count * width;
  switch (transform) {
    case Transform::kPlain:
    case Transform::kShuffle:
    case Transform::kDeltaShuffle:
      break;
    case Transform::kDeltaPacked:
    case Transform::kAscendingPacked: {
      const uint64_t least = kClassCount + (count + 1) / 2;
      return {least, least + bytes};
    }
    case Transform::kCoded:
    case Transform::kDeltaCoded:
    case Transform::kAscendingCoded:
    case Transform::kMedianCoded:
      // A code takes 11 bits at most, and what follows it 3 less than a value.
      return {2, kMaxTokenHeadBytes + count * (width + 1)};
    case Transform::kHalvesCoded:
      return {2, kMaxTokenHeadBytes + count * (width + 2)};
    case Transform::kScaledHalvesCoded:
      return {3, 1 + kMaxTokenHeadBytes + count * (width + 2)};
  }
  return {bytes, bytes};
}

void AppendTransformed(Transform transform, std::span<const std::byte> values,
                       size_t width, std::vector<std::byte>& coded) {
  if (transform == Transform::kPlain) {
    coded.insert(coded.end(), values.begin(), values.end());
    return;
  }
  VisitWidth(CodedWidth(transform, width), [&](auto zero) {
    using U = decltype(zero);
    const auto append_planes = [&](const std::byte* from) {
      const size_t at = coded.size();
      coded.resize(at + values.size());
      Shuffle<U>(from, values.size() / sizeof(U), coded.data() + at);
    };
    if (transform == Transform::kShuffle) {
      append_planes(values.data());
      return;
    }
    VisitResiduals(transform, [&](auto kind) {
      int shift = 0;
      if constexpr (kind() == Transform::kScaledHalvesCoded) {
        shift = CommonZeroBits<U>(values);
        coded.push_back(static_cast<std::byte>(shift));
      }
      const std::vector<U> residuals = ResidualsOf<kind(), U>(values, shift);
      if constexpr (kind() == Transform::kDeltaShuffle) {
        append_planes(AsBytes(residuals).data());
      } else if constexpr (IsCoded(kind())) {
        AppendTokenCoded(std::span<const U>(residuals), coded);
      } else {
        AppendPacked(std::span<const U>(residuals), coded);
      }
    });
  });
}

uint64_t CodedBytes(Transform transform, std::span<const std::byte> values,
                    size_t width) {
  return VisitWidth(CodedWidth(transform, width), [&](auto zero) -> uint64_t {
    using U = decltype(zero);
    return VisitResiduals(transform, [&](auto kind) -> uint64_t {
      if constexpr (!IsCoded(kind())) return values.size();
      constexpr bool kScaled = kind() == Transform::kScaledHalvesCoded;
      const int shift = kScaled ? CommonZeroBits<U>(values) : 0;
      const std::vector<U> residuals = ResidualsOf<kind(), U>(values, shift);
      return TokenCodedBytes(std::span<const U>(residuals)) + (kScaled ? 1 : 0);
    });
  });
}

absl::Status InvertTransform(Transform transform,
                             std::span<const std::byte> coded, size_t width,
                             std::span<std::byte> values) {
  if (TransformName(transform).empty() || !SuitsWidth(transform, width)) {
    return absl::DataLossError(
        absl::StrCat("transform ", static_cast<int>(transform),
                     " is not one of ", width, " bytes"));
  }
  return VisitWidth(CodedWidth(transform, width), [&](auto zero) {
    using U = decltype(zero);
    const size_t count = values.size() / sizeof(U);
    switch (transform) {
      case Transform::kPlain:
        MAPSIEVE_RETURN_IF_ERROR(CheckSize(coded, values));
        if (!coded.empty()) {
          std::memcpy(values.data(), coded.data(), coded.size());
        }
        return absl::OkStatus();
      case Transform::kShuffle:
        MAPSIEVE_RETURN_IF_ERROR(CheckSize(coded, values));
        for (size_t i = 0; i < count; ++i) {
          Store(values.data(), i, LoadShuffled<U>(coded.data(), count, i));
        }
        return absl::OkStatus();
      default:
        break;
    }
    return VisitResiduals(transform, [&](auto kind) -> absl::Status {
      int shift = 0;
      if constexpr (kind() == Transform::kScaledHalvesCoded) {
        MAPSIEVE_ASSIGN_OR_RETURN(shift, TakeShift<U>(coded));
      }
      Residuals<kind(), U> residuals(shift);
      const auto use = [&](size_t i, U value) {
        Store(values.data(), i, residuals.ValueOf(value));
      };
      if constexpr (kind() == Transform::kDeltaShuffle) {
        MAPSIEVE_RETURN_IF_ERROR(CheckSize(coded, values));
        for (size_t i = 0; i < count; ++i) {
          use(i, LoadShuffled<U>(coded.data(), count, i));
        }
        return absl::OkStatus();
      } else if constexpr (IsCoded(kind())) {
        return ReadTokenCoded<U>(coded, count, use);
      } else {
        return Unpack<U>(coded, count, use);
      }
    });
  });
}

}  // namespace mapsieve::core
