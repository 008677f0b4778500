#include "core/codec/token_code.h"

#include <limits>
#include <random>
#include <vector>

#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

template <typename U>
std::vector<std::byte> Coded(const std::vector<U>& values) {
  std::vector<std::byte> coded;
  AppendTokenCoded(std::span<const U>(values), coded);
  EXPECT_EQ(TokenCodedBytes(std::span<const U>(values)), coded.size());
  return coded;
}

template <typename U>
absl::StatusOr<std::vector<U>> Read(std::span<const std::byte> coded,
                                    size_t count) {
  std::vector<U> values(count);
  MAPSIEVE_RETURN_IF_ERROR(ReadTokenCoded<U>(
      coded, count, [&](size_t i, U value) { values[i] = value; }));
  return values;
}

template <typename U>
void ExpectRoundTrip(const std::vector<U>& values) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<U> back,
                                Read<U>(Coded(values), values.size()));
  EXPECT_EQ(back, values);
}

TEST(TokenCode, TokensCoverAllValuesWithoutOverlap) {
  uint64_t next = 0;
  for (unsigned token = 0; token < kTokenCount; ++token) {
    EXPECT_EQ(TokenBase(token), next) << token;
    const uint64_t last = next + (uint64_t{1} << TokenLowBits(token)) - 1;
    EXPECT_EQ(TokenOf(next), token);
    EXPECT_EQ(TokenOf(last), token);
    next = last + 1;
  }
  EXPECT_EQ(next, 0u);  // 2^64
  for (const size_t width : {1, 2, 4, 8}) {
    EXPECT_EQ(TokenOf(std::numeric_limits<uint64_t>::max() >> (64 - 8 * width)),
              TokenCountOf(width) - 1);
  }
}

TEST(TokenCode, RoundTripsEveryTokenOfEveryWidth) {
  std::vector<uint64_t> values;
  for (unsigned token = 0; token < kTokenCount; ++token) {
    values.push_back(TokenBase(token));
    values.push_back(TokenBase(token) + (uint64_t{1} << TokenLowBits(token)) -
                     1);
  }
  ExpectRoundTrip(values);
  std::vector<uint8_t> bytes(values.begin(), values.begin() + 64);
  ExpectRoundTrip(bytes);
  std::vector<uint16_t> words(values.begin(), values.begin() + 128);
  ExpectRoundTrip(words);
  std::vector<uint32_t> longs(values.begin(), values.begin() + 256);
  ExpectRoundTrip(longs);
}

TEST(TokenCode, CodesStayWithin11BitsHoweverUnevenTheCounts) {
  // Counts like the Fibonacci numbers make the deepest of all Huffman trees.
  std::vector<uint32_t> values;
  size_t a = 1;
  size_t b = 1;
  for (uint32_t value = 0; value < 24; ++value) {
    values.insert(values.end(), a, value);
    a = std::exchange(b, a + b);
  }
  std::shuffle(values.begin(), values.end(), std::mt19937_64(1));
  ExpectRoundTrip(values);
}

TEST(TokenCode, ComesNearTheEntropy) {
  std::mt19937_64 random(2);
  std::geometric_distribution<uint32_t> distribution(0.3);
  std::vector<uint32_t> values(100'000);
  for (uint32_t& value : values) value = distribution(random);
  // The entropy of the distribution is 2.94 bits.
  EXPECT_LT(8 * Coded(values).size(), 3.0 * 100'000);
}

TEST(TokenCode, EqualSmallValuesTakeNoBits) {
  EXPECT_EQ(Coded(std::vector<uint64_t>(1000, 5)).size(), 1u + 3);
  ExpectRoundTrip(std::vector<uint64_t>(1000, 5));
  EXPECT_EQ(Coded(std::vector<uint8_t>()).size(), 2u);
  ExpectRoundTrip(std::vector<uint8_t>());
  // 4 low bits each, none of the code.
  EXPECT_EQ(Coded(std::vector<uint16_t>(1000, 100)).size(),
            1u + 14 + 12 + 1000 / 2);
}

TEST(TokenCode, RefusesTablesThatAreNoCode) {
  const std::vector<uint8_t> values = {0, 1, 2, 2};
  const auto expect_refused = [&](size_t at, int byte, const char* message) {
    auto coded = Coded(values);
    coded[at] = static_cast<std::byte>(byte);
    EXPECT_THAT(Read<uint8_t>(coded, values.size()),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr(message)));
  };
  // Three tokens with codes of 2, 2 and 1 bits.
  ASSERT_EQ(Coded(values)[0], std::byte{2});
  ASSERT_EQ(Coded(values)[1], std::byte{0x22});
  ASSERT_EQ(Coded(values)[2], std::byte{0x01});
  expect_refused(0, 32, "at most 32 tokens, have 33");
  expect_refused(0, 31, "complete code");
  expect_refused(1, 0x2c, "codes of at most 11 bits, have 12");
  expect_refused(1, 0x12, "complete code");
  expect_refused(1, 0x32, "complete code");
  expect_refused(1, 0x00, "bits of equal values");
  expect_refused(2, 0x00, "complete code");
  expect_refused(2, 0x11, "no code length behind the last");
  expect_refused(3, 200, "a stream of at most");
  expect_refused(3, 0, "to end at bit");
  expect_refused(Coded(values).size() - 1, 0x80, "last bits are not zero");
}

template <typename U>
void ExpectRefusedOrRead() {
  std::mt19937_64 random(3);
  std::vector<U> source(37);
  for (U& value : source) {
    value = static_cast<U>(random() >> random() % 64);
  }
  const auto coded = Coded(source);
  for (size_t at = 0; at < coded.size(); ++at) {
    for (int byte = 0; byte < 256; ++byte) {
      auto other = coded;
      other[at] = static_cast<std::byte>(byte);
      const auto values = Read<U>(other, source.size());
      EXPECT_TRUE(values.ok() || absl::IsDataLoss(values.status()))
          << values.status();
    }
  }
  for (size_t size = 0; size < coded.size(); ++size) {
    const std::vector<std::byte> cut(
        coded.begin(), coded.begin() + static_cast<ptrdiff_t>(size));
    EXPECT_THAT(Read<U>(cut, source.size()),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("expected")));
  }
}

TEST(TokenCode, ArbitraryBytesAreRefusedOrRead) {
  ExpectRefusedOrRead<uint8_t>();
  ExpectRefusedOrRead<uint16_t>();
  ExpectRefusedOrRead<uint32_t>();
  ExpectRefusedOrRead<uint64_t>();
}

TEST(TokenCode, OtherCountsAreRefused) {
  std::mt19937_64 random(4);
  std::vector<uint32_t> values(100);
  for (uint32_t& value : values) value = static_cast<uint32_t>(random() % 5000);
  const auto coded = Coded(values);
  for (const size_t count : {0, 1, 50, 90, 108, 150, 100'000}) {
    EXPECT_THAT(Read<uint32_t>(coded, count),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("expected")))
        << count;
  }
}

}  // namespace
}  // namespace mapsieve::core
