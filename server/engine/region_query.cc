#include "server/engine/region_query.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/bulk_vector.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/sampling/spatial_budget.h"
#include "server/engine/answer_columns.h"
#include "server/engine/answer_stream.h"
#include "server/engine/chunk_walk.h"
#include "server/engine/point_filter.h"
#include "server/engine/query_checks.h"
#include "server/engine/resume_token.h"

namespace mapsieve::engine {
namespace {

using core::Label;
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
/// Bytes of a point in a block that a budget in bytes is taken to buy at most,
/// for the memory of the choice: few queries get more points.
constexpr int64_t kCheapPointBytes = 3;
/// A chunk decoded, its selected rows, and those rows waiting to be sent.
constexpr int64_t kChunkCopies = 3;
/// Under a budget: those decoded meanwhile.
constexpr int64_t kChunkCopiesAhead = kMaxChunksAhead - 1;
/// Blocks before and after they are encoded, and two messages on their way.
constexpr int64_t kBatchCopies = 2 * kMaxBlocksAhead + 3;

/// Choices tried for a budget in bytes.
constexpr int kMaxTrials = 16;
/// The share of it that makes a choice good enough, and that a trial aims at.
constexpr double kGoodShare = 0.955;
constexpr double kTargetShare = 0.98;

/// Of a decoded chunk of so many points.
int64_t ChunkBytes(const AnswerColumns& columns, const PointFilter& filter,
                   int64_t point_count) {
  return point_count *
         (columns.stored_point_bytes() + filter.attribute_bytes());
}

/// All points asked for, in Morton order.
struct Candidates {
  std::vector<LatticePoint> positions;
  std::vector<Label> labels;
  /// For each, its number in the order of the walk.
  std::vector<uint32_t> order;
};

class RegionQuery final : public QueryCursor {
 public:
  /// `memory`: null if the caller has reserved AnswerBytes.
  RegionQuery(MemoryPool* memory, const QuerySpec& spec,
              std::shared_ptr<const ReadSnapshot> snapshot, PointFilter filter,
              AnswerColumns columns, std::optional<ResumePoint> resume,
              std::stop_token stop)
      : max_points_(spec.max_points),
        max_bytes_(spec.max_bytes),
        label_weights_(spec.label_weights),
        resume_key_(spec.resume_key),
        resume_(std::move(resume)),
        snapshot_(std::move(snapshot)),
        filter_(std::move(filter)),
        columns_(std::move(columns)),
        source_{.snapshot = *snapshot_,
                .kind = spec.raw ? ChunkKind::kRaw : ChunkKind::kProduct,
                .filter = filter_,
                .columns = columns_,
                .representative = spec.representative,
                .allows_partial = spec.allow_partial,
                .compression = spec.plain_blocks ? core::Compression::kNone
                                                 : core::Compression::kLz4,
                .stop = std::move(stop)} {
    if (memory != nullptr) memory_.emplace(*memory);
    header_ = {.revision = snapshot_->revision().number,
               .step_nm = snapshot_->map().spec.step_nm,
               .columns = columns_.specs()};
  }

