#ifndef MAPSIEVE_CLIENT_LAB_SURVEYED_PAIR_H_
#define MAPSIEVE_CLIENT_LAB_SURVEYED_PAIR_H_

#include <vector>

#include "client/lab/scan_pair.h"

namespace mapsieve::client {

/// How many pairs the survey has.
inline constexpr int kMaxSurveyedPairs = 12;

/// `count` pairs, 0 to kMaxSurveyedPairs, of a map and a scan in it, as a robot
/// has them. The reference is what every second rotation of a simulated survey
/// (SimulateOptions, 3 million points) sees within 80 m of a place, half a
/// million points and more; the reading is what a rotation that the map lacks
/// sees of that from there. Both have the place of the scanner as their origin
/// and the axes of the map, so the exact truth is the identity. Ranges have
/// Gaussian noise of 12 mm. Pair i is a function of i alone; it is of
/// kSemiStructured and named "survey-3".
std::vector<PairSource> SurveyedPairs(int count);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_SURVEYED_PAIR_H_
