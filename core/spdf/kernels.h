#ifndef MAPSIEVE_CORE_SPDF_KERNELS_H_
#define MAPSIEVE_CORE_SPDF_KERNELS_H_

#include <cstdint>

/// The inner loops of the filter over plain arrays. The same source is compiled
/// for several instruction sets; every version gives the same bits, since all
/// sums are integers and every float operation is rounded once.
namespace mapsieve::core {

/// Arrays that kernels read hold their elements and then, up to the next
/// multiple of it, padding; those that kernels write have room for as much
/// again.
inline constexpr int kKernelPadding = 16;

/// Points around a query, distinct; coordinates relative to the block's
/// centre, |coordinate| <= 3/2 kMaxRadiusSteps, so that differences to a query
/// of it fit int16 and squared distances int32.
struct CandidateBlock {
  /// x in the low, y in the high half; padded.
  const int32_t* xy = nullptr;
  /// z in the low half, 0 in the high one; padded with kFarAway.
  const int32_t* z = nullptr;
  int count = 0;
};

/// A z that is out of reach of every query.
inline constexpr int32_t kFarAway = 28'000;

constexpr int32_t PackXy(int32_t x, int32_t y) {
  return static_cast<int32_t>(static_cast<uint32_t>(x & 0xffff) |
                              static_cast<uint32_t>(y) << 16);
}
constexpr int32_t PackZ(int32_t z) { return z & 0xffff; }
constexpr int32_t UnpackX(int32_t xy) { return static_cast<int16_t>(xy); }
constexpr int32_t UnpackY(int32_t xy) { return xy >> 16; }
constexpr int32_t UnpackZ(int32_t z) { return static_cast<int16_t>(z); }

/// Points to gather a block from, and the box that it takes: those whose
/// coordinates differ by at most `half` from `center`.
struct GatherSource {
  const int32_t* x = nullptr;
  const int32_t* y = nullptr;
  const int32_t* z = nullptr;
  int32_t center[3] = {0, 0, 0};
  int32_t half[3] = {0, 0, 0};
};

/// A block that is being made. Room for the elements and twice kKernelPadding.
struct BlockArrays {
  int32_t* xy = nullptr;
  int32_t* z = nullptr;
  /// Index positions.
  int32_t* ids = nullptr;
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

/// Voters' tensors, an array for each of the six unique entries (xx xy xz yy
/// yz zz); element i holds the bits of candidate i's float. Padded.
struct VoterTensors {
  const int32_t* entry[6] = {};
};

/// Room for one query over a block: arrays of its count and twice
/// kKernelPadding.
struct KernelScratch {
  int32_t* d2 = nullptr;
  int32_t* xy = nullptr;
  int32_t* z = nullptr;
  /// For aware_vote only.
  int32_t* entry[6] = {};
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

/// Symmetric matrices to decompose, side by side.
struct EigenBatch {
  static constexpr int kSize = 8;
  /// xx xy xz yy yz zz of each.
  double entry[6][kSize] = {};
  /// Eigenvalues in no particular order.
  double value[3][kSize] = {};
  /// vector[i][axis]: unit eigenvector of value[i].
  double vector[3][3][kSize] = {};
};

struct Kernels {
  const char* name;

  /// Appends the points [begin, end) of `source` that lie in its box to a block
  /// of `count` elements; returns its new count.
  int (*gather)(const GatherSource& source, uint32_t begin, uint32_t end,
                const BlockArrays& block, int count);

  /// d2[i] = squared distance of candidate i from (x, y, z), and INT32_MAX in
  /// the padding.
  void (*distances)(const CandidateBlock& block, int32_t x, int32_t y,
                    int32_t z, int32_t* d2);

  /// A value b such that exactly `rank` of the `count` values are <= b, or the
  /// smallest with at least `rank` if ties make that impossible; `bound` if
  /// fewer than `rank` values are <= bound. d2 is padded with INT32_MAX.
  int32_t (*select)(const int32_t* d2, int count, int rank, int32_t bound);

  /// Keeps the elements with d2 <= bound, in order; returns how many.
  int (*keep_within)(const BlockArrays& block, const int32_t* d2, int count,
                     int32_t bound);

  /// Whether any candidate lies within bound_d2 of (x, y, z).
  bool (*any_within)(const CandidateBlock& block, int32_t x, int32_t y,
                     int32_t z, int32_t bound_d2);

  /// The ball votes of the `neighbor_count` nearest other points, ties by
  /// coordinate (x, then y, then z). The query is a point of the block.
  void (*ball_vote)(const CandidateBlock& block, const NeighborQuery& query,
                    const KernelScratch& scratch, BallSums* sums);

  /// The votes of the same neighbours, given their radius_d2 as bound, carrying
  /// tensors.
  void (*aware_vote)(const CandidateBlock& block, const NeighborQuery& query,
                     const VoterTensors& tensors, const KernelScratch& scratch,
                     VoteSums* sums);

  /// How many points lie within bound_d2 of (x, y, z) and have a smaller
  /// priority than `priority`; any number >= `limit` once that is reached.
  /// `priorities`: one a candidate; padded.
  int (*count_better)(const CandidateBlock& block, const int32_t* priorities,
                      int32_t x, int32_t y, int32_t z, int32_t bound_d2,
                      int32_t priority, int limit);

  /// Eigenvalues and eigenvectors of a batch by cyclic Jacobi rotations, each
  /// matrix's as if it were alone.
  void (*decompose)(EigenBatch* batch);
  /// The same eigenvalues without the vectors.
  void (*find_eigenvalues)(EigenBatch* batch);

  /// The vote weight of squared distance `d2` in units of 2^-24.
  int32_t (*weight)(int32_t d2, float weight_scale);
};

/// The version in use: the fastest that this processor runs. Thread-safe.
const Kernels& ActiveKernels();

/// Makes `kernels` the version in use, for tests and benchmarks. Not while
/// others filter.
void UseKernels(const Kernels& kernels);

/// Every version that this processor runs, the portable one first; for tests
/// and benchmarks. `count` receives their number.
const Kernels* const* AvailableKernels(int* count);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_KERNELS_H_
