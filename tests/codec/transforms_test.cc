#include "core/codec/transforms.h"

#include <cstring>
#include <random>
#include <vector>

#include "core/base/bytes.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr size_t kWidths[] = {1, 2, 4, 8};

/// The low `width` bytes of every value.
std::vector<std::byte> Values(const std::vector<uint64_t>& values,
                              size_t width) {
  std::vector<std::byte> bytes(values.size() * width);
  for (size_t i = 0; i < values.size(); ++i) {
    std::memcpy(bytes.data() + i * width, &values[i], width);
  }
  return bytes;
}

std::vector<std::byte> Transformed(Transform transform,
                                   std::span<const std::byte> values,
                                   size_t width) {
  std::vector<std::byte> coded;
  AppendTransformed(transform, values, width, coded);
  return coded;
}

std::vector<std::byte> Bytes(std::initializer_list<int> values) {
  std::vector<std::byte> bytes;
  for (const int value : values) bytes.push_back(static_cast<std::byte>(value));
  return bytes;
}

void ExpectRoundTrip(const std::vector<uint64_t>& values) {
  for (const size_t width : kWidths) {
    const std::vector<std::byte> bytes = Values(values, width);
    for (const Transform transform : kTransforms) {
      if (!SuitsWidth(transform, width)) continue;
      SCOPED_TRACE(::testing::Message()
                   << TransformName(transform) << ", " << values.size()
                   << " values of " << width << " bytes");
      const auto coded = Transformed(transform, bytes, width);
      const CodedSizeRange sizes = CodedSizes(transform, values.size(), width);
      EXPECT_GE(coded.size(), sizes.min);
      EXPECT_LE(coded.size(), sizes.max);
      if (IsCoded(transform)) {
        EXPECT_EQ(CodedBytes(transform, bytes, width), coded.size());
      }
      std::vector<std::byte> back(bytes.size(), std::byte{0xaa});
      MAPSIEVE_ASSERT_OK(InvertTransform(transform, coded, width, back));
      EXPECT_EQ(back, bytes);
    }
  }
}

TEST(Transforms, RoundTripValuesOfEveryLength) {
  std::mt19937_64 random(1);
  for (const size_t count : {0, 1, 2, 3, 16, 17, 255, 1000}) {
    for (unsigned longest = 0; longest <= 64; ++longest) {
      std::vector<uint64_t> values(count);
      for (uint64_t& value : values) {
        const uint64_t length = random() % (longest + 1);
        value = length == 0 ? 0 : random() >> (64 - length);
      }
      ExpectRoundTrip(values);
    }
  }
}

TEST(Transforms, RoundTripSortedAndAlternatingExtremes) {
  std::vector<uint64_t> ascending;
  for (uint64_t i = 0; i < 64; ++i) ascending.push_back(uint64_t{1} << i);
  ExpectRoundTrip(ascending);
  ExpectRoundTrip({ascending.rbegin(), ascending.rend()});
  ExpectRoundTrip(std::vector<uint64_t>(77, ~uint64_t{0}));
  std::vector<uint64_t> alternating(100);
  for (size_t i = 0; i < alternating.size(); i += 2) alternating[i] = ~i;
  ExpectRoundTrip(alternating);
}

TEST(Transforms, AppendBehindWhatIsThere) {
  const auto values = Values({1, 2, 3, 4}, 4);
  for (const Transform transform : kTransforms) {
    std::vector<std::byte> coded = Bytes({9, 8, 7});
    AppendTransformed(transform, values, 4, coded);
    auto expected = Bytes({9, 8, 7});
    const auto alone = Transformed(transform, values, 4);
    expected.insert(expected.end(), alone.begin(), alone.end());
    EXPECT_EQ(coded, expected) << TransformName(transform);
  }
}

// The next three say in bytes what FORMAT.md says in words.

TEST(Transforms, ShuffleGathersBytesOfOneWeight) {
  const auto values = Values({0x0102, 0x0304, 0x0506}, 2);
  EXPECT_EQ(Transformed(Transform::kShuffle, values, 2),
            Bytes({2, 4, 6, 1, 3, 5}));
}

TEST(Transforms, DeltaShuffleZigzagsTheDifferences) {
  // Differences 5, -1, 1, -2 modulo 2^16.
  const auto values = Values({5, 4, 5, 3}, 2);
  EXPECT_EQ(Transformed(Transform::kDeltaShuffle, values, 2),
            Bytes({10, 1, 2, 3, 0, 0, 0, 0}));
}

