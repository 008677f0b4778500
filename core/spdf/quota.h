#ifndef MAPSIEVE_CORE_SPDF_QUOTA_H_
#define MAPSIEVE_CORE_SPDF_QUOTA_H_

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/bulk_vector.h"
#include "core/base/executor.h"
#include "core/spdf/gathered_block.h"
#include "core/spdf/point_index.h"

namespace mapsieve::core {

/// What rule kQuota asks of a point: that fewer than neighbor_count points of
/// better priority lie in the closed ball of the radius around it.
struct QuotaRule {
  int neighbor_count = 0;
  /// Squared radius in steps², up to 2^52.
  int64_t radius_d2 = 0;
  int64_t seed = 0;
};

/// The priorities of the points of an index: hashes of their coordinates and
/// the seed, the smaller the better, ties by coordinate. Const methods are
/// thread-safe.
class QuotaPriorities {
 public:
  /// `index` outlives the object.
  QuotaPriorities(const PointIndex& index, int64_t seed, Executor& executor);

  const PointIndex& index() const { return index_; }
  /// The upper bits of an index point's priority, less than INT32_MAX.
  int32_t upper(uint32_t i) const { return upper_[i]; }
  bool IsBetter(uint32_t a, uint32_t b) const;

 private:
  uint64_t Hash(uint32_t i) const;

  const PointIndex& index_;
  const int64_t seed_;
  BulkVector<int32_t> upper_;
};

/// Applies the rule to groups of nearby points. Not thread-safe; several may
/// share the priorities.
class QuotaCounter {
 public:
  /// `priorities` outlives the object; its index is not changed meanwhile.
  QuotaCounter(const QuotaPriorities& priorities, const QuotaRule& rule);

  /// Those of the index points `points`, which lie near each other, that break
  /// the rule; valid until the next call.
  std::span<const uint32_t> FindCrowded(std::span<const uint32_t> points);

 private:
  void FindCrowdedIn(const IndexBox& box, std::span<const uint32_t> points);
  void CountInBlock(std::span<const uint32_t> points);
  int CountBetter(uint32_t i) const;

  const QuotaPriorities& priorities_;
  const PointIndex& index_;
  const QuotaRule rule_;
  const int64_t radius_;
  std::vector<uint32_t> crowded_;
  GatheredBlock block_;
  /// Of the block's candidates.
  std::vector<int32_t> near_;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_QUOTA_H_
