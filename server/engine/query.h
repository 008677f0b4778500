#ifndef MAPSIEVE_SERVER_ENGINE_QUERY_H_
#define MAPSIEVE_SERVER_ENGINE_QUERY_H_

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cloud/column.h"
#include "core/sampling/spatial_budget.h"
#include "core/spdf/labels.h"
#include "server/engine/damaged_chunk.h"
#include "server/engine/shapes.h"

namespace mapsieve::engine {

/// Columns of an answer besides the positions; they come in this order.
struct ColumnSelection {
  /// label (uint8): value of core::Label.
  bool label = false;
  /// confidence (float32): saliency of the point's own label, 0 to 1.
  bool confidence = false;
  /// nx, ny, nz (float32): unit normal of the surface.
  bool normal = false;
  /// tx, ty, tz (float32): unit tangent of the curve.
  bool tangent = false;
  /// lambda1, lambda2, lambda3 (float32): eigenvalues of the vote, descending.
  bool eigenvalues = false;
  /// saliency_surface, saliency_curve, saliency_junction (float32): lambda1 -
  /// lambda2, lambda2 - lambda3, lambda3.
  bool saliencies = false;
  /// cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz (float32): how freely a
  /// point may slide, for plane-to-plane registration, without a unit. With
  /// normal n: I - 0.999 n n^T on a surface and on a curve, I at a junction.
  bool covariance = false;
  /// All attributes of the uploaded points, by name. Beside what the filter
  /// says they are named by core::NameBeside: one named as a column of
  /// core::MakeLabeledCloud, or as another one asked for, comes as
  /// input_<name>.
  bool all_attributes = false;
  /// Attributes of the uploaded points by their own names, if not all; they
  /// come by name too.
  std::vector<std::string> attributes;
};

/// Which point stands for a group under a budget.
enum class Representative {
  /// The point nearest to the group's centroid.
  kNearest,
  /// The centroid, rounded to the lattice half to even on each axis, with the
  /// columns of the point nearest to it. It may lie outside a sphere asked for
  /// by less than a lattice cell.
  kCentroid,
};

/// A closed range of numbers; NaN is in none.
struct Range {
  double min = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity();

  bool Contains(double value) const { return value >= min && value <= max; }

  friend bool operator==(const Range&, const Range&) = default;
};

/// Points whose attribute `name` is in `range`: values compared as double, a
/// missing one is in none.
struct AttributeRange {
  std::string name;
  Range range;

