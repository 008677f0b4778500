#ifndef MAPSIEVE_CORE_REGISTRATION_ICP_H_
#define MAPSIEVE_CORE_REGISTRATION_ICP_H_

#include <array>
#include <cstdint>
#include <limits>
#include <span>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/lattice.h"
#include "core/geometry/rigid_transform.h"
#include "core/geometry/vector3.h"
#include "core/registration/label_covariance.h"

/// Registration of two clouds by iterated closest points: pairs of nearest
/// points under the pose so far give a better pose, until it settles.
namespace mapsieve::core {

/// A cloud to register; columns that are not empty have one entry a point.
struct IcpCloud {
  /// In metres, finite, no coordinate beyond kMaxIcpCoordinate.
  std::span<const Point3> positions;
  /// Unit vectors, of either sign.
  std::span<const Vector3> normals;
  /// How freely each point may slide (LabelCovariance), positive definite;
  /// their scale does not matter, if it is the same in both clouds.
  std::span<const Covariance> covariances;
};

inline constexpr size_t kMinIcpPointCount = 6;
inline constexpr double kMaxIcpCoordinate = 1e13;

enum class IcpMethod : uint8_t {
  /// Least squares of distances along the reference's normals. Chen and
  /// Medioni, "Object modelling by registration of multiple range images",
  /// 1992.
  kPointToPlane = 1,
  /// Least squares of differences weighted by the covariances of both clouds
  /// (generalised ICP). Segal, Haehnel and Thrun, "Generalized-ICP", 2009.
  kPlaneToPlane = 2,
};

struct IcpOptions {
  IcpMethod method = IcpMethod::kPointToPlane;
  /// Points of the reference that each point of the reading is paired with,
  /// its nearest ones; 1 to 16.
  int neighbor_count = 2;
  /// Share of the pairs that count, those of least distance; above 0, to 1.
  /// The rest are taken for points that the other cloud does not have.
  double trim_ratio = 0.75;
  /// Pairs farther apart never count; above 0.
  double max_distance_m = std::numeric_limits<double>::infinity();
  /// Nor do pairs whose normals' cosine is below this in magnitude: they lie
  /// on different surfaces; 0 (all count) to 1. Above 0 both clouds need
  /// normals.
  double min_normal_cosine = 0;
  /// Steps at most, 0 (measures the pairs at the given pose) to 10000.
  int max_iteration_count = 100;
  /// The pose has settled after this many steps in a row, at least 1, ...
  int settled_step_count = 3;
  /// ... each of which moved the centre of the pairs by no more than this, 0
  /// or above, ...
  double translation_tolerance_m = 1e-4;
  /// ... and turned by no more than this, 0 or above.
  double rotation_tolerance_rad = 1e-5;
  /// A direction of motion whose eigenvalue in IcpResult::information is below
  /// this is degenerate; 1e-12 to 1.
  double degenerate_eigenvalue = 0.005;

  /// kInvalidArgument, naming the field, its value and its limits.
  absl::Status Validate() const;

  friend bool operator==(const IcpOptions&, const IcpOptions&) = default;
};

enum class IcpStop : uint8_t {
  /// The pose has settled.
  kConverged = 1,
  /// max_iteration_count was reached.
  kIterationLimit = 2,
  /// Fewer than kMinIcpPointCount pairs were left under max_distance_m and
  /// min_normal_cosine: the pose is the last one, and nothing is known of it.
  kTooFewPairs = 3,
};

/// A small motion: a rotation about a centre, then a translation.
struct PoseMotion {
  /// Its direction is the axis, its length the angle, in radians.
  Vector3 rotation = {0, 0, 0};
  /// In metres.
  Vector3 translation = {0, 0, 0};
};

/// What the pairs say of each direction of motion, by the eigenvalues of the
/// normal matrix of the least squares.
///
/// The square of a motion's length is the square of its translation and the
/// mean square of the ways that its rotation moves the pairs' points, about
/// `center`; so all coordinates are metres and the eigenvalues can be compared.
/// An eigenvalue is the mean squared change of the residuals under a motion of
/// length 1: the share of the points' motion that the pairs see, from 0 to 1,
/// without a unit. For plane-to-plane the means are by weight, a pair's weight
/// being the trace of its inverse covariance, and the eigenvalues are about
/// those of point-to-plane.
///
/// Along a degenerate direction points slide on their surfaces: a plane has
/// three, a corridor one, a sphere three.
struct PoseInformation {
  /// Ascending.
  std::array<double, 6> eigenvalues{};
  /// motions[i]: the motion of length 1 of eigenvalues[i], in the axes of the
  /// reference. The points about an axis count as a hundredth of the largest
  /// extent away from it at least.
  std::array<PoseMotion, 6> motions{};
  /// How many of the first eigenvalues are below degenerate_eigenvalue.
  int degenerate_count = 0;
  /// Mean of the pairs' points, in the frame of the reference.
  Point3 center;
};

struct IcpResult {
  /// Moves the reading onto the reference.
  RigidTransform T_reference_reading;
  IcpStop stop = IcpStop::kIterationLimit;
  /// Steps that were made.
  int iteration_count = 0;
  /// Pairs that count at the pose returned; what follows is of them.
  int64_t pair_count = 0;
  /// pair_count over all pairs, neighbor_count a point of the reading.
  double pair_ratio = 0;
  /// Root of the mean squared residual, by weight for plane-to-plane: there
  /// too it is a distance across the surfaces.
  double rms_residual_m = 0;
  /// Zero if `stop` is kTooFewPairs.
  PoseInformation information;

  bool converged() const { return stop == IcpStop::kConverged; }
};

/// Registers `reading` to `reference` from the pose `T_reference_reading`,
/// whose rotation is made orthonormal first (Orthonormalized).
/// Point-to-plane needs normals of the reference, plane-to-plane covariances
/// of both clouds. Each step minimises the linearised least squares over the
/// pairs and moves by the exponential map. It leaves the pose as it is along
/// degenerate directions (Zhang et al., "On degeneracy of optimization-based
/// state estimation problems", 2016). The set-up, two neighbours and trimmed
/// distances, is that of Labussière et al. 2020.
///
/// The result is a function of the two sets of points, the pose and the
/// options: the same bits for any number of threads and any order of points.
/// Points are centred first, so clouds far from their origins lose nothing but
/// what their coordinates' own rounding loses.
///
/// Errors: kInvalidArgument (options; a cloud of fewer than kMinIcpPointCount
/// points; a reference of fewer than neighbor_count points; a column that is
/// missing or of another length; a value out of its range; a pose that is
/// none), kCancelled. That it does not converge is no error. Cost a step:
/// O(N log M) for N points of the reading and M of the reference. Thread-safe.
absl::StatusOr<IcpResult> RunIcp(const IcpCloud& reading,
                                 const IcpCloud& reference,
                                 const RigidTransform& T_reference_reading,
                                 const IcpOptions& options,
                                 const ExecutionContext& context = {});

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_REGISTRATION_ICP_H_
