#include "storage/tile_order.h"

#include <random>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;

// Cells of all levels, near zero, near the ends of the lattice and anywhere.
core::CellKey RandomCell(std::mt19937_64& random) {
  core::CellKey cell;
  cell.level = static_cast<int>(random() % (core::kMaxCellLevel + 1));
  const auto coordinate = [&] {
    constexpr int64_t kLimit = core::kLatticeLimit;
    int64_t q = static_cast<int64_t>(random() % (2 * kLimit)) - kLimit;
    if (random() % 3 == 0) q = static_cast<int64_t>(random() % 64) - 32;
    if (random() % 5 == 0) q = random() % 2 == 0 ? -kLimit : kLimit - 1;
    return q;
  };
  const core::LatticePoint q{coordinate(), coordinate(), coordinate()};
  return core::CellKey::Of(q, cell.level);
}

TEST(TileOrderKey, OrdersCellsAsCellKeyLess) {
  std::mt19937_64 random(1);
  for (int i = 0; i < 20'000; ++i) {
    const core::CellKey a = RandomCell(random);
    core::CellKey b = RandomCell(random);
    if (random() % 2 == 0) b = core::CellKey::Of(b.corner(), a.level);
    if (random() % 4 == 0) b.z = a.z;
    if (!IsValidCell(b)) continue;
    EXPECT_EQ(TileOrderKey(a) < TileOrderKey(b), core::CellKeyLess()(a, b))
        << a.ToString() << " " << b.ToString();
    EXPECT_EQ(TileOrderKey(a) == TileOrderKey(b), a == b);
  }
}

TEST(TileOrderKey, IsParsedBack) {
  std::mt19937_64 random(2);
  for (int i = 0; i < 5'000; ++i) {
    const core::CellKey cell = RandomCell(random);
    ASSERT_TRUE(IsValidCell(cell)) << cell.ToString();
    const std::string key = TileOrderKey(cell);
    EXPECT_EQ(key.size(), kTileOrderKeyBytes);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::CellKey parsed,
                                  ParseTileOrderKey(key));
    EXPECT_EQ(parsed, cell);
  }
}

TEST(TileOrderKey, BytesThatAreNoKeyAreDataLoss) {
  const std::string key = TileOrderKey({10, 1, -2, 3});
  EXPECT_THAT(ParseTileOrderKey(key.substr(1)),
              StatusIs(absl::StatusCode::kDataLoss, _));
  EXPECT_THAT(ParseTileOrderKey(key + "x"),
              StatusIs(absl::StatusCode::kDataLoss, _));
  EXPECT_THAT(ParseTileOrderKey(""), StatusIs(absl::StatusCode::kDataLoss, _));
  EXPECT_THAT(ParseTileOrderKey(std::string(kTileOrderKeyBytes, '\xff')),
              StatusIs(absl::StatusCode::kDataLoss, _));
  // Whatever is accepted is a cell.
  std::mt19937_64 random(3);
  for (int i = 0; i < 5'000; ++i) {
    std::string noise(kTileOrderKeyBytes, '\0');
    for (char& c : noise) c = static_cast<char>(random());
    noise[0] = static_cast<char>(random() % 44);
    if (random() % 2 == 0) noise[1] = static_cast<char>(random() % 8);
    const auto cell = ParseTileOrderKey(noise);
    if (cell.ok()) {
      EXPECT_EQ(TileOrderKey(*cell), noise);
    }
  }
}

TEST(IsValidCell, KnowsTheEndsOfTheLattice) {
  constexpr int64_t kEnd = core::kLatticeLimit;
  EXPECT_TRUE(IsValidCell({0, kEnd - 1, -kEnd, 0}));
  EXPECT_FALSE(IsValidCell({0, kEnd, 0, 0}));
  EXPECT_FALSE(IsValidCell({0, 0, -kEnd - 1, 0}));
  EXPECT_TRUE(IsValidCell({42, -1, 0, 0}));
  EXPECT_FALSE(IsValidCell({42, 1, 0, 0}));
  EXPECT_FALSE(IsValidCell({-1, 0, 0, 0}));
  EXPECT_FALSE(IsValidCell({44, 0, 0, 0}));
}

}  // namespace
}  // namespace mapsieve::storage
