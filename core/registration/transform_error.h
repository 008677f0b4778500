#ifndef MAPSIEVE_CORE_REGISTRATION_TRANSFORM_ERROR_H_
#define MAPSIEVE_CORE_REGISTRATION_TRANSFORM_ERROR_H_

#include "core/geometry/rigid_transform.h"

namespace mapsieve::core {

/// How far a registration is from the truth.
struct TransformError {
  /// Length of the translation of T_truth^-1 T_estimate, in metres.
  double translation_m = 0;
  /// Angle of its rotation, 0 to pi: arccos((trace - 1) / 2).
  double rotation_rad = 0;
};

/// The error of `estimate`; both transforms move the same frame to the same
/// one. Small angles are as exact as large ones. The translation is that of
/// the origin of the moved frame, where a scan has its sensor: between clouds
/// far from their origins it grows with the rotation error.
/// Source: Pomerleau et al. 2013, "Comparing ICP variants on real-world data
/// sets", section on precision, which Labussière et al. 2020 follow.
TransformError CompareTransforms(const RigidTransform& estimate,
                                 const RigidTransform& truth);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_REGISTRATION_TRANSFORM_ERROR_H_
