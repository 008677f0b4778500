// Compiled once per instruction set, which the build names in
// MAPSIEVE_KERNEL_SET. Only plain arrays, intrinsics and builtins: an inline
// function of a library compiled here could be the copy that the linker keeps
// for the whole program, and would then run on processors without these
// instructions.
#include "core/spdf/kernels.h"

#include "core/spdf/kernel_vectors.h"

#define MAPSIEVE_KERNEL_STRING_(x) #x
#define MAPSIEVE_KERNEL_STRING(x) MAPSIEVE_KERNEL_STRING_(x)

namespace mapsieve::core {
namespace {

static_assert(kKernelPadding % kLaneCount == 0);

constexpr int32_t kNoDistance = 0x7fffffff;

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

inline int RoundUp(int count) {
  return (count + kKernelPadding - 1) / kKernelPadding * kKernelPadding;
}

/// `value` from p on, for one padding.
inline void Fill(int32_t* p, int32_t value) {
  for (int i = 0; i < kKernelPadding; i += kLaneCount) {
    Store(p + i, Broadcast(value));
  }
}

int Gather(const GatherSource& source, uint32_t begin, uint32_t end,
           const BlockArrays& block, int count) {
  const Lanes center_x = Broadcast(source.center[0]);
  const Lanes center_y = Broadcast(source.center[1]);
  const Lanes center_z = Broadcast(source.center[2]);
  const Lanes half_x = Broadcast(source.half[0]);
  const Lanes half_y = Broadcast(source.half[1]);
  const Lanes half_z = Broadcast(source.half[2]);
  const Lanes low = Broadcast(0xffff);
  int32_t steps[kLaneCount];
  for (int i = 0; i < kLaneCount; ++i) steps[i] = i;
  const Lanes step = Load(steps);
  for (uint32_t i = begin; i < end; i += kLaneCount) {
    const Lanes x = Subtract(Load(source.x + i), center_x);
    const Lanes y = Subtract(Load(source.y + i), center_y);
    const Lanes z = Subtract(Load(source.z + i), center_z);
    LaneMask chosen = IsLessEqual(Magnitude(x), half_x) &
                      IsLessEqual(Magnitude(y), half_y) &
                      IsLessEqual(Magnitude(z), half_z);
    if (end - i < kLaneCount) chosen &= (1u << (end - i)) - 1;
    StoreChosen(block.xy + count, chosen, Or(And(x, low), ShiftToHigh(y)));
    StoreChosen(block.z + count, chosen, And(z, low));
    StoreChosen(block.ids + count, chosen,
                Add(Broadcast(static_cast<int32_t>(i)), step));
    count += Count(chosen);
  }
  return count;
}

/// A query's place, and the differences and squared distances from it.
struct Query {
  Query(int32_t px, int32_t py, int32_t pz)
      : xy(Broadcast(PackXy(px, py))), z(Broadcast(PackZ(pz))) {}
  Lanes xy;
  Lanes z;
};

struct Differences {
  Differences(const CandidateBlock& block, int i, const Query& query)
      : xy(SubtractHalves(Load(block.xy + i), query.xy)),
        z(SubtractHalves(Load(block.z + i), query.z)) {}
  Lanes xy;
  Lanes z;
  Lanes SquaredDistance() const {
    return Add(SquareHalves(xy), SquareHalves(z));
  }
};

void Distances(const CandidateBlock& block, int32_t x, int32_t y, int32_t z,
               int32_t* d2) {
  const Query query(x, y, z);
  for (int i = 0; i < block.count; i += kLaneCount) {
    Store(d2 + i, Differences(block, i, query).SquaredDistance());
  }
  Fill(d2 + block.count, kNoDistance);
}

inline int CountWithin(const int32_t* d2, int count, int32_t bound) {
  const Lanes limit = Broadcast(bound);
  int within = 0;
  for (int i = 0; i < count; i += kLaneCount) {
    within += Count(IsLessEqual(Load(d2 + i), limit));
  }
  return within;
}

/// Select among values of which more than `rank` are <= bound.
inline int32_t SelectBelow(const int32_t* d2, int count, int rank,
                           int32_t bound) {
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

int32_t Select(const int32_t* d2, int count, int rank, int32_t bound) {
  if (CountWithin(d2, count, bound) <= rank) return bound;
  return SelectBelow(d2, count, rank, bound);
}

int KeepWithin(const BlockArrays& block, const int32_t* d2, int count,
               int32_t bound) {
  const Lanes limit = Broadcast(bound);
  int kept = 0;
  for (int i = 0; i < count; i += kLaneCount) {
    // The rest of a store falls on elements that were read before.
    const LaneMask chosen = IsLessEqual(Load(d2 + i), limit);
    StoreChosen(block.xy + kept, chosen, Load(block.xy + i));
    StoreChosen(block.z + kept, chosen, Load(block.z + i));
    StoreChosen(block.ids + kept, chosen, Load(block.ids + i));
    kept += Count(chosen);
  }
  return kept;
}

bool AnyWithin(const CandidateBlock& block, int32_t x, int32_t y, int32_t z,
               int32_t bound_d2) {
  const Query query(x, y, z);
  const Lanes limit = Broadcast(bound_d2);
  for (int i = 0; i < block.count; i += kLaneCount) {
    if (IsLessEqual(Differences(block, i, query).SquaredDistance(), limit) !=
        0) {
      return true;
    }
  }
  return false;
}

/// Differences and squared distances of some candidates.
struct Members {
  int32_t* d2;
  int32_t* xy;
  int32_t* z;
  int count;
};

/// The candidates within the query's bound.
inline Members CollectWithin(const CandidateBlock& block,
                             const NeighborQuery& query,
                             const KernelScratch& scratch) {
  const Query place(query.x, query.y, query.z);
  const Lanes limit = Broadcast(query.bound_d2);
  int count = 0;
  for (int i = 0; i < block.count; i += kLaneCount) {
    const Differences to(block, i, place);
    const Lanes d2 = to.SquaredDistance();
    const LaneMask chosen = IsLessEqual(d2, limit);
    StoreChosen(scratch.d2 + count, chosen, d2);
    StoreChosen(scratch.xy + count, chosen, to.xy);
    StoreChosen(scratch.z + count, chosen, to.z);
    count += Count(chosen);
  }
  return {scratch.d2, scratch.xy, scratch.z, count};
}

/// True if member `a` comes before `b` in the order of lattice coordinates.
inline bool IsBefore(const Members& members, int a, int b) {
  const int32_t ax = UnpackX(members.xy[a]);
  const int32_t bx = UnpackX(members.xy[b]);
  if (ax != bx) return ax < bx;
  const int32_t ay = UnpackY(members.xy[a]);
  const int32_t by = UnpackY(members.xy[b]);
  if (ay != by) return ay < by;
  return UnpackZ(members.z[a]) < UnpackZ(members.z[b]);
}

/// Leaves `rank` of the members, which hold more and are otherwise right: of
/// those that tie at the largest distance the last by coordinate get distance
/// 0, as if each were the query itself, which has no vote.
inline void ExcludeTies(const Members& members, int rank, int32_t radius) {
  for (int excess = members.count - rank; excess > 0; --excess) {
    int last = -1;
    for (int i = 0; i < members.count; ++i) {
      if (members.d2[i] != radius) continue;
      if (last < 0 || IsBefore(members, last, i)) last = i;
    }
    members.d2[last] = 0;
  }
}

/// Marks the elements up to the next multiple of kKernelPadding as the query
/// itself, which has no vote.
inline void PadMembers(const Members& members) {
  Fill(members.d2 + members.count, 0);
  Fill(members.xy + members.count, 0);
  Fill(members.z + members.count, 0);
}

void BallVote(const CandidateBlock& block, const NeighborQuery& query,
              const KernelScratch& scratch, BallSums* sums) {
  Members members = CollectWithin(block, query, scratch);
  // The query itself is a candidate, at distance 0: one more than the
  // neighbours.
  const int rank = query.neighbor_count + 1;
  int32_t radius = query.bound_d2;
  if (members.count > rank) {
    Fill(members.d2 + members.count, kNoDistance);
    radius = SelectBelow(members.d2, members.count, rank, radius);
    const Lanes limit = Broadcast(radius);
    int kept = 0;
    for (int i = 0; i < members.count; i += kLaneCount) {
      const Lanes d2 = Load(members.d2 + i);
      const LaneMask chosen = IsLessEqual(d2, limit);
      const Lanes xy = Load(members.xy + i);
      const Lanes z = Load(members.z + i);
      StoreChosen(members.d2 + kept, chosen, d2);
      StoreChosen(members.xy + kept, chosen, xy);
      StoreChosen(members.z + kept, chosen, z);
      kept += Count(chosen);
    }
    members.count = kept;
    if (kept > rank) ExcludeTies(members, rank, radius);
  }
  PadMembers(members);
  const int32_t* __restrict d2 = members.d2;
  const int32_t* __restrict xys = members.xy;
  const int32_t* __restrict zs = members.z;
  int32_t c0 = 0;
  int32_t xx = 0;
  int32_t xy = 0;
  int32_t xz = 0;
  int32_t yy = 0;
  int32_t yz = 0;
  const float scale = query.weight_scale;
  const int padded = RoundUp(members.count);
  for (int m = 0; m < padded; ++m) {
    const auto dx = static_cast<float>(UnpackX(xys[m]));
    const auto dy = static_cast<float>(UnpackY(xys[m]));
    const auto dz = static_cast<float>(UnpackZ(zs[m]));
    const auto dd = static_cast<float>(d2[m]);
    const bool self = dd == 0.0f;
    const float w = self ? 0.0f : ScaledWeight(dd, scale);
    const float g = w / (self ? 1.0f : dd);
    const float gx = g * dx;
    const float gy = g * dy;
    c0 += Round(w);
    xx += Round(gx * dx);
    xy += Round(gx * dy);
    xz += Round(gx * dz);
    yy += Round(gy * dy);
    yz += Round(gy * dz);
  }
  sums->c0 = c0;
  sums->xx = xx;
  sums->xy = xy;
  sums->xz = xz;
  sums->yy = yy;
  sums->yz = yz;
  sums->member_count = (members.count < rank ? members.count : rank) - 1;
  sums->radius_d2 = radius;
}

void AwareVote(const CandidateBlock& block, const NeighborQuery& query,
               const VoterTensors& tensors, const KernelScratch& scratch,
               VoteSums* sums) {
  const Query place(query.x, query.y, query.z);
  const Lanes limit = Broadcast(query.bound_d2);
  Members members = {scratch.d2, scratch.xy, scratch.z, 0};
  for (int i = 0; i < block.count; i += kLaneCount) {
    const Differences to(block, i, place);
    const Lanes distance = to.SquaredDistance();
    const LaneMask chosen = IsLessEqual(distance, limit);
    if (chosen == 0) continue;
    StoreChosen(members.d2 + members.count, chosen, distance);
    StoreChosen(members.xy + members.count, chosen, to.xy);
    StoreChosen(members.z + members.count, chosen, to.z);
    for (int e = 0; e < 6; ++e) {
      StoreChosen(scratch.entry[e] + members.count, chosen,
                  Load(tensors.entry[e] + i));
    }
    members.count += Count(chosen);
  }
  const int rank = query.neighbor_count + 1;
  if (members.count > rank) ExcludeTies(members, rank, query.bound_d2);
  PadMembers(members);
  for (int e = 0; e < 6; ++e) Fill(scratch.entry[e] + members.count, 0);
  const int32_t* __restrict d2 = members.d2;
  const int32_t* __restrict xys = members.xy;
  const int32_t* __restrict zs = members.z;
  const int32_t* __restrict bkxx = scratch.entry[0];
  const int32_t* __restrict bkxy = scratch.entry[1];
  const int32_t* __restrict bkxz = scratch.entry[2];
  const int32_t* __restrict bkyy = scratch.entry[3];
  const int32_t* __restrict bkyz = scratch.entry[4];
  const int32_t* __restrict bkzz = scratch.entry[5];
  int32_t xx = 0;
  int32_t xy = 0;
  int32_t xz = 0;
  int32_t yy = 0;
  int32_t yz = 0;
  int32_t zz = 0;
  const float scale = query.weight_scale;
  const int padded = RoundUp(members.count);
  for (int m = 0; m < padded; ++m) {
    // With unit r, g = K r and q = r . g, the symmetric part of R K R' is
    // K - 7/4 (r gᵀ + g rᵀ) + 3 q r rᵀ.
    const float kxx = BitsToFloat(bkxx[m]);
    const float kxy = BitsToFloat(bkxy[m]);
    const float kxz = BitsToFloat(bkxz[m]);
    const float kyy = BitsToFloat(bkyy[m]);
    const float kyz = BitsToFloat(bkyz[m]);
    const float kzz = BitsToFloat(bkzz[m]);
    const auto dd = static_cast<float>(d2[m]);
    const bool self = dd == 0.0f;
    const float w = self ? 0.0f : ScaledWeight(dd, scale);
    const float length = __builtin_sqrtf(self ? 1.0f : dd);
    const float rx = static_cast<float>(UnpackX(xys[m])) / length;
    const float ry = static_cast<float>(UnpackY(xys[m])) / length;
    const float rz = static_cast<float>(UnpackZ(zs[m])) / length;
    const float gx = (kxx * rx + kxy * ry) + kxz * rz;
    const float gy = (kxy * rx + kyy * ry) + kyz * rz;
    const float gz = (kxz * rx + kyz * ry) + kzz * rz;
    const float q3 = 3.0f * ((gx * rx + gy * ry) + gz * rz);
    const float qx = q3 * rx;
    const float qy = q3 * ry;
    const float qz = q3 * rz;
    xx += Round(w * ((kxx - 3.5f * (rx * gx)) + qx * rx));
    xy += Round(w * ((kxy - 1.75f * (rx * gy + ry * gx)) + qx * ry));
    xz += Round(w * ((kxz - 1.75f * (rx * gz + rz * gx)) + qx * rz));
    yy += Round(w * ((kyy - 3.5f * (ry * gy)) + qy * ry));
    yz += Round(w * ((kyz - 1.75f * (ry * gz + rz * gy)) + qy * rz));
    zz += Round(w * ((kzz - 3.5f * (rz * gz)) + qz * rz));
  }
  sums->xx = xx;
  sums->xy = xy;
  sums->xz = xz;
  sums->yy = yy;
  sums->yz = yz;
  sums->zz = zz;
  sums->member_count = (members.count < rank ? members.count : rank) - 1;
}

int CountBetter(const CandidateBlock& block, const int32_t* priorities,
                int32_t x, int32_t y, int32_t z, int32_t bound_d2,
                int32_t priority, int limit) {
  const Query query(x, y, z);
  const Lanes bound = Broadcast(bound_d2);
  const Lanes own = Broadcast(priority);
  int better = 0;
  for (int i = 0; i < block.count && better < limit; i += kLaneCount) {
    better += Count(
        IsLessEqual(Differences(block, i, query).SquaredDistance(), bound) &
        IsLess(Load(priorities + i), own));
  }
  return better;
}

/// Zeroes entry pq of every matrix by a rotation of rows and columns p and q;
/// r is the third. A matrix whose `active` is 0 stays.
template <bool kVectors>
inline void Rotate(const double* __restrict active, double* __restrict pp,
                   double* __restrict qq, double* __restrict pq,
                   double* __restrict rp, double* __restrict rq,
                   double (*__restrict vp)[EigenBatch::kSize],
                   double (*__restrict vq)[EigenBatch::kSize]) {
  for (int i = 0; i < EigenBatch::kSize; ++i) {
    const double off = pq[i];
    const bool turns = off != 0.0 && active[i] != 0.0;
    const double theta = (qq[i] - pp[i]) / (2.0 * (turns ? off : 1.0));
    const double magnitude =
        1.0 / (__builtin_fabs(theta) + __builtin_sqrt(theta * theta + 1.0));
    const double signed_t = theta < 0.0 ? -magnitude : magnitude;
    const double t = turns ? signed_t : 0.0;
    const double c = 1.0 / __builtin_sqrt(t * t + 1.0);
    const double s = t * c;
    pp[i] -= t * off;
    qq[i] += t * off;
    pq[i] = turns ? 0.0 : off;
    const double p = rp[i];
    const double q = rq[i];
    rp[i] = c * p - s * q;
    rq[i] = s * p + c * q;
    if constexpr (kVectors) {
      for (int a = 0; a < 3; ++a) {
        const double ap = vp[a][i];
        const double aq = vq[a][i];
        vp[a][i] = c * ap - s * aq;
        vq[a][i] = s * ap + c * aq;
      }
    }
  }
}

template <bool kVectors>
void Diagonalize(EigenBatch* batch) {
  constexpr int kSize = EigenBatch::kSize;
  double a[6][kSize];
  __builtin_memcpy(a, batch->entry, sizeof(a));
  auto& [xx, xy, xz, yy, yz, zz] = a;
  double v[3][3][kSize] = {};
  for (int d = 0; d < 3; ++d) {
    for (int i = 0; i < kSize; ++i) v[d][d][i] = 1.0;
  }
  // Convergence is quadratic: five sweeps reach the last bit of any matrix,
  // and most stop earlier.
  constexpr int kMaxSweeps = 10;
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    double active[kSize];
    double any = 0;
    for (int i = 0; i < kSize; ++i) {
      const double off =
          __builtin_fabs(xy[i]) + __builtin_fabs(xz[i]) + __builtin_fabs(yz[i]);
      const double scale =
          __builtin_fabs(xx[i]) + __builtin_fabs(yy[i]) + __builtin_fabs(zz[i]);
      active[i] = off > 1e-17 * scale ? 1.0 : 0.0;
      any += active[i];
    }
    if (any == 0.0) break;
    Rotate<kVectors>(active, xx, yy, xy, xz, yz, v[0], v[1]);
    Rotate<kVectors>(active, xx, zz, xz, xy, yz, v[0], v[2]);
    Rotate<kVectors>(active, yy, zz, yz, xy, xz, v[1], v[2]);
  }
  __builtin_memcpy(batch->value[0], xx, sizeof(xx));
  __builtin_memcpy(batch->value[1], yy, sizeof(yy));
  __builtin_memcpy(batch->value[2], zz, sizeof(zz));
  if constexpr (kVectors) __builtin_memcpy(batch->vector, v, sizeof(v));
}

}  // namespace

#define MAPSIEVE_KERNEL_TABLE_(set) k##set##Kernels
#define MAPSIEVE_KERNEL_TABLE(set) MAPSIEVE_KERNEL_TABLE_(set)

extern const Kernels MAPSIEVE_KERNEL_TABLE(MAPSIEVE_KERNEL_SET);
const Kernels MAPSIEVE_KERNEL_TABLE(MAPSIEVE_KERNEL_SET) = {
    MAPSIEVE_KERNEL_STRING(MAPSIEVE_KERNEL_SET),
    Gather,
    Distances,
    Select,
    KeepWithin,
    AnyWithin,
    BallVote,
    AwareVote,
    CountBetter,
    Diagonalize<true>,
    Diagonalize<false>,
    Weight,
};

}  // namespace mapsieve::core
