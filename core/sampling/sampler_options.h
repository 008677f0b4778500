#ifndef MAPSIEVE_CORE_SAMPLING_SAMPLER_OPTIONS_H_
#define MAPSIEVE_CORE_SAMPLING_SAMPLER_OPTIONS_H_

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>

#include "absl/status/status.h"
#include "core/geometry/lattice.h"
#include "core/sampling/cells.h"
#include "core/sampling/spatial_budget.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::core {

/// The samplers that Labussière et al. 2020 compare.
enum class SampleMethod : uint8_t {
  /// Each point with the same probability.
  kRandom = 1,
  /// Dense places thinned to a density (density_sample.h).
  kMaxDensity,
  /// A point and a normal of each part of a few points (surface_sample.h).
  kSsNormal,
  /// A point of each leaf of the absolute octree (octree_sample.h).
  kOctree,
  /// A point of each voxel (voxel_sample.h).
  kVoxel,
  /// Normal-space sampling (normal_space_sample.h).
  kNss,
  /// Covariance sampling (covariance_sample.h).
  kCovs,
  /// The Spectral Decomposition Filter (cloud_filter.h).
  kSpdf,
  /// The same under a budget of points (spatial_budget.h).
  kSpatialSpdf,
};

inline constexpr std::array<SampleMethod, 9> kSampleMethods = {
    SampleMethod::kRandom,     SampleMethod::kMaxDensity,
    SampleMethod::kSsNormal,   SampleMethod::kOctree,
    SampleMethod::kVoxel,      SampleMethod::kNss,
    SampleMethod::kCovs,       SampleMethod::kSpdf,
    SampleMethod::kSpatialSpdf};

/// "random", "max-density", "ss-normal" … "spatial-spdf".
std::string_view SampleMethodName(SampleMethod method);

/// A method and its parameter, or how many points it is to keep. Of the
/// parameters only those of the method may be given; 0 is not given. Lengths
/// are in map units, called metres.
struct SamplerOptions {
  SampleMethod method = SampleMethod::kSpdf;

  /// Points wanted. kRandom, kMaxDensity, kSsNormal, kOctree, kNss and kCovs
  /// keep exactly so many or all distinct points, kSpatialSpdf so many or all
  /// that are no outliers. kVoxel and kSpdf keep at most so many: a parameter
  /// is searched that comes near. Required by kNss, kCovs and kSpatialSpdf; the
  /// others take it instead of their parameter.
  int64_t max_points = 0;

  /// Of kRandom, up to 1.
  double keep_probability = 0;
  /// Of kMaxDensity: points per cubic map unit, as the spdf.neighbor_count
  /// nearest ones tell it.
  double max_density = 0;
  /// Of kSsNormal and kOctree: cells with more points are divided.
  int64_t max_cell_points = 0;
  /// Of kVoxel, and of kOctree, where cells of at most this edge are not
  /// divided: at least a lattice step.
  double cell_edge_m = 0;

  /// Which point stands for a cell. Of kOctree (kFirst unless given), kVoxel
  /// (kCentroid), kSsNormal (kNearest), none of which has confidences for
  /// kSurest, and of kSpatialSpdf (kNearest, or kCentroid or kSurest).
  std::optional<Representative> representative;

  /// Of kSpatialSpdf: which cell is divided next; kFullest unless given.
  std::optional<CellSplit> cell_split;
  /// Of kSpatialSpdf, in place of spdf.outlier_share, up to 1: a point is an
  /// outlier if its confidence is below this share of an ideal shape's
  /// (OutlierTest::OfIdealShapes), whatever the rest of the map is.
  double ideal_share = 0;

  /// Of kSpdf and kSpatialSpdf; its votes are also where kNss and kCovs have
  /// their normals from. seed is that of every method. max_points makes kSpdf
  /// choose density_radius_m.
  SpdfOptions spdf;

  /// `representative`, or what it is unless given.
  Representative ChosenRepresentative() const;

  /// kInvalidArgument, naming what is wrong, missing, or of another method.
  absl::Status Validate(const Lattice& lattice) const;

  friend bool operator==(const SamplerOptions&,
                         const SamplerOptions&) = default;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SAMPLING_SAMPLER_OPTIONS_H_
