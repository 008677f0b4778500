#include "core/spdf/quota.h"

#include <algorithm>
#include <array>
#include <utility>

#include "core/base/hash.h"
#include "core/spdf/integer_root.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::core {
namespace {

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
  ForEachPart(executor, upper_.size(), 8192,
              [&](size_t, size_t begin, size_t end) {
                for (size_t i = begin; i < end; ++i) {
                  upper_[i] = static_cast<int32_t>(
                      Hash(static_cast<uint32_t>(i)) >> 32 ^ 0x80000000u);
                }
              });
}

uint64_t QuotaPriorities::Hash(uint32_t i) const {
  const LatticePoint q = index_.Position(i);
  const int64_t key[4] = {q.x, q.y, q.z, seed_};
  return HashIntegers(key);
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
  SplitWide(index_, points, GroupExtent(radius_),
            [&](const IndexBox& box, std::span<const uint32_t> part) {
              block_.Gather(box, radius_);
              // Fewer than k others, and all may stay.
              const auto k = static_cast<size_t>(rule_.neighbor_count);
              if (block_.ids().size() > k) CountInBlock(part);
            });
  return crowded_;
}

void QuotaCounter::CountInBlock(std::span<const uint32_t> points) {
  const int k = rule_.neighbor_count;
  const std::span<const int32_t> ids = block_.ids();
  near_.assign(ids.size() + kKernelPadding, 0);
  for (size_t c = 0; c < ids.size(); ++c) {
    near_[c] = priorities_.upper(static_cast<uint32_t>(ids[c]));
  }
  for (const uint32_t i : points) {
    const auto [x, y, z] = block_.Relative(i);
    const int better = ActiveKernels().count_better(
        block_.block(), near_.data(), x, y, z,
        static_cast<int32_t>(rule_.radius_d2), priorities_.upper(i), k);
    if (better >= k || (HasTwin(i) && CountBetter(i) >= k)) {
      crowded_.push_back(i);
    }
  }
}

/// Whether another point of the block has the same upper half.
bool QuotaCounter::HasTwin(uint32_t i) const {
  return std::count(near_.begin(), near_.end() - kKernelPadding,
                    priorities_.upper(i)) > 1;
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
