#include "client/lab/simulated_pair.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lab/place.h"
#include "client/lab/scene.h"
#include "client/lab/spinning_scanner.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

constexpr double kSpuriousShare = 0.002;

/// Moves points of the sensor's frame to the scene's.
core::RigidTransform SensorPose(const Station& station, double z) {
  return {core::RotationFromVector({0, 0, station.yaw}),
          {station.x, station.y, z}};
}

/// The pulses of a pair's scans differ, so their noise does.
core::LatticeCloud TakeScan(const Place& place, size_t scan, uint64_t seed,
                            int rotation_count,
                            core::RigidTransform& T_scene_sensor) {
  SceneDescription description = place.scene;
  description.polyhedra.insert(description.polyhedra.end(),
                               place.moving[scan].begin(),
                               place.moving[scan].end());
  Scene scene(std::move(description));
  const Station& station = place.stations[scan];
  T_scene_sensor = SensorPose(
      station, scene.GroundHeight(station.x, station.y) + place.scanner_height);
  const core::RigidTransform T_sensor_scene = T_scene_sensor.Inverse();
  const core::Vector3& origin = T_scene_sensor.translation;
  const SpinningScanner scanner({.seed = seed,
                                 .max_range_m = place.max_range_m,
                                 .range_noise_m = place.range_noise_m,
                                 .spurious_share = kSpuriousShare});
  core::PointCloud cloud;
  for (int i = 0; i < rotation_count; ++i) {
    const ScannerRotation rotation = {
        .index = static_cast<int64_t>(scan) * rotation_count + i,
        .start = {origin[0], origin[1], origin[2]}};
    for (int pulse = 0; pulse < SpinningScanner::kPulseCount; ++pulse) {
      const auto echo = scanner.Fire(scene, rotation, pulse);
      if (echo) cloud.positions.push_back(T_sensor_scene(echo->position));
    }
  }
  core::RefusedCounts refused;
  return core::Quantize(std::move(cloud), core::Lattice(), refused);
}

ScanPair MakePair(Environment environment, int number, int rotation_count) {
  const Place place = MakePlace(environment, number);
  const uint64_t seed =
      1000 * static_cast<uint64_t>(environment) + static_cast<uint64_t>(number);
  ScanPair pair;
  core::RigidTransform T_scene_reference;
  core::RigidTransform T_scene_reading;
  pair.reference = TakeScan(place, 0, seed, rotation_count, T_scene_reference);
  pair.reading = TakeScan(place, 1, seed, rotation_count, T_scene_reading);
  pair.T_reference_reading = T_scene_reference.Inverse() * T_scene_reading;
  return pair;
}

}  // namespace

absl::Status SimulatedPairOptions::Validate() const {
  for (const int count : pair_counts) {
    if (count < 0 || count > 1000) {
      return absl::InvalidArgumentError(
          absl::StrCat("pair_counts holds ", count, "; expected 0 to 1000"));
    }
  }
  if (first_pair < 0 || first_pair > 1'000'000) {
    return absl::InvalidArgumentError(
        absl::StrCat("first_pair is ", first_pair, "; expected 0 to 1000000"));
  }
  if (rotation_count < 1 || rotation_count > 32) {
    return absl::InvalidArgumentError(absl::StrCat(
        "rotation_count is ", rotation_count, "; expected 1 to 32"));
  }
  return absl::OkStatus();
}

std::vector<PairSource> SimulatedPairs(const SimulatedPairOptions& options) {
  std::vector<PairSource> sources;
  for (size_t kind = 0; kind < options.pair_counts.size(); ++kind) {
    const Environment environment = kEnvironments[kind];
    for (int k = 0; k < options.pair_counts[kind]; ++k) {
      const int number = options.first_pair + k;
      const int rotation_count = options.rotation_count;
      sources.push_back({absl::StrCat(ToAbsl(EnvironmentName(environment)), "-",
                                      number, "-r", rotation_count),
                         environment, [environment, number, rotation_count] {
                           return absl::StatusOr<ScanPair>(
                               MakePair(environment, number, rotation_count));
                         }});
    }
  }
  return sources;
}

}  // namespace mapsieve::client
