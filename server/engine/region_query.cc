#include "server/engine/region_query.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/codec/points_codec.h"
#include "core/sampling/spatial_budget.h"
#include "core/spdf/levels.h"
#include "server/engine/answer_columns.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/chunk_walk.h"
#include "server/engine/opaque_records.h"
#include "server/engine/product_chunk.h"

namespace mapsieve::engine {
namespace {

using core::Column;
using core::Label;
using core::LatticeCloud;
using core::LatticePoint;
using storage::ChunkKind;
using storage::ChunkRef;
using storage::ReadSnapshot;

/// Of a candidate under a budget: position and label, as they come and sorted,
/// the order, a row number and the sample's own row number.
constexpr int64_t kCandidateBytes =
    2 * (sizeof(LatticePoint) + sizeof(Label)) + 3 * sizeof(uint32_t);
/// Of a point chosen under a budget: cell, row and centroid, twice while they
/// are sorted.
constexpr int64_t kChosenBytes = 80;
/// A chunk decoded, its selected rows, and those rows waiting to be sent.
constexpr int64_t kChunkCopies = 3;
/// A batch before and after it is encoded.
constexpr int64_t kBatchCopies = 4;

/// What makes a point of a snapshot part of an answer.
struct PointFilter {
  std::optional<Region> region;
  /// By label; all of them for raw points.
  std::array<bool, core::kLabelCount> labels{};
  /// Nothing for raw points.
  std::optional<core::OutlierTest> outliers;
  int min_depth = 0;

  /// Points of the chunk that may pass.
  int64_t CountCandidates(const ChunkRef& chunk) const {
    if (!outliers.has_value()) return chunk.point_count;
    int64_t count = 0;
    for (size_t l = 0; l < core::kLabelCount; ++l) {
      if (labels[l]) count += chunk.label_counts[l];
    }
    return count;
  }

  /// The rows of a decoded chunk that pass, and the label of each.
  struct Passed {
    std::vector<uint32_t> rows;
    std::vector<Label> labels;
  };
  absl::StatusOr<Passed> Select(const LatticeCloud& chunk) const {
    std::optional<LabelColumnView> columns;
    std::vector<uint8_t> depths;
    if (outliers.has_value()) {
      MAPSIEVE_ASSIGN_OR_RETURN(columns, LabelColumnView::Of(chunk.attributes));
      if (min_depth > 0) {
        MAPSIEVE_ASSIGN_OR_RETURN(depths, DepthsOf(chunk.attributes));
      }
    }
    Passed passed;
    for (uint32_t row = 0; row < chunk.size(); ++row) {
      Label label = Label::kNone;
      if (outliers.has_value()) {
        label = columns->label(row);
        if (!labels[static_cast<size_t>(label)] ||
            !outliers->Keeps(label, columns->confidence(row))) {
          continue;
        }
        if (min_depth > 0 && depths[row] < min_depth) continue;
      }
      if (region.has_value() && !region->Contains(chunk.positions[row])) {
        continue;
      }
      passed.rows.push_back(row);
      passed.labels.push_back(label);
    }
    return passed;
  }
};

class RegionQuery final : public QueryCursor {
 public:
  RegionQuery(MemoryPool& memory, const QuerySpec& spec,
              std::shared_ptr<const ReadSnapshot> snapshot, PointFilter filter,
              AnswerColumns columns, std::stop_token stop)
      : max_points_(spec.max_points),
        representative_(spec.representative),
        allows_partial_(spec.allow_partial),
        kind_(spec.raw ? ChunkKind::kRaw : ChunkKind::kProduct),
        snapshot_(std::move(snapshot)),
        filter_(std::move(filter)),
        columns_(std::move(columns)),
        stop_(std::move(stop)),
        pool_(memory),
        memory_(memory),
        walk_(NewWalk()) {
    header_ = {.revision = snapshot_->revision().number,
               .step_nm = snapshot_->map().spec.step_nm,
               .columns = columns_.specs()};
    pending_.lattice = core::Lattice(header_.step_nm);
  }

