#ifndef MAPSIEVE_TESTS_BENCH_KNOWN_CLOUDS_H_
#define MAPSIEVE_TESTS_BENCH_KNOWN_CLOUDS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cloud/label.h"
#include "core/cloud/point_cloud.h"

/// Clouds whose geometry is known point by point.
namespace mapsieve::bench {

/// Points of a surface or a post are "clear" if no point of anything else, and
/// none near an edge, is nearer than this, in metres. Stray points in the air
/// do not count.
inline constexpr double kClearance = 0.5;

/// What some points of a cloud lie on.
struct Kind {
  std::string name;
  /// The label that every one of them deserves: a clear surface, a clear post;
  /// else kNone, nothing definite.
  core::Label expected = core::Label::kNone;
  /// Of a post, in metres.
  double radius_m = 0;
};

struct KnownCloud {
  std::string name;
  /// Distinct points in Morton order; no attributes.
  core::LatticeCloud cloud;
  std::vector<Kind> kinds;
  /// One entry a point: an index of `kinds`.
  std::vector<uint8_t> kind_of;
};

/// Clouds that the criteria of the tables were chosen on, and others, of other
/// geometry, that were not looked at before.
enum class Scenes { kChosenOn, kHeldOut };

/// The simulated campus survey with 1 million points: few places are denser
/// than 50 points in a ball of 0.2 m.
absl::StatusOr<KnownCloud> CampusCloud(Scenes scenes, double range_noise_m);

/// A yard with two walls, a kiosk and posts of four radii, seen by the campus'
/// scanner from so many places that most of it holds more than 50 points in a
/// ball of 0.1 m.
absl::StatusOr<KnownCloud> YardCloud(Scenes scenes, double range_noise_m);

/// `path`: float32 x, y, z of each point, little-endian; `path`.truth: a
/// core::Label a point, 0 for foliage and noise. Surfaces farther than
/// `split_range_m` from the origin are a kind of their own; 0: no such kind.
/// kNotFound, kDataLoss.
absl::StatusOr<KnownCloud> ReferenceCloud(const std::string& path,
                                          double split_range_m);

}  // namespace mapsieve::bench

#endif  // MAPSIEVE_TESTS_BENCH_KNOWN_CLOUDS_H_
