#ifndef MAPSIEVE_CORE_GEOMETRY_LATTICE_H_
#define MAPSIEVE_CORE_GEOMETRY_LATTICE_H_

#include <cmath>
#include <compare>
#include <cstdint>
#include <optional>

namespace mapsieve::core {

/// A point of a map's absolute lattice: coordinates in steps. Ordered by x,
/// then y, then z, which a shift of all points does not change: ties are broken
/// by it.
struct LatticePoint {
  int64_t x = 0;
  int64_t y = 0;
  int64_t z = 0;

  friend auto operator<=>(const LatticePoint&, const LatticePoint&) = default;
};

/// A position in map units (metres unless the map's CRS says otherwise).
struct Point3 {
  double x = 0;
  double y = 0;
  double z = 0;

  friend bool operator==(const Point3&, const Point3&) = default;
};

/// Lattice coordinates q obey |q| < kLatticeLimit on every axis.
inline constexpr int64_t kLatticeLimit = int64_t{1} << 42;
inline constexpr int64_t kDefaultStepNm = 1'000'000;
inline constexpr int64_t kMaxStepNm = 1'000'000'000;

/// The absolute lattice of a map: q = round(x / step), half to even, and
/// x = q * step_nm / 1e9. Depends on nothing but the step, so no origin or
/// bounds are ever chosen.
class Lattice {
 public:
  /// `step_nm`: edge of a lattice cell in nanometres, 1 to kMaxStepNm.
  explicit Lattice(int64_t step_nm = kDefaultStepNm) : step_nm_(step_nm) {}

  int64_t step_nm() const { return step_nm_; }
  double step() const { return static_cast<double>(step_nm_) / 1e9; }

  /// The lattice point of a position; nothing if a coordinate is not finite
  /// or falls outside kLatticeLimit.
  std::optional<LatticePoint> Quantize(const Point3& position) const {
    LatticePoint q;
    if (!QuantizeAxis(position.x, q.x) || !QuantizeAxis(position.y, q.y) ||
        !QuantizeAxis(position.z, q.z)) {
      return std::nullopt;
    }
    return q;
  }

  Point3 Position(const LatticePoint& q) const {
    return {Coordinate(q.x), Coordinate(q.y), Coordinate(q.z)};
  }

  double Coordinate(int64_t q) const {
    return static_cast<double>(q) * static_cast<double>(step_nm_) / 1e9;
  }

  friend bool operator==(const Lattice&, const Lattice&) = default;

 private:
  bool QuantizeAxis(double x, int64_t& q) const {
    const double steps = std::nearbyint(x / step());
    // False for NaN and the infinities too.
    if (!(std::abs(steps) < static_cast<double>(kLatticeLimit))) return false;
    q = static_cast<int64_t>(steps);
    return true;
  }

  int64_t step_nm_;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_LATTICE_H_
