#ifndef MAPSIEVE_CORE_CLOUD_MERGE_DUPLICATES_H_
#define MAPSIEVE_CORE_CLOUD_MERGE_DUPLICATES_H_

#include <cstdint>
#include <span>
#include <stop_token>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/cloud/point_cloud.h"

namespace mapsieve::core {

/// Whether `positions` are in Morton order.
bool IsMortonSorted(std::span<const LatticePoint> positions);

/// The rows of `positions` in Morton order; rows of one lattice point keep
/// their order. At most 2^32 - 1 rows.
std::vector<uint32_t> MortonOrder(std::span<const LatticePoint> positions,
                                  Executor& executor = InlineExecutor());

/// MortonOrder by merging what ascends already: as fast where that are a few
/// runs, slower where they are many. kCancelled, some milliseconds after `stop`
/// was requested.
absl::StatusOr<std::vector<uint32_t>> MergeMortonRuns(
    std::span<const LatticePoint> positions, const std::stop_token& stop);

/// One row for every distinct lattice point of `cloud`, in Morton order: of
/// several points in one place, the one with the smallest attributes
/// (attributes by name, missing before present, then by little-endian bytes).
/// So the choice depends on the set of points alone.
std::vector<uint32_t> MergeDuplicates(const LatticeCloud& cloud,
                                      Executor& executor = InlineExecutor());

/// MergeDuplicates for points without attributes.
std::vector<LatticePoint> DistinctPoints(
    std::span<const LatticePoint> positions);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CLOUD_MERGE_DUPLICATES_H_
