#ifndef MAPSIEVE_CORE_GEOMETRY_OCTAHEDRAL_H_
#define MAPSIEVE_CORE_GEOMETRY_OCTAHEDRAL_H_

#include <array>
#include <cstdint>

#include "core/geometry/vector3.h"

namespace mapsieve::core {

/// A unit vector in 32 bits: its projection on the octahedron |x|+|y|+|z| = 1,
/// unfolded to a square, 12 signed bits a side in the upper bits of 16 (the low
/// half is the first coordinate). The angle to the vector encoded is below
/// 0.06 degrees, a hundredth of what noise does to a normal. Meyer et al., "On
/// floating-point normal vectors", 2010.
using OctahedralVector = uint32_t;

OctahedralVector EncodeOctahedral(const Vector3& unit);

/// The unit vector of `code`, computed by a fixed sequence of operations: the
/// same bits on every processor.
std::array<float, 3> DecodeOctahedral(OctahedralVector code);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_GEOMETRY_OCTAHEDRAL_H_
