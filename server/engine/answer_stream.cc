#include "server/engine/answer_stream.h"

#include <algorithm>
#include <cmath>
#include <future>
#include <utility>

#include "core/base/status.h"
#include "core/cloud/row_runs.h"
#include "core/codec/points_codec.h"
#include "server/engine/chunk_reader.h"

namespace mapsieve::engine {
namespace {

using core::Label;
using core::LatticeCloud;
using core::LatticePoint;
using storage::ChunkRef;

/// Points that tell what suits the blocks behind them too.
constexpr size_t kTellingPoints = 512;

}  // namespace

absl::Status AnswerSource::CheckStop() const {
  if (stop.stop_requested()) return absl::CancelledError("cancelled");
  return absl::OkStatus();
}

absl::StatusOr<AnswerSource::Part> AnswerSource::Read(
    const ChunkRef& chunk, std::vector<std::string> names) const {
  MAPSIEVE_RETURN_IF_ERROR(CheckStop());
  names.insert(names.end(), filter.stored_names().begin(),
               filter.stored_names().end());
  Part part;
  MAPSIEVE_ASSIGN_OR_RETURN(
      part.points,
      ReadPoints(snapshot, chunk, {.attributes = std::move(names)}));
  MAPSIEVE_ASSIGN_OR_RETURN(part.passed,
                            filter.Select(chunk, part.points, stop));
  return part;
}

absl::StatusOr<std::optional<AnswerSource::Part>> AnswerSource::Accept(
    const ChunkRef& chunk, absl::StatusOr<Part> part,
    MissingChunks* missing) const {
  if (part.ok()) return *std::move(part);
  MAPSIEVE_RETURN_IF_ERROR(CheckRead(chunk, part.status(), missing));
  return std::nullopt;
}

absl::StatusOr<std::optional<std::vector<std::byte>>>
AnswerSource::ReadAsStored(const ChunkRef& chunk,
                           MissingChunks* missing) const {
  MAPSIEVE_RETURN_IF_ERROR(CheckStop());
  const std::vector<core::ColumnSpec>& specs = columns.specs();
  if (kind != storage::ChunkKind::kRaw ||
      compression == core::Compression::kNone ||
      specs.size() != snapshot.revision().spec.attributes.size() ||
      chunk.stored_bytes > kMaxBatchBytes || !filter.PassesAllOf(chunk)) {
    return std::nullopt;
  }
  absl::StatusOr<std::vector<std::byte>> block = snapshot.ReadChunk(chunk);
  if (!block.ok()) {
    MAPSIEVE_RETURN_IF_ERROR(CheckRead(chunk, block.status(), missing));
    return std::nullopt;
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const core::BlockHeader header,
                            core::ReadBlockHeader(*block));
  const bool fits = std::all_of(header.columns.begin(), header.columns.end(),
                                [&](const core::ColumnSpec& column) {
                                  return std::find(specs.begin(), specs.end(),
                                                   column) != specs.end();
                                });
  if (!fits) return std::nullopt;
  return *std::move(block);
}

absl::Status AnswerSource::CheckRead(const ChunkRef& chunk,
                                     const absl::Status& status,
                                     MissingChunks* missing) const {
  if (missing == nullptr || !allows_partial || !absl::IsDataLoss(status)) {
    return status;
  }
  missing->numbers.insert(chunk.number);
  missing->point_count += filter.CountCandidates(chunk);
  if (missing->listed.size() < kMaxListedChunks) {
    missing->listed.push_back(MakeDamagedChunk(chunk, status));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::optional<std::vector<std::byte>>> AnswerStream::Next() {
  // The first block does not wait for the points of the second one, and what
  // is only read waits for its turn.
  const size_t wanted =
      given_.point_count == 0 || gave_stored_ ? 1 : BlocksAhead();
  while (coming_.size() < wanted && !is_ended_ &&
         (coming_.empty() || !coming_.back().stored.has_value())) {
    MAPSIEVE_RETURN_IF_ERROR(BeginBlock());
  }
  if (coming_.empty()) return std::nullopt;
  Coming next = std::move(coming_.front());
  coming_.pop_front();
  gave_stored_ = next.stored.has_value();
  absl::StatusOr<Block> block =
      gave_stored_ ? *std::move(next.stored) : next.encoded.get();
  if (block.ok()) last_block_bytes_ = block->size();
  given_ = next.totals;
  MAPSIEVE_RETURN_IF_ERROR(block.status());
  return *std::move(block);
}

size_t AnswerStream::BlocksAhead() const {
  constexpr size_t kRoom = kMaxBatchBytes / 2;
  return std::clamp(kRoom / std::max(last_block_bytes_, size_t{1}), size_t{1},
                    kMaxBlocksAhead);
}

size_t AnswerStream::PointsPerBlock() const {
  // Plain blocks are as large as their bound.
  return source_.columns.PointsPerBlock(
      source_.compression == core::Compression::kNone ? kMaxBatchBytes / 2
                                                      : kMaxBatchBytes);
}

absl::Status AnswerStream::BeginBlock() {
  MAPSIEVE_ASSIGN_OR_RETURN(LatticeCloud points, TakePoints());
  Coming next;
  if (points.size() > 0) {
    const core::EncodeOptions options = {
        .compression = source_.compression,
        .plan = plan_.has_value() ? &*plan_ : nullptr};
    next.encoded = std::async(
        std::launch::async,
        [options, points = std::move(points)]() -> absl::StatusOr<Block> {
          return core::EncodePoints(points, options);
        });
  } else if (auto stored = TakeStored(); stored.has_value()) {
    next.stored = std::move(stored);
  } else {
    is_ended_ = true;
    return absl::OkStatus();
  }
  next.totals = taken_totals_;
  next.totals.missing_chunk_count = missing_.count();
  coming_.push_back(std::move(next));
  return absl::OkStatus();
}

absl::StatusOr<bool> AnswerStream::Skip() {
  MAPSIEVE_ASSIGN_OR_RETURN(const LatticeCloud points, TakePoints());
  const bool is_block = points.size() > 0 || TakeStored().has_value();
  given_ = taken_totals_;
  given_.missing_chunk_count = missing_.count();
  return is_block;
}

std::optional<AnswerStream::Block> AnswerStream::TakeStored() {
  if (!stored_.has_value()) return std::nullopt;
  taken_totals_.point_count += stored_point_count_;
  taken_totals_.label_counts[static_cast<size_t>(Label::kNone)] +=
      stored_point_count_;
  return std::exchange(stored_, std::nullopt);
}

absl::StatusOr<LatticeCloud> AnswerStream::TakePoints() {
  // The first block takes what one chunk has.
  const size_t wanted =
      taken_totals_.point_count == 0 ? size_t{1} : PointsPerBlock();
  MAPSIEVE_RETURN_IF_ERROR(LoadPending(wanted));
  const size_t count = std::min(PointsPerBlock(), PendingCount());
  for (size_t row = taken_; row < taken_ + count; ++row) {
    ++taken_totals_.label_counts[static_cast<size_t>(pending_labels_[row])];
  }
  LatticeCloud points = PendingPoints(taken_, count);
  taken_ += count;
  if (!plan_.has_value() &&
      count >= std::min(kTellingPoints, PointsPerBlock()) &&
      source_.compression != core::Compression::kNone) {
    plan_ =
        core::PlanEncoding(points, source_.compression, core::PlanAim::kSpeed);
  }
  taken_totals_.point_count += static_cast<int64_t>(count);
  return points;
}

absl::Status AnswerStream::LoadPending(size_t wanted) {
  if (choice_ != nullptr) return LoadChosen(wanted);
  while (!is_walked_ && !stored_.has_value() && PendingCount() < wanted) {
    MAPSIEVE_RETURN_IF_ERROR(LoadChunk());
  }
  return absl::OkStatus();
}

absl::Status AnswerStream::LoadChunk() {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::optional<ChunkRef> chunk, walk_.Next());
  if (!chunk.has_value()) {
    is_walked_ = true;
    return absl::OkStatus();
  }
  if (source_.filter.CountCandidates(*chunk) == 0 ||
      missing_.numbers.contains(chunk->number)) {
    return absl::OkStatus();
  }
  MAPSIEVE_ASSIGN_OR_RETURN(stored_, source_.ReadAsStored(*chunk, &missing_));
  stored_point_count_ = chunk->point_count;
  if (stored_.has_value() || missing_.numbers.contains(chunk->number)) {
    return absl::OkStatus();
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::optional<AnswerSource::Part> part,
      source_.Accept(*chunk,
                     source_.Read(*chunk, source_.columns.stored_names()),
                     &missing_));
  if (!part.has_value()) return absl::OkStatus();
  std::vector<LatticePoint> positions;
  for (const uint32_t row : part->passed.rows) {
    positions.push_back(part->points.positions[row]);
  }
  return Append(part->points, part->passed, positions);
}

absl::Status AnswerStream::LoadChosen(size_t wanted) {
  const std::vector<uint32_t>& rows = choice_->sample.rows;
  struct ChosenChunk {
    ComingChunk chunk;
    // The number of its first candidate, and its entries of the choice.
    uint64_t begin = 0;
    size_t first = 0;
    size_t last = 0;
  };
  std::deque<ChosenChunk> coming;
  const size_t first_of_all = next_chosen_;
  const size_t pending = PendingCount();
  while (true) {
    while (!is_walked_ && coming.size() < kMaxChunksAhead &&
           pending + (next_chosen_ - first_of_all) < wanted) {
      MAPSIEVE_ASSIGN_OR_RETURN(std::optional<ChunkRef> ref, walk_.Next());
      is_walked_ = !ref.has_value();
      if (is_walked_ || source_.filter.CountCandidates(*ref) == 0 ||
          missing_.numbers.contains(ref->number)) {
        continue;
      }
      const uint64_t begin = candidates_seen_;
      const size_t first = next_chosen_;
      candidates_seen_ += choice_->chunk_counts[chunks_seen_++];
      while (next_chosen_ < rows.size() &&
             rows[next_chosen_] < candidates_seen_) {
        ++next_chosen_;
      }
      if (next_chosen_ == first) continue;
      auto part = source_.BeginRead(*ref, source_.columns.stored_names());
      coming.push_back(
          {{*std::move(ref), std::move(part)}, begin, first, next_chosen_});
    }
    if (coming.empty()) return absl::OkStatus();
    ChosenChunk next = std::move(coming.front());
    coming.pop_front();
    // A choice counts on the points that were there.
    MAPSIEVE_ASSIGN_OR_RETURN(
        std::optional<AnswerSource::Part> part,
        source_.Accept(next.chunk.ref, next.chunk.part.get(), nullptr));
    const std::vector<LatticePoint> positions = KeepChosen(
        part->points, next.begin, next.first, next.last, part->passed);
    MAPSIEVE_RETURN_IF_ERROR(Append(part->points, part->passed, positions));
  }
}

std::vector<LatticePoint> AnswerStream::KeepChosen(
    const LatticeCloud& points, uint64_t begin, size_t first, size_t last,
    PointFilter::Passed& passed) const {
  std::vector<LatticePoint> positions;
  PointFilter::Passed kept;
  for (size_t entry = first; entry < last; ++entry) {
    const size_t i = choice_->sample.rows[entry] - begin;
    kept.rows.push_back(passed.rows[i]);
    kept.labels.push_back(passed.labels[i]);
    const core::Point3& c = choice_->sample.centroids[entry];
    positions.push_back(
        source_.representative == Representative::kNearest
            ? points.positions[passed.rows[i]]
            : LatticePoint{static_cast<int64_t>(std::nearbyint(c.x)),
                           static_cast<int64_t>(std::nearbyint(c.y)),
                           static_cast<int64_t>(std::nearbyint(c.z))});
  }
  passed = std::move(kept);
  return positions;
}

absl::Status AnswerStream::Append(const LatticeCloud& points,
                                  const PointFilter::Passed& passed,
                                  std::span<const LatticePoint> positions) {
  if (positions.empty()) return absl::OkStatus();
  MAPSIEVE_ASSIGN_OR_RETURN(const core::ColumnSet answer,
                            source_.columns.Build(points, passed.rows));
  DropTaken();
  MAPSIEVE_RETURN_IF_ERROR(
      pending_.attributes.AppendAll(pending_.size(), answer, positions.size()));
  pending_.positions.insert(pending_.positions.end(), positions.begin(),
                            positions.end());
  pending_labels_.insert(pending_labels_.end(), passed.labels.begin(),
                         passed.labels.end());
  return absl::OkStatus();
}

void AnswerStream::DropTaken() {
  pending_ = PendingPoints(taken_, pending_.size() - taken_);
  pending_labels_.erase(
      pending_labels_.begin(),
      pending_labels_.begin() + static_cast<ptrdiff_t>(taken_));
  taken_ = 0;
}

LatticeCloud AnswerStream::PendingPoints(size_t begin, size_t count) const {
  const core::RowRun run = {.begin = static_cast<uint32_t>(begin),
                            .count = static_cast<uint32_t>(count)};
  return core::SelectRuns(pending_, {&run, 1});
}

}  // namespace mapsieve::engine
