#include "core/spdf/quota.h"

#include <algorithm>
#include <array>
#include <utility>

#include "core/geometry/point_hash.h"
#include "core/spdf/integer_root.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::core {
namespace {

/// One more still fits int32.
constexpr int kUpperBits = 30;

/// So few are counted for every point of a group, however wide it is.
constexpr size_t kFewCandidates = 512;

int64_t SquaredDistance(const PointIndex& index, uint32_t a, uint32_t b) {
  const std::array<int32_t, 3> p = index.Coordinates(a);
  const std::array<int32_t, 3> q = index.Coordinates(b);
  int64_t sum = 0;
  for (size_t axis = 0; axis < 3; ++axis) {
    const int64_t d = int64_t{p[axis]} - q[axis];
    sum += d * d;
  }
  return sum;
}

int64_t SquaredDistance(const IndexBox& box, const std::array<int32_t, 3>& q) {
  int64_t sum = 0;
  for (size_t axis = 0; axis < 3; ++axis) {
    const int64_t d = std::max({int64_t{box.min[axis]} - q[axis],
                                int64_t{q[axis]} - box.max[axis], int64_t{0}});
    sum += d * d;
  }
  return sum;
}

}  // namespace

QuotaPriorities::QuotaPriorities(const PointIndex& index, int64_t seed,
                                 Executor& executor)
    : index_(index), seed_(seed), upper_(index.size()) {
  ForEachPart(
      executor, upper_.size(), 8192, [&](size_t, size_t begin, size_t end) {
        for (size_t i = begin; i < end; ++i) {
          upper_[i] = static_cast<int32_t>(Hash(static_cast<uint32_t>(i)) >>
                                           (64 - kUpperBits));
        }
      });
}

uint64_t QuotaPriorities::Hash(uint32_t i) const {
  return PointHash(index_.Position(i), seed_);
}

bool QuotaPriorities::IsBetter(uint32_t a, uint32_t b) const {
  if (upper_[a] != upper_[b]) return upper_[a] < upper_[b];
  return std::pair(Hash(a), index_.Position(a)) <
         std::pair(Hash(b), index_.Position(b));
}

QuotaCounter::QuotaCounter(const QuotaPriorities& priorities,
                           const QuotaRule& rule)
    : priorities_(priorities),
      index_(priorities.index()),
      rule_(rule),
      radius_(CeilRoot(rule.radius_d2)),
      block_(index_) {}

std::span<const uint32_t> QuotaCounter::FindCrowded(
    std::span<const uint32_t> points) {
  crowded_.clear();
  if (radius_ > kMaxRadiusSteps) {
    // The 16-bit coordinates of a block do not reach that far.
    for (const uint32_t i : points) {
      if (CountBetter(i) >= rule_.neighbor_count) crowded_.push_back(i);
    }
    return crowded_;
  }
  SplitWide(index_, points, kMaxRadiusSteps,
            [&](const IndexBox& box, std::span<const uint32_t> part) {
              FindCrowdedIn(box, part);
            });
  return crowded_;
}

/// Of points whose box is at most kMaxRadiusSteps wide.
void QuotaCounter::FindCrowdedIn(const IndexBox& box,
                                 std::span<const uint32_t> points) {
  block_.Gather(box, radius_);
  const size_t candidates = block_.ids().size();
  // Fewer than k others, and all may stay.
  if (candidates <= static_cast<size_t>(rule_.neighbor_count)) return;
  if (candidates <= kFewCandidates || points.size() == 1 ||
      box.Extent() <= GroupExtent(radius_)) {
    CountInBlock(points);
    return;
  }
  const size_t half = points.size() / 2;
  for (const auto part : {points.first(half), points.subspan(half)}) {
    FindCrowdedIn(index_.BoxOf(part), part);
  }
}

void QuotaCounter::CountInBlock(std::span<const uint32_t> points) {
  const int k = rule_.neighbor_count;
  const auto bound_d2 = static_cast<int32_t>(rule_.radius_d2);
  const auto count = ActiveKernels().count_better;
  const std::span<const int32_t> ids = block_.ids();
  near_.resize(ids.size() + kKernelPadding);
  for (size_t c = 0; c < ids.size(); ++c) {
    near_[c] = priorities_.upper(static_cast<uint32_t>(ids[c]));
  }
  for (const uint32_t i : points) {
    const auto [x, y, z] = block_.Relative(i);
    const int32_t own = priorities_.upper(i);
    // Those not worse by the upper bits, the point itself among them.
    if (count(block_.block(), near_.data(), x, y, z, bound_d2, own + 1,
              k + 1) <= k) {
      continue;
    }
    if (count(block_.block(), near_.data(), x, y, z, bound_d2, own, k) >= k ||
        CountBetter(i) >= k) {
      crowded_.push_back(i);
    }
  }
}

/// Better points within the radius of index point `i`, by whole priorities; at
/// most neighbor_count.
int QuotaCounter::CountBetter(uint32_t i) const {
  const std::span<const PointIndex::Node> nodes = index_.nodes();
  const std::array<int32_t, 3> center = index_.Coordinates(i);
  int better = 0;
  const auto visit = [&](const auto& self, uint32_t n) -> void {
    const PointIndex::Node& node = nodes[n];
    if (better >= rule_.neighbor_count ||
        SquaredDistance(node.box, center) > rule_.radius_d2) {
      return;
    }
    if (!node.is_leaf()) {
      self(self, n + 1);
      self(self, node.right);
      return;
    }
    for (uint32_t other = node.begin; other < node.end; ++other) {
      if (priorities_.IsBetter(other, i) &&
          SquaredDistance(index_, other, i) <= rule_.radius_d2 &&
          ++better >= rule_.neighbor_count) {
        return;
      }
    }
  };
  visit(visit, 0);
  return better;
}

}  // namespace mapsieve::core
