#include "tests/testing/clouds.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <utility>

namespace mapsieve::testing {
namespace {

using core::LatticeCloud;
using core::LatticePoint;
using core::Point3;

/// Uniform numbers that are the same with every standard library.
class Uniform {
 public:
  explicit Uniform(uint64_t seed) : random_(seed) {}
  double operator()(double low, double high) {
    return low + (high - low) * static_cast<double>(random_() >> 11) * 0x1p-53;
  }

 private:
  std::mt19937_64 random_;
};

LatticeCloud Generate(int count, uint64_t seed,
                      const std::function<Point3(Uniform&)>& draw) {
  Uniform uniform(seed);
  LatticeCloud cloud;
  for (int i = 0; i < count; ++i) {
    cloud.positions.push_back(cloud.lattice.Quantize(draw(uniform)).value());
  }
  return cloud;
}

}  // namespace

LatticeCloud PlaneCloud(int count, double half_edge, uint64_t seed) {
  return Generate(count, seed, [=](Uniform& u) {
    return Point3{u(-half_edge, half_edge), u(-half_edge, half_edge), 0};
  });
}

LatticeCloud LineCloud(int count, double half_length, uint64_t seed) {
  return Generate(count, seed, [=](Uniform& u) {
    return Point3{u(-half_length, half_length), 0, 0};
  });
}

LatticeCloud VolumeCloud(int count, double half_edge, uint64_t seed) {
  return Generate(count, seed, [=](Uniform& u) {
    return Point3{u(-half_edge, half_edge), u(-half_edge, half_edge),
                  u(-half_edge, half_edge)};
  });
}

LatticeCloud SphereCloud(int count, double radius, uint64_t seed) {
  return Generate(count, seed, [=](Uniform& u) {
    const double z = u(-1, 1);
    const double angle = u(-M_PI, M_PI);
    const double r = std::sqrt(1 - z * z);
    return Point3{radius * r * std::cos(angle), radius * r * std::sin(angle),
                  radius * z};
  });
}

LatticeCloud EdgeCloud(int count, double half_edge, uint64_t seed) {
  return Generate(count, seed, [=](Uniform& u) {
    const double along = u(-half_edge, half_edge);
    const double across = u(0, half_edge);
    return u(0, 1) < 0.5 ? Point3{along, across, 0} : Point3{along, 0, across};
  });
}

LatticeCloud SceneCloud(int count, double half_edge, uint64_t seed) {
  return Generate(count, seed, [=](Uniform& u) {
    const double h = half_edge;
    const double noise = u(-0.01, 0.01);
    const double which = u(0, 10);
    if (which < 4) return Point3{u(-h, h), u(-h, h), noise};
    if (which < 6) return Point3{noise + h / 2, u(-h, h), u(0, h)};
    if (which < 7) return Point3{u(-h, h), noise - h / 3, u(0, h)};
    if (which < 8) return Point3{noise, noise + h / 2, u(0, h)};
    if (which < 9) return Point3{u(-h, h), u(-h, h), u(0, h)};
    return Point3{u(-0.1, 0.1), u(-0.1, 0.1) - h / 2, noise};
  });
}

LatticeCloud GridCloud(int edge, int64_t spacing) {
  LatticeCloud cloud;
  for (int64_t x = 0; x < edge; ++x) {
    for (int64_t y = 0; y < edge; ++y) {
      for (int64_t z = 0; z < edge; ++z) {
        cloud.positions.push_back({x * spacing, y * spacing, z * spacing});
      }
    }
  }
  return cloud;
}

LatticeCloud Shifted(LatticeCloud cloud, const LatticePoint& offset) {
  return Mapped(std::move(cloud), [&](const LatticePoint& q) {
    return LatticePoint{q.x + offset.x, q.y + offset.y, q.z + offset.z};
  });
}

LatticeCloud Mapped(
    LatticeCloud cloud,
    const std::function<LatticePoint(const LatticePoint&)>& move) {
  for (LatticePoint& q : cloud.positions) q = move(q);
  return cloud;
}

LatticeCloud Shuffled(const LatticeCloud& cloud, uint64_t seed) {
  std::vector<uint32_t> rows(cloud.size());
  std::iota(rows.begin(), rows.end(), uint32_t{0});
  std::mt19937_64 random(seed);
  std::shuffle(rows.begin(), rows.end(), random);
  return cloud.Select(rows);
}

LatticeCloud Concatenated(LatticeCloud a, const LatticeCloud& b) {
  a.positions.insert(a.positions.end(), b.positions.begin(), b.positions.end());
  return a;
}

LatticeCloud WithAttributes(LatticeCloud cloud, uint64_t seed) {
  std::mt19937_64 random(seed);
  core::Column intensity({"intensity", core::ScalarType::kUint16});
  core::Column time({"gps_time", core::ScalarType::kFloat64});
  core::Column range({"range", core::ScalarType::kInt8});
  for (size_t i = 0; i < cloud.size(); ++i) {
    intensity.Append(static_cast<uint16_t>(random()));
    time.Append(static_cast<double>(random() % 1000000) / 7.0);
    range.Append(static_cast<int8_t>(random()));
    if (random() % 5 == 0) range.SetMissing(i);
  }
  cloud.attributes.columns() = {std::move(intensity), std::move(time),
                                std::move(range)};
  return cloud;
}

}  // namespace mapsieve::testing
