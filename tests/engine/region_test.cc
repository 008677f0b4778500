#include "server/engine/region.h"

#include <cmath>
#include <limits>
#include <random>

#include "gtest/gtest.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine {
namespace {

using core::Lattice;
using core::LatticeBox;
using core::LatticePoint;
using core::Point3;
using mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

Region MakeRegion(const RegionShape& shape, const Lattice& lattice) {
  auto region = Region::Make(shape, lattice);
  EXPECT_TRUE(region.ok()) << region.status();
  return *region;
}

TEST(Region, BoxTakesItsMinAndLeavesItsMax) {
  const Lattice lattice;
  const Region region =
      MakeRegion(Box{{-0.1, 0.2, 0.3}, {0.1, 0.7, 0.301}}, lattice);
  EXPECT_TRUE(region.Contains({-100, 200, 300}));
  EXPECT_FALSE(region.Contains({-101, 200, 300}));
  EXPECT_TRUE(region.Contains({99, 699, 300}));
  EXPECT_FALSE(region.Contains({100, 699, 300}));
  EXPECT_FALSE(region.Contains({99, 700, 300}));
  EXPECT_FALSE(region.Contains({99, 699, 301}));
}

TEST(Region, SphereTakesItsSurface) {
  const Lattice lattice(1'000'000'000);
  const Region region = MakeRegion(Sphere{{10, -20, 30}, 5}, lattice);
  EXPECT_TRUE(region.Contains({15, -20, 30}));
  EXPECT_TRUE(region.Contains({13, -24, 30}));
  EXPECT_FALSE(region.Contains({16, -20, 30}));
  EXPECT_FALSE(region.Contains({13, -24, 31}));
}

// For any step, the box on the lattice must hold exactly the points whose
// positions in double lie in the box.
TEST(Region, AgreesWithPositionsWhateverTheStep) {
  std::mt19937 random(3);
  for (const int64_t step_nm :
       {int64_t{1}, int64_t{333'333}, int64_t{1'000'000}, int64_t{7'654'321},
        int64_t{1'000'000'000}}) {
    const Lattice lattice(step_nm);
    for (int i = 0; i < 200; ++i) {
      const auto q = std::uniform_int_distribution<int64_t>(
          -(int64_t{1} << 41), int64_t{1} << 41)(random);
      // Ends on lattice coordinates, and beside them.
      const double end = lattice.Coordinate(q);
      for (const double x :
           {end, std::nextafter(end, 1e99), std::nextafter(end, -1e99)}) {
        const double far = lattice.Coordinate(q + 1000);
        const Region region =
            MakeRegion(Box{{x, -1e9, -1e9}, {far, 1e9, 1e9}}, lattice);
        for (int64_t n = q - 2; n <= q + 2; ++n) {
          EXPECT_EQ(region.Contains({n, 0, 0}), lattice.Coordinate(n) >= x)
              << step_nm << " " << n;
        }
        const Region below = MakeRegion(
            Box{{lattice.Coordinate(q - 1000), -1e9, -1e9}, {x, 1e9, 1e9}},
            lattice);
        for (int64_t n = q - 2; n <= q + 2; ++n) {
          EXPECT_EQ(below.Contains({n, 0, 0}), lattice.Coordinate(n) < x)
              << step_nm << " " << n;
        }
      }
    }
  }
}

TEST(Region, NoBoxThatItDoesNotMeetHoldsItsPointsAndOneItEnclosesNoOthers) {
  std::mt19937 random(5);
  const auto uniform = [&](int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(random);
  };
  const Lattice lattice(250'000'000);
  int enclosed = 0;
  int met = 0;
  int missed = 0;
  for (int i = 0; i < 3000; ++i) {
    const Point3 center = {static_cast<double>(uniform(-40, 40)) / 7,
                           static_cast<double>(uniform(-40, 40)) / 7,
                           static_cast<double>(uniform(-40, 40)) / 7};
    const Region region = MakeRegion(
        Sphere{center, static_cast<double>(uniform(1, 30)) / 8}, lattice);
    const LatticePoint min = {uniform(-30, 25), uniform(-30, 25),
                              uniform(-30, 25)};
    const LatticeBox box = {
        min,
        {min.x + uniform(1, 5), min.y + uniform(1, 5), min.z + uniform(1, 5)}};
    bool holds = false;
    bool holds_all = true;
    for (int64_t x = box.min.x; x < box.max.x; ++x) {
      for (int64_t y = box.min.y; y < box.max.y; ++y) {
        for (int64_t z = box.min.z; z < box.max.z; ++z) {
          holds = holds || region.Contains({x, y, z});
          holds_all = holds_all && region.Contains({x, y, z});
        }
      }
    }
    EXPECT_TRUE(!holds || region.Intersects(box));
    EXPECT_TRUE(holds_all || !region.Encloses(box));
    enclosed += region.Encloses(box);
    EXPECT_TRUE(!region.Encloses(box) || region.Intersects(box));
    ++(region.Intersects(box) ? met : missed);
  }
  EXPECT_GT(enclosed, 10);
  EXPECT_GT(met, 50);
  EXPECT_GT(missed, 50);
}

TEST(Region, IsEmptyOutsideTheLattice) {
  const Lattice lattice;
  const Region region =
      MakeRegion(Box{{1e30, 1e30, 1e30}, {2e30, 2e30, 2e30}}, lattice);
  EXPECT_FALSE(region.Intersects({{0, 0, 0}, {10, 10, 10}}));
  const Region all = MakeRegion(Sphere{{0, 0, 0}, 1e60}, lattice);
  EXPECT_TRUE(
      all.Contains({core::kLatticeLimit - 1, 1 - core::kLatticeLimit, 0}));
}

TEST(Region, RefusesWhatIsNoShape) {
  const Lattice lattice;
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInf = std::numeric_limits<double>::infinity();
  const auto code = absl::StatusCode::kInvalidArgument;
  EXPECT_THAT(Region::Make(Box{{0, 0, 0}, {1, kNan, 1}}, lattice),
              StatusIs(code, HasSubstr("box.max.y")));
  EXPECT_THAT(Region::Make(Box{{-kInf, 0, 0}, {1, 1, 1}}, lattice),
              StatusIs(code, HasSubstr("box.min.x")));
  EXPECT_THAT(Region::Make(Box{{0, 0, 1}, {1, 1, 1}}, lattice),
              StatusIs(code, HasSubstr("box.min.z is 1")));
  EXPECT_THAT(Region::Make(Box{{0, 2, 0}, {1, 1, 1}}, lattice),
              StatusIs(code, HasSubstr("min must be below max")));
  EXPECT_THAT(Region::Make(Sphere{{0, 0, kNan}, 1}, lattice),
              StatusIs(code, HasSubstr("sphere.center.z")));
  EXPECT_THAT(Region::Make(Sphere{{0, 0, 0}, 0}, lattice),
              StatusIs(code, HasSubstr("sphere.radius")));
  EXPECT_THAT(Region::Make(Sphere{{0, 0, 0}, kInf}, lattice),
              StatusIs(code, HasSubstr("sphere.radius")));
}

}  // namespace
}  // namespace mapsieve::engine
