#ifndef MAPSIEVE_CLIENT_LAB_SPINNING_SCANNER_H_
#define MAPSIEVE_CLIENT_LAB_SPINNING_SCANNER_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "client/lab/scene.h"
#include "core/geometry/lattice.h"
#include "core/geometry/vector3.h"

namespace mapsieve::client {

/// One turn of the scanner's head: it starts at `start` and moves on evenly.
struct ScannerRotation {
  /// Numbers the rotations of a survey: together with the pulse it keys the
  /// draws.
  int64_t index = 0;
  core::Point3 start;
  /// Metres a second.
  core::Vector3 velocity = {0, 0, 0};
  double start_time_s = 0;

  core::Point3 PositionAt(double time_s) const {
    const double t = time_s - start_time_s;
    return {start.x + t * velocity[0], start.y + t * velocity[1],
            start.z + t * velocity[2]};
  }
};

/// One echo, in the frame of the scene.
struct ScannerReturn {
  core::Point3 position;
  double time_s = 0;
  /// Reflectance times a share of the cosine of incidence, 0 to 1.
  float intensity = 0;
  ObjectClass object = ObjectClass::kGround;
  core::Label truth = core::Label::kNone;
};

struct ScannerOptions {
  uint64_t seed = 1;
  /// Nothing farther is seen.
  double max_range_m = 100;
  /// Standard deviation of a range.
  double range_noise_m = 0.012;
  /// Share of returns that come from nothing: somewhere in the air before what
  /// the pulse would have met.
  double spurious_share = 0.002;
};

/// A lidar with 64 beams on an upright head that turns ten times a second,
/// anticlockwise.
///
/// Beam table: beam b has the elevation b - 25 degrees, -25 to +38; a rotation
/// has 512 columns, 360 / 512 degrees apart, and in every column all beams
/// fire at once. The bearing of column 0 is drawn for every rotation. One
/// return a pulse at most, none from nearer than kMinRange. Ranges carry
/// Gaussian noise but stay positive; directions are exact. A return depends on
/// the options, the scene, the rotation and the pulse alone. Thread-safe (the
/// scene is not).
class SpinningScanner {
 public:
  static constexpr int kBeamCount = 64;
  static constexpr int kColumnCount = 512;
  static constexpr int kPulseCount = kBeamCount * kColumnCount;
  static constexpr double kRotationTime = 0.1;
  static constexpr double kMinRange = 0.4;

  /// Degrees above the horizon, `beam` in [0, kBeamCount).
  static constexpr double BeamElevationDeg(int beam) { return beam - 25.0; }

  explicit SpinningScanner(const ScannerOptions& options);

  /// Pulse `pulse` of a rotation, in [0, kPulseCount): beam pulse % kBeamCount
  /// of column pulse / kBeamCount. Nothing if no echo comes back.
  std::optional<ScannerReturn> Fire(Scene& scene,
                                    const ScannerRotation& rotation,
                                    int pulse) const;

 private:
  static constexpr int kFractionCount = 64;

  struct Bearing {
    double cosine = 1;
    double sine = 0;
  };

  ScannerOptions options_;
  std::array<Bearing, kBeamCount> elevations_;
  std::array<Bearing, kColumnCount> azimuths_;
  /// Fractions of a column's angle, for the bearing of column 0.
  std::array<Bearing, kFractionCount> fractions_;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_SPINNING_SCANNER_H_
