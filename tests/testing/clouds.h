#ifndef MAPSIEVE_TESTS_TESTING_CLOUDS_H_
#define MAPSIEVE_TESTS_TESTING_CLOUDS_H_

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/cloud/point_cloud.h"

/// Seeded clouds of known geometry, in metres around the origin, on a lattice
/// of 1 mm.
namespace mapsieve::testing {

/// `count` points uniform on a square of edge 2 * `half_edge` in z = 0.
core::LatticeCloud PlaneCloud(int count, double half_edge, uint64_t seed);
/// Uniform on the x axis, |x| <= half_length.
core::LatticeCloud LineCloud(int count, double half_length, uint64_t seed);
/// Uniform in a cube.
core::LatticeCloud VolumeCloud(int count, double half_edge, uint64_t seed);
/// Uniform on a sphere.
core::LatticeCloud SphereCloud(int count, double radius, uint64_t seed);
/// Uniform on the half planes z = 0, y >= 0 and y = 0, z >= 0.
core::LatticeCloud EdgeCloud(int count, double half_edge, uint64_t seed);
/// Ground, two walls, a pole, noise and a very dense spot in a box of about
/// 2 * half_edge; no attributes.
core::LatticeCloud SceneCloud(int count, double half_edge, uint64_t seed);
/// A cubic grid of `edge`³ points, `spacing` steps apart: ties everywhere.
core::LatticeCloud GridCloud(int edge, int64_t spacing);

/// Moves every point by `offset` steps.
core::LatticeCloud Shifted(core::LatticeCloud cloud,
                           const core::LatticePoint& offset);
/// Applies `move` to every point.
core::LatticeCloud Mapped(
    core::LatticeCloud cloud,
    const std::function<core::LatticePoint(const core::LatticePoint&)>& move);
/// The points in random order, attributes with them.
core::LatticeCloud Shuffled(const core::LatticeCloud& cloud, uint64_t seed);
/// Both clouds' points; no attributes.
core::LatticeCloud Concatenated(core::LatticeCloud a,
                                const core::LatticeCloud& b);
/// The cloud with random attributes of several types, some values missing.
core::LatticeCloud WithAttributes(core::LatticeCloud cloud, uint64_t seed);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_CLOUDS_H_
