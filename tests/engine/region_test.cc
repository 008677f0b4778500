#include "server/engine/region.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <random>
#include <utility>
#include <variant>
#include <vector>

#include "gtest/gtest.h"
#include "server/engine/field_error.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine {
namespace {

using core::Lattice;
using core::LatticeBox;
using core::LatticePoint;
using core::Point3;
using mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

Region MakeRegion(const QueryShape& shape, const Lattice& lattice) {
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

/// Makes shapes of all kinds, within 8 of the origin.
class ShapeMaker {
 public:
  explicit ShapeMaker(std::mt19937& random) : random_(random) {}

  double Number(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  Point3 Place() { return {Number(-6, 6), Number(-6, 6), Number(-6, 6)}; }
  Quaternion Turn() {
    const double q[] = {Number(-1, 1), Number(-1, 1), Number(-1, 1),
                        Number(0.1, 1)};
    const double length =
        std::hypot(std::hypot(q[0], q[1]), std::hypot(q[2], q[3]));
    return {q[0] / length, q[1] / length, q[2] / length, q[3] / length};
  }
  std::optional<double> Limit(double low, double high) {
    if (Number(0, 1) < 0.2) return std::nullopt;
    return Number(low, high);
  }
  /// A star around the origin: simple, and not convex.
  PolygonPrism Star() {
    PolygonPrism prism{.min_z = Limit(-6, -1), .max_z = Limit(0, 6)};
    const auto count = static_cast<int>(Number(3, 12));
    const double sense = Number(0, 1) < 0.5 ? 1 : -1;
    for (int i = 0; i < count; ++i) {
      const double angle = sense * 2 * std::numbers::pi * i / count;
      const double radius = Number(1, 8);
      prism.vertices.push_back(
          {radius * std::cos(angle), radius * std::sin(angle)});
    }
    return prism;
  }
  QueryShape Make(int kind) {
    switch (kind) {
      case 0: {
        const Point3 min = Place();
        return Box{min,
                   {min.x + Number(0.1, 8), min.y + Number(0.1, 8),
                    min.z + Number(0.1, 8)}};
      }
      case 1:
        return Sphere{Place(), Number(0.1, 4)};
      case 2:
        return OrientedBox{
            Place(), Turn(), {Number(0.1, 5), Number(0.1, 5), Number(0.1, 5)}};
      case 3:
        return VerticalCylinder{.center_x = Number(-5, 5),
                                .center_y = Number(-5, 5),
                                .radius = Number(0.2, 5),
                                .min_z = Limit(-6, -1),
                                .max_z = Limit(0, 6)};
      case 4:
        return Star();
      case 5: {
        const double near = Number(0, 2);
        return Frustum{Place(),        Turn(), Number(0.1, 2),
                       Number(0.1, 2), near,   near + Number(0.5, 9)};
      }
      default: {
        Corridor corridor{.radius = Number(0.2, 3)};
        const auto count = static_cast<int>(Number(2, 6));
        for (int i = 0; i < count; ++i) corridor.path.push_back(Place());
        if (Number(0, 1) < 0.3) corridor.path.push_back(corridor.path.back());
        return corridor;
      }
    }
  }

  static constexpr int kKinds = 7;

 private:
  std::mt19937& random_;
};

TEST(Region, NoBoxThatItDoesNotMeetHoldsItsPointsAndOneItEnclosesNoOthers) {
  std::mt19937 random(5);
  const auto uniform = [&](int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(random);
  };
  const Lattice lattice(250'000'000);
  ShapeMaker maker(random);
  for (int kind = 0; kind < ShapeMaker::kKinds; ++kind) {
    SCOPED_TRACE(kind);
    int enclosed = 0;
    int met = 0;
    int missed = 0;
    // Boxes that are said to be met and hold none of its points.
    int in_vain = 0;
    for (int i = 0; i < 3000; ++i) {
      const Region region = MakeRegion(maker.Make(kind), lattice);
      const LatticePoint min = {uniform(-30, 25), uniform(-30, 25),
                                uniform(-30, 25)};
      const LatticeBox box = {min,
                              {min.x + uniform(1, 5), min.y + uniform(1, 5),
                               min.z + uniform(1, 5)}};
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
      in_vain += region.Intersects(box) && !holds ? 1 : 0;
    }
    EXPECT_GT(enclosed, 10);
    EXPECT_GT(met, 50);
    EXPECT_GT(missed, 50);
    EXPECT_LT(in_vain, missed / 2);
  }
}

// The shapes as their definitions say, with other arithmetic.

using Wide = long double;

/// Coordinates of p - origin in the frame of a quaternion, by q* v q.
std::array<Wide, 3> InFrame(const Quaternion& q, const Point3& origin,
                            const Point3& p) {
  const Wide v[] = {Wide{p.x} - origin.x, Wide{p.y} - origin.y,
                    Wide{p.z} - origin.z};
  const Wide u[] = {-q.x, -q.y, -q.z};
  const auto cross = [](const Wide* a, const Wide* b) {
    return std::array<Wide, 3>{a[1] * b[2] - a[2] * b[1],
                               a[2] * b[0] - a[0] * b[2],
                               a[0] * b[1] - a[1] * b[0]};
  };
  const auto once = cross(u, v);
  const auto twice = cross(u, once.data());
  std::array<Wide, 3> result{};
  for (size_t i = 0; i < 3; ++i) {
    result[i] = v[i] + 2 * (Wide{q.w} * once[i] + twice[i]);
  }
  return result;
}

/// How far `p` is from being outside (above 0) or inside (below 0), roughly.
Wide Depth(const Box& box, const Point3& p) {
  return std::min({p.x - Wide{box.min.x}, p.y - Wide{box.min.y},
                   p.z - Wide{box.min.z}, box.max.x - Wide{p.x},
                   box.max.y - Wide{p.y}, box.max.z - Wide{p.z}});
}
Wide Depth(const Sphere& sphere, const Point3& p) {
  return sphere.radius - std::hypot(Wide{p.x} - sphere.center.x,
                                    Wide{p.y} - sphere.center.y,
                                    Wide{p.z} - sphere.center.z);
}
Wide Depth(const OrientedBox& box, const Point3& p) {
  const auto v = InFrame(box.orientation, box.center, p);
  return std::min({box.half_size.x - std::abs(v[0]),
                   box.half_size.y - std::abs(v[1]),
                   box.half_size.z - std::abs(v[2])});
}
Wide DepthOfHeight(std::optional<double> min, std::optional<double> max,
                   const Point3& p) {
  return std::min(min ? p.z - Wide{*min} : Wide{1e9},
                  max ? *max - Wide{p.z} : Wide{1e9});
}
Wide Depth(const VerticalCylinder& c, const Point3& p) {
  return std::min(
      c.radius - std::hypot(Wide{p.x} - c.center_x, Wide{p.y} - c.center_y),
      DepthOfHeight(c.min_z, c.max_z, p));
}
Wide Depth(const PolygonPrism& prism, const Point3& p) {
  // The angle that the edge turns around the point, and its distance.
  Wide turned = 0;
  Wide distance = 1e9;
  const size_t n = prism.vertices.size();
  for (size_t i = 0; i < n; ++i) {
    const Wide ax = Wide{prism.vertices[i].x} - p.x;
    const Wide ay = Wide{prism.vertices[i].y} - p.y;
    const Wide bx = Wide{prism.vertices[(i + 1) % n].x} - p.x;
    const Wide by = Wide{prism.vertices[(i + 1) % n].y} - p.y;
    turned += std::atan2(ax * by - ay * bx, ax * bx + ay * by);
    const Wide dx = bx - ax;
    const Wide dy = by - ay;
    const Wide t = std::clamp(-(ax * dx + ay * dy) / (dx * dx + dy * dy),
                              Wide{0}, Wide{1});
    distance = std::min(distance, std::hypot(ax + t * dx, ay + t * dy));
  }
  const bool is_inside = std::abs(turned) > 3;
  return std::min(is_inside ? distance : -distance,
                  DepthOfHeight(prism.min_z, prism.max_z, p));
}
Wide Depth(const Frustum& f, const Point3& p) {
  const auto v = InFrame(f.orientation, f.position, p);
  return std::min({v[2] - f.near, f.far - v[2],
                   f.half_width * v[2] - std::abs(v[0]),
                   f.half_height * v[2] - std::abs(v[1])});
}
Wide Depth(const Corridor& corridor, const Point3& p) {
  Wide distance = 1e9;
  // By thirds, since the distance along a straight line is convex.
  for (size_t i = 0; i + 1 < corridor.path.size(); ++i) {
    const Point3& a = corridor.path[i];
    const Point3& b = corridor.path[i + 1];
    const auto at = [&](Wide t) {
      return std::hypot(a.x + t * (Wide{b.x} - a.x) - p.x,
                        a.y + t * (Wide{b.y} - a.y) - p.y,
                        a.z + t * (Wide{b.z} - a.z) - p.z);
    };
    Wide low = 0;
    Wide high = 1;
    for (int step = 0; step < 60; ++step) {
      const Wide third = (high - low) / 3;
      if (at(low + third) < at(high - third)) {
        high -= third;
      } else {
        low += third;
      }
    }
    distance = std::min({distance, at(low), at(0), at(1)});
  }
  return corridor.radius - distance;
}

TEST(Region, HoldsThePointsThatTheDefinitionsOfItsShapeSay) {
  std::mt19937 random(6);
  ShapeMaker maker(random);
  for (const int64_t step_nm : {int64_t{1'000'000}, int64_t{7'654'321}}) {
    const Lattice lattice(step_nm);
    for (int kind = 0; kind < ShapeMaker::kKinds; ++kind) {
      SCOPED_TRACE(kind);
      int inside = 0;
      int outside = 0;
      for (int i = 0; i < 30; ++i) {
        const QueryShape shape = maker.Make(kind);
        const Region region = MakeRegion(shape, lattice);
        for (int k = 0; k < 300; ++k) {
          const LatticePoint q = *lattice.Quantize(
              {maker.Number(-8, 8), maker.Number(-8, 8), maker.Number(-8, 8)});
          const Wide depth = std::visit(
              [&](const auto& s) { return Depth(s, lattice.Position(q)); },
              shape);
          // Either is right on the very edge.
          if (std::abs(depth) < 1e-9L) continue;
          ASSERT_EQ(region.Contains(q), depth > 0) << i << " " << k;
          ++(depth > 0 ? inside : outside);
        }
      }
      EXPECT_GT(inside, 50);
      EXPECT_GT(outside, 50);
    }
  }
}

TEST(Region, EdgesAreInsideWhereTheDefinitionsSay) {
  const Lattice lattice(1'000'000'000);
  // A rectangle in either sense is the box.
  for (const bool reverse : {false, true}) {
    PolygonPrism prism{
        .vertices = {{-2, 1}, {3, 1}, {3, 4}, {-2, 4}}, .min_z = 0, .max_z = 2};
    if (reverse) std::reverse(prism.vertices.begin(), prism.vertices.end());
    const Region polygon = MakeRegion(prism, lattice);
    const Region box = MakeRegion(Box{{-2, 1, 0}, {3, 4, 2}}, lattice);
    for (int64_t x = -4; x < 6; ++x) {
      for (int64_t y = -1; y < 6; ++y) {
        for (int64_t z = -1; z < 4; ++z) {
          EXPECT_EQ(polygon.Contains({x, y, z}), box.Contains({x, y, z}))
              << x << " " << y << " " << z;
        }
      }
    }
  }
  const Region turned =
      MakeRegion(OrientedBox{{0, 0, 0}, {0, 0, 1, 0}, {2, 3, 4}}, lattice);
  EXPECT_TRUE(turned.Contains({2, -3, 4}));
  EXPECT_FALSE(turned.Contains({3, 0, 0}));
  const Region cylinder = MakeRegion(
      VerticalCylinder{.center_x = 1, .radius = 5, .min_z = -1, .max_z = 2},
      lattice);
  EXPECT_TRUE(cylinder.Contains({4, 4, -1}));
  EXPECT_TRUE(cylinder.Contains({6, 0, 2}));
  EXPECT_FALSE(cylinder.Contains({6, 0, 3}));
  EXPECT_FALSE(cylinder.Contains({6, 1, 2}));
  // A camera that looks along x: its x is -y of the map, its y is -z.
  const Region frustum = MakeRegion(
      Frustum{{0, 0, 0}, {-0.5, 0.5, -0.5, 0.5}, 1, 0.5, 1, 4}, lattice);
  EXPECT_TRUE(frustum.Contains({4, 4, 2}));
  EXPECT_TRUE(frustum.Contains({1, -1, 0}));
  EXPECT_FALSE(frustum.Contains({4, 4, 3}));
  EXPECT_FALSE(frustum.Contains({4, -5, 0}));
  EXPECT_FALSE(frustum.Contains({5, 0, 0}));
  EXPECT_FALSE(frustum.Contains({0, 0, 0}));
  EXPECT_FALSE(frustum.Contains({-2, 0, 0}));
  const Region corridor =
      MakeRegion(Corridor{{{0, 0, 0}, {10, 0, 0}, {10, 10, 0}}, 2}, lattice);
  EXPECT_TRUE(corridor.Contains({5, 2, 0}));
  EXPECT_TRUE(corridor.Contains({10, 12, 0}));
  EXPECT_FALSE(corridor.Contains({5, 2, 1}));
  EXPECT_FALSE(corridor.Contains({7, 5, 0}));
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
              StatusIs(code, HasSubstr("box.min.z: it is 1")));
  EXPECT_THAT(Region::Make(Box{{0, 2, 0}, {1, 1, 1}}, lattice),
              StatusIs(code, HasSubstr("min must be below max")));
  EXPECT_THAT(Region::Make(Sphere{{0, 0, kNan}, 1}, lattice),
              StatusIs(code, HasSubstr("sphere.center.z")));
  EXPECT_THAT(Region::Make(Sphere{{0, 0, 0}, 0}, lattice),
              StatusIs(code, HasSubstr("sphere.radius")));
  EXPECT_THAT(Region::Make(Sphere{{0, 0, 0}, kInf}, lattice),
              StatusIs(code, HasSubstr("sphere.radius")));

  const auto refuses = [&](const QueryShape& shape, const char* field,
                           const char* message) {
    const absl::Status status = Region::Make(shape, lattice).status();
    EXPECT_THAT(status, StatusIs(code, HasSubstr(message)));
    EXPECT_EQ(FieldOf(status), field) << status;
  };
  refuses(Box{{0, 2, 0}, {1, 1, 1}}, "box.min.y", "below max");
  refuses(OrientedBox{{0, 0, 0}, {0, 0, 0, 0}, {1, 1, 1}},
          "oriented_box.orientation", "its length is 0");
  refuses(OrientedBox{{0, 0, 0}, {0, kNan, 0, 1}, {1, 1, 1}},
          "oriented_box.orientation.y", "nan");
  refuses(OrientedBox{{0, 0, 0}, {}, {1, 0, 1}}, "oriented_box.half_size.y",
          "above 0");
  refuses(VerticalCylinder{.radius = -1}, "cylinder.radius", "above 0");
  refuses(VerticalCylinder{.radius = 1, .min_z = 2, .max_z = 2},
          "cylinder.min_z", "below max_z");
  refuses(VerticalCylinder{.radius = 1, .max_z = kNan}, "cylinder.max_z",
          "nan");
  const auto polygon = [](std::vector<Point2> vertices) {
    return PolygonPrism{.vertices = std::move(vertices)};
  };
  refuses(polygon({{0, 0}, {1, 0}}), "polygon.vertices", "3 to 1000");
  refuses(polygon(std::vector<Point2>(1001)), "polygon.vertices",
          "there are 1001");
  refuses(polygon({{0, 0}, {1, kInf}, {0, 1}}), "polygon.vertices[1].y",
          "finite");
  refuses(polygon({{0, 0}, {1, 0}, {0, 1}, {0, 0}}), "polygon.vertices[0]",
          "not again at the end");
  refuses(polygon({{0, 0}, {2, 2}, {2, 0}, {0, 2}}), "polygon.vertices[2]",
          "must not cross");
  // A vertex on another edge; no area.
  refuses(polygon({{0, 0}, {4, 0}, {4, 4}, {2, 0}, {0, 4}}),
          "polygon.vertices[2]", "must not cross or touch");
  refuses(polygon({{0, 0}, {1, 1}, {2, 2}}), "polygon.vertices[2]",
          "lie on each other");
  refuses(Frustum{{0, 0, 0}, {0, 0, 0, 2}, 1, 1, 0, 1}, "frustum.orientation",
          "unit quaternion");
  refuses(Frustum{{0, 0, 0}, {}, 1, 1e6, 0, 1}, "frustum.half_height",
          "at most 1000");
  refuses(Frustum{{0, 0, 0}, {}, 1, 1, 3, 3}, "frustum.near", "near < far");
  refuses(Frustum{{0, 0, 0}, {}, 1, 1, -1, 3}, "frustum.near", "0 <= near");
  refuses(Corridor{{{0, 0, 0}}, 1}, "corridor.path", "it has 1 points");
  refuses(Corridor{std::vector<Point3>(1001), 1}, "corridor.path", "2 to 1000");
  refuses(Corridor{{{0, 0, 0}, {0, kNan, 0}}, 1}, "corridor.path[1].y",
          "finite");
  refuses(Corridor{{{0, 0, 0}, {1, 0, 0}}, 0}, "corridor.radius", "above 0");
}

}  // namespace
}  // namespace mapsieve::engine
