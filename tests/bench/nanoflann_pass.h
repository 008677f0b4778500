#ifndef MAPSIEVE_TESTS_BENCH_NANOFLANN_PASS_H_
#define MAPSIEVE_TESTS_BENCH_NANOFLANN_PASS_H_

#include <array>
#include <vector>

namespace mapsieve::bench {

/// One plain k-nearest-neighbour pass, the yardstick of the filter's speed:
/// builds nanoflann's tree (float, leaf 16) and asks for the `neighbor_count`
/// nearest of every point, on one thread. Returns a sum over the distances, so
/// that nothing is optimised away.
double NanoflannPass(const std::vector<std::array<float, 3>>& points,
                     int neighbor_count);

}  // namespace mapsieve::bench

#endif  // MAPSIEVE_TESTS_BENCH_NANOFLANN_PASS_H_
