#include "client/lab/evaluation_options.h"

#include <algorithm>
#include <cstddef>
#include <limits>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::client {
namespace {

using core::DensityRule;
using core::IcpMethod;
using core::SampleMethod;

template <typename T>
bool HasRepeats(const std::vector<T>& values) {
  for (size_t i = 0; i < values.size(); ++i) {
    if (std::find(values.begin(), values.begin() + static_cast<ptrdiff_t>(i),
                  values[i]) != values.begin() + static_cast<ptrdiff_t>(i)) {
      return true;
    }
  }
  return false;
}

}  // namespace

std::string EvaluatedMethod::name() const {
  std::string name(core::SampleMethodName(sampler));
  if (rule == DensityRule::kQuota) name += "-quota";
  if (variant == SpatialVariant::kWide) name += "-wide";
  if (variant == SpatialVariant::kSurest) name += "-surest";
  return name;
}

std::vector<EvaluatedMethod> EvaluatedMethods() {
  std::vector<EvaluatedMethod> methods;
  for (const SampleMethod sampler : core::kSampleMethods) {
    methods.push_back({sampler});
  }
  methods.push_back({SampleMethod::kSpdf, DensityRule::kQuota});
  for (const SpatialVariant variant :
       {SpatialVariant::kPaper, SpatialVariant::kWide,
        SpatialVariant::kSurest}) {
    methods.push_back(
        {SampleMethod::kSpatialSpdf, DensityRule::kQuota, variant});
  }
  return methods;
}

std::string_view IcpMethodName(IcpMethod method) {
  return method == IcpMethod::kPointToPlane ? "point-to-plane"
                                            : "plane-to-plane";
}

absl::Status EvaluationOptions::Validate() const {
  const auto wrong = [](auto... parts) {
    return absl::InvalidArgumentError(absl::StrCat(parts...));
  };
  if (methods.empty() || HasRepeats(methods)) {
    return wrong("methods holds ", methods.size(),
                 "; expected one at least, each once");
  }
  if (icp_methods.empty() || HasRepeats(icp_methods)) {
    return wrong("icp_methods holds ", icp_methods.size(),
                 "; expected one at least, each once");
  }
  for (size_t i = 0; i < counts.size(); ++i) {
    const int64_t low = i == 0 ? 10 : counts[i - 1] + 1;
    if (counts[i] < low) {
      return wrong("counts holds ", counts[i], "; expected ", low, " or more");
    }
  }
  if (counts.empty()) return wrong("counts is empty; expected one at least");
  if (trial_count < 1 || trial_count > 1'000'000) {
    return wrong("trial_count is ", trial_count, "; expected 1 to 1000000");
  }
  if (seed > static_cast<uint64_t>(std::numeric_limits<int64_t>::max())) {
    return wrong("seed is ", seed, "; expected below 2^63");
  }
  if (!(max_translation_m >= 0 && max_translation_m <= 1000)) {
    return wrong("max_translation_m is ", max_translation_m,
                 "; expected 0 to 1000");
  }
  if (!(max_rotation_deg >= 0 && max_rotation_deg <= 180)) {
    return wrong("max_rotation_deg is ", max_rotation_deg,
                 "; expected 0 to 180");
  }
  if (!(min_normal_cosine >= 0 && min_normal_cosine <= 1)) {
    return wrong("min_normal_cosine is ", min_normal_cosine,
                 "; expected 0 to 1");
  }
  MAPSIEVE_RETURN_IF_ERROR(core::CheckLabelNeighborCount(label_neighbor_count));
  if (reading_point_count != 0 && reading_point_count < 10) {
    return wrong("reading_point_count is ", reading_point_count,
                 "; expected 0, or 10 or more");
  }
  return absl::OkStatus();
}

}  // namespace mapsieve::client
