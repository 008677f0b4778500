#include "core/codec/compression.h"

#include <random>
#include <vector>

#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

constexpr Compression kCompressions[] = {Compression::kNone, Compression::kLz4,
                                         Compression::kZstd};
constexpr Compression kCompressors[] = {Compression::kLz4, Compression::kZstd};

std::vector<std::byte> Pattern(size_t size) {
  std::vector<std::byte> bytes(size);
  for (size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::byte>(i % 7);
  return bytes;
}

TEST(Compression, GivesBackTheBytes) {
  for (const Compression compression : kCompressors) {
    for (const size_t size : {100, 4096, 300'000}) {
      const auto bytes = Pattern(size);
      const auto stored = Compress(compression, bytes);
      ASSERT_FALSE(stored.empty());
      EXPECT_LT(stored.size(), bytes.size());
      std::vector<std::byte> back(size);
      MAPSIEVE_ASSERT_OK(Decompress(compression, stored, back));
      EXPECT_EQ(back, bytes);
    }
  }
}

TEST(Compression, IsEmptyWhereItWouldNotShrink) {
  std::mt19937_64 random(1);
  std::vector<std::byte> bytes(5000);
  for (std::byte& b : bytes) b = static_cast<std::byte>(random());
  for (const Compression compression : kCompressions) {
    EXPECT_TRUE(Compress(compression, bytes).empty());
    EXPECT_TRUE(Compress(compression, {}).empty());
    EXPECT_TRUE(Compress(compression, std::span(bytes).first(1)).empty());
  }
  EXPECT_TRUE(Compress(Compression::kNone, Pattern(100)).empty());
}

TEST(Compression, RefusesAnyOtherSize) {
  const auto bytes = Pattern(1000);
  for (const Compression compression : kCompressions) {
    auto stored = Compress(compression, bytes);
    if (stored.empty()) stored = bytes;
    for (const size_t size : {0, 1, 999, 1001, 5000}) {
      std::vector<std::byte> back(size);
      EXPECT_THAT(Decompress(compression, stored, back),
                  StatusIs(absl::StatusCode::kDataLoss,
                           HasSubstr(absl::StrCat("expected ", size))))
          << CompressionName(compression) << " to " << size;
    }
    std::vector<std::byte> back(bytes.size());
    for (size_t size = 0; size < stored.size(); ++size) {
      EXPECT_THAT(
          Decompress(compression, std::span(stored).first(size), back),
          StatusIs(absl::StatusCode::kDataLoss, HasSubstr("expected 1000")));
    }
  }
}

}  // namespace
}  // namespace mapsieve::core
