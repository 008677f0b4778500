#ifndef MAPSIEVE_CLIENT_LAB_CAMPUS_H_
#define MAPSIEVE_CLIENT_LAB_CAMPUS_H_

#include <cstdint>

#include "client/lab/scene.h"
#include "core/geometry/lattice.h"

namespace mapsieve::client {

/// A campus without an end: undulating ground, a grid of streets with kerbs,
/// lamps, trees and parked cars, and between them blocks with buildings,
/// houses, groves and car parks. Every block is a function of the seed and its
/// own indices, so any part of the world can be made alone and made again.
///
/// In the campus' frame block (x, y) begins at (x * kBlockX, y * kBlockY); its
/// first kStreetWidth metres on either axis are street. Thread-safe.
class Campus {
 public:
  static constexpr double kBlockX = 64;
  static constexpr double kBlockY = 48;
  static constexpr double kStreetWidth = 8;
  /// Along both sides of every street.
  static constexpr double kPavementWidth = 2;
  static constexpr double kKerbHeight = 0.12;
  /// How far from a block a ray may start in the block's surroundings.
  static constexpr double kReach = 2;

  explicit Campus(uint64_t seed) : seed_(seed) {}

  /// Everything that a ray of at most `range` metres can meet from a place
  /// within kReach of block (block_x, block_y).
  SceneDescription Surroundings(int64_t block_x, int64_t block_y,
                                double range) const;

  /// Height of the street at a place, kerbs and lawns aside.
  double TerrainHeight(double x, double y) const;

 private:
  uint64_t seed_;
};

/// A drive along the middle of the streets of a Campus in a square spiral from
/// the crossing at the origin: it passes every crossing once and never ends.
/// Returns the place after `distance` metres, 0 to 1e12, swaying gently;
/// z is 0. Thread-safe.
core::Point3 SpiralDrive(double distance);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_CAMPUS_H_
