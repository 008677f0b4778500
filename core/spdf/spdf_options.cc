#include "core/spdf/spdf_options.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/base/status.h"

namespace mapsieve::core {
namespace {

constexpr double kLn1000 = 6.907755278982137;

double ReachSquared(const SpdfOptions& options) {
  return options.reach_m > 0 ? options.reach_m * options.reach_m
                             : options.vote_scale_m2 * kLn1000;
}

/// Largest integer d² with d * step <= radius.
double RadiusInSteps2(double radius2, const Lattice& lattice) {
  return std::floor(radius2 / (lattice.step() * lattice.step()));
}

absl::Status CheckRadius(const char* field, double radius2,
                         const Lattice& lattice) {
  const double steps2 = RadiusInSteps2(radius2, lattice);
  constexpr double kMax = static_cast<double>(kMaxRadiusSteps);
  if (steps2 >= 1 && steps2 <= kMax * kMax) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(field, " is ", std::sqrt(radius2), ", ",
                   std::sqrt(radius2) / lattice.step(), " lattice steps of ",
                   lattice.step(), "; it must be 1 to ", kMaxRadiusSteps,
                   " steps: change it or the map's step"));
}

bool IsNeighborCount(int count) {
  return count >= kMinNeighborCount && count <= kMaxNeighborCount;
}

}  // namespace

std::string_view DensityRuleName(DensityRule rule) {
  return rule == DensityRule::kQuota ? "quota" : "paper";
}

absl::Status CheckNeighborCount(int count) {
  if (IsNeighborCount(count)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("neighbor_count is ", count, "; it must be ",
                   kMinNeighborCount, " to ", kMaxNeighborCount));
}

absl::Status CheckLabelNeighborCount(int count) {
  if (count == 0 || IsNeighborCount(count)) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      "label_neighbor_count is ", count, "; it must be ", kMinNeighborCount,
      " to ", kMaxNeighborCount, ", or 0 for as many as neighbor_count"));
}

absl::Status SpdfOptions::Validate(const Lattice& lattice) const {
  MAPSIEVE_RETURN_IF_ERROR(CheckNeighborCount(neighbor_count));
  MAPSIEVE_RETURN_IF_ERROR(CheckLabelNeighborCount(label_neighbor_count));
  // Negated comparisons refuse NaN too.
  if (!(vote_scale_m2 > 0) || !std::isfinite(vote_scale_m2)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "vote_scale_m2 is ", vote_scale_m2, "; it must be above 0"));
  }
  if (!(density_radius_m > 0) || !std::isfinite(density_radius_m)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "density_radius_m is ", density_radius_m, "; it must be above 0"));
  }
  if (!(reach_m >= 0) || !std::isfinite(reach_m)) {
    return absl::InvalidArgumentError(
        absl::StrCat("reach_m is ", reach_m, "; it must be 0 or above"));
  }
  if (max_round_count < 0 || max_round_count > kMaxRoundCount) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_round_count is ", max_round_count,
                     "; it must be 0 to ", kMaxRoundCount));
  }
  if (rule != DensityRule::kPaper && rule != DensityRule::kQuota) {
    return absl::InvalidArgumentError(absl::StrCat(
        "rule is ", static_cast<int>(rule), "; it must be paper or quota"));
  }
  if (!(outlier_share >= 0 && outlier_share <= 1)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "outlier_share is ", outlier_share, "; it must be 0 to 1"));
  }
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRadius("reach_m", ReachSquared(*this), lattice));
  return CheckRadius("density_radius_m", density_radius_m * density_radius_m,
                     lattice);
}

int64_t RadiusD2(double radius_m, const Lattice& lattice) {
  return static_cast<int64_t>(RadiusInSteps2(radius_m * radius_m, lattice));
}

double ExpectedStrength(int dimension, double vote_scale_m2,
                        double density_radius_m) {
  const double sigma = vote_scale_m2;
  const double rho = density_radius_m;
  const double u = rho / std::sqrt(sigma);
  const double root = std::sqrt(std::numbers::pi * sigma) * std::erf(u);
  switch (dimension) {
    case 1:
      return root / (2 * rho);
    case 2:
      return sigma / (rho * rho) * -std::expm1(-u * u);
    default:
      return 3 * sigma / (4 * rho * rho * rho) *
             (root - 2 * rho * std::exp(-u * u));
  }
}

double ExpectedSaliency(int dimension, const SpdfOptions& options) {
  constexpr double kVoterShare[] = {0.5, 0.25, 0};
  const double radius_m =
      options.density_radius_m *
      std::pow(static_cast<double>(options.LabelNeighborCount()) /
                   options.neighbor_count,
               1.0 / dimension);
  const double strength =
      ExpectedStrength(dimension, options.vote_scale_m2, radius_m);
  return kVoterShare[dimension - 1] * strength * strength;
}

SpdfConstants MakeSpdfConstants(const SpdfOptions& options,
                                const Lattice& lattice) {
  SpdfConstants constants;
  constants.neighbor_count = options.neighbor_count;
  constants.label_neighbor_count = options.LabelNeighborCount();
  constants.reach_d2 =
      static_cast<int32_t>(RadiusInSteps2(ReachSquared(options), lattice));
  constants.density_d2 =
      static_cast<int32_t>(RadiusD2(options.density_radius_m, lattice));
  const auto root = [](int32_t d2) {
    return static_cast<int32_t>(std::sqrt(static_cast<double>(d2))) + 1;
  };
  constants.reach_steps = root(constants.reach_d2);
  constants.density_steps = root(constants.density_d2);
  constants.weight_scale = static_cast<float>(lattice.step() * lattice.step() /
                                              options.vote_scale_m2);
  for (int dimension = 1; dimension <= 3; ++dimension) {
    constants.strength[dimension - 1] = static_cast<int32_t>(
        std::lrint(ExpectedStrength(dimension, options.vote_scale_m2,
                                    options.density_radius_m) *
                   0x1p24));
  }
  return constants;
}

}  // namespace mapsieve::core