TEST(Transforms, PackedValuesReadByTheirClasses) {
  // Classes: length 0; length 1; lengths 2 and 3 in 3 bits; length 4, whose
  // top bit is implied, in 3 bits; the others are not used.
  const auto coded = Bytes({0, 1, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4,
                            4,  //
                                // Class numbers 0, 1, 2, 3, 2, low half first.
                            0x10, 0x32, 0x02,
                            // Bits: none, none, 6, 9 - 8, 3, lowest first.
                            0b11001110, 0});
  std::vector<std::byte> values(5);
  MAPSIEVE_ASSERT_OK(
      InvertTransform(Transform::kAscendingPacked, coded, 1, values));
  // Sums of 0, 1, 6, 9, 3.
  EXPECT_EQ(values, Bytes({0, 1, 7, 16, 19}));
}

/// A table of one code bit for each of two tokens, then four streams.
std::vector<std::byte> TwoTokens(int low, int high,
                                 std::initializer_list<int> streams) {
  std::vector<std::byte> coded(static_cast<size_t>(1 + high / 2 + 1));
  coded[0] = static_cast<std::byte>(high);
  for (const int token : {low, high}) {
    coded[static_cast<size_t>(1 + token / 2)] |=
        static_cast<std::byte>(1 << (4 * (token % 2)));
  }
  for (const int byte : {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}) {
    coded.push_back(static_cast<std::byte>(byte));
  }
  for (const int stream : streams) {
    coded.push_back(static_cast<std::byte>(stream));
  }
  return coded;
}

/// What `transform` makes of `values` of one byte, and back.
void ExpectCoded(Transform transform, std::initializer_list<int> values,
                 const std::vector<std::byte>& expected, size_t width) {
  EXPECT_EQ(Transformed(transform, Bytes(values), width), expected);
  std::vector<std::byte> back(values.size());
  MAPSIEVE_ASSERT_OK(InvertTransform(transform, expected, width, back));
  EXPECT_EQ(back, Bytes(values));
}

TEST(Transforms, CodedValuesReadByTheirTokens) {
  // Token 3 has code 0; token 19, values 28 to 31, code 1 and 2 low bits. The
  // streams take turns: 3 3; 31; 29; 28.
  ExpectCoded(Transform::kCoded, {3, 31, 29, 28, 3},
              TwoTokens(3, 19, {0b00, 0b111, 0b011, 0b001}), 1);
}

TEST(Transforms, CodedResidualsAreThoseOfTheFormat) {
  // Differences 2, 0, 0, 2.
  ExpectCoded(Transform::kAscendingCoded, {2, 2, 2, 4},
              TwoTokens(0, 2, {1, 0, 0, 1}), 1);
  // Differences 1, -1, -1, 1: zigzag 2, 1, 1, 2.
  ExpectCoded(Transform::kDeltaCoded, {1, 0, 255, 0},
              TwoTokens(1, 2, {1, 0, 0, 1}), 1);
  // Differences 0, 1, 1, 1; medians of the three before 0, 0, 0, 1.
  ExpectCoded(Transform::kMedianCoded, {0, 1, 2, 3},
              TwoTokens(0, 2, {0, 1, 1, 0}), 1);
  // Low halves 1, 1; high halves 0, 1.
  ExpectCoded(Transform::kHalvesCoded, {1, 0, 1, 1},
              TwoTokens(0, 2, {1, 0, 0, 1}), 2);
  // The same but for two zero bits below.
  auto scaled = TwoTokens(0, 2, {1, 0, 0, 1});
  scaled.insert(scaled.begin(), std::byte{2});
  ExpectCoded(Transform::kScaledHalvesCoded, {4, 0, 4, 4}, scaled, 2);
}

TEST(Transforms, ScaledHalvesDoNotPayForZeroBits) {
  std::mt19937_64 random(5);
  std::vector<uint64_t> values(1000);
  for (uint64_t& v : values) v = (random() & 0x0fff'0fff) << 4;
  const auto bytes = Values(values, 4);
  // Of four bits less for each half, differences, which do not wrap around any
  // more, take one back.
  EXPECT_LT(Transformed(Transform::kScaledHalvesCoded, bytes, 4).size() + 700,
            Transformed(Transform::kHalvesCoded, bytes, 4).size());
}

TEST(Transforms, RefuseMoreZeroBitsThanAHalfHas) {
  auto coded = Transformed(Transform::kScaledHalvesCoded, Values({1, 2}, 2), 2);
  std::vector<std::byte> back(4);
  coded[0] = std::byte{8};
  EXPECT_THAT(InvertTransform(Transform::kScaledHalvesCoded, coded, 2, back),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("expected fewer than 8 zero bits, have 8")));
}