  /// Counts the candidates and reserves what the answer needs in any case.
  absl::Status Prepare() {
    ChunkWalk walk = NewWalk();
    int64_t largest = 0;
    while (true) {
      MAPSIEVE_RETURN_IF_ERROR(CheckStop());
      MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<ChunkRef> chunk,
                                walk.Next());
      if (!chunk.has_value()) break;
      max_candidates_ += filter_.CountCandidates(*chunk);
      largest = std::max(largest, chunk->point_count);
    }
    header_.candidate_point_count = max_points_ > 0
                                        ? std::min(max_candidates_, max_points_)
                                        : max_candidates_;
    return memory_.Grow(kChunkCopies * largest * columns_.stored_point_bytes() +
                            kBatchCopies * kMaxBatchBytes,
                        "the query");
  }

  const QueryHeader& header() const override { return header_; }

  absl::StatusOr<std::optional<std::vector<std::byte>>> NextBatch() override {
    if (max_points_ > 0 && !sample_.has_value()) {
      MAPSIEVE_RETURN_IF_ERROR(ChooseUnderBudget());
    }
    const size_t wanted = columns_.PointsPerBlock(kMaxBatchBytes);
    while (!is_walked_ && pending_.size() - sent_ < wanted) {
      MAPSIEVE_RETURN_IF_ERROR(CheckStop());
      MAPSIEVE_RETURN_IF_ERROR(LoadChunk());
    }
    const size_t count = std::min(wanted, pending_.size() - sent_);
    if (count == 0) return std::nullopt;
    std::vector<uint32_t> rows(count);
    std::iota(rows.begin(), rows.end(), static_cast<uint32_t>(sent_));
    MAPSIEVE_ASSIGN_OR_RETURN(std::vector<std::byte> block,
                              core::EncodePoints(pending_.Select(rows)));
    for (const uint32_t row : rows) {
      ++summary_.label_counts[static_cast<size_t>(pending_labels_[row])];
    }
    summary_.point_count += static_cast<int64_t>(count);
    sent_ += count;
    return block;
  }

  QuerySummary summary() const override { return summary_; }

 private:
  ChunkWalk NewWalk() const {
    return {*snapshot_, kind_, filter_.region, filter_.min_depth};
  }

  absl::Status CheckStop() const {
    if (stop_.stop_requested()) return absl::CancelledError("cancelled");
    return absl::OkStatus();
  }

  /// Columns that the filter looks at.
  std::vector<std::string> FilterNames() const {
    if (kind_ == ChunkKind::kRaw) return {};
    std::vector<std::string> names = {std::string(kLabelColumn),
                                      std::string(kConfidenceColumn)};
    if (filter_.min_depth > 0) names.emplace_back(kDepthColumn);
    return names;
  }

  /// Of a chunk: its points, and which of them pass.
  struct Part {
    LatticeCloud points;
    PointFilter::Passed passed;
  };
  absl::StatusOr<Part> ReadPart(const ChunkRef& chunk,
                                std::vector<std::string> names) const {
    Part part;
    MAPSIEVE_ASSIGN_OR_RETURN(
        part.points,
        ReadPoints(*snapshot_, chunk, {.attributes = std::move(names)}));
    MAPSIEVE_ASSIGN_OR_RETURN(part.passed, filter_.Select(part.points));
    return part;
  }

  bool LeavesOut(const absl::Status& status) const {
    return allows_partial_ && absl::IsDataLoss(status);
  }

  void NoteMissing(const ChunkRef& chunk, const absl::Status& damage) {
    missing_.insert(chunk.number);
    ++summary_.missing_chunk_count;
    summary_.missing_point_count += filter_.CountCandidates(chunk);
    if (summary_.missing_chunks.size() < kMaxListedChunks) {
      summary_.missing_chunks.push_back(MakeDamagedChunk(chunk, damage));
    }
  }

