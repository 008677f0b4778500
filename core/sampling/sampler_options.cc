#include "core/sampling/sampler_options.h"

#include <cmath>
#include <string>

#include "core/base/status.h"

namespace mapsieve::core {
namespace {

bool CastsVotes(SampleMethod method) {
  return method == SampleMethod::kNss || method == SampleMethod::kCovs ||
         method == SampleMethod::kSpdf || method == SampleMethod::kSpatialSpdf;
}

/// A parameter of some methods.
struct Parameter {
  absl::string_view name;
  /// 0: not given.
  double value;
  double min;
  double max;
  bool is_of_method;
};

absl::Status CheckRange(const Parameter& p) {
  // Negated comparisons would let NaN pass.
  if (p.value > 0 && p.value >= p.min && p.value <= p.max) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(absl::StrCat(
      p.name, " is ", p.value, "; it must be ",
      p.min > 0 ? absl::StrCat(p.min, " or above") : "above 0",
      std::isfinite(p.max) ? absl::StrCat(" and at most ", p.max) : ""));
}

}  // namespace

std::string_view SampleMethodName(SampleMethod method) {
  switch (method) {
    case SampleMethod::kRandom:
      return "random";
    case SampleMethod::kMaxDensity:
      return "max-density";
    case SampleMethod::kSsNormal:
      return "ss-normal";
    case SampleMethod::kOctree:
      return "octree";
    case SampleMethod::kVoxel:
      return "voxel";
    case SampleMethod::kNss:
      return "nss";
    case SampleMethod::kCovs:
      return "covs";
    case SampleMethod::kSpdf:
      return "spdf";
    case SampleMethod::kSpatialSpdf:
      return "spatial-spdf";
  }
  return "";
}

Representative SamplerOptions::ChosenRepresentative() const {
  return representative.value_or(
      method == SampleMethod::kOctree  ? Representative::kFirst
      : method == SampleMethod::kVoxel ? Representative::kCentroid
                                       : Representative::kNearest);
}

absl::Status SamplerOptions::Validate(const Lattice& lattice) const {
  const auto invalid = [&](const auto&... what) {
    return absl::InvalidArgumentError(absl::StrCat(
        "method ", ToAbsl(SampleMethodName(method)), " ", what...));
  };
  const bool is_octree = method == SampleMethod::kOctree;
  const bool is_spatial = method == SampleMethod::kSpatialSpdf;
  const Parameter parameters[] = {
      {"keep_probability", keep_probability, 0, 1,
       method == SampleMethod::kRandom},
      {"max_density", max_density, 0, HUGE_VAL,
       method == SampleMethod::kMaxDensity},
      {"max_cell_points", static_cast<double>(max_cell_points), 1, HUGE_VAL,
       is_octree || method == SampleMethod::kSsNormal},
      {"cell_edge_m", cell_edge_m, lattice.step(), HUGE_VAL,
       is_octree || method == SampleMethod::kVoxel}};
  if (!is_spatial && cell_split.has_value()) {
    return invalid("takes no cell_split");
  }
  if (!is_spatial && ideal_share != 0) return invalid("takes no ideal_share");
  if (!(ideal_share >= 0 && ideal_share <= 1)) {
    return absl::InvalidArgumentError(
        absl::StrCat("ideal_share is ", ideal_share, "; it must be 0 to 1"));
  }
  std::string of_method = "max_points";
  bool is_given = false;
  for (const Parameter& p : parameters) {
    if (p.is_of_method) absl::StrAppend(&of_method, " or ", p.name);
    if (p.value == 0) continue;
    if (!p.is_of_method) return invalid("takes no ", p.name);
    MAPSIEVE_RETURN_IF_ERROR(CheckRange(p));
    is_given = true;
  }
  if (max_points < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_points is ", max_points, "; it must be 0 or above"));
  }
  if (is_given && max_points > 0) {
    return invalid("takes ", of_method, ", not both");
  }
  if (!is_given && max_points == 0 && method != SampleMethod::kSpdf) {
    return invalid("needs ", of_method);
  }
  const bool divides_in_cells = is_octree || is_spatial ||
                                method == SampleMethod::kVoxel ||
                                method == SampleMethod::kSsNormal;
  if (representative.has_value() && !divides_in_cells) {
    return invalid("takes no representative");
  }
  const Representative chosen = ChosenRepresentative();
  if (is_spatial &&
      (chosen == Representative::kFirst || chosen == Representative::kRandom)) {
    return invalid("takes the representatives nearest, centroid and surest");
  }
  if (!is_spatial && chosen == Representative::kSurest) {
    return invalid("takes no representative surest");
  }
  if (method == SampleMethod::kMaxDensity) {
    return CheckNeighborCount(spdf.neighbor_count);
  }
  return CastsVotes(method) ? spdf.Validate(lattice) : absl::OkStatus();
}

}  // namespace mapsieve::core
