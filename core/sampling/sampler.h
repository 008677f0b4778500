#ifndef MAPSIEVE_CORE_SAMPLING_SAMPLER_H_
#define MAPSIEVE_CORE_SAMPLING_SAMPLER_H_

#include <cstdint>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/cloud/point_cloud.h"
#include "core/sampling/sampler_options.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/labels.h"

namespace mapsieve::core {

/// What a sampler made of a cloud.
struct CloudSample {
  /// Rows of the input, in Morton order of their points. Of several points in
  /// one lattice cell the one with the smallest attributes stands for all.
  std::vector<uint32_t> rows;
  /// The points themselves with all their attributes; centroids on the lattice
  /// in place of the points they stand for. Methods that vote add the columns
  /// of MakeLabeledCloud, kSsNormal nx, ny and nz (missing where a cell has no
  /// normal); attributes of these names become input_<name>.
  LatticeCloud cloud;
  /// What the votes say of each row; empty if the method casts none.
  LabelColumns columns;
  /// The parameter that gives the sample: probability, density, points of the
  /// fullest cell (kSsNormal, kOctree), edge, density_radius_m; of kNss, kCovs
  /// and kSpatialSpdf the number of points.
  double parameter = 0;
  /// Of kSpdf and kSpatialSpdf: the filter's answer, outliers included.
  std::optional<FilteredCloud> filtered;
};

/// Chooses points of `cloud`. The sample is a function of the set of points and
/// `options`: neither order nor worker count show in it.
/// Errors: kInvalidArgument (options), kFailedPrecondition (no parameter of
/// kVoxel or kSpdf keeps so few points), kCancelled.
absl::StatusOr<CloudSample> Sample(const LatticeCloud& cloud,
                                   const SamplerOptions& options,
                                   const ExecutionContext& context = {});

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_SAMPLER_H_