  /// Gathers all candidates and chooses among them.
  absl::Status ChooseUnderBudget() {
    constexpr int64_t kMaxCandidates = std::numeric_limits<uint32_t>::max();
    if (max_candidates_ > kMaxCandidates) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "max_points: ", max_candidates_, " points to choose from, at most ",
          kMaxCandidates, " can be; ask for a smaller region"));
    }
    Reservation candidates(pool_);
    MAPSIEVE_RETURN_IF_ERROR(
        candidates.Grow(kCandidateBytes * max_candidates_,
                        absl::StrCat("choosing max_points among ",
                                     max_candidates_, " points")));
    std::vector<LatticePoint> positions;
    std::vector<Label> labels;
    positions.reserve(static_cast<size_t>(max_candidates_));
    labels.reserve(static_cast<size_t>(max_candidates_));
    ChunkWalk walk = NewWalk();
    while (true) {
      MAPSIEVE_RETURN_IF_ERROR(CheckStop());
      MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<ChunkRef> chunk,
                                walk.Next());
      if (!chunk.has_value()) break;
      if (filter_.CountCandidates(*chunk) == 0) continue;
      const absl::StatusOr<Part> part = ReadPart(*chunk, FilterNames());
      if (LeavesOut(part.status())) {
        NoteMissing(*chunk, part.status());
        continue;
      }
      MAPSIEVE_RETURN_IF_ERROR(part.status());
      for (const uint32_t row : part->passed.rows) {
        positions.push_back(part->points.positions[row]);
      }
      labels.insert(labels.end(), part->passed.labels.begin(),
                    part->passed.labels.end());
    }
    const auto chosen =
        std::min(max_points_, static_cast<int64_t>(labels.size()));
    MAPSIEVE_RETURN_IF_ERROR(memory_.Grow(kChosenBytes * chosen, "max_points"));
    // The sample asks for Morton order, which the walk has within each group.
    const std::vector<uint32_t> order = core::MortonOrder(positions);
    std::vector<LatticePoint> sorted_positions;
    std::vector<Label> sorted_labels;
    for (const uint32_t row : order) {
      sorted_positions.push_back(positions[row]);
      sorted_labels.push_back(labels[row]);
    }
    MAPSIEVE_ASSIGN_OR_RETURN(
        const core::BudgetSample sample,
        core::SampleUnderBudget(sorted_positions, sorted_labels, chosen));
    std::vector<std::pair<uint32_t, size_t>> rows;
    for (size_t i = 0; i < sample.rows.size(); ++i) {
      rows.emplace_back(order[sample.rows[i]], i);
    }
    std::sort(rows.begin(), rows.end());
    sample_.emplace();
    for (const auto& [row, i] : rows) {
      sample_->rows.push_back(row);
      sample_->centroids.push_back(sample.centroids[i]);
    }
    return absl::OkStatus();
  }

  /// Appends what passes of the next chunk to the pending points.
  absl::Status LoadChunk() {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<ChunkRef> chunk,
                              walk_.Next());
    if (!chunk.has_value()) {
      is_walked_ = true;
      return absl::OkStatus();
    }
    if (filter_.CountCandidates(*chunk) == 0 ||
        missing_.contains(chunk->number)) {
      return absl::OkStatus();
    }
    std::vector<std::string> names = FilterNames();
    names.insert(names.end(), columns_.stored_names().begin(),
                 columns_.stored_names().end());
    absl::StatusOr<Part> part = ReadPart(*chunk, std::move(names));
    // The choice counts on the points that were there.
    if (!sample_.has_value() && LeavesOut(part.status())) {
      NoteMissing(*chunk, part.status());
      return absl::OkStatus();
    }
    MAPSIEVE_RETURN_IF_ERROR(part.status());
    auto& [points, passed] = *part;
    std::vector<LatticePoint> positions;
    if (sample_.has_value()) {
      positions = KeepChosen(points, passed);
    } else {
      for (const uint32_t row : passed.rows) {
        positions.push_back(points.positions[row]);
      }
    }
    if (positions.empty()) return absl::OkStatus();
    MAPSIEVE_ASSIGN_OR_RETURN(const core::ColumnSet answer,
                              columns_.Build(points, passed.rows));
    DropSent();
    MAPSIEVE_RETURN_IF_ERROR(pending_.attributes.AppendAll(
        pending_.size(), answer, positions.size()));
    pending_.positions.insert(pending_.positions.end(), positions.begin(),
                              positions.end());
    pending_labels_.insert(pending_labels_.end(), passed.labels.begin(),
                           passed.labels.end());
    return absl::OkStatus();
  }

  /// Leaves the chosen ones of the candidates `passed` and returns where they
  /// are in the answer.
  std::vector<LatticePoint> KeepChosen(const LatticeCloud& points,
                                       PointFilter::Passed& passed) {
    std::vector<LatticePoint> positions;
    PointFilter::Passed kept;
    const uint64_t end = candidates_seen_ + passed.rows.size();
    for (; next_chosen_ < sample_->rows.size() &&
           sample_->rows[next_chosen_] < end;
         ++next_chosen_) {
      const size_t i = sample_->rows[next_chosen_] - candidates_seen_;
      kept.rows.push_back(passed.rows[i]);
      kept.labels.push_back(passed.labels[i]);
      const core::Point3& c = sample_->centroids[next_chosen_];
      positions.push_back(
          representative_ == Representative::kNearest
              ? points.positions[passed.rows[i]]
              : LatticePoint{static_cast<int64_t>(std::nearbyint(c.x)),
                             static_cast<int64_t>(std::nearbyint(c.y)),
                             static_cast<int64_t>(std::nearbyint(c.z))});
    }
    candidates_seen_ = end;
    passed = std::move(kept);
    return positions;
  }

  /// Frees the pending points that were sent.
  void DropSent() {
    std::vector<uint32_t> rest(pending_.size() - sent_);
    std::iota(rest.begin(), rest.end(), static_cast<uint32_t>(sent_));
    pending_ = pending_.Select(rest);
    pending_labels_.erase(
        pending_labels_.begin(),
        pending_labels_.begin() + static_cast<ptrdiff_t>(sent_));
    sent_ = 0;
  }

  const int64_t max_points_;
  const Representative representative_;
  const bool allows_partial_;
  const ChunkKind kind_;
  const std::shared_ptr<const ReadSnapshot> snapshot_;
  const PointFilter filter_;
  const AnswerColumns columns_;
  const std::stop_token stop_;
  MemoryPool& pool_;
  Reservation memory_;
  /// Points of the chunks that the region meets, with the labels asked for.
  int64_t max_candidates_ = 0;
  QueryHeader header_;
  QuerySummary summary_;
  /// Numbers of the chunks left out.
  std::set<int64_t> missing_;
  ChunkWalk walk_;
  bool is_walked_ = false;
  /// Points of the answer, those up to sent_ sent.
  LatticeCloud pending_;
  std::vector<Label> pending_labels_;
  size_t sent_ = 0;
  /// Under a budget: what was chosen, and how far the walk has come in it.
  std::optional<core::BudgetSample> sample_;
  size_t next_chosen_ = 0;
  uint64_t candidates_seen_ = 0;
};