  /// Counts the candidates and reserves what the answer needs.
  absl::Status Prepare() {
    ChunkWalk walk = source_.NewWalk();
    int64_t largest = 0;
    while (true) {
      MAPSIEVE_RETURN_IF_ERROR(source_.CheckStop());
      MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<ChunkRef> chunk,
                                walk.Next());
      if (!chunk.has_value()) break;
      max_candidates_ += filter_.CountCandidates(*chunk);
      largest = std::max(largest, chunk->point_count);
    }
    header_.candidate_point_count = max_points_ > 0
                                        ? std::min(max_candidates_, max_points_)
                                        : max_candidates_;
    if (!memory_.has_value()) return absl::OkStatus();
    const int64_t answer_bytes = AnswerBytes(columns_, filter_, largest);
    if (!HasBudget()) {
      return memory_->Grow(answer_bytes, "the query", source_.stop);
    }
    constexpr int64_t kMaxCandidates = std::numeric_limits<uint32_t>::max();
    if (max_candidates_ > kMaxCandidates) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "a budget: ", max_candidates_, " points to choose from, at most ",
          kMaxCandidates, " can be; ask for a smaller region"));
    }
    int64_t chosen = max_candidates_;
    if (max_points_ > 0) chosen = std::min(chosen, max_points_);
    if (max_bytes_ > 0) {
      chosen = std::min(chosen, max_bytes_ / kCheapPointBytes);
    }
    choice_bytes_ = kChosenBytes * chosen;
    return memory_->Grow(
        answer_bytes +
            kChunkCopiesAhead * ChunkBytes(columns_, filter_, largest) +
            choice_bytes_ + kCandidateBytes * max_candidates_,
        absl::StrCat("choosing under a budget among ", max_candidates_,
                     " points (fewer at a coarser depth)"),
        source_.stop);
  }

  const QueryHeader& header() const override { return header_; }

  absl::StatusOr<std::optional<std::vector<std::byte>>> NextBatch() override {
    if (!stream_.has_value()) MAPSIEVE_RETURN_IF_ERROR(Begin());
    MAPSIEVE_ASSIGN_OR_RETURN(auto block, stream_->Next());
    if (block.has_value()) {
      block_bytes_ += static_cast<int64_t>(block->size());
    }
    return block;
  }

  bool gave_stored_chunk() const override {
    return stream_.has_value() && stream_->gave_stored();
  }

  QuerySummary summary() const override {
    QuerySummary summary = {.block_bytes = block_bytes_,
                            .missing_chunk_count = missing_.count(),
                            .missing_point_count = missing_.point_count,
                            .missing_chunks = missing_.listed};
    if (stream_.has_value()) {
      summary.point_count = stream_->given().point_count;
      summary.label_counts = stream_->given().label_counts;
    }
    summary.available_label_counts =
        HasBudget() ? available_ : summary.label_counts;
    return summary;
  }

  std::string resume_token() const override {
    const AnswerStream::Totals given =
        stream_.has_value() ? stream_->given() : AnswerStream::Totals{};
    return WriteResumeToken({.key = resume_key_,
                             .revision = header_.revision,
                             .point_count = given.point_count,
                             .block_bytes = block_bytes_,
                             .missing_chunk_count = given.missing_chunk_count});
  }

 private:
  bool HasBudget() const { return max_points_ > 0 || max_bytes_ > 0; }

  /// Chooses under a budget, and goes to where the answer is resumed.
  absl::Status Begin() {
    if (HasBudget()) MAPSIEVE_RETURN_IF_ERROR(ChooseUnderBudget());
    stream_.emplace(source_, HasBudget() ? &choice_ : nullptr, missing_);
    if (!resume_.has_value()) return absl::OkStatus();
    bool has_more = true;
    while (has_more && stream_->given().point_count < resume_->point_count) {
      MAPSIEVE_ASSIGN_OR_RETURN(has_more, stream_->Skip());
    }
    block_bytes_ = resume_->block_bytes;
    if (stream_->given().point_count == resume_->point_count &&
        stream_->given().missing_chunk_count == resume_->missing_chunk_count) {
      return absl::OkStatus();
    }
    return absl::AbortedError(
        "resume_token: other chunks can be read than when the answer began; "
        "ask again without it");
  }

  absl::StatusOr<Candidates> Gather() {
    Candidates found;
    ReserveBulk(found.positions, static_cast<size_t>(max_candidates_));
    found.labels.reserve(static_cast<size_t>(max_candidates_));
    ChunkWalk walk = source_.NewWalk();
    bool is_walked = false;
    // Chunks being read at the same time.
    std::deque<ComingChunk> coming;
    choice_.chunk_counts.clear();
    while (true) {
      while (!is_walked && coming.size() < kMaxChunksAhead) {
        MAPSIEVE_RETURN_IF_ERROR(source_.CheckStop());
        MAPSIEVE_ASSIGN_OR_RETURN(std::optional<ChunkRef> ref, walk.Next());
        is_walked = !ref.has_value();
        if (is_walked || filter_.CountCandidates(*ref) == 0) continue;
        auto part = source_.BeginRead(*ref, {});
        coming.push_back({*std::move(ref), std::move(part)});
      }
      if (coming.empty()) break;
      ComingChunk next = std::move(coming.front());
      coming.pop_front();
      MAPSIEVE_ASSIGN_OR_RETURN(
          const std::optional<AnswerSource::Part> part,
          source_.Accept(next.ref, next.part.get(), &missing_));
      if (!part.has_value()) continue;
      for (const uint32_t row : part->passed.rows) {
        found.positions.push_back(part->points.positions[row]);
      }
      found.labels.insert(found.labels.end(), part->passed.labels.begin(),
                          part->passed.labels.end());
      choice_.chunk_counts.push_back(
          static_cast<uint32_t>(part->passed.rows.size()));
    }
    for (const Label label : found.labels) {
      ++available_[static_cast<size_t>(label)];
    }
    Candidates sorted;
    // The walk gives a run for each of its few groups.
    MAPSIEVE_ASSIGN_OR_RETURN(
        sorted.order, core::MergeMortonRuns(found.positions, source_.stop));
    ReserveBulk(sorted.positions, found.positions.size());
    sorted.labels.reserve(found.labels.size());
    for (const uint32_t row : sorted.order) {
      sorted.positions.push_back(found.positions[row]);
      sorted.labels.push_back(found.labels[row]);
    }
    return sorted;
  }

  /// Makes choice_ a sample of `count` candidates.
  absl::Status Choose(const Candidates& candidates, int64_t count) {
    const int64_t bytes = kChosenBytes * count;
    if (bytes > choice_bytes_) {
      MAPSIEVE_RETURN_IF_ERROR(
          memory_->Grow(bytes - choice_bytes_, "the chosen points"));
      choice_bytes_ = bytes;
    }
    MAPSIEVE_ASSIGN_OR_RETURN(
        const core::CellSample sample,
        core::SampleUnderBudget(candidates.positions, candidates.labels, count,
                                label_weights_, source_.stop));
    std::vector<std::pair<uint32_t, size_t>> rows;
    rows.reserve(sample.rows.size());
    for (size_t i = 0; i < sample.rows.size(); ++i) {
      rows.emplace_back(candidates.order[sample.rows[i]], i);
    }
    std::sort(rows.begin(), rows.end());
    choice_.sample = {};
    for (const auto& [row, i] : rows) {
      choice_.sample.rows.push_back(row);
      choice_.sample.centroids.push_back(sample.centroids[i]);
    }
    return absl::OkStatus();
  }

  /// Bytes of the blocks of an answer with choice_.
  absl::StatusOr<int64_t> MeasureChoice() {
    AnswerStream stream(source_, &choice_, missing_);
    int64_t bytes = 0;
    while (true) {
      MAPSIEVE_ASSIGN_OR_RETURN(const auto block, stream.Next());
      if (!block.has_value()) return bytes;
      bytes += static_cast<int64_t>(block->size());
    }
  }

  /// Chooses as many candidates, up to `count`, as max_bytes_ has room for.
  absl::Status ChooseForBytes(const Candidates& candidates, int64_t count) {
    const auto max_bytes = static_cast<double>(max_bytes_);
    // A choice that fits, and the smallest one tried that does not.
    int64_t low = 0;
    double low_bytes = 0;
    int64_t high = count + 1;
    double high_bytes = 0;
    int64_t chosen = -1;
    auto trial = static_cast<int64_t>(columns_.PointsPerBlock(max_bytes_));
    for (int i = 0; i < kMaxTrials; ++i) {
      if (low + 1 >= high) break;
      chosen = std::clamp(trial, low + 1, high - 1);
      MAPSIEVE_RETURN_IF_ERROR(Choose(candidates, chosen));
      MAPSIEVE_ASSIGN_OR_RETURN(const int64_t bytes, MeasureChoice());
      if (bytes <= max_bytes_) {
        low = chosen;
        low_bytes = static_cast<double>(bytes);
        if (low == count || low_bytes >= kGoodShare * max_bytes) break;
      } else {
        high = chosen;
        high_bytes = static_cast<double>(bytes);
      }
      const double missing = kTargetShare * max_bytes - low_bytes;
      if (high_bytes == 0) {
        trial = low + static_cast<int64_t>(static_cast<double>(low) * missing /
                                           low_bytes);
      } else if (i % 4 == 3) {
        trial = low + (high - low) / 2;
      } else {
        trial = low + static_cast<int64_t>(static_cast<double>(high - low) *
                                           missing / (high_bytes - low_bytes));
      }
    }
    return chosen == low ? absl::OkStatus() : Choose(candidates, low);
  }

  /// Gathers all candidates, chooses among them and gives their memory back.
  absl::Status ChooseUnderBudget() {
    {
      MAPSIEVE_ASSIGN_OR_RETURN(const Candidates candidates, Gather());
      auto count = static_cast<int64_t>(candidates.labels.size());
      if (max_points_ > 0) count = std::min(count, max_points_);
      MAPSIEVE_RETURN_IF_ERROR(max_bytes_ > 0 && count > 0
                                   ? ChooseForBytes(candidates, count)
                                   : Choose(candidates, count));
    }
    memory_->Shrink(kCandidateBytes * max_candidates_);
    return absl::OkStatus();
  }

  const int64_t max_points_;
  const int64_t max_bytes_;
  const std::optional<core::LabelWeights> label_weights_;
  const uint64_t resume_key_;
  const std::optional<ResumePoint> resume_;
  const std::shared_ptr<const ReadSnapshot> snapshot_;
  const PointFilter filter_;
  const AnswerColumns columns_;
  const AnswerSource source_;
  std::optional<Reservation> memory_;
  /// Points of the chunks that the region meets, with the labels asked for.
  int64_t max_candidates_ = 0;
  QueryHeader header_;
  MissingChunks missing_;
  /// Under a budget: what was chosen, its memory, and what there was, by label.
  Choice choice_;
  int64_t choice_bytes_ = 0;
  core::LabelCounts available_{};
  /// Nothing before the first batch.
  std::optional<AnswerStream> stream_;
  int64_t block_bytes_ = 0;
};

