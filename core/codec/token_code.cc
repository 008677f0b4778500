#include "core/codec/token_code.h"

#include <algorithm>
#include <cstring>
#include <memory>
#include <vector>

namespace mapsieve::core {
namespace {

using TokenCounts = std::array<uint64_t, kTokenCount>;
using CodeLengths = std::array<uint8_t, kTokenCount>;

/// The number of bits of each token's code; 0 where the token does not occur.
/// A token that is alone has 1, and its code is not written.
CodeLengths HuffmanLengths(TokenCounts counts) {
  struct Node {
    uint64_t count = 0;
    size_t parent = 0;
  };
  std::vector<uint8_t> tokens;
  for (size_t t = 0; t < kTokenCount; ++t) {
    if (counts[t] != 0) tokens.push_back(static_cast<uint8_t>(t));
  }
  CodeLengths lengths{};
  if (tokens.size() < 2) {
    for (const uint8_t token : tokens) lengths[token] = 1;
    return lengths;
  }
  while (true) {
    std::sort(tokens.begin(), tokens.end(), [&](uint8_t a, uint8_t b) {
      return counts[a] != counts[b] ? counts[a] < counts[b] : a < b;
    });
    // Leaves, then the nodes above them: both ascend, so the two smallest
    // without a parent are at the fronts.
    const size_t leaf_count = tokens.size();
    std::vector<Node> nodes(2 * leaf_count - 1);
    for (size_t i = 0; i < leaf_count; ++i) nodes[i].count = counts[tokens[i]];
    size_t leaf = 0;
    size_t inner = leaf_count;
    for (size_t made = leaf_count; made < nodes.size(); ++made) {
      for (int child = 0; child < 2; ++child) {
        const bool takes_leaf =
            leaf < leaf_count &&
            (inner == made || nodes[leaf].count <= nodes[inner].count);
        Node& node = nodes[takes_leaf ? leaf++ : inner++];
        node.parent = made;
        nodes[made].count += node.count;
      }
    }
    std::vector<unsigned> depths(nodes.size());
    unsigned deepest = 0;
    for (size_t i = nodes.size() - 1; i-- > 0;) {
      depths[i] = depths[nodes[i].parent] + 1;
      deepest = std::max(deepest, depths[i]);
    }
    if (deepest <= kMaxTokenCodeBits) {
      for (size_t i = 0; i < leaf_count; ++i) {
        lengths[tokens[i]] = static_cast<uint8_t>(depths[i]);
      }
      return lengths;
    }
    for (const uint8_t token : tokens) counts[token] = (counts[token] + 1) / 2;
  }
}

struct StreamCounts {
  std::array<TokenCounts, kTokenStreams> of_stream{};

