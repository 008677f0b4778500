#include "tests/testing/normal_error.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/geometry/octahedral.h"
#include "core/spdf/cloud_filter.h"

namespace mapsieve::testing {

NormalError MeasureNormalError(const IdealShape& plane,
                               const core::SpdfOptions& options) {
  const auto filtered = core::FilterCloud(plane.cloud, options).value();
  const double(&expected)[3] = plane.axes[2];
  std::vector<double> errors;
  for (size_t i = 0; i < filtered.rows.size(); ++i) {
    if (!plane.IsInterior(plane.cloud.positions[filtered.rows[i]])) continue;
    const std::array<float, 3> normal =
        core::DecodeOctahedral(filtered.columns.normal[i]);
    const double cosine =
        std::abs(normal[0] * expected[0] + normal[1] * expected[1] +
                 normal[2] * expected[2]);
    errors.push_back(std::acos(std::min(1.0, cosine)) * 180 / std::numbers::pi);
  }
  std::sort(errors.begin(), errors.end());
  const auto quantile = [&](double share) {
    return errors[static_cast<size_t>(share *
                                      static_cast<double>(errors.size() - 1))];
  };
  return {.median = quantile(0.5), .p90 = quantile(0.9)};
}

}  // namespace mapsieve::testing
