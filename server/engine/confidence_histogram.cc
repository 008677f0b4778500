#include "server/engine/confidence_histogram.h"

namespace mapsieve::engine {
namespace {

constexpr size_t kConfidenceCount = 65536;

}  // namespace

ConfidenceHistogram::ConfidenceHistogram() {
  for (std::vector<int64_t>& counts : counts_) counts.resize(kConfidenceCount);
}

core::LabelCounts ConfidenceHistogram::CountKept(
    const core::OutlierTest& test) const {
  core::LabelCounts kept{};
  for (size_t l = 0; l < core::kLabelCount; ++l) {
    for (size_t c = 0; c < kConfidenceCount; ++c) {
      if (test.Keeps(static_cast<core::Label>(l), static_cast<uint16_t>(c))) {
        kept[l] += counts_[l][c];
      }
    }
  }
  return kept;
}

core::MaxConfidence ConfidenceHistogram::MaxConfidences() const {
  core::MaxConfidence largest{};
  for (size_t l = 0; l < core::kLabelCount; ++l) {
    for (size_t c = 0; c < kConfidenceCount; ++c) {
      if (counts_[l][c] > 0) largest[l] = static_cast<uint16_t>(c);
    }
  }
  return largest;
}

}  // namespace mapsieve::engine
