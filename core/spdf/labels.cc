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

void LabelColumns::Append(const LabelSpans& part) {
  const auto append = [](auto& column, const auto& from) {
    column.insert(column.end(), from.begin(), from.end());
  };
  append(label, part.label);
  append(confidence, part.confidence);
  append(lambda, part.lambda);
  append(normal, part.normal);
  append(tangent, part.tangent);
}

void LabelColumns::Set(size_t i, const LabelColumns& other, size_t row) {
  label[i] = other.label[row];
  confidence[i] = other.confidence[row];
  lambda[i] = other.lambda[row];
  normal[i] = other.normal[row];
  tangent[i] = other.tangent[row];
}

LabelColumns LabelColumns::Select(std::span<const uint32_t> rows) const {
  LabelColumns selected;
  selected.Reserve(rows.size());
  for (const uint32_t row : rows) selected.Append(Slice(row, row + 1));
  return selected;
}

LabelSpans LabelColumns::Slice(size_t begin, size_t end) const {
  const auto slice = [&](const auto& column) {
    return std::span(column).subspan(begin, end - begin);
  };
  return {slice(label), slice(confidence), slice(lambda), slice(normal),
          slice(tangent)};
}

OutlierTest::OutlierTest(const MaxConfidence& max_confidence,
                         double outlier_share) {
  for (size_t l = 0; l < kLabelCount; ++l) {
    threshold_[l] = static_cast<uint32_t>(
        std::ceil(outlier_share * static_cast<double>(max_confidence[l])));
  }
}

OutlierTest OutlierTest::OfIdealShapes(const SpdfOptions& options,
                                       double share) {
  constexpr double kFullConfidence = 65535;
  OutlierTest test;
  for (size_t l = 0; l < kLabelCount; ++l) {
    const int dimension = static_cast<Label>(l) == Label::kCurve ? 1 : 2;
    test.threshold_[l] = static_cast<uint32_t>(std::ceil(
        share * kFullConfidence * ExpectedSaliency(dimension, options)));
  }
  return test;
}

MaxConfidence UpdateMaxConfidence(const LabelSpans& columns,
                                  MaxConfidence so_far) {
  for (size_t i = 0; i < columns.size(); ++i) {
    uint16_t& largest = so_far[static_cast<size_t>(columns.label[i])];
    largest = std::max(largest, columns.confidence[i]);
  }
  return so_far;
}

}  // namespace mapsieve::core
