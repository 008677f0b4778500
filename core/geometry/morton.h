#ifndef MAPSIEVE_CORE_GEOMETRY_MORTON_H_
#define MAPSIEVE_CORE_GEOMETRY_MORTON_H_

#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>

#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// Spreads the low 21 bits of `v` to every third bit.
constexpr uint64_t SpreadBits3(uint64_t v) {
  v &= 0x1fffff;
  v = (v | v << 32) & 0x001f00000000ffff;
  v = (v | v << 16) & 0x001f0000ff0000ff;
  v = (v | v << 8) & 0x100f00f00f00f00f;
  v = (v | v << 4) & 0x10c30c30c30c30c3;
  v = (v | v << 2) & 0x1249249249249249;
  return v;
}

/// The inverse of SpreadBits3.
constexpr uint64_t GatherBits3(uint64_t v) {
  v &= 0x1249249249249249;
  v = (v | v >> 2) & 0x10c30c30c30c30c3;
  v = (v | v >> 4) & 0x100f00f00f00f00f;
  v = (v | v >> 8) & 0x001f0000ff0000ff;
  v = (v | v >> 16) & 0x001f00000000ffff;
  v = (v | v >> 32) & 0x1fffff;
  return v;
}

/// Morton code of three coordinates of at most 21 bits; x is the lowest bit.
constexpr uint64_t MortonCode(uint64_t x, uint64_t y, uint64_t z) {
  return SpreadBits3(x) | SpreadBits3(y) << 1 | SpreadBits3(z) << 2;
}

/// The order of lattice points and of cells of one level everywhere in the
/// project: that of the Morton codes of the coordinates with the sign bit
/// flipped, without building the codes (which need 129 bits).
constexpr bool MortonLess(int64_t ax, int64_t ay, int64_t az, int64_t bx,
                          int64_t by, int64_t bz) {
  // The coordinate with the highest bit that differs decides, z before y before
  // x. It is chosen by masks: nothing could predict a branch.
  auto a = static_cast<uint64_t>(az);
  auto b = static_cast<uint64_t>(bz);
  uint64_t highest = a ^ b;
  const auto consider = [&](int64_t p, int64_t q) {
    const auto up = static_cast<uint64_t>(p);
    const auto uq = static_cast<uint64_t>(q);
    const uint64_t differing = up ^ uq;
    // Of two numbers that of the lower highest bit is below their xor.
    const bool is_higher =
        (highest < differing) & (highest < (highest ^ differing));
    const uint64_t mask = -static_cast<uint64_t>(is_higher);
    highest ^= (highest ^ differing) & mask;
    a ^= (a ^ up) & mask;
    b ^= (b ^ uq) & mask;
  };
  consider(ay, by);
  consider(ax, bx);
  // Sign bits are flipped in codes, so that negative coordinates come first.
  return static_cast<int64_t>(a) < static_cast<int64_t>(b);
}

constexpr bool MortonLess(const LatticePoint& a, const LatticePoint& b) {
  return MortonLess(a.x, a.y, a.z, b.x, b.y, b.z);
}

/// Calls use(q) for the points that only one of two ranges in Morton order
/// holds.
template <typename Use>
void ForEachDifference(std::span<const LatticePoint> a,
                       std::span<const LatticePoint> b, const Use& use) {
  size_t i = 0;
  size_t j = 0;
  while (i < a.size() || j < b.size()) {
    if (i < a.size() && j < b.size() && a[i] == b[j]) {
      ++i;
      ++j;
    } else if (j == b.size() || (i < a.size() && MortonLess(a[i], b[j]))) {
      use(a[i++]);
    } else {
      use(b[j++]);
    }
  }
}

/// The bit of a coordinate in which points of a cell differ first.
struct MortonBit {
  int64_t LatticePoint::*axis = nullptr;
  /// -1 if they do not differ; 63 where coordinates have both signs.
  int bit = -1;
};

/// The highest bit in which points of a range in Morton order differ: that of
/// its `first` and its `last`. The smallest octree cell around them has an edge
/// of 2^(bit + 1).
constexpr MortonBit HighestMortonBit(const LatticePoint& first,
                                     const LatticePoint& last) {
  // Flipping the sign bits, which the order asks for, cancels out in the xor.
  MortonBit highest;
  for (const auto axis :
       {&LatticePoint::z, &LatticePoint::y, &LatticePoint::x}) {
    const auto differing = static_cast<uint64_t>(first.*axis ^ last.*axis);
    const int bit = 63 - std::countl_zero(differing);
    if (bit > highest.bit) highest = {axis, bit};
  }
  return highest;
}

/// Where the highest differing bit of the points [begin, end) changes: both
/// sides are cells, or parts of cells, of the octree. `point(i)` gives the
/// points, which are distinct, at least two, and in Morton order.
template <typename PointAt>
uint32_t MortonSplit(uint32_t begin, uint32_t end, const PointAt& point) {
  // The range is sorted by that bit first.
  const LatticePoint first = point(begin);
  const MortonBit highest = HighestMortonBit(first, point(end - 1));
  const auto side = [&](const LatticePoint& q) {
    return q.*highest.axis >> highest.bit & 1;
  };
  const int64_t first_side = side(first);
  uint32_t low = begin;
  uint32_t high = end - 1;
  while (high - low > 1) {
    const uint32_t middle = low + (high - low) / 2;
    if (side(point(middle)) == first_side) {
      low = middle;
    } else {
      high = middle;
    }
  }
  return high;
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_MORTON_H_
