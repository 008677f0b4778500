#ifndef MAPSIEVE_SERVER_ENGINE_CONFIDENCE_HISTOGRAM_H_
#define MAPSIEVE_SERVER_ENGINE_CONFIDENCE_HISTOGRAM_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/cloud/label.h"
#include "core/spdf/labels.h"

namespace mapsieve::engine {

/// Counts of points by label and confidence.
class ConfidenceHistogram {
 public:
  ConfidenceHistogram();
  void Add(core::Label label, uint16_t confidence) {
    ++counts_[static_cast<size_t>(label)][confidence];
  }
  /// Points of each label that are no outliers.
  core::LabelCounts CountKept(const core::OutlierTest& test) const;
  /// 0 for a label without points.
  core::MaxConfidence MaxConfidences() const;

 private:
  std::array<std::vector<int64_t>, core::kLabelCount> counts_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_CONFIDENCE_HISTOGRAM_H_
