#include "client/lab/ball_counter.h"

#include <algorithm>
#include <cstdlib>
#include <utility>

#include "core/geometry/morton.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::client {
namespace {

using core::LatticePoint;

/// No ball reaches farther, and the squares of three such lengths fit.
constexpr int64_t kFar = int64_t{core::kMaxRadiusSteps} + 1;

int64_t SumOfSquares(int64_t x, int64_t y, int64_t z) {
  return std::min(x, kFar) * std::min(x, kFar) +
         std::min(y, kFar) * std::min(y, kFar) +
         std::min(z, kFar) * std::min(z, kFar);
}

/// Squared distance of `q` from the nearest place of a box, capped beyond all
/// radii.
int64_t NearestSquared(const LatticePoint& q, const LatticePoint& min,
                       const LatticePoint& max) {
  const auto gap = [](int64_t v, int64_t low, int64_t high) {
    return std::max({low - v, v - high, int64_t{0}});
  };
  return SumOfSquares(gap(q.x, min.x, max.x), gap(q.y, min.y, max.y),
                      gap(q.z, min.z, max.z));
}

/// The same of the farthest place.
int64_t FarthestSquared(const LatticePoint& q, const LatticePoint& min,
                        const LatticePoint& max) {
  const auto span = [](int64_t v, int64_t low, int64_t high) {
    return std::max(std::abs(v - low), std::abs(high - v));
  };
  return SumOfSquares(span(q.x, min.x, max.x), span(q.y, min.y, max.y),
                      span(q.z, min.z, max.z));
}

}  // namespace

BallCounter::BallCounter(std::vector<LatticePoint> points)
    : points_(std::move(points)) {
  if (!points_.empty()) Build(0, static_cast<uint32_t>(points_.size()));
}

void BallCounter::Build(uint32_t begin, uint32_t end) {
  const size_t self = nodes_.size();
  nodes_.push_back({.begin = begin, .end = end});
  LatticePoint min = points_[begin];
  LatticePoint max = min;
  const auto extend = [&](const LatticePoint& low, const LatticePoint& high) {
    min = {std::min(min.x, low.x), std::min(min.y, low.y),
           std::min(min.z, low.z)};
    max = {std::max(max.x, high.x), std::max(max.y, high.y),
           std::max(max.z, high.z)};
  };
  if (end - begin <= kLeafSize) {
    for (uint32_t i = begin; i < end; ++i) extend(points_[i], points_[i]);
  } else {
    const uint32_t middle =
        core::MortonSplit(begin, end, [&](uint32_t i) { return points_[i]; });
    Build(begin, middle);
    const auto right = static_cast<uint32_t>(nodes_.size());
    Build(middle, end);
    nodes_[self].right = right;
    for (const size_t child : {self + 1, size_t{right}}) {
      extend(nodes_[child].min, nodes_[child].max);
    }
  }
  nodes_[self].min = min;
  nodes_[self].max = max;
}

int64_t BallCounter::Count(const LatticePoint& center,
                           int64_t radius_d2) const {
  return nodes_.empty() ? 0 : CountBelow(0, center, radius_d2);
}

int64_t BallCounter::CountBelow(uint32_t node, const LatticePoint& center,
                                int64_t radius_d2) const {
  const Node& n = nodes_[node];
  if (NearestSquared(center, n.min, n.max) > radius_d2) return 0;
  if (FarthestSquared(center, n.min, n.max) <= radius_d2) {
    return n.end - n.begin;
  }
  if (n.right != 0) {
    return CountBelow(node + 1, center, radius_d2) +
           CountBelow(n.right, center, radius_d2);
  }
  int64_t count = 0;
  for (uint32_t i = n.begin; i < n.end; ++i) {
    count += NearestSquared(center, points_[i], points_[i]) <= radius_d2;
  }
  return count;
}

}  // namespace mapsieve::client
