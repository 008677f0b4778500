#ifndef MAPSIEVE_CORE_SAMPLING_NORMAL_SPACE_SAMPLE_H_
#define MAPSIEVE_CORE_SAMPLING_NORMAL_SPACE_SAMPLE_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// Cells of the space of axes, that is of directions where opposite ones are
/// the same.
inline constexpr size_t kAxisCellCount = 3 * 17 * 17;

/// The cell of the axis of `normal`, not zero, below kAxisCellCount. Each of
/// three faces of a cube around the origin is divided in 17 x 17 cells of about
/// 5 degrees, with the coordinate axes in the midst of a cell; areas on the
/// sphere differ by a factor of 1.5 at most.
size_t AxisCell(const std::array<float, 3>& normal);

/// Normal-space sampling: rows, ascending, of exactly min(count, N) points,
/// spread over the directions of their normals: each cell of the space of axes
/// gives as many as every other, or all that it has. Which ones, and which
/// cells give the last few, is drawn by hashes of coordinates and `seed`.
/// `positions` are distinct; `normals` are unit vectors of either sign, one a
/// point, or zero if it has none: such points come after all others.
/// Source: Rusinkiewicz and Levoy, "Efficient variants of the ICP algorithm",
/// 2001.
std::vector<uint32_t> SampleNormalSpace(
    std::span<const LatticePoint> positions,
    std::span<const std::array<float, 3>> normals, int64_t count, int64_t seed);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_NORMAL_SPACE_SAMPLE_H_
