// Compiled once per instruction set, which the build names in
// MAPSIEVE_KERNEL_SET. Only plain arrays and builtins: an inline function of a
// library compiled here could be the copy that the linker keeps for the whole
// program, and would then run on processors without these instructions.
#include "core/spdf/kernels.h"

#define MAPSIEVE_KERNEL_STRING_(x) #x
#define MAPSIEVE_KERNEL_STRING(x) MAPSIEVE_KERNEL_STRING_(x)

namespace mapsieve::core {
namespace {

constexpr int kMaxMembers = 128;

inline float BitsToFloat(int32_t bits) {
  float value;
  __builtin_memcpy(&value, &bits, sizeof(value));
  return value;
}

/// 2^24 * exp(-d2 * scale), unrounded: n = round(x log2 e), Cody-Waite
/// reduction in two steps, polynomial of degree 6, scaled by 2^(n + 24).
inline float ScaledWeight(float d2, float scale) {
  float x = -(d2 * scale);
  x = x < -87.0f ? -87.0f : x;
  const float n = __builtin_rintf(x * 1.44269504f);
  const float r = (x - n * 0.693359375f) - n * -2.12194440e-4f;
  float p = 1.38888889e-3f;
  p = p * r + 8.33333333e-3f;
  p = p * r + 4.16666667e-2f;
  p = p * r + 1.66666667e-1f;
  p = p * r + 0.5f;
  p = p * r + 1.0f;
  p = p * r + 1.0f;
  return p * BitsToFloat((static_cast<int32_t>(n) + 24 + 127) << 23);
}

inline int32_t Round(float x) {
  return static_cast<int32_t>(__builtin_rintf(x));
}

int32_t Weight(int32_t d2, float scale) {
  return Round(ScaledWeight(static_cast<float>(d2), scale));
}

void Distances(const CandidateBlock& block, int32_t x, int32_t y, int32_t z,
               int32_t* __restrict d2) {
  const int32_t* __restrict bx = block.x;
  const int32_t* __restrict by = block.y;
  const int32_t* __restrict bz = block.z;
  const int count = block.count;
  for (int i = 0; i < count; ++i) {
    const int32_t dx = bx[i] - x;
    const int32_t dy = by[i] - y;
    const int32_t dz = bz[i] - z;
    d2[i] = dx * dx + dy * dy + dz * dz;
  }
}

inline int CountWithin(const int32_t* __restrict d2, int count, int32_t bound) {
  int within = 0;
  for (int i = 0; i < count; ++i) within += d2[i] <= bound ? 1 : 0;
  return within;
}

int32_t Select(const int32_t* d2, int count, int rank, int32_t bound) {
  if (CountWithin(d2, count, bound) <= rank) return bound;
  int32_t low = -1;  // fewer than rank values are <= low
  int32_t high = bound;
  while (high - low > 1) {
    const int32_t middle = low + (high - low) / 2;
    const int within = CountWithin(d2, count, middle);
    if (within == rank) return middle;
    if (within < rank) {
      low = middle;
    } else {
      high = middle;
    }
  }
  return high;
}

/// True if candidate `a` comes before `b` in the order of lattice coordinates.
inline bool IsBefore(const CandidateBlock& block, int32_t a, int32_t b) {
  if (block.x[a] != block.x[b]) return block.x[a] < block.x[b];
  if (block.y[a] != block.y[b]) return block.y[a] < block.y[b];
  return block.z[a] < block.z[b];
}

/// Writes the indices of the first `rank` candidates by (d2, coordinate) to
/// `members`, in no particular order; `radius` comes from Select.
inline int CollectMembers(const CandidateBlock& block,
                          const int32_t* __restrict d2, int rank,
                          int32_t radius, int32_t* __restrict members) {
  int found = 0;
  for (int i = 0; i < block.count; ++i) {
    members[found] = i;
    found += d2[i] <= radius ? 1 : 0;
  }
  if (found <= rank) return found;
  // More than `rank` points lie within: some tie at the radius. The nearer
  // ones come first, then as many of the tied ones as there is room for.
  int kept = 0;
  for (int m = 0; m < found; ++m) {
    const int32_t i = members[m];
    if (d2[i] == radius) continue;
    members[m] = members[kept];
    members[kept++] = i;
  }
  for (; kept < rank; ++kept) {
    int first = kept;
    for (int m = kept + 1; m < found; ++m) {
      if (IsBefore(block, members[m], members[first])) first = m;
    }
    const int32_t i = members[first];
    members[first] = members[kept];
    members[kept] = i;
  }
  return rank;
}

void BallVote(const CandidateBlock& block, const NeighborQuery& query,
              const KernelScratch& scratch, BallSums* sums) {
  Distances(block, query.x, query.y, query.z, scratch.d2);
  // The query itself is a candidate, at distance 0: one more than the
  // neighbours.
  const int rank = query.neighbor_count + 1;
  const int32_t radius = Select(scratch.d2, block.count, rank, query.bound_d2);
  const int found =
      CollectMembers(block, scratch.d2, rank, radius, scratch.members);
  float dx[kMaxMembers];
  float dy[kMaxMembers];
  float dz[kMaxMembers];
  float dd[kMaxMembers];
  for (int m = 0; m < found; ++m) {
    const int32_t i = scratch.members[m];
    dx[m] = static_cast<float>(query.x - block.x[i]);
    dy[m] = static_cast<float>(query.y - block.y[i]);
    dz[m] = static_cast<float>(query.z - block.z[i]);
    dd[m] = static_cast<float>(scratch.d2[i]);
  }
  int32_t c0 = 0;
  int32_t xx = 0;
  int32_t xy = 0;
  int32_t xz = 0;
  int32_t yy = 0;
  int32_t yz = 0;
  const float scale = query.weight_scale;
  for (int m = 0; m < found; ++m) {
    const bool self = dd[m] == 0.0f;
    const float w = self ? 0.0f : ScaledWeight(dd[m], scale);
    const float g = w / (self ? 1.0f : dd[m]);
    const float gx = g * dx[m];
    const float gy = g * dy[m];
    c0 += Round(w);
    xx += Round(gx * dx[m]);
    xy += Round(gx * dy[m]);
    xz += Round(gx * dz[m]);
    yy += Round(gy * dy[m]);
    yz += Round(gy * dz[m]);
  }
  sums->c0 = c0;
  sums->xx = xx;
  sums->xy = xy;
  sums->xz = xz;
  sums->yy = yy;
  sums->yz = yz;
  sums->member_count = found - 1;
  sums->radius_d2 = radius;
}

void AwareVote(const CandidateBlock& block, const NeighborQuery& query,
               const VoterTensor* tensors, const KernelScratch& scratch,
               VoteSums* sums) {
  Distances(block, query.x, query.y, query.z, scratch.d2);
  const int rank = query.neighbor_count + 1;
  const int found =
      CollectMembers(block, scratch.d2, rank, query.bound_d2, scratch.members);
  float dx[kMaxMembers];
  float dy[kMaxMembers];
  float dz[kMaxMembers];
  float dd[kMaxMembers];
  float k[6][kMaxMembers];
  for (int m = 0; m < found; ++m) {
    const int32_t i = scratch.members[m];
    dx[m] = static_cast<float>(query.x - block.x[i]);
    dy[m] = static_cast<float>(query.y - block.y[i]);
    dz[m] = static_cast<float>(query.z - block.z[i]);
    dd[m] = static_cast<float>(scratch.d2[i]);
    for (int e = 0; e < 6; ++e) k[e][m] = tensors[i].entry[e];
  }
  int32_t xx = 0;
  int32_t xy = 0;
  int32_t xz = 0;
  int32_t yy = 0;
  int32_t yz = 0;
  int32_t zz = 0;
  const float scale = query.weight_scale;
  for (int m = 0; m < found; ++m) {
    // With unit r, g = K r and q = r . g, the symmetric part of R K R' is
    // K - 7/4 (r gᵀ + g rᵀ) + 3 q r rᵀ.
    const bool self = dd[m] == 0.0f;
    const float w = self ? 0.0f : ScaledWeight(dd[m], scale);
    const float length = __builtin_sqrtf(self ? 1.0f : dd[m]);
    const float rx = dx[m] / length;
    const float ry = dy[m] / length;
    const float rz = dz[m] / length;
    const float gx = (k[0][m] * rx + k[1][m] * ry) + k[2][m] * rz;
    const float gy = (k[1][m] * rx + k[3][m] * ry) + k[4][m] * rz;
    const float gz = (k[2][m] * rx + k[4][m] * ry) + k[5][m] * rz;
    const float q3 = 3.0f * ((gx * rx + gy * ry) + gz * rz);
    const float qx = q3 * rx;
    const float qy = q3 * ry;
    const float qz = q3 * rz;
    xx += Round(w * ((k[0][m] - 3.5f * (rx * gx)) + qx * rx));
    xy += Round(w * ((k[1][m] - 1.75f * (rx * gy + ry * gx)) + qx * ry));
    xz += Round(w * ((k[2][m] - 1.75f * (rx * gz + rz * gx)) + qx * rz));
    yy += Round(w * ((k[3][m] - 3.5f * (ry * gy)) + qy * ry));
    yz += Round(w * ((k[4][m] - 1.75f * (ry * gz + rz * gy)) + qy * rz));
    zz += Round(w * ((k[5][m] - 3.5f * (rz * gz)) + qz * rz));
  }
  sums->xx = xx;
  sums->xy = xy;
  sums->xz = xz;
  sums->yy = yy;
  sums->yz = yz;
  sums->zz = zz;
  sums->member_count = found - 1;
}

int CountBetter(const CandidateBlock& block,
                const uint64_t* __restrict priorities, int self,
                int32_t bound_d2) {
  const int32_t* __restrict bx = block.x;
  const int32_t* __restrict by = block.y;
  const int32_t* __restrict bz = block.z;
  const int32_t x = bx[self];
  const int32_t y = by[self];
  const int32_t z = bz[self];
  const uint64_t mine = priorities[self];
  int better = 0;
  int tied = 0;
  for (int i = 0; i < block.count; ++i) {
    const int32_t dx = bx[i] - x;
    const int32_t dy = by[i] - y;
    const int32_t dz = bz[i] - z;
    const bool near = dx * dx + dy * dy + dz * dz <= bound_d2;
    better += (near & (priorities[i] < mine)) ? 1 : 0;
    tied += (near & (priorities[i] == mine)) ? 1 : 0;
  }
  if (tied == 1) return better;  // the point itself
  for (int i = 0; i < block.count; ++i) {
    const int32_t dx = bx[i] - x;
    const int32_t dy = by[i] - y;
    const int32_t dz = bz[i] - z;
    const bool near = dx * dx + dy * dy + dz * dz <= bound_d2;
    if (near && priorities[i] == mine && IsBefore(block, i, self)) ++better;
  }
  return better;
}

}  // namespace

#define MAPSIEVE_KERNEL_TABLE_(set) k##set##Kernels
#define MAPSIEVE_KERNEL_TABLE(set) MAPSIEVE_KERNEL_TABLE_(set)

extern const Kernels MAPSIEVE_KERNEL_TABLE(MAPSIEVE_KERNEL_SET);
const Kernels MAPSIEVE_KERNEL_TABLE(MAPSIEVE_KERNEL_SET) = {
    MAPSIEVE_KERNEL_STRING(MAPSIEVE_KERNEL_SET),
    Distances,
    Select,
    BallVote,
    AwareVote,
    CountBetter,
    Weight,
};

}  // namespace mapsieve::core
