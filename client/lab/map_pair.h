#ifndef MAPSIEVE_CLIENT_LAB_MAP_PAIR_H_
#define MAPSIEVE_CLIENT_LAB_MAP_PAIR_H_

#include <cstdint>
#include <filesystem>

#include "absl/status/statusor.h"
#include "client/lab/scan_pair.h"
#include "core/geometry/rigid_transform.h"

namespace mapsieve::client {

/// Two files of one place, maps or scans, as a pair for an evaluation.
struct MapPair {
  /// Named after the files and their content: the reference, the reading.
  PairSource source;
  /// Distinct points of the smaller one, on a lattice of 1 mm; kMinPointCount
  /// at least.
  int64_t point_count = 0;
  /// Share of the reading's points, where the truth puts them, that have a
  /// point of the reference within kOverlapDistance; kMinOverlap at least.
  double overlap = 0;

  static constexpr int64_t kMinPointCount = 10;
  static constexpr double kOverlapDistance = 1;
  static constexpr double kMinOverlap = 0.05;
};

/// Reads both files, in any format of OpenPointFile. `T_reference_reading`, the
/// truth, moves the reading's coordinates onto the reference's. The pair has
/// the mean of the reading's points as its origin, and the same place in the
/// reference: there starting poses turn and errors are measured, however far
/// away the files' own origins are, as in maps of a projected system.
///
/// Errors: kInvalidArgument naming the file: fewer points than kMinPointCount
/// that are finite and distinct; the two overlap less than kMinOverlap; those
/// of ReadPointFile.
absl::StatusOr<MapPair> LoadMapPair(
    const std::filesystem::path& reference,
    const std::filesystem::path& reading,
    const core::RigidTransform& T_reference_reading);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_MAP_PAIR_H_
