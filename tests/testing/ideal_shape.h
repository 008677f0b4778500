#ifndef MAPSIEVE_TESTS_TESTING_IDEAL_SHAPE_H_
#define MAPSIEVE_TESTS_TESTING_IDEAL_SHAPE_H_

#include <cstdint>
#include <string>
#include <vector>

#include "core/cloud/point_cloud.h"
#include "core/spdf/spdf_options.h"

/// A line, a plane or a volume with points of known density, on which a
/// density rule's word can be checked.
namespace mapsieve::testing {

struct IdealShapeOptions {
  /// 1 line, 2 plane, 3 volume.
  int dimension = 2;
  /// k and rho: the density aimed at is k / (V_D rho^D).
  int neighbor_count = 50;
  double radius_m = 0.2;
  /// Density of the points over the one aimed at.
  double start = 10;
  /// Standard deviation along every axis.
  double noise_m = 0;
  /// Of the points, the noise and the shape's orientation.
  uint64_t seed = 1;
};

/// Points uniform on a D-dimensional cube, rotated at random.
struct IdealShape {
  core::LatticeCloud cloud;
  /// Distinct points over those aimed at: below `start` where the lattice
  /// merges some.
  double start = 0;
  /// Extent of the interior, which ends two radii from the cube's rim: metres
  /// to the power of D.
  double interior_measure = 0;
  /// Axes of the cube in the cloud's frame.
  double axes[3][3] = {};
  double half_interior_m = 0;
  int dimension = 0;

  bool IsInterior(const core::LatticePoint& q) const;
};

/// Steps of 0.15 mm: the finest lattice on which the filter's default reach is
/// allowed, so that it merges few points of a dense line.
inline constexpr int64_t kIdealShapeStepNm = 150'000;

IdealShape MakeIdealShape(const IdealShapeOptions& options);

/// The density of points of a shape, in its interior.
struct ReachedDensity {
  /// Interior points per metre, square metre or cubic metre, over target.
  double per_measure = 0;
  /// Mean count of others in the balls of interior points, over k.
  double per_ball = 0;
  /// Standard deviation of that count over its mean.
  double spread = 0;
};

/// `points`: points of `shape`. O(N²).
ReachedDensity MeasureDensity(const IdealShape& shape,
                              const IdealShapeOptions& options,
                              const std::vector<core::LatticePoint>& points);

/// What the filter leaves of a shape's cloud after the rounds.
std::vector<core::LatticePoint> Survivors(const core::LatticeCloud& cloud,
                                          const core::SpdfOptions& options);

/// As many points of a shape's cloud, chosen at random.
std::vector<core::LatticePoint> RandomlyThinned(const core::LatticeCloud& cloud,
                                                size_t count, int64_t seed);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_IDEAL_SHAPE_H_
