#ifndef MAPSIEVE_CLIENT_LAB_SIMULATED_PAIR_H_
#define MAPSIEVE_CLIENT_LAB_SIMULATED_PAIR_H_

#include <array>
#include <vector>

#include "client/lab/scan_pair.h"

namespace mapsieve::client {

/// Which simulated pairs an evaluation has.
struct SimulatedPairOptions {
  /// Of kStructured, kSemiStructured and kUnstructured; 0 to 1000.
  std::array<int, 3> pair_counts = {15, 15, 15};
  /// The number of the first of each, 0 to 1000000: what is tuned on some pairs
  /// can be judged on others.
  int first_pair = 0;
  /// Rotations of the scanner that make a scan, 1 to 32: each sends 32768
  /// pulses, at bearings of its own.
  int rotation_count = 2;

  /// kInvalidArgument naming the field, its value and its limits.
  absl::Status Validate() const;
};

/// Pairs of scans of places that do not exist, with the exact truth.
///
/// Structured: two furnished rooms joined by a door. Semi-structured: a street
/// of a Campus. Unstructured: a wood on rough ground, without a plane in it.
/// A SpinningScanner, on an upright tripod, stands still at two places of a
/// room or some metres apart (1.2 to 3 m, 3 to 6 m, 3 to 5 m), turned by up to
/// 40 degrees between them. Ranges have Gaussian noise of 10, 15 and 20 mm, 2
/// per mille of the returns are spurious, and people (in streets cars too)
/// stand elsewhere in the second scan. The lattice's step is 1 mm.
///
/// Pair i of an environment is a function of i and rotation_count alone, and is
/// named after them: "structured-3-r2". Of valid options.
std::vector<PairSource> SimulatedPairs(const SimulatedPairOptions& options);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_SIMULATED_PAIR_H_
