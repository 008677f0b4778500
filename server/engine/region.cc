#include "server/engine/region.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <variant>

#include "core/base/status.h"

namespace mapsieve::engine {
namespace {

using core::Lattice;
using core::LatticeBox;
using core::LatticePoint;

/// `x` in steps, rounded down and moved by `margin`, within the limits.
int64_t Steps(double x, int64_t margin, const Lattice& lattice) {
  constexpr auto kLimit = static_cast<double>(core::kLatticeLimit);
  const double steps =
      std::floor(x / lattice.step()) + static_cast<double>(margin);
  return static_cast<int64_t>(std::clamp(steps, -kLimit, kLimit));
}

/// The lattice points of a box of positions, and a few more: divisions round.
LatticeBox PointsOf(const PositionBox& box, const Lattice& lattice) {
  const auto& [min, max] = box;
  return {{Steps(min.x, -1, lattice), Steps(min.y, -1, lattice),
           Steps(min.z, -1, lattice)},
          {Steps(max.x, 3, lattice), Steps(max.y, 3, lattice),
           Steps(max.z, 3, lattice)}};
}

/// The smallest box of positions that holds those of the points of `box`.
PositionBox PositionsOf(const LatticeBox& box, const Lattice& lattice) {
  return {lattice.Position(box.min),
          lattice.Position({box.max.x - 1, box.max.y - 1, box.max.z - 1})};
}

}  // namespace

Region::Region(std::shared_ptr<const Solid> solid, const Lattice& lattice)
    : solid_(std::move(solid)),
      lattice_(lattice),
      bounds_(PointsOf(solid_->Bounds(), lattice)) {}

absl::StatusOr<Region> Region::Make(const QueryShape& shape,
                                    const Lattice& lattice) {
  MAPSIEVE_ASSIGN_OR_RETURN(std::shared_ptr<const Solid> solid,
                            MakeSolid(shape));
  return Region(std::move(solid), lattice);
}

absl::StatusOr<Region> Region::OfEdit(const RegionShape& shape,
                                      const Lattice& lattice) {
  return std::visit([&](const auto& s) { return Make(s, lattice); }, shape);
}

bool Region::Intersects(const LatticeBox& box) const {
  return bounds_.Intersects(box) && solid_->Meets(PositionsOf(box, lattice_));
}

bool Region::Encloses(const LatticeBox& box) const {
  return bounds_.Contains(box.min) &&
         bounds_.Contains({box.max.x - 1, box.max.y - 1, box.max.z - 1}) &&
         solid_->Encloses(PositionsOf(box, lattice_));
}

}  // namespace mapsieve::engine
