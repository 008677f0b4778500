#ifndef MAPSIEVE_CORE_SPDF_SPDF_OPTIONS_H_
#define MAPSIEVE_CORE_SPDF_SPDF_OPTIONS_H_

#include <cstdint>
#include <string_view>

#include "absl/status/status.h"
#include "core/geometry/lattice.h"

namespace mapsieve::core {

/// How the filter decides which points of a too dense place stay.
enum class DensityRule : uint8_t {
  /// Rounds of eigenvalue tests and draws, as the paper's authors publish it.
  kPaper = 1,
  /// A point stays if fewer than k points of better priority lie within the
  /// density radius.
  kQuota = 2,
};

/// "paper", "quota".
std::string_view DensityRuleName(DensityRule rule);

/// Parameters of the Spectral Decomposition Filter. Lengths are in map units,
/// called metres.
struct SpdfOptions {
  /// Neighbours that vote for a point (the paper's k), 6 to 127.
  int neighbor_count = 50;
  /// Neighbours that vote for the label and the directions of a point that
  /// stays, 6 to 127; 0: neighbor_count. The more, the less noise of the
  /// positions matters, and the wider edges are.
  int label_neighbor_count = 0;
  /// The vote kernel is exp(-distance² / vote_scale_m2) (the paper's sigma);
  /// above 0.
  double vote_scale_m2 = 0.2;
  /// Radius of the ball that holds neighbor_count points at the density aimed
  /// at (the paper's rho); above 0.
  double density_radius_m = 0.4;
  /// Neighbours farther away do not vote. 0: where the kernel falls to 0.001,
  /// sqrt(vote_scale_m2 * ln 1000). At most 8191 lattice steps, as is
  /// density_radius_m.
  double reach_m = 0;
  /// Rounds of the rule kPaper at most, 0 (keep every point) to 15.
  int max_round_count = 10;
  DensityRule rule = DensityRule::kPaper;
  /// Changes which points stay, never how many are aimed at.
  int64_t seed = 0;
  /// A point is an outlier if its confidence is below this share of the
  /// largest confidence of its label in the whole map; 0 (none) to 1.
  double outlier_share = 0.1;

  /// kInvalidArgument, naming the field, its value and its limits on `lattice`.
  absl::Status Validate(const Lattice& lattice) const;

  /// Neighbours that vote for labels: label_neighbor_count, its default
  /// replaced.
  int LabelNeighborCount() const {
    return label_neighbor_count > 0 ? label_neighbor_count : neighbor_count;
  }

  friend bool operator==(const SpdfOptions&, const SpdfOptions&) = default;
};

/// Largest radius of a neighbourhood in lattice steps: squared distances
/// within a neighbourhood's surroundings then fit int32.
inline constexpr int kMaxRadiusSteps = 8191;
inline constexpr int kMinNeighborCount = 6;
inline constexpr int kMaxNeighborCount = 127;
inline constexpr int kMaxRoundCount = 15;

/// kInvalidArgument unless SpdfOptions::neighbor_count may be `count`.
absl::Status CheckNeighborCount(int count);
/// The same of SpdfOptions::label_neighbor_count.
absl::Status CheckLabelNeighborCount(int count);

/// SpdfOptions as the integers and floats that the filter computes with.
struct SpdfConstants {
  int neighbor_count = 0;
  int label_neighbor_count = 0;
  /// Largest squared distance, in steps², of a voter.
  int32_t reach_d2 = 0;
  /// Largest squared distance within the density radius.
  int32_t density_d2 = 0;
  /// Halo in steps that holds every voter of a tile's points.
  int32_t reach_steps = 0;
  int32_t density_steps = 0;
  /// step² / vote_scale_m2: squared steps to the exponent of the kernel.
  float weight_scale = 0;
  /// Expected strengths of an ideal curve, surface and volume at the density
  /// aimed at, in units of 2^-24.
  int32_t strength[3] = {0, 0, 0};
};

/// `options` must be valid on `lattice`.
SpdfConstants MakeSpdfConstants(const SpdfOptions& options,
                                const Lattice& lattice);

/// Largest squared distance, in steps², of two points within `radius_m` of each
/// other (up to 2^26 steps).
int64_t RadiusD2(double radius_m, const Lattice& lattice);

/// Expected kernel strength of a point whose neighbours are uniform in a
/// `dimension`-ball (1 to 3) of radius density_radius_m, closed form
/// (Labussière et al. 2020, with the curve's factor corrected to 1/2).
double ExpectedStrength(int dimension, double vote_scale_m2,
                        double density_radius_m);

/// The saliency of a point of an ideal shape of that density, whose neighbours
/// fill a ball wider than the density radius if more of them vote for labels.
/// Of the strength there, a line's voters carry half across it, a plane's a
/// quarter along its normal, a volume's nothing, and votes multiply by the
/// strength once more. For infinitely many neighbours: the tensors of k voters
/// in a volume differ by chance, so its saliency is above 0.
double ExpectedSaliency(int dimension, const SpdfOptions& options);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_SPDF_OPTIONS_H_
