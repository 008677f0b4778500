#ifndef MAPSIEVE_SERVER_ENGINE_CONVEX_SOLID_H_
#define MAPSIEVE_SERVER_ENGINE_CONVEX_SOLID_H_

#include <array>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/vector3.h"
#include "server/engine/solid.h"

namespace mapsieve::engine {

/// The positions p with normal . (p - origin) <= limit for each of some closed
/// half spaces, which share `origin`.
class ConvexSolid final : public Solid {
 public:
  static absl::StatusOr<std::shared_ptr<const Solid>> Make(
      const OrientedBox& box);
  static absl::StatusOr<std::shared_ptr<const Solid>> Make(
      const Frustum& frustum);

  bool Contains(const core::Point3& p) const override;
  bool Meets(const PositionBox& box) const override;
  bool Encloses(const PositionBox& box) const override;
  PositionBox Bounds() const override { return bounds_; }

 private:
  struct HalfSpace {
    core::Vector3 normal;
    double limit = 0;
  };

  ConvexSolid(const core::Point3& origin, std::vector<HalfSpace> half_spaces,
              const std::array<core::Vector3, 8>& corners);

  /// normal . (p - origin). Every operation is monotone in each coordinate of
  /// `p`, rounding included.
  double Along(const core::Vector3& normal, const core::Point3& p) const;

  core::Point3 origin_;
  std::vector<HalfSpace> half_spaces_;
  PositionBox bounds_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_CONVEX_SOLID_H_