  TokenCounts All() const {
    TokenCounts all{};
    for (const TokenCounts& counts : of_stream) {
      for (size_t t = 0; t < kTokenCount; ++t) all[t] += counts[t];
    }
    return all;
  }
};

template <std::unsigned_integral U>
StreamCounts CountTokens(std::span<const U> values) {
  StreamCounts counts;
  for (size_t i = 0; i < values.size(); ++i) {
    ++counts.of_stream[i % kTokenStreams][TokenOf(values[i])];
  }
  return counts;
}

bool IsAlone(const CodeLengths& lengths) {
  return std::count(lengths.begin(), lengths.end(), 0) + 1 ==
         static_cast<ptrdiff_t>(kTokenCount);
}

/// Tokens up to the last that has a code, at least one.
size_t UsedTokens(const CodeLengths& lengths) {
  size_t used = kTokenCount;
  while (used > 1 && lengths[used - 1] == 0) --used;
  return used;
}

uint64_t TableBytes(const CodeLengths& lengths) {
  return 1 + (UsedTokens(lengths) + 1) / 2;
}

/// Bytes of the bits of a stream.
uint64_t StreamBytes(const TokenCounts& counts, const CodeLengths& lengths) {
  const bool is_alone = IsAlone(lengths);
  uint64_t bits = 0;
  for (unsigned t = 0; t < kTokenCount; ++t) {
    bits += counts[t] * ((is_alone ? 0 : lengths[t]) + TokenLowBits(t));
  }
  return (bits + 7) / 8;
}

/// Whether the values have no bits: there are none, or one token without low
/// bits stands for all.
bool IsConstant(const CodeLengths& lengths) {
  const size_t last = UsedTokens(lengths) - 1;
  return lengths[last] == 0 ||
         (IsAlone(lengths) && TokenLowBits(static_cast<unsigned>(last)) == 0);
}

constexpr size_t kStreamLengthBytes = (kTokenStreams - 1) * sizeof(uint32_t);

/// Bytes of the lengths of the streams and of the streams.
uint64_t AllStreamBytes(const StreamCounts& counts,
                        const CodeLengths& lengths) {
  if (IsConstant(lengths)) return 0;
  uint64_t bytes = kStreamLengthBytes;
  for (const TokenCounts& of_stream : counts.of_stream) {
    bytes += StreamBytes(of_stream, lengths);
  }
  return bytes;
}

/// The canonical codes, the first bit lowest.
std::array<uint16_t, kTokenCount> ReversedCodes(const CodeLengths& lengths) {
  std::array<uint16_t, kTokenCount> codes{};
  unsigned code = 0;
  for (unsigned length = 1; length <= kMaxTokenCodeBits; ++length) {
    code <<= 1;
    for (size_t t = 0; t < kTokenCount; ++t) {
      if (lengths[t] != length) continue;
      unsigned reversed = 0;
      for (unsigned bit = 0; bit < length; ++bit) {
        reversed |= (code >> bit & 1) << (length - 1 - bit);
      }
      codes[t] = static_cast<uint16_t>(reversed);
      ++code;
    }
  }
  return codes;
}

/// Writes bits, the lowest first. Whole words are stored, so up to 8 bytes
/// behind the bits are written too.
class BitWriter {
 public:
  explicit BitWriter(std::byte* to) : to_(to) {}

  /// At most 57 bits.
  void Put(uint64_t bits, unsigned count) {
    word_ |= bits << filled_;
    std::memcpy(to_, &word_, sizeof(word_));
    filled_ += count;
    to_ += filled_ / 8;
    // At most 57 + 7 bits: a shift by 64 is left out.
    word_ = filled_ < 64 ? word_ >> (filled_ & ~7U) : 0;
    filled_ %= 8;
  }