absl::Status CheckSpec(const QuerySpec& spec) {
  if (spec.revision < 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "revision is ", spec.revision, "; it must be 0 (newest) or above"));
  }
  if (spec.max_points < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_points is ", spec.max_points,
                     "; it must be 0 (no limit) or above"));
  }
  if (spec.depth < 0 || spec.depth > core::kMaxDepth) {
    return absl::InvalidArgumentError(
        absl::StrCat("depth is ", spec.depth, "; it must be 0 (all points) to ",
                     core::kMaxDepth));
  }
  if (!(spec.spacing_m >= 0)) {
    return absl::InvalidArgumentError(
        absl::StrCat("spacing_m is ", spec.spacing_m,
                     "; it must be 0 (all points) or above"));
  }
  if (spec.depth > 0 && spec.spacing_m > 0) {
    return absl::InvalidArgumentError(
        "depth, spacing_m: both choose a level of detail; leave one out");
  }
  if (spec.raw && (spec.depth > 0 || spec.spacing_m > 0)) {
    return absl::InvalidArgumentError(
        "depth, spacing_m: raw points have no levels of detail; leave them or "
        "raw out");
  }
  for (const Label label : spec.labels) {
    if (label != Label::kJunction && label != Label::kCurve &&
        label != Label::kSurface) {
      return absl::InvalidArgumentError(
          absl::StrCat("labels holds ", static_cast<int>(label),
                       "; labels are 1 junction, 2 curve and 3 surface"));
    }
  }
  if (spec.raw && !spec.labels.empty()) {
    return absl::InvalidArgumentError(
        "labels: raw points have none; leave labels or raw out");
  }
  if (spec.raw && spec.max_points > 0) {
    return absl::InvalidArgumentError(
        "max_points: a budget is shared out by label, which raw points lack; "
        "leave max_points or raw out");
  }
  return absl::OkStatus();
}

