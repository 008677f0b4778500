#ifndef MAPSIEVE_CLIENT_LAB_EVALUATION_OPTIONS_H_
#define MAPSIEVE_CLIENT_LAB_EVALUATION_OPTIONS_H_

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "core/registration/icp.h"
#include "core/sampling/sampler_options.h"

namespace mapsieve::client {

/// How kSpatialSpdf chooses.
enum class SpatialVariant : uint8_t {
  /// As the paper says.
  kPaper = 1,
  /// With CellSplit::kWidest and an ideal_share of kRegistrationIdealShare.
  kWide,
  /// With CellSplit::kMidway, Representative::kSurest and the same share, which
  /// simulated pairs of numbers 100 to 159 chose.
  kSurest,
};

/// A sampler as it is compared: those with a density rule once with each.
struct EvaluatedMethod {
  core::SampleMethod sampler = core::SampleMethod::kRandom;
  core::DensityRule rule = core::DensityRule::kPaper;
  /// Of kSpatialSpdf.
  SpatialVariant variant = SpatialVariant::kPaper;

  /// The sampler's name, after it "-quota" for that rule, then "-wide" or
  /// "-surest".
  std::string name() const;

  friend bool operator==(const EvaluatedMethod&,
                         const EvaluatedMethod&) = default;
};

/// Chosen by registrations of simulated pairs of numbers 15 to 33, which an
/// evaluation of the default size has none of.
inline constexpr double kRegistrationIdealShare = 0.02;

/// The paper's nine, then spdf and spatial-spdf with the rule quota, then the
/// variants of that.
std::vector<EvaluatedMethod> EvaluatedMethods();

/// "point-to-plane", "plane-to-plane".
std::string_view IcpMethodName(core::IcpMethod method);

struct EvaluationOptions {
  /// One at least, each once.
  std::vector<EvaluatedMethod> methods = EvaluatedMethods();
  /// One at least, each once.
  std::vector<core::IcpMethod> icp_methods = {core::IcpMethod::kPointToPlane,
                                              core::IcpMethod::kPlaneToPlane};
  /// Points that each scan is sampled to, or with reading_point_count each
  /// reference; one at least, ascending, 10 or more.
  std::vector<int64_t> counts = {1000, 2000, 5000, 10000};
  /// Starting poses of every pair, the same for all methods and counts; 1 to
  /// 1000000.
  int trial_count = 2;
  /// Changes starting poses and samples; below 2^63.
  uint64_t seed = 1;
  /// Starting poses are this far from the truth at most, in a uniform direction
  /// and about a uniform axis, by a uniform length and angle.
  double max_translation_m = 0.5;
  double max_rotation_deg = 20;
  /// core::IcpOptions::min_normal_cosine of every registration; 0 to 1. The
  /// default was chosen by registrations of simulated pairs of numbers 40
  /// to 54.
  double min_normal_cosine = 0.5;
  /// core::SpdfOptions::label_neighbor_count of the methods by the filter; 0 or
  /// 6 to 127. The votes on whole scans have the default.
  int label_neighbor_count = 0;
  /// Above 0, 10 or more: of every reading so many points at random, or all of
  /// them, whatever the method and the count: a robot's own scan, registered to
  /// a map that is sampled. 0: readings are sampled as references are.
  int64_t reading_point_count = 0;

  /// kInvalidArgument naming the field, its value and its limits.
  absl::Status Validate() const;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_EVALUATION_OPTIONS_H_
