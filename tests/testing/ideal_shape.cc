#include "tests/testing/ideal_shape.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/cloud/merge_duplicates.h"
#include "core/sampling/random_sample.h"
#include "core/spdf/cloud_filter.h"
#include "tests/testing/random.h"

namespace mapsieve::testing {
namespace {

using core::LatticeCloud;
using core::LatticePoint;
using core::Point3;

/// Edge of the interior in radii, by dimension: 500 to 1000 points at target.
constexpr double kInteriorEdge[] = {20, 8, 4};
constexpr double kRim = 2;

double UnitBallVolume(int dimension) {
  constexpr double kPi = std::numbers::pi;
  return dimension == 1 ? 2 : dimension == 2 ? kPi : 4 * kPi / 3;
}

double TargetDensity(const IdealShapeOptions& options) {
  return options.neighbor_count /
         (UnitBallVolume(options.dimension) *
          std::pow(options.radius_m, options.dimension));
}

/// Rows of a random rotation, from a unit quaternion.
void DrawAxes(Random& random, double (&axes)[3][3]) {
  double q[4];
  double norm = 0;
  for (double& value : q) {
    value = random.Normal();
    norm += value * value;
  }
  for (double& value : q) value /= std::sqrt(norm);
  const auto [w, x, y, z] = q;
  const double rows[3][3] = {
      {1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
      {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
      {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
  for (int i = 0; i < 3; ++i) std::copy_n(rows[i], 3, axes[i]);
}

}  // namespace

bool IdealShape::IsInterior(const LatticePoint& q) const {
  const Point3 p = cloud.lattice.Position(q);
  for (int d = 0; d < dimension; ++d) {
    const double along = axes[d][0] * p.x + axes[d][1] * p.y + axes[d][2] * p.z;
    if (std::abs(along) > half_interior_m) return false;
  }
  return true;
}

IdealShape MakeIdealShape(const IdealShapeOptions& options) {
  Random random(options.seed);
  IdealShape shape{.cloud = {.lattice = core::Lattice(kIdealShapeStepNm)},
                   .dimension = options.dimension};
  DrawAxes(random, shape.axes);
  shape.half_interior_m =
      kInteriorEdge[options.dimension - 1] / 2 * options.radius_m;
  shape.interior_measure =
      std::pow(2 * shape.half_interior_m, options.dimension);
  const double half_edge = shape.half_interior_m + kRim * options.radius_m;
  const double target =
      TargetDensity(options) * std::pow(2 * half_edge, options.dimension);
  const auto count = std::llround(options.start * target);
  for (int64_t i = 0; i < count; ++i) {
    double p[3];
    for (double& value : p) value = options.noise_m * random.Normal();
    for (int d = 0; d < options.dimension; ++d) {
      const double along = random.Uniform(-half_edge, half_edge);
      for (int axis = 0; axis < 3; ++axis) {
        p[axis] += along * shape.axes[d][axis];
      }
    }
    shape.cloud.positions.push_back(
        shape.cloud.lattice.Quantize({p[0], p[1], p[2]}).value());
  }
  shape.cloud.positions = core::DistinctPoints(shape.cloud.positions);
  shape.start = static_cast<double>(shape.cloud.size()) / target;
  return shape;
}

ReachedDensity MeasureDensity(const IdealShape& shape,
                              const IdealShapeOptions& options,
                              const std::vector<LatticePoint>& points) {
  const double step = shape.cloud.lattice.step();
  const double radius_d2 =
      std::floor(options.radius_m * options.radius_m / (step * step));
  double interior = 0;
  double sum = 0;
  double sum_of_squares = 0;
  for (const LatticePoint& q : points) {
    if (!shape.IsInterior(q)) continue;
    const auto others = static_cast<double>(std::count_if(
                            points.begin(), points.end(),
                            [&](const LatticePoint& p) {
                              const auto x = static_cast<double>(p.x - q.x);
                              const auto y = static_cast<double>(p.y - q.y);
                              const auto z = static_cast<double>(p.z - q.z);
                              return x * x + y * y + z * z <= radius_d2;
                            })) -
                        1;
    ++interior;
    sum += others;
    sum_of_squares += others * others;
  }
  const double mean = sum / interior;
  return {
      .per_measure = interior / shape.interior_measure / TargetDensity(options),
      .per_ball = mean / options.neighbor_count,
      .spread = std::sqrt(sum_of_squares / interior - mean * mean) / mean};
}

std::vector<LatticePoint> Survivors(const LatticeCloud& cloud,
                                    const core::SpdfOptions& options) {
  const auto filtered = core::FilterCloud(cloud, options);
  std::vector<LatticePoint> points;
  for (const uint32_t row : filtered.value().rows) {
    points.push_back(cloud.positions[row]);
  }
  return points;
}

std::vector<LatticePoint> RandomlyThinned(const LatticeCloud& cloud,
                                          size_t count, int64_t seed) {
  return cloud
      .Select(core::RandomSample(cloud.positions, static_cast<int64_t>(count),
                                 seed))
      .positions;
}

}  // namespace mapsieve::testing