/// The revision that answers `spec`.
absl::StatusOr<std::shared_ptr<const ReadSnapshot>> OpenRevision(
    storage::Store& store, const QuerySpec& spec) {
  MAPSIEVE_ASSIGN_OR_RETURN(auto asked,
                            store.OpenSnapshot(spec.map_id, spec.revision));
  const int64_t processed = asked->revision().processed_revision;
  if (spec.raw || processed == asked->revision().number) return asked;
  if (processed == 0) {
    if (spec.revision == 0) {
      return absl::FailedPreconditionError(
          absl::StrCat("map ", spec.map_id,
                       " was never processed; process it, or ask for raw "
                       "points"));
    }
    return absl::OutOfRangeError(absl::StrCat(
        "map ", spec.map_id, " was not processed up to revision ",
        spec.revision, "; ask for a later one, or for raw points"));
  }
  return store.OpenProduct(*asked);
}

}  // namespace

absl::StatusOr<std::unique_ptr<QueryCursor>> OpenQuery(storage::Store& store,
                                                       MemoryPool& memory,
                                                       const QuerySpec& spec,
                                                       std::stop_token stop) {
  MAPSIEVE_RETURN_IF_ERROR(CheckSpec(spec));
  MAPSIEVE_ASSIGN_OR_RETURN(std::shared_ptr<const ReadSnapshot> snapshot,
                            OpenRevision(store, spec));
  const storage::RevisionSpec& revision = snapshot->revision().spec;
  PointFilter filter;
  if (spec.region.has_value()) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        filter.region,
        Region::Make(*spec.region,
                     core::Lattice(snapshot->map().spec.step_nm)));
  }
  for (const Label label : spec.labels) {
    filter.labels[static_cast<size_t>(label)] = true;
  }
  if (spec.labels.empty()) filter.labels.fill(true);
  if (!spec.raw) {
    if (!revision.product.has_value()) {
      return absl::DataLossError(absl::StrCat(
          "map ", spec.map_id, ", revision ", snapshot->revision().number,
          ": its product is not described"));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const core::SpdfOptions options,
                              ParseSpdfOptions(revision.product->options));
    filter.outliers.emplace(revision.product->max_confidence,
                            options.outlier_share);
    filter.min_depth = spec.spacing_m > 0
                           ? core::LevelOfSpacing(options, spec.spacing_m)
                           : spec.depth;
  }
  MAPSIEVE_ASSIGN_OR_RETURN(AnswerColumns columns,
                            AnswerColumns::Make(spec, revision.attributes));
  auto query = std::make_unique<RegionQuery>(
      memory, spec, std::move(snapshot), std::move(filter), std::move(columns),
      std::move(stop));
  MAPSIEVE_RETURN_IF_ERROR(query->Prepare());
  return query;
}

}  // namespace mapsieve::engine
