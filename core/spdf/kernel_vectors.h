#ifndef MAPSIEVE_CORE_SPDF_KERNEL_VECTORS_H_
#define MAPSIEVE_CORE_SPDF_KERNEL_VECTORS_H_

#include <cstdint>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

/// The few integer operations of kernels.cc that compilers do not find by
/// themselves, for the instruction set that the file is compiled for. Included
/// by kernels.cc only: everything has internal linkage, so that no copy of it
/// runs on a processor without the instructions.
namespace mapsieve::core {
namespace {

#if defined(__AVX512BW__)

using Lanes = __m512i;
using LaneMask = uint32_t;
constexpr int kLaneCount = 16;

inline Lanes Load(const int32_t* p) { return _mm512_loadu_si512(p); }
inline void Store(int32_t* p, Lanes a) { _mm512_storeu_si512(p, a); }
inline Lanes Broadcast(int32_t a) { return _mm512_set1_epi32(a); }
inline Lanes Add(Lanes a, Lanes b) { return _mm512_add_epi32(a, b); }
inline Lanes Subtract(Lanes a, Lanes b) { return _mm512_sub_epi32(a, b); }
inline Lanes And(Lanes a, Lanes b) { return _mm512_and_si512(a, b); }
inline Lanes Or(Lanes a, Lanes b) { return _mm512_or_si512(a, b); }
// The masks, all lanes, keep GCC 12 from warning of its own undefined values.
inline Lanes Magnitude(Lanes a) { return _mm512_maskz_abs_epi32(0xffff, a); }
inline Lanes ShiftToHigh(Lanes a) {
  return _mm512_maskz_slli_epi32(0xffff, a, 16);
}
inline Lanes SubtractHalves(Lanes a, Lanes b) { return _mm512_sub_epi16(a, b); }
inline Lanes SquareHalves(Lanes a) { return _mm512_madd_epi16(a, a); }
/// GCC 12 spills a mask as 16 bits and may read it back as 32: it is moved to a
/// general register, whose spills are whole, as soon as it is made.
inline LaneMask Whole(__mmask16 mask) {
  LaneMask whole = mask;
  asm("" : "+r"(whole));
  return whole;
}
inline LaneMask IsLessEqual(Lanes a, Lanes b) {
  return Whole(_mm512_cmple_epi32_mask(a, b));
}
inline LaneMask IsLess(Lanes a, Lanes b) {
  return Whole(_mm512_cmplt_epi32_mask(a, b));
}
inline void StoreChosen(int32_t* p, LaneMask chosen, Lanes a) {
  // Compressed in a register: straight to memory is slow on some processors.
  Store(p, _mm512_maskz_compress_epi32(static_cast<__mmask16>(chosen), a));
}

#elif defined(__AVX2__)

using Lanes = __m256i;
using LaneMask = uint32_t;
constexpr int kLaneCount = 8;

inline Lanes Load(const int32_t* p) {
  return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p));
}
inline void Store(int32_t* p, Lanes a) {
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), a);
}
inline Lanes Broadcast(int32_t a) { return _mm256_set1_epi32(a); }
inline Lanes Add(Lanes a, Lanes b) { return _mm256_add_epi32(a, b); }
inline Lanes Subtract(Lanes a, Lanes b) { return _mm256_sub_epi32(a, b); }
inline Lanes And(Lanes a, Lanes b) { return _mm256_and_si256(a, b); }
inline Lanes Or(Lanes a, Lanes b) { return _mm256_or_si256(a, b); }
inline Lanes Magnitude(Lanes a) { return _mm256_abs_epi32(a); }
inline Lanes ShiftToHigh(Lanes a) { return _mm256_slli_epi32(a, 16); }
inline Lanes SubtractHalves(Lanes a, Lanes b) { return _mm256_sub_epi16(a, b); }
inline Lanes SquareHalves(Lanes a) { return _mm256_madd_epi16(a, a); }
inline LaneMask IsLess(Lanes a, Lanes b) {
  return static_cast<LaneMask>(
      _mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpgt_epi32(b, a))));
}
inline LaneMask IsLessEqual(Lanes a, Lanes b) { return IsLess(b, a) ^ 0xff; }

