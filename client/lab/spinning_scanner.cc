#include "client/lab/spinning_scanner.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/base/hash.h"

namespace mapsieve::client {
namespace {

using std::numbers::pi;

/// Keys the draws of one pulse or rotation.
enum class Purpose : int64_t { kBearing, kRangeNoise, kSpurious };

uint64_t Draw(uint64_t seed, int64_t subject, Purpose purpose) {
  return HashIntegers(std::array{static_cast<int64_t>(seed), subject,
                                 static_cast<int64_t>(purpose)});
}

/// A standard normal value from 64 random bits (Box and Muller).
double Normal(uint64_t bits) {
  const double u = (static_cast<double>(bits >> 32) + 1) * 0x1p-32;
  const double v = static_cast<double>(bits & 0xffffffff) * 0x1p-32;
  return std::sqrt(-2 * std::log(u)) * std::cos(2 * pi * v);
}

}  // namespace

SpinningScanner::SpinningScanner(const ScannerOptions& options)
    : options_(options) {
  for (int beam = 0; beam < kBeamCount; ++beam) {
    const double angle = BeamElevationDeg(beam) * pi / 180;
    elevations_[static_cast<size_t>(beam)] = {std::cos(angle), std::sin(angle)};
  }
  constexpr double kColumnAngle = 2 * pi / kColumnCount;
  for (int column = 0; column < kColumnCount; ++column) {
    const double angle = kColumnAngle * column;
    azimuths_[static_cast<size_t>(column)] = {std::cos(angle), std::sin(angle)};
  }
  for (int i = 0; i < kFractionCount; ++i) {
    const double angle = kColumnAngle * i / kFractionCount;
    fractions_[static_cast<size_t>(i)] = {std::cos(angle), std::sin(angle)};
  }
}

std::optional<ScannerReturn> SpinningScanner::Fire(
    Scene& scene, const ScannerRotation& rotation, int pulse) const {
  const Bearing& elevation =
      elevations_[static_cast<size_t>(pulse % kBeamCount)];
  const int column = pulse / kBeamCount;
  const uint64_t start = Draw(options_.seed, rotation.index, Purpose::kBearing);
  const Bearing& azimuth =
      azimuths_[((start >> 32) + static_cast<uint64_t>(column)) % kColumnCount];
  const Bearing& fraction = fractions_[start % kFractionCount];
  const core::Vector3 direction = {
      elevation.cosine *
          (azimuth.cosine * fraction.cosine - azimuth.sine * fraction.sine),
      elevation.cosine *
          (azimuth.sine * fraction.cosine + azimuth.cosine * fraction.sine),
      elevation.sine};
  const double time_s =
      rotation.start_time_s + kRotationTime * column / kColumnCount;
  const core::Point3 origin = rotation.PositionAt(time_s);
  const PulseKey key = {options_.seed, rotation.index * kPulseCount + pulse};

  const std::optional<SceneHit> hit =
      scene.Cast(origin, direction, options_.max_range_m, key);
  if (!hit || hit->range < kMinRange) return std::nullopt;

  ScannerReturn result;
  result.time_s = time_s;
  result.intensity =
      static_cast<float>(hit->reflectance * (0.3 + 0.7 * hit->cos_incidence));
  result.object = hit->object;
  result.truth = hit->truth;
  double range = hit->range;
  const uint64_t spurious = Draw(key.seed, key.pulse, Purpose::kSpurious);
  if (static_cast<double>(spurious >> 32) * 0x1p-32 < options_.spurious_share) {
    const double share = static_cast<double>(spurious & 0xffffffff) * 0x1p-32;
    range = kMinRange + share * (range - kMinRange);
    result.intensity *= 0.1F;
    result.object = ObjectClass::kNoise;
    result.truth = core::Label::kNone;
  }
  range += options_.range_noise_m *
           Normal(Draw(key.seed, key.pulse, Purpose::kRangeNoise));
  range = std::max(range, 0.5 * kMinRange);
  result.position = {origin.x + range * direction[0],
                     origin.y + range * direction[1],
                     origin.z + range * direction[2]};
  return result;
}

}  // namespace mapsieve::client
