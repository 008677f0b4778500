#ifndef MAPSIEVE_CLIENT_LAB_PLACE_H_
#define MAPSIEVE_CLIENT_LAB_PLACE_H_

#include <array>
#include <cmath>
#include <vector>

#include "client/lab/scan_pair.h"
#include "client/lab/scene.h"

namespace mapsieve::client {

/// Where a scanner stands.
struct Station {
  double x = 0;
  double y = 0;
  double yaw = 0;

  double Distance(double px, double py) const {
    return std::hypot(px - x, py - y);
  }
};

/// A place with its two scans' stations: of the reference, of the reading.
struct Place {
  SceneDescription scene;
  std::array<Station, 2> stations;
  /// Bodies that each scan alone meets.
  std::array<std::vector<Polyhedron>, 2> moving;
  double scanner_height = 1.5;
  double max_range_m = 60;
  double range_noise_m = 0.01;
};

/// Place `number` (>= 0) of a kind, always the same. Structured: two furnished
/// rooms joined by a door, with a corner at the origin. Semi-structured: a
/// street of a Campus. Otherwise: a wood on rough ground, without a plane in
/// it.
Place MakePlace(Environment environment, int number);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_PLACE_H_
