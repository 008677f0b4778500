#include "core/spdf/labels.h"

#include <algorithm>
#include <cmath>

namespace mapsieve::core {

void LabelColumns::Reserve(size_t size) {
  label.reserve(size);
  confidence.reserve(size);
  lambda.reserve(size);
  normal.reserve(size);
  tangent.reserve(size);
}

void LabelColumns::Resize(size_t size) {
  label.resize(size);
  confidence.resize(size);
  lambda.resize(size);
  normal.resize(size);
  tangent.resize(size);
}

void LabelColumns::AppendRange(const LabelColumns& other, size_t begin,
                               size_t end) {
  const auto append = [begin, end](auto& column, const auto& from) {
    column.insert(column.end(), from.begin() + static_cast<ptrdiff_t>(begin),
                  from.begin() + static_cast<ptrdiff_t>(end));
  };
  append(label, other.label);
  append(confidence, other.confidence);
  append(lambda, other.lambda);
  append(normal, other.normal);
  append(tangent, other.tangent);
}

OutlierTest::OutlierTest(const MaxConfidence& max_confidence,
                         double outlier_share) {
  for (size_t l = 0; l < kLabelCount; ++l) {
    threshold_[l] = static_cast<uint32_t>(
        std::ceil(outlier_share * static_cast<double>(max_confidence[l])));
  }
}

MaxConfidence UpdateMaxConfidence(const LabelColumns& columns,
                                  MaxConfidence so_far) {
  for (size_t i = 0; i < columns.size(); ++i) {
    uint16_t& largest = so_far[static_cast<size_t>(columns.label[i])];
    largest = std::max(largest, columns.confidence[i]);
  }
  return so_far;
}

}  // namespace mapsieve::core