/// For each mask the chosen lanes, three bits each, first lane lowest.
struct ChosenLanes {
  uint32_t order[256] = {};
  constexpr ChosenLanes() {
    for (uint32_t mask = 0; mask < 256; ++mask) {
      int position = 0;
      for (uint32_t lane = 0; lane < 8; ++lane) {
        if ((mask >> lane & 1) != 0) order[mask] |= lane << (3 * position++);
      }
    }
  }
};
constexpr ChosenLanes kChosenLanes;

inline void StoreChosen(int32_t* p, LaneMask chosen, Lanes a) {
  // The permutation looks at the low three bits of each lane only.
  const Lanes order = _mm256_srlv_epi32(
      Broadcast(static_cast<int32_t>(kChosenLanes.order[chosen])),
      _mm256_setr_epi32(0, 3, 6, 9, 12, 15, 18, 21));
  Store(p, _mm256_permutevar8x32_epi32(a, order));
}

#else

/// Plain C++ for any processor.
struct Lanes {
  int32_t lane[8];
};
using LaneMask = uint32_t;
constexpr int kLaneCount = 8;

template <typename Operation>
inline Lanes Map(Lanes a, Lanes b, const Operation& operation) {
  Lanes result;
  for (int i = 0; i < kLaneCount; ++i) {
    result.lane[i] = operation(a.lane[i], b.lane[i]);
  }
  return result;
}
constexpr int32_t LowHalf(int32_t a) { return static_cast<int16_t>(a); }
constexpr int32_t HighHalf(int32_t a) { return a >> 16; }

inline Lanes Load(const int32_t* p) {
  Lanes result;
  for (int i = 0; i < kLaneCount; ++i) result.lane[i] = p[i];
  return result;
}
inline void Store(int32_t* p, Lanes a) {
  for (int i = 0; i < kLaneCount; ++i) p[i] = a.lane[i];
}
inline Lanes Broadcast(int32_t a) { return {{a, a, a, a, a, a, a, a}}; }
inline Lanes Add(Lanes a, Lanes b) {
  return Map(a, b, [](int32_t p, int32_t q) { return p + q; });
}
inline Lanes Subtract(Lanes a, Lanes b) {
  return Map(a, b, [](int32_t p, int32_t q) { return p - q; });
}
inline Lanes And(Lanes a, Lanes b) {
  return Map(a, b, [](int32_t p, int32_t q) { return p & q; });
}
inline Lanes Or(Lanes a, Lanes b) {
  return Map(a, b, [](int32_t p, int32_t q) { return p | q; });
}
inline Lanes Magnitude(Lanes a) {
  return Map(a, a, [](int32_t p, int32_t) { return p < 0 ? -p : p; });
}
inline Lanes ShiftToHigh(Lanes a) {
  return Map(a, a, [](int32_t p, int32_t) {
    return static_cast<int32_t>(static_cast<uint32_t>(p) << 16);
  });
}
inline Lanes SubtractHalves(Lanes a, Lanes b) {
  return Map(a, b, [](int32_t p, int32_t q) {
    const int32_t high = HighHalf(p) - HighHalf(q);
    return static_cast<int32_t>(
        static_cast<uint32_t>((LowHalf(p) - LowHalf(q)) & 0xffff) |
        static_cast<uint32_t>(high) << 16);
  });
}
inline Lanes SquareHalves(Lanes a) {
  return Map(a, a, [](int32_t p, int32_t) {
    return LowHalf(p) * LowHalf(p) + HighHalf(p) * HighHalf(p);
  });
}
inline LaneMask IsLess(Lanes a, Lanes b) {
  LaneMask mask = 0;
  for (int i = 0; i < kLaneCount; ++i) {
    mask |= static_cast<LaneMask>(a.lane[i] < b.lane[i]) << i;
  }
  return mask;
}
inline LaneMask IsLessEqual(Lanes a, Lanes b) { return IsLess(b, a) ^ 0xff; }
inline void StoreChosen(int32_t* p, LaneMask chosen, Lanes a) {
  for (int i = 0; i < kLaneCount; ++i) {
    *p = a.lane[i];
    p += chosen >> i & 1;
  }
}

#endif

constexpr int Count(LaneMask mask) { return __builtin_popcount(mask); }

}  // namespace
}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_KERNEL_VECTORS_H_