TEST(Transforms, EqualResidualsTakeNoBits) {
  // Token 7 alone.
  const auto coded = Bytes({7, 0, 0, 0, 0x10});
  ExpectCoded(Transform::kCoded, {7, 7, 7, 7, 7, 7}, coded, 1);
  ExpectCoded(Transform::kAscendingCoded, {7, 14, 21}, coded, 1);
}

TEST(Transforms, PackedFormIsSmallForSmallDifferences) {
  std::mt19937_64 random(2);
  std::vector<uint64_t> values(10'000);
  uint64_t value = uint64_t{1} << 62;
  for (uint64_t& v : values) v = value += random() % 256;
  const auto bytes = Values(values, 8);
  const size_t ascending =
      Transformed(Transform::kAscendingPacked, bytes, 8).size();
  const size_t zigzag = Transformed(Transform::kDeltaPacked, bytes, 8).size();
  // 4 bits of class and 8 bits at most of value, less the implied top bits.
  EXPECT_LT(8 * ascending, 11 * values.size());
  // The sign costs one bit each.
  EXPECT_GT(8 * zigzag, 8 * ascending + values.size() - 100);
}

TEST(Transforms, RefuseCodedBytesOfAnotherSize) {
  const auto values = Values({1, 20, 300, 4000, 50'000}, 4);
  for (const Transform transform : kTransforms) {
    const auto coded = Transformed(transform, values, 4);
    std::vector<std::byte> back(values.size());
    for (size_t size = 0; size <= coded.size() + 3; ++size) {
      if (size == coded.size()) continue;
      std::vector<std::byte> other = coded;
      other.resize(size);
      EXPECT_THAT(InvertTransform(transform, other, 4, back),
                  StatusIs(absl::StatusCode::kDataLoss,
                           AllOf(HasSubstr("expected"), HasSubstr("have"))))
          << TransformName(transform) << ", " << size << " bytes";
    }
  }
}

TEST(Transforms, RefuseAnUnknownNumber) {
  std::vector<std::byte> values(4);
  EXPECT_THAT(InvertTransform(static_cast<Transform>(11), values, 4, values),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("transform 11")));
  EXPECT_TRUE(TransformName(static_cast<Transform>(11)).empty());
}

TEST(Transforms, RefuseHalvesOfOneByte) {
  std::vector<std::byte> values(4);
  EXPECT_THAT(InvertTransform(Transform::kHalvesCoded, values, 1, values),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("transform 9")));
}

TEST(PackedValues, RefuseClassesThatAreNone) {
  const auto values = Values({1, 2, 3}, 2);
  const auto coded = Transformed(Transform::kAscendingPacked, values, 2);
  std::vector<std::byte> back(values.size());
  const auto expect_refused = [&](size_t at, int byte, const char* message) {
    auto other = coded;
    other[at] = static_cast<std::byte>(byte);
    EXPECT_THAT(InvertTransform(Transform::kAscendingPacked, other, 2, back),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr(message)));
  };
  expect_refused(15, 17, "length at most expected 16, have 17");
  expect_refused(0, 9, "class lengths decrease");
  expect_refused(17, 0x10, "last class");
}

TEST(PackedValues, RefuseBitsBeyondTheLast) {
  const auto values = Values({1, 3, 8}, 2);
  auto coded = Transformed(Transform::kAscendingPacked, values, 2);
  coded.back() |= std::byte{0x80};
  std::vector<std::byte> back(values.size());
  EXPECT_THAT(InvertTransform(Transform::kAscendingPacked, coded, 2, back),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("not zero")));
}

TEST(PackedValues, ArbitraryBytesAreRefusedOrRead) {
  std::mt19937_64 random(3);
  std::vector<uint64_t> source(40);
  for (uint64_t& value : source) value = random() >> random() % 64;
  for (const size_t width : kWidths) {
    const auto values = Values(source, width);
    const auto coded = Transformed(Transform::kDeltaPacked, values, width);
    for (size_t at = 0; at < coded.size(); ++at) {
      for (int byte = 0; byte < 256; ++byte) {
        auto other = coded;
        other[at] = static_cast<std::byte>(byte);
        std::vector<std::byte> back(values.size());
        const absl::Status status =
            InvertTransform(Transform::kDeltaPacked, other, width, back);
        EXPECT_TRUE(status.ok() || absl::IsDataLoss(status)) << status;
      }
    }
  }
}

}  // namespace
}  // namespace mapsieve::core
