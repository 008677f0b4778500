#ifndef MAPSIEVE_SERVER_ENGINE_CORRIDOR_SOLID_H_
#define MAPSIEVE_SERVER_ENGINE_CORRIDOR_SOLID_H_

#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "server/engine/solid.h"

namespace mapsieve::engine {

/// Corridor. Every test costs time linear in the points of the path.
class CorridorSolid final : public Solid {
 public:
  static absl::StatusOr<std::shared_ptr<const Solid>> Make(
      const Corridor& corridor);

  bool Contains(const core::Point3& p) const override;
  bool Meets(const PositionBox& box) const override;
  bool Encloses(const PositionBox& box) const override;
  PositionBox Bounds() const override { return bounds_; }

 private:
  explicit CorridorSolid(const Corridor& corridor);

  /// A straight piece of the path: a + t d, t from 0 to 1.
  struct Piece {
    core::Point3 a;
    core::Point3 d;
    /// d . d
    double square = 0;
    /// Holds every position near it.
    PositionBox bounds;
  };
  static double SquaredDistance(const Piece& piece, const core::Point3& p);

  std::vector<Piece> pieces_;
  double radius_;
  PositionBox bounds_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_CORRIDOR_SOLID_H_
