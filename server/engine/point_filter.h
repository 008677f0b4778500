#ifndef MAPSIEVE_SERVER_ENGINE_POINT_FILTER_H_
#define MAPSIEVE_SERVER_ENGINE_POINT_FILTER_H_

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/labels.h"
#include "server/engine/query.h"
#include "server/engine/region.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// What makes a point of a snapshot part of an answer, before any budget.
class PointFilter {
 public:
  /// For a checked `spec` (CheckSpec) on `snapshot`. kInvalidArgument: the
  /// region, or an attribute that the map has not; kDataLoss.
  static absl::StatusOr<PointFilter> Make(
      const QuerySpec& spec, const storage::ReadSnapshot& snapshot);

  const std::optional<Region>& region() const { return region_; }
  /// Only points of this depth and above.
  int min_depth() const { return min_depth_; }

  /// Columns of a chunk that Select needs.
  const std::vector<std::string>& stored_names() const { return stored_names_; }

  /// An upper bound of what a decoded point of a chunk needs for its attributes
  /// that Select looks at.
  int64_t attribute_bytes() const {
    constexpr int64_t kLargestValueAndFlag = 8 + 1;
    return static_cast<int64_t>(ranges_.size()) * kLargestValueAndFlag;
  }

  /// Whether it is known that all points of the chunk pass.
  bool PassesAllOf(const storage::ChunkRef& chunk) const;

  /// Points of the chunk that may pass.
  int64_t CountCandidates(const storage::ChunkRef& chunk) const;

  /// The rows of a decoded chunk that pass, and the label of each (kNone of
  /// raw points).
  struct Passed {
    std::vector<uint32_t> rows;
    std::vector<core::Label> labels;
  };
  /// `points`: those of `chunk`. kCancelled: `stop`; kDataLoss: a column is
  /// missing.
  absl::StatusOr<Passed> Select(const storage::ChunkRef& chunk,
                                const core::LatticeCloud& points,
                                const std::stop_token& stop) const;

 private:
  PointFilter() = default;

  /// Whether `row` is in all attribute ranges; `columns` has one for each,
  /// none of them null.
  bool HasAttributes(std::span<const core::Column* const> columns,
                     uint32_t row) const;

  std::optional<Region> region_;
  /// By label; all of them for raw points.
  std::array<bool, core::kLabelCount> labels_{};
  /// Nothing for raw points.
  std::optional<core::OutlierTest> outliers_;
  int min_depth_ = 0;
  std::optional<Range> confidence_;
  std::vector<AttributeRange> ranges_;
  std::vector<std::string> stored_names_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_POINT_FILTER_H_
