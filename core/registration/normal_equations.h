#ifndef MAPSIEVE_CORE_REGISTRATION_NORMAL_EQUATIONS_H_
#define MAPSIEVE_CORE_REGISTRATION_NORMAL_EQUATIONS_H_

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/executor.h"
#include "core/geometry/vector3.h"
#include "core/registration/icp.h"

/// One linearised least squares of RunIcp.
namespace mapsieve::core {

/// The points of a cloud under registration, columns of equal length or empty.
struct IcpPoints {
  std::vector<Vector3> positions;
  std::vector<Vector3> normals;
  std::vector<Covariance> covariances;
};

/// Rows of the reading and of the reference.
struct IcpPair {
  uint32_t reading = 0;
  uint32_t reference = 0;
};

/// A least squares over pairs, solved.
struct IcpSolution {
  PoseInformation information;
  double rms_residual_m = 0;
  /// The motion about information.center to the minimum along the directions
  /// that are not degenerate.
  PoseMotion step;
};

/// Solves the least squares of `options.method` over `pairs`, at least one.
/// `moved`: positions of the reading under the pose of `rotation`, which turns
/// its covariances. Sums are made in the order of `pairs`, whatever the number
/// of threads.
IcpSolution SolvePairs(std::span<const Vector3> moved, const Matrix3& rotation,
                       const IcpPoints& reading, const IcpPoints& reference,
                       std::span<const IcpPair> pairs,
                       const IcpOptions& options, Executor& executor);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_REGISTRATION_NORMAL_EQUATIONS_H_
