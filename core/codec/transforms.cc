#include "core/codec/transforms.h"

#include <algorithm>
#include <array>
#include <bit>
#include <concepts>
#include <cstring>
#include <limits>
#include <optional>

#include "core/base/bytes.h"
#include "core/base/status.h"

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

/// Differences modulo 2^bits; the first is that to zero.
template <std::unsigned_integral U>
std::vector<U> Differences(std::span<const std::byte> values, bool zigzag) {
  std::vector<U> result(values.size() / sizeof(U));
  U previous = 0;
  for (size_t i = 0; i < result.size(); ++i) {
    const U value = Load<U>(values.data(), i);
    const U difference = static_cast<U>(value - previous);
    result[i] = zigzag ? ZigZag(difference) : difference;
    previous = value;
  }
  return result;
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

template <std::unsigned_integral U>
absl::Status Unpack(std::span<const std::byte> coded, bool zigzag,
                    std::span<std::byte> values) {
  const size_t count = values.size() / sizeof(U);
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

  U value = 0;
  uint64_t at = 0;
  const auto unpack_from = [&](const std::byte* bytes, size_t i) {
    const size_t c =
        (static_cast<size_t>(control[i / 2]) >> (4 * (i % 2))) & 0xf;
    const unsigned width = classes.width[c];
    const U coded_value =
        static_cast<U>(classes.base[c] + LoadBits(bytes, at, width));
    at += width;
    value =
        static_cast<U>(value + (zigzag ? UnZigZag(coded_value) : coded_value));
    Store(values.data(), i, value);
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
  }
  return {bytes, bytes};
}

void AppendTransformed(Transform transform, std::span<const std::byte> values,
                       size_t width, std::vector<std::byte>& coded) {
  if (transform == Transform::kPlain) {
    coded.insert(coded.end(), values.begin(), values.end());
    return;
  }
  VisitWidth(width, [&](auto zero) {
    using U = decltype(zero);
    const size_t count = values.size() / sizeof(U);
    if (transform == Transform::kShuffle ||
        transform == Transform::kDeltaShuffle) {
      const size_t at = coded.size();
      coded.resize(at + values.size());
      if (transform == Transform::kShuffle) {
        Shuffle<U>(values.data(), count, coded.data() + at);
      } else {
        const std::vector<U> differences = Differences<U>(values, true);
        Shuffle<U>(AsBytes(differences).data(), count, coded.data() + at);
      }
    } else {
      const std::vector<U> differences =
          Differences<U>(values, transform == Transform::kDeltaPacked);
      AppendPacked(std::span<const U>(differences), coded);
    }
  });
}

absl::Status InvertTransform(Transform transform,
                             std::span<const std::byte> coded, size_t width,
                             std::span<std::byte> values) {
  return VisitWidth(width, [&](auto zero) -> absl::Status {
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
      case Transform::kDeltaShuffle: {
        MAPSIEVE_RETURN_IF_ERROR(CheckSize(coded, values));
        U value = 0;
        for (size_t i = 0; i < count; ++i) {
          const U difference =
              UnZigZag(LoadShuffled<U>(coded.data(), count, i));
          value = static_cast<U>(value + difference);
          Store(values.data(), i, value);
        }
        return absl::OkStatus();
      }
      case Transform::kDeltaPacked:
        return Unpack<U>(coded, true, values);
      case Transform::kAscendingPacked:
        return Unpack<U>(coded, false, values);
    }
    return absl::DataLossError(absl::StrCat(
        "transform ", static_cast<int>(transform), " is not known"));
  });
}

}  // namespace mapsieve::core
