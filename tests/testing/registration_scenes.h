#ifndef MAPSIEVE_TESTS_TESTING_REGISTRATION_SCENES_H_
#define MAPSIEVE_TESTS_TESTING_REGISTRATION_SCENES_H_

#include <vector>

#include "core/registration/icp.h"
#include "tests/testing/random.h"

/// Clouds on flat boards, with the true normal of each point, to register.
namespace mapsieve::testing {

/// A cloud with all columns of registration.
struct RegistrationCloud {
  std::vector<core::Point3> positions;
  std::vector<core::Vector3> normals;
  std::vector<core::Covariance> covariances;

  size_t size() const { return positions.size(); }
  core::IcpCloud view() const { return {positions, normals, covariances}; }
  /// A point with the covariance of a surface.
  void Add(const core::Vector3& position, const core::Vector3& normal);
};

/// A rectangle: its centre and half edges, which are at right angles.
struct Board {
  core::Vector3 center;
  core::Vector3 u;
  core::Vector3 v;
};

/// Floor, two walls and a slope around the origin, 5 m in radius, too far apart
/// for a point's two nearest neighbours to lie on different ones.
std::vector<Board> RoomBoards();
/// Floor and two walls, 20 m along x.
std::vector<Board> CorridorBoards();
/// Floor, two walls and stairs: edges everywhere.
std::vector<Board> StairBoards();

/// Points uniform on each board, moved along its normal by Gaussian noise.
RegistrationCloud SampleBoards(const std::vector<Board>& boards,
                               int points_per_board, double noise_m,
                               Random& random);

/// `cloud` moved by `transform`.
RegistrationCloud Moved(const RegistrationCloud& cloud,
                        const core::RigidTransform& transform);

/// The points of `cloud` in random order.
RegistrationCloud Shuffled(const RegistrationCloud& cloud, Random& random);

core::Vector3 RandomDirection(Random& random);

/// A translation and a rotation of these magnitudes in random directions.
core::RigidTransform RandomMotion(double translation_m, double rotation_rad,
                                  Random& random);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_REGISTRATION_SCENES_H_
