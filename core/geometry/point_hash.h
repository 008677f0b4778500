#ifndef MAPSIEVE_CORE_GEOMETRY_POINT_HASH_H_
#define MAPSIEVE_CORE_GEOMETRY_POINT_HASH_H_

#include <cstdint>

#include "core/base/hash.h"
#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// XXH3_64 of (x, y, z, seed): a draw that belongs to the point, whatever the
/// order of points.
inline uint64_t PointHash(const LatticePoint& q, int64_t seed) {
  const int64_t key[4] = {q.x, q.y, q.z, seed};
  return HashIntegers(key);
}

/// The upper bits of PointHash as a number from 0 to below 1.
inline double PointDraw(const LatticePoint& q, int64_t seed) {
  return static_cast<double>(PointHash(q, seed) >> 11) * 0x1p-53;
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_POINT_HASH_H_
