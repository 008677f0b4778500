#ifndef MAPSIEVE_CLIENT_LAB_BALL_COUNTER_H_
#define MAPSIEVE_CLIENT_LAB_BALL_COUNTER_H_

#include <cstdint>
#include <vector>

#include "core/geometry/lattice.h"

namespace mapsieve::client {

/// Counts the points of a set in balls: a tree over points in Morton order,
/// whose nodes count as a whole where they lie in the ball, so that a ball
/// costs what its border costs. Immutable; thread-safe.
class BallCounter {
 public:
  /// `points`: distinct, in Morton order, fewer than 2^32. O(N).
  explicit BallCounter(std::vector<core::LatticePoint> points);

  const std::vector<core::LatticePoint>& points() const { return points_; }

  /// How many points lie within a squared distance of `radius_d2` steps² of
  /// `center`, one at `center` among them; 0 to core::kMaxRadiusSteps².
  int64_t Count(const core::LatticePoint& center, int64_t radius_d2) const;

 private:
  static constexpr uint32_t kLeafSize = 16;

  /// A range of the points and the smallest box around it. The left half of a
  /// node follows it.
  struct Node {
    core::LatticePoint min;
    core::LatticePoint max;
    uint32_t begin = 0;
    uint32_t end = 0;
    /// 0: a leaf.
    uint32_t right = 0;
  };

  void Build(uint32_t begin, uint32_t end);
  int64_t CountBelow(uint32_t node, const core::LatticePoint& center,
                     int64_t radius_d2) const;

  std::vector<core::LatticePoint> points_;
  std::vector<Node> nodes_;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_BALL_COUNTER_H_
