#ifndef MAPSIEVE_CLIENT_LAB_CAMPUS_BLOCK_H_
#define MAPSIEVE_CLIENT_LAB_CAMPUS_BLOCK_H_

#include <cstdint>

#include "client/lab/campus.h"
#include "client/lab/scene.h"

namespace mapsieve::client {

/// Appends the bodies of block (block_x, block_y) of `campus` to `scene`, in
/// the campus' frame: a function of the arguments alone. Bodies reach at most
/// kBlockOverhang beyond the block. Thread-safe.
void AddBlock(const Campus& campus, uint64_t seed, int64_t block_x,
              int64_t block_y, SceneDescription& scene);

inline constexpr double kBlockOverhang = 8;

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_CAMPUS_BLOCK_H_
