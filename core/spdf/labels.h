#ifndef MAPSIEVE_CORE_SPDF_LABELS_H_
#define MAPSIEVE_CORE_SPDF_LABELS_H_

#include <array>
#include <cstdint>
#include <span>

#include "core/base/bulk_vector.h"
#include "core/cloud/label.h"
#include "core/geometry/octahedral.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::core {

/// The coarsest level of detail (levels.h).
inline constexpr int kMaxDepth = 10;

/// Largest confidence of each label in a map.
using MaxConfidence = std::array<uint16_t, kLabelCount>;

/// A part of LabelColumns; valid as long as they are.
struct LabelSpans {
  std::span<const Label> label;
  std::span<const uint16_t> confidence;
  std::span<const std::array<float, 3>> lambda;
  std::span<const OctahedralVector> normal;
  std::span<const OctahedralVector> tangent;

  size_t size() const { return label.size(); }
};

/// What the filter says of points, one entry a point in every column.
struct LabelColumns {
  BulkVector<Label> label;
  /// Saliency of the point's own label, [0, 1] as 0 to 65535.
  BulkVector<uint16_t> confidence;
  /// Eigenvalues of the aware vote, descending: saliency of a surface is
  /// lambda[0] - lambda[1], of a curve lambda[1] - lambda[2], of a junction
  /// lambda[2].
  BulkVector<std::array<float, 3>> lambda;
  /// Axis of the largest eigenvalue.
  BulkVector<OctahedralVector> normal;
  /// Axis of the smallest eigenvalue.
  BulkVector<OctahedralVector> tangent;

  size_t size() const { return label.size(); }
  void Reserve(size_t size);
  /// New entries have no value yet.
  void Resize(size_t size);
  void Append(const LabelSpans& part);
  /// Makes entry `i` that of `other` at `row`.
  void Set(size_t i, const LabelColumns& other, size_t row);
  /// The entries at `rows`, in that order.
  LabelColumns Select(std::span<const uint32_t> rows) const;
  /// Entries [begin, end).
  LabelSpans Slice(size_t begin, size_t end) const;
  LabelSpans All() const { return Slice(0, size()); }

  friend bool operator==(const LabelColumns&, const LabelColumns&) = default;
};

/// Decides which points are outliers: those without a label and those whose
/// confidence is below a share of the largest of their label.
class OutlierTest {
 public:
  OutlierTest(const MaxConfidence& max_confidence, double outlier_share);

  /// Decides by a share of the saliency of an ideal shape of the point's label
  /// at the density that `options` aim at (ExpectedSaliency), a junction's that
  /// of a surface: whatever else the map holds.
  static OutlierTest OfIdealShapes(const SpdfOptions& options, double share);

  bool Keeps(Label label, uint16_t confidence) const {
    return label != Label::kNone &&
           confidence >= threshold_[static_cast<size_t>(label)];
  }

 private:
  OutlierTest() = default;

  std::array<uint32_t, kLabelCount> threshold_{};
};

/// Largest confidences of `columns`, and of `so_far`.
MaxConfidence UpdateMaxConfidence(const LabelSpans& columns,
                                  MaxConfidence so_far = {});

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_LABELS_H_