  friend bool operator==(const AttributeRange&,
                         const AttributeRange&) = default;
};

inline constexpr size_t kMaxAttributeRanges = 16;

/// Smallest QuerySpec::max_bytes.
inline constexpr int64_t kMinBudgetBytes = 65536;

/// Largest block of an answer.
inline constexpr int64_t kMaxBatchBytes = 1'000'000;

/// The points asked for.
struct QuerySpec {
  std::string map_id;
  /// 0: the newest processed revision, or with `raw` the newest.
  int64_t revision = 0;
  /// Nothing: the whole map.
  std::optional<QueryShape> region;
  /// Only points with one of these labels (kNone is no choice: such points are
  /// outliers); empty: all. Not with `raw`.
  std::vector<core::Label> labels;
  /// The points of this level of detail (core/spdf/levels.h), 0 to
  /// core::kMaxDepth: those of this depth and above. Not with `raw`.
  int depth = 0;
  /// Another way to say it, if above 0: core::LevelOfSpacing with the options
  /// that the answering revision was processed with. Not with `depth` or `raw`.
  double spacing_m = 0;
  /// At most this many points, by core::SampleUnderBudget over all points
  /// asked for. 0: no limit. Not with `raw`.
  int64_t max_points = 0;
  /// At most this many bytes of blocks, with points chosen in the same way, so
  /// many that at least 95 % of it is used where there are as many; 0: no
  /// limit, else at least kMinBudgetBytes. Not with `raw`.
  int64_t max_bytes = 0;
  /// How a budget is shared out to the labels (core::SampleUnderBudget). Each
  /// that is asked for is above 0 and at most core::kMaxLabelWeight.
  std::optional<core::LabelWeights> label_weights;
  /// Nothing: any. Not with `raw`.
  std::optional<Range> confidence;
  /// At most kMaxAttributeRanges; a point must be in all of them.
  std::vector<AttributeRange> attribute_ranges;
  /// Nothing: label, confidence, normal and all attributes, which is what
  /// core::MakeLabeledCloud gives; with `raw`, all attributes. What the filter
  /// says cannot be asked for with `raw`.
  std::optional<ColumnSelection> columns;
  /// The points as they were uploaded, duplicates included, instead of the
  /// survivors of the filter without outliers.
  bool raw = false;
  Representative representative = Representative::kNearest;
  /// Damaged and missing chunks are left out and told of in the summary; else
  /// they are kDataLoss.
  bool allow_partial = false;
  /// Blocks of plain columns (core::Compression::kNone).
  bool plain_blocks = false;
  /// Confidences, normals and tangents as core/cloud/packed_columns.h has them.
  bool packed_columns = false;
  /// Nothing, or what QueryCursor::resume_token gave after a batch of the same
  /// query: the answer goes on behind that batch, from the same revision.
  std::string resume_token;
  /// Tells queries apart: a token fits those of the same map and key.
  uint64_t resume_key = 0;
};

/// What the batches of an answer have in common.
struct QueryHeader {
  /// The revision that the answer is from: for the filter's survivors the one
  /// that computed them, at most the one asked for.
  int64_t revision = 0;
  int64_t step_nm = 0;
  /// Columns of the batches, which come in any order there.
  std::vector<core::ColumnSpec> columns;
  /// Points to come at most.
  int64_t candidate_point_count = 0;
};

/// Chunks left out of one answer that are told of one by one.
inline constexpr size_t kMaxListedChunks = 1000;

/// The end of a complete answer.
struct QuerySummary {
  int64_t point_count = 0;
  /// point_count by label; all under kNone with `raw`.
  core::LabelCounts label_counts{};
  /// Bytes of the blocks.
  int64_t block_bytes = 0;
  /// By label, what region and filters leave, before a budget.
  core::LabelCounts available_label_counts{};
  /// Chunks with points that may have been asked for, left out by
  /// allow_partial, and all their points with the labels asked for.
  int64_t missing_chunk_count = 0;
  int64_t missing_point_count = 0;
  /// The first kMaxListedChunks of these chunks.
  std::vector<DamagedChunk> missing_chunks;
};

/// An answer on its way, pinned to one revision, which later changes of the
/// map do not touch. Used by one thread at a time; destroyed before its Engine.
class QueryCursor {
 public:
  virtual ~QueryCursor() = default;

  virtual const QueryHeader& header() const = 0;

  /// The next points as one block of core/codec of 1 to kMaxBatchBytes bytes;
  /// nothing once all were given. Points come in Morton order of their tiles;
  /// the filter's survivors those of depth 3 and above first, then depth 2, 1
  /// and 0, each part in Morton order throughout. Raw chunks that the query
  /// asks for whole may be batches as they are stored. Reads a few chunks of
  /// storage; the first call under a budget reads all candidates, with
  /// max_bytes several times, and the first call after a resume what was read
  /// before. After an error the cursor is of no further use.
  /// kCancelled; kAborted: what can be read changed since the answer that is
  /// resumed; kDataLoss: a chunk is damaged, and not allow_partial (under a
  /// budget also one that was sound when the points were chosen), or the
  /// catalogue is; kUnavailable: storage; kResourceExhausted: very many
  /// points fit max_bytes, more than there is memory left to choose.
  virtual absl::StatusOr<std::optional<std::vector<std::byte>>> NextBatch() = 0;

  /// Whether the last batch was a raw chunk as it is stored. Then nothing of
  /// the answer waits in memory; else blocks of together up to half of
  /// kMaxBatchBytes may.
  virtual bool gave_stored_chunk() const = 0;

  /// Of the batches so far, those before a resume included; of the answer once
  /// NextBatch gave nothing.
  virtual QuerySummary summary() const = 0;

  /// For QuerySpec::resume_token: stands for the batches so far.
  virtual std::string resume_token() const = 0;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_QUERY_H_
