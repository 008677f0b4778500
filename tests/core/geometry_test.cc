#include <algorithm>
#include <random>
#include <vector>

#include "core/geometry/cell_key.h"
#include "core/geometry/lattice.h"
#include "core/geometry/morton.h"
#include "gtest/gtest.h"

namespace mapsieve::core {
namespace {

TEST(Lattice, RoundsHalfToEven) {
  const Lattice metres(1'000'000'000);
  EXPECT_EQ(metres.Quantize({0.5, 1.5, -2.5}), (LatticePoint{0, 2, -2}));
  EXPECT_EQ(metres.Quantize({-0.5, 3.4999, 2.5001}), (LatticePoint{0, 3, 3}));
}

TEST(Lattice, EveryLatticePointComesBackAsItself) {
  std::mt19937_64 random(7);
  std::uniform_int_distribution<int64_t> coordinate(-kLatticeLimit + 1,
                                                    kLatticeLimit - 1);
  for (const int64_t step_nm : {int64_t{1}, int64_t{1000}, int64_t{1'000'000},
                                int64_t{10'000'000}, int64_t{304'800'610}}) {
    const Lattice lattice(step_nm);
    for (int i = 0; i < 20000; ++i) {
      const LatticePoint q{coordinate(random), coordinate(random),
                           coordinate(random)};
      ASSERT_EQ(lattice.Quantize(lattice.Position(q)), q) << step_nm;
    }
  }
}

TEST(Lattice, RefusesTheLimit) {
  const Lattice metres(1'000'000'000);
  const double limit = static_cast<double>(kLatticeLimit);
  EXPECT_FALSE(metres.Quantize({limit, 0, 0}).has_value());
  EXPECT_FALSE(metres.Quantize({0, -limit, 0}).has_value());
  EXPECT_TRUE(metres.Quantize({limit - 1, 1 - limit, 0}).has_value());
}

TEST(Morton, CodesAreTheInterleavedBits) {
  EXPECT_EQ(MortonCode(1, 0, 0), 1u);
  EXPECT_EQ(MortonCode(0, 1, 0), 2u);
  EXPECT_EQ(MortonCode(0, 0, 1), 4u);
  EXPECT_EQ(MortonCode(0x1fffff, 0x1fffff, 0x1fffff), (uint64_t{1} << 63) - 1);
  std::mt19937_64 random(3);
  for (int i = 0; i < 1000; ++i) {
    const uint64_t v = random() & 0x1fffff;
    ASSERT_EQ(GatherBits3(SpreadBits3(v)), v);
  }
}

TEST(Morton, OrderAgreesWithCodesAndPutsNegativeFirst) {
  std::mt19937_64 random(5);
  std::vector<LatticePoint> points;
  for (int i = 0; i < 300; ++i) {
    const auto small = [&] { return static_cast<int64_t>(random() % 9) - 4; };
    points.push_back({small(), small(), small()});
  }
  for (const LatticePoint& a : points) {
    for (const LatticePoint& b : points) {
      const auto code = [](const LatticePoint& q) {
        const auto biased = [](int64_t v) {
          return static_cast<uint64_t>(v + (1 << 20));
        };
        return MortonCode(biased(q.x), biased(q.y), biased(q.z));
      };
      ASSERT_EQ(MortonLess(a, b), code(a) < code(b));
    }
  }
}

TEST(CellKey, CoversItsLatticePointsBelowZeroToo) {
  std::mt19937_64 random(11);
  std::uniform_int_distribution<int64_t> coordinate(-1000, 1000);
  for (int i = 0; i < 1000; ++i) {
    const LatticePoint q{coordinate(random), coordinate(random),
                         coordinate(random)};
    for (const int level : {0, 3, 8, 15}) {
      const CellKey cell = CellKey::Of(q, level);
      ASSERT_TRUE(cell.box().Contains(q));
      ASSERT_EQ(CellKey::Of(cell.corner(), level), cell);
      ASSERT_EQ(cell.Ancestor(level + 2), CellKey::Of(q, level + 2));
    }
  }
}

TEST(LatticeBox, IntersectionIsHalfOpen) {
  const LatticeBox a{{0, 0, 0}, {10, 10, 10}};
  EXPECT_FALSE(a.Intersects({{10, 0, 0}, {20, 10, 10}}));
  EXPECT_TRUE(a.Intersects({{9, 9, 9}, {20, 10, 10}}));
  EXPECT_TRUE(a.Grown(1).Intersects({{10, 0, 0}, {20, 10, 10}}));
}

}  // namespace
}  // namespace mapsieve::core
