#ifndef MAPSIEVE_CORE_CODEC_TOKEN_CODE_H_
#define MAPSIEVE_CORE_CODEC_TOKEN_CODE_H_

#include <algorithm>
#include <array>
#include <bit>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/bytes.h"
#include "core/base/status.h"

/// Entropy coding of unsigned integers whose small values are frequent: the
/// magnitude of a value is a token with a Huffman code, the bits below follow
/// as they are. FORMAT.md describes the bytes. Used by transforms.h alone. All
/// functions are thread-safe.
namespace mapsieve::core {

inline constexpr size_t kTokenCount = 256;
inline constexpr unsigned kMaxTokenCodeBits = 11;

/// Below 16 a value is its own token; above, a token stands for the values
/// that agree in their length and the two bits behind the highest.
constexpr unsigned TokenOf(uint64_t value) {
  const unsigned low_bits =
      static_cast<unsigned>(std::bit_width(value | 16)) - 3;
  const unsigned token =
      4 * low_bits + 8 + (static_cast<unsigned>(value >> low_bits) & 3);
  return value < 16 ? static_cast<unsigned>(value) : token;
}

/// Bits that follow the code of a token.
constexpr unsigned TokenLowBits(unsigned token) {
  return token < 16 ? 0 : token / 4 - 2;
}

/// The smallest value of a token.
constexpr uint64_t TokenBase(unsigned token) {
  return token < 16 ? token
                    : (uint64_t{4} + (token & 3)) << TokenLowBits(token);
}

/// Tokens of values of `width` bytes.
constexpr size_t TokenCountOf(size_t width) { return 32 * width; }

/// Bytes that AppendTokenCoded takes at most beside those of whole bytes of
/// bits: code lengths, lengths of streams, and a last byte of each.
inline constexpr size_t kMaxTokenHeadBytes = 1 + kTokenCount / 2 + 4 * 4;

/// Bytes that AppendTokenCoded would append.
template <std::unsigned_integral U>
uint64_t TokenCodedBytes(std::span<const U> values);

/// Appends the table of code lengths and the bits of `values` to `coded`.
/// Deterministic.
template <std::unsigned_integral U>
void AppendTokenCoded(std::span<const U> values, std::vector<std::byte>& coded);

/// Where the code that begins a few bits ends, and what it stands for.
struct TokenEntry {
  uint8_t token = 0;
  uint8_t code_bits = 0;
  uint8_t low_bits = 0;
};

/// Value i is in stream i % kTokenStreams: a processor reads several at a time.
inline constexpr size_t kTokenStreams = 4;

/// Coded values that have been looked at, but for their bits.
struct TokenStreams {
  std::array<TokenEntry, size_t{1} << kMaxTokenCodeBits> entries;
  /// Whether all values are that of the first entry, and there are no bits.
  bool is_constant = false;
  /// The bits of all streams, and 24 bytes of room.
  std::vector<std::byte> bytes;
  /// The first bit of each stream, and behind the last.
  std::array<uint64_t, kTokenStreams + 1> begins{};

  /// kDataLoss: other streams than those that the values ended at.
  absl::Status CheckEnds(const std::array<uint64_t, kTokenStreams>& ends) const;
};

/// Reads what is in front of the bits of `count` values of `width` bytes.
/// kDataLoss: no complete prefix code, or impossible lengths.
absl::StatusOr<TokenStreams> ReadTokenStreams(std::span<const std::byte> coded,
                                              size_t width, size_t count);

/// Calls use(i, value) for the `count` values in `coded`, in order. kDataLoss
/// if `coded` is not the form of that many values, after any number of calls.
template <std::unsigned_integral U, typename Use>
absl::Status ReadTokenCoded(std::span<const std::byte> coded, size_t count,
                            const Use& use) {
  MAPSIEVE_ASSIGN_OR_RETURN(const TokenStreams streams,
                            ReadTokenStreams(coded, sizeof(U), count));
  std::array<uint64_t, kTokenCount> bases;
  for (unsigned token = 0; token < kTokenCount; ++token) {
    bases[token] = TokenBase(token);
  }
  if (streams.is_constant) {
    const U value = static_cast<U>(bases[streams.entries[0].token]);
    for (size_t i = 0; i < count; ++i) use(i, value);
    return absl::OkStatus();
  }
  const std::byte* const bytes = streams.bytes.data();
  const auto next = [&](uint64_t& at) {
    const uint64_t word =
        LoadLittleEndian<uint64_t>(bytes + at / 8) >> (at % 8);
    const TokenEntry entry = streams.entries[word % streams.entries.size()];
    uint64_t low = word >> entry.code_bits;
    if constexpr (sizeof(U) == 8) {
      if (entry.code_bits + entry.low_bits > 57) {
        const uint64_t from = at + entry.code_bits;
        low = LoadLittleEndian<uint64_t>(bytes + from / 8) >> (from % 8);
        low |= static_cast<uint64_t>(bytes[from / 8 + 8])
               << 1 << (63 - from % 8);
      }
    }
    at += unsigned{entry.code_bits} + entry.low_bits;
    return static_cast<U>(bases[entry.token] +
                          (low & ((uint64_t{1} << entry.low_bits) - 1)));
  };
  // A value has at most 72 bits, so from the end on all that is read is room.
  const uint64_t end = streams.begins.back();
  std::array<uint64_t, kTokenStreams> at;
  std::copy_n(streams.begins.begin(), kTokenStreams, at.begin());
  static_assert(kTokenStreams == 4);
  size_t i = 0;
  for (; i + 4 <= count; i += 4) {
    if (std::max({at[0], at[1], at[2], at[3]}) > end) break;
    const U a = next(at[0]);
    const U b = next(at[1]);
    const U c = next(at[2]);
    const U d = next(at[3]);
    use(i, a);
    use(i + 1, b);
    use(i + 2, c);
    use(i + 3, d);
  }
  for (; i < count && at[i % 4] <= end; ++i) use(i, next(at[i % 4]));
  return streams.CheckEnds(at);
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CODEC_TOKEN_CODE_H_