 private:
  std::byte* to_;
  uint64_t word_ = 0;
  /// Bits of `word_` that are not behind `to_` yet, below 8.
  unsigned filled_ = 0;
};

struct Code {
  uint64_t base = 0;
  uint16_t bits = 0;
  uint8_t count = 0;
  uint8_t low_bits = 0;
};

std::array<Code, kTokenCount> CodesOf(const CodeLengths& lengths) {
  std::array<Code, kTokenCount> codes;
  const std::array<uint16_t, kTokenCount> reversed = ReversedCodes(lengths);
  const bool is_alone = IsAlone(lengths);
  for (unsigned t = 0; t < kTokenCount; ++t) {
    codes[t] = {TokenBase(t), reversed[t], is_alone ? uint8_t{0} : lengths[t],
                static_cast<uint8_t>(TokenLowBits(t))};
  }
  return codes;
}

/// Writes the lengths of the streams and the streams to `at`.
template <std::unsigned_integral U>
void WriteStreams(std::span<const U> values, const StreamCounts& counts,
                  const CodeLengths& lengths, std::byte* at) {
  const std::array<Code, kTokenCount> codes = CodesOf(lengths);
  std::array<uint32_t, kTokenStreams> bytes;
  std::array<size_t, kTokenStreams> begins;
  size_t end = 0;
  for (size_t s = 0; s < kTokenStreams; ++s) {
    bytes[s] = static_cast<uint32_t>(StreamBytes(counts.of_stream[s], lengths));
    begins[s] = end;
    end += bytes[s] + sizeof(uint64_t);
  }
  // All streams at once, as they are read: none waits for its last value. In
  // room of their own, since a writer may write behind its end.
  const auto room = std::make_unique_for_overwrite<std::byte[]>(end);
  const auto put = [&](BitWriter& writer, U value) {
    const Code& code = codes[TokenOf(value)];
    const uint64_t low = value - code.base;
    if (sizeof(U) == 8 && code.low_bits > 40) {
      writer.Put(code.bits, code.count);
      writer.Put(low & 0xffffffff, 32);
      writer.Put(low >> 32, code.low_bits - 32U);
    } else {
      writer.Put(code.bits | low << code.count,
                 unsigned{code.count} + code.low_bits);
    }
  };
  static_assert(kTokenStreams == 4);
  BitWriter a(room.get() + begins[0]);
  BitWriter b(room.get() + begins[1]);
  BitWriter c(room.get() + begins[2]);
  BitWriter d(room.get() + begins[3]);
  size_t i = 0;
  for (; i + 4 <= values.size(); i += 4) {
    put(a, values[i]);
    put(b, values[i + 1]);
    put(c, values[i + 2]);
    put(d, values[i + 3]);
  }
  if (i < values.size()) put(a, values[i]);
  if (i + 1 < values.size()) put(b, values[i + 1]);
  if (i + 2 < values.size()) put(c, values[i + 2]);
  std::byte* stream = at + kStreamLengthBytes;
  for (size_t s = 0; s < kTokenStreams; ++s) {
    if (s + 1 < kTokenStreams) {
      std::memcpy(at + s * sizeof(uint32_t), &bytes[s], sizeof(uint32_t));
    }
    std::memcpy(stream, room.get() + begins[s], bytes[s]);
    stream += bytes[s];
  }
}

}  // namespace

template <std::unsigned_integral U>
uint64_t TokenCodedBytes(std::span<const U> values) {
  const StreamCounts counts = CountTokens(values);
  const CodeLengths lengths = HuffmanLengths(counts.All());
  return TableBytes(lengths) + AllStreamBytes(counts, lengths);
}

template <std::unsigned_integral U>
void AppendTokenCoded(std::span<const U> values,
                      std::vector<std::byte>& coded) {
  const StreamCounts counts = CountTokens(values);
  const CodeLengths lengths = HuffmanLengths(counts.All());
  const size_t begin = coded.size();
  const size_t end =
      begin + static_cast<size_t>(TableBytes(lengths) +
                                  AllStreamBytes(counts, lengths));
  coded.resize(end + sizeof(uint64_t));
  const size_t used = UsedTokens(lengths);
  coded[begin] = static_cast<std::byte>(used - 1);
  std::byte* at = coded.data() + begin + 1;
  for (size_t t = 0; t < used; ++t) {
    at[t / 2] |= static_cast<std::byte>(lengths[t] << (4 * (t % 2)));
  }
  at += (used + 1) / 2;
  if (!IsConstant(lengths)) WriteStreams(values, counts, lengths, at);
  coded.resize(end);
}

absl::StatusOr<TokenStreams> ReadTokenStreams(std::span<const std::byte> coded,
                                              size_t width, size_t count) {
  if (coded.size() < 2) {
    return absl::DataLossError(absl::StrCat(
        "coded values: expected at least 2 bytes, have ", coded.size()));
  }
  const size_t used = static_cast<size_t>(coded[0]) + 1;
  if (used > TokenCountOf(width)) {
    return absl::DataLossError(absl::StrCat("coded values: expected at most ",
                                            TokenCountOf(width),
                                            " tokens, have ", used));
  }
  const size_t table_bytes = 1 + (used + 1) / 2;
  if (coded.size() < table_bytes) {
    return absl::DataLossError(absl::StrCat("coded values: expected at least ",
                                            table_bytes, " bytes, have ",
                                            coded.size()));
  }
  TokenStreams streams;
  CodeLengths lengths{};
  uint64_t shares = 0;
  for (size_t t = 0; t < used; ++t) {
    lengths[t] = static_cast<uint8_t>(
        static_cast<unsigned>(coded[1 + t / 2]) >> (4 * (t % 2)) & 0xf);
    if (lengths[t] > kMaxTokenCodeBits) {
      return absl::DataLossError(
          absl::StrCat("coded values: expected codes of at most ",
                       kMaxTokenCodeBits, " bits, have ", lengths[t]));
    }
    if (lengths[t] != 0) shares += streams.entries.size() >> lengths[t];
  }
  if (used % 2 != 0 && static_cast<unsigned>(coded[1 + used / 2]) > 0xf) {
    return absl::DataLossError(
        "coded values: expected no code length behind the last");
  }
  const bool is_alone = IsAlone(lengths);
  const bool is_empty = shares == 0 && count == 0;
  if (is_alone ? lengths[used - 1] != 1
               : !is_empty && shares != streams.entries.size()) {
    return absl::DataLossError(
        absl::StrCat("coded values: expected a complete code, have one of ",
                     shares, " in ", streams.entries.size(), " parts"));
  }
  const std::array<uint16_t, kTokenCount> codes = ReversedCodes(lengths);
  for (size_t t = 0; t < used; ++t) {
    if (lengths[t] == 0) continue;
    const unsigned code_bits = is_alone ? 0 : lengths[t];
    for (size_t i = is_alone ? 0 : codes[t]; i < streams.entries.size();
         i += size_t{1} << code_bits) {
      streams.entries[i] = {
          static_cast<uint8_t>(t), static_cast<uint8_t>(code_bits),
          static_cast<uint8_t>(TokenLowBits(static_cast<unsigned>(t)))};
    }
  }
  streams.is_constant = IsConstant(lengths);
  const size_t length_bytes = streams.is_constant ? 0 : kStreamLengthBytes;
  if (coded.size() - table_bytes < length_bytes) {
    return absl::DataLossError(absl::StrCat("coded values: expected at least ",
                                            table_bytes + length_bytes,
                                            " bytes, have ", coded.size()));
  }
  const auto bits = coded.subspan(table_bytes + length_bytes);
  if (streams.is_constant) {
    if (bits.empty()) return streams;
    return absl::DataLossError(
        absl::StrCat("coded values: expected no bits of equal values, have ",
                     bits.size(), " bytes"));
  }
  size_t rest = bits.size();
  for (size_t s = 0; s + 1 < kTokenStreams; ++s) {
    const auto bytes = LoadLittleEndian<uint32_t>(coded.data() + table_bytes +
                                                  s * sizeof(uint32_t));
    if (bytes > rest) {
      return absl::DataLossError(
          absl::StrCat("coded values: expected a stream of at most ", rest,
                       " bytes, have one of ", bytes));
    }
    rest -= bytes;
    streams.begins[s + 1] = streams.begins[s] + 8 * uint64_t{bytes};
  }
  streams.begins[kTokenStreams] = 8 * uint64_t{bits.size()};
  constexpr size_t kRoom = 24;
  streams.bytes.reserve(bits.size() + kRoom);
  streams.bytes.assign(bits.begin(), bits.end());
  streams.bytes.resize(bits.size() + kRoom);
  return streams;
}

absl::Status TokenStreams::CheckEnds(
    const std::array<uint64_t, kTokenStreams>& ends) const {
  for (size_t s = 0; s < kTokenStreams; ++s) {
    const uint64_t end = begins[s + 1];
    if (ends[s] > end || ends[s] + 7 < end || ends[s] < begins[s]) {
      return absl::DataLossError(
          absl::StrCat("coded values: expected stream ", s, " to end at bit ",
                       end, " of all, have its values end at ", ends[s]));
    }
    if (ends[s] % 8 != 0 &&
        static_cast<unsigned>(bytes[ends[s] / 8]) >> (ends[s] % 8) != 0) {
      return absl::DataLossError("coded values: the last bits are not zero");
    }
  }
  return absl::OkStatus();
}

template uint64_t TokenCodedBytes(std::span<const uint8_t>);
template uint64_t TokenCodedBytes(std::span<const uint16_t>);
template uint64_t TokenCodedBytes(std::span<const uint32_t>);
template uint64_t TokenCodedBytes(std::span<const uint64_t>);
template void AppendTokenCoded(std::span<const uint8_t>,
                               std::vector<std::byte>&);
template void AppendTokenCoded(std::span<const uint16_t>,
                               std::vector<std::byte>&);
template void AppendTokenCoded(std::span<const uint32_t>,
                               std::vector<std::byte>&);
template void AppendTokenCoded(std::span<const uint64_t>,
                               std::vector<std::byte>&);

}  // namespace mapsieve::core