/// What tokens of answers to `spec` are bound to: the query and the map, which
/// may have had another of its name before.
uint64_t ResumeKey(const QuerySpec& spec, const storage::MapRecord& map) {
  return spec.resume_key ^ Hash64(TextBytes(map.uid));
}

/// Begins the answer of a pinned revision that answers `spec`.
absl::StatusOr<std::unique_ptr<QueryCursor>> Open(
    std::shared_ptr<const ReadSnapshot> snapshot, MemoryPool* memory,
    QuerySpec spec, std::optional<ResumePoint> resume, std::stop_token stop) {
  spec.resume_key = ResumeKey(spec, snapshot->map());
  MAPSIEVE_ASSIGN_OR_RETURN(PointFilter filter,
                            PointFilter::Make(spec, *snapshot));
  MAPSIEVE_ASSIGN_OR_RETURN(
      AnswerColumns columns,
      AnswerColumns::Make(spec, snapshot->revision().spec.attributes));
  auto query = std::make_unique<RegionQuery>(
      memory, spec, std::move(snapshot), std::move(filter), std::move(columns),
      std::move(resume), std::move(stop));
  MAPSIEVE_RETURN_IF_ERROR(query->Prepare());
  return query;
}

}  // namespace

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

absl::StatusOr<std::unique_ptr<QueryCursor>> OpenQuery(storage::Store& store,
                                                       MemoryPool& memory,
                                                       const QuerySpec& asked,
                                                       std::stop_token stop) {
  MAPSIEVE_RETURN_IF_ERROR(CheckSpec(asked));
  QuerySpec spec = asked;
  std::optional<ResumePoint> resume;
  if (!asked.resume_token.empty()) {
    MAPSIEVE_ASSIGN_OR_RETURN(const storage::MapRecord map,
                              store.catalogue().GetMap(asked.map_id));
    MAPSIEVE_ASSIGN_OR_RETURN(
        resume, ReadResumeToken(asked.resume_token, ResumeKey(asked, map)));
    spec.revision = resume->revision;
  }
  MAPSIEVE_ASSIGN_OR_RETURN(std::shared_ptr<const ReadSnapshot> snapshot,
                            OpenRevision(store, spec));
  return Open(std::move(snapshot), &memory, std::move(spec), std::move(resume),
              std::move(stop));
}

absl::StatusOr<std::unique_ptr<QueryCursor>> OpenQuery(
    std::shared_ptr<const ReadSnapshot> snapshot, const QuerySpec& spec,
    std::stop_token stop) {
  return Open(std::move(snapshot), nullptr, spec, std::nullopt,
              std::move(stop));
}

int64_t AnswerBytes(const AnswerColumns& columns, const PointFilter& filter,
                    int64_t largest_chunk) {
  return kChunkCopies * ChunkBytes(columns, filter, largest_chunk) +
         kBatchCopies * kMaxBatchBytes;
}

}  // namespace mapsieve::engine
