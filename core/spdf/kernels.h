#ifndef MAPSIEVE_CORE_SPDF_KERNELS_H_
#define MAPSIEVE_CORE_SPDF_KERNELS_H_

#include <cstdint>

/// The inner loops of the filter over plain arrays. The same source is compiled
/// for several instruction sets; every version gives the same bits, since all
/// sums are integers and every float operation is rounded once.
namespace mapsieve::core {

/// Points around a query, distinct; coordinates relative to the block's
/// centre, |coordinate| <= 2 * kMaxRadiusSteps.
struct CandidateBlock {
  const int32_t* x = nullptr;
  const int32_t* y = nullptr;
  const int32_t* z = nullptr;
  int count = 0;
};

/// A point of the block whose neighbourhood is wanted.
struct NeighborQuery {
  int32_t x = 0;
  int32_t y = 0;
  int32_t z = 0;
  /// Neighbours wanted.
  int neighbor_count = 0;
  /// Only points with squared distance <= bound_d2 are neighbours.
  int32_t bound_d2 = 0;
  /// Squared steps to the exponent of the vote kernel.
  float weight_scale = 0;
};

/// Room for one query over a block of `capacity` candidates.
struct KernelScratch {
  int32_t* d2 = nullptr;       // capacity
  int32_t* members = nullptr;  // capacity; indices of neighbours in the block
};

/// Sum of ball votes in units of 2^-24: c0 = sum of weights; the rest is
/// A = sum of w r rᵀ (zz = c0 - xx - yy).
struct BallSums {
  int32_t c0 = 0;
  int32_t xx = 0;
  int32_t xy = 0;
  int32_t xz = 0;
  int32_t yy = 0;
  int32_t yz = 0;
  int32_t member_count = 0;
  /// Every neighbour lies within it; bound_d2 if fewer than asked for.
  int32_t radius_d2 = 0;
};

/// Six unique entries of a symmetric matrix in units of 2^-24.
struct VoteSums {
  int32_t xx = 0;
  int32_t xy = 0;
  int32_t xz = 0;
  int32_t yy = 0;
  int32_t yz = 0;
  int32_t zz = 0;
  int32_t member_count = 0;
};

/// Six unique entries (xx xy xz yy yz zz) of a voter's tensor.
struct VoterTensor {
  float entry[6] = {0, 0, 0, 0, 0, 0};
};

struct Kernels {
  const char* name;

  /// d2[i] = squared distance of candidate i from (x, y, z).
  void (*distances)(const CandidateBlock& block, int32_t x, int32_t y,
                    int32_t z, int32_t* d2);

  /// A value b such that exactly `rank` of the `count` values are <= b, or the
  /// smallest with at least `rank` if ties make that impossible; `bound` if
  /// fewer than `rank` values are <= bound.
  int32_t (*select)(const int32_t* d2, int count, int rank, int32_t bound);

  /// The ball votes of the `neighbor_count` nearest other points, ties by
  /// coordinate (x, then y, then z). The query is a point of the block.
  void (*ball_vote)(const CandidateBlock& block, const NeighborQuery& query,
                    const KernelScratch& scratch, BallSums* sums);

  /// The votes of the same neighbours, given their radius_d2 as bound, carrying
  /// tensors: tensors[i] is candidate i's.
  void (*aware_vote)(const CandidateBlock& block, const NeighborQuery& query,
                     const VoterTensor* tensors, const KernelScratch& scratch,
                     VoteSums* sums);

  /// How many other points lie within bound_d2 of the query (candidate
  /// `self`) and have a smaller priority, ties by coordinate.
  int (*count_better)(const CandidateBlock& block, const uint64_t* priorities,
                      int self, int32_t bound_d2);

  /// The vote weight of squared distance `d2` in units of 2^-24.
  int32_t (*weight)(int32_t d2, float weight_scale);
};

/// The fastest version that this processor runs. Thread-safe.
const Kernels& ActiveKernels();

/// Every version that this processor runs, the portable one first; for tests.
/// `count` receives their number.
const Kernels* const* AvailableKernels(int* count);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_KERNELS_H_
