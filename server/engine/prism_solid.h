#ifndef MAPSIEVE_SERVER_ENGINE_PRISM_SOLID_H_
#define MAPSIEVE_SERVER_ENGINE_PRISM_SOLID_H_

#include <memory>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "server/engine/shape_checks.h"
#include "server/engine/solid.h"

namespace mapsieve::engine {

/// PolygonPrism. A position is inside if a ray from it towards greater x
/// crosses the polygon an odd number of times. Every test costs time linear in
/// the vertices.
class PrismSolid final : public Solid {
 public:
  /// Cost quadratic in the vertices.
  static absl::StatusOr<std::shared_ptr<const Solid>> Make(
      const PolygonPrism& prism);

  bool Contains(const core::Point3& p) const override;
  bool Meets(const PositionBox& box) const override;
  bool Encloses(const PositionBox& box) const override;
  PositionBox Bounds() const override { return bounds_; }

 private:
  PrismSolid(const std::vector<Point2>& vertices, const HeightRange& heights);

  /// An edge that is not along x, from its lower to its upper end, or one that
  /// is, in any order.
  struct Edge {
    Point2 a;
    Point2 b;
  };

  bool IsInPolygon(double x, double y) const;
  /// Whether the edge of the polygon may come into `box`, or so near that the
  /// rounding of IsInPolygon could tell.
  bool EdgeMeets(const PositionBox& box) const;

  std::vector<Edge> edges_;
  PositionBox bounds_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_PRISM_SOLID_H_
