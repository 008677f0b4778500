#include "server/engine/answer_stream.h"

#include <algorithm>
#include <cmath>

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

}  // namespace

absl::Status AnswerSource::CheckStop() const {
  if (stop.stop_requested()) return absl::CancelledError("cancelled");
  return absl::OkStatus();
}

absl::StatusOr<std::optional<AnswerSource::Part>> AnswerSource::Read(
    const ChunkRef& chunk, std::vector<std::string> names,
    MissingChunks* missing) const {
  MAPSIEVE_RETURN_IF_ERROR(CheckStop());
  names.insert(names.end(), filter.stored_names().begin(),
               filter.stored_names().end());
  const auto read = [&]() -> absl::StatusOr<Part> {
    Part part;
    MAPSIEVE_ASSIGN_OR_RETURN(
        part.points,
        ReadPoints(snapshot, chunk, {.attributes = std::move(names)}));
    MAPSIEVE_ASSIGN_OR_RETURN(part.passed,
                              filter.Select(chunk, part.points, stop));
    return part;
  };
  absl::StatusOr<Part> part = read();
  if (part.ok()) return *std::move(part);
  if (missing == nullptr || !allows_partial ||
      !absl::IsDataLoss(part.status())) {
    return part.status();
  }
  missing->numbers.insert(chunk.number);
  missing->point_count += filter.CountCandidates(chunk);
  if (missing->listed.size() < kMaxListedChunks) {
    missing->listed.push_back(MakeDamagedChunk(chunk, part.status()));
  }
  return std::nullopt;
}

absl::StatusOr<std::optional<std::vector<std::byte>>> AnswerStream::Next() {
  MAPSIEVE_ASSIGN_OR_RETURN(const LatticeCloud points, TakePoints());
  if (points.size() == 0) return std::nullopt;
  return core::EncodePoints(points,
                            {.compression = source_.compression,
                             .plan = plan_.has_value() ? &*plan_ : nullptr});
}

absl::StatusOr<bool> AnswerStream::Skip() {
  MAPSIEVE_ASSIGN_OR_RETURN(const LatticeCloud points, TakePoints());
  return points.size() > 0;
}

absl::StatusOr<LatticeCloud> AnswerStream::TakePoints() {
  const size_t limit = source_.columns.PointsPerBlock(kMaxBatchBytes);
  // The first block is there as soon as any chunk gives points.
  const size_t wanted = point_count_ == 0 ? 1 : limit;
  while (!is_walked_ && pending_.size() - taken_ < wanted) {
    MAPSIEVE_RETURN_IF_ERROR(LoadChunk());
  }
  const size_t count = std::min(limit, pending_.size() - taken_);
  for (size_t row = taken_; row < taken_ + count; ++row) {
    ++label_counts_[static_cast<size_t>(pending_labels_[row])];
  }
  LatticeCloud points = PendingPoints(taken_, count);
  taken_ += count;
  if (point_count_ == 0 && source_.compression != core::Compression::kNone) {
    plan_ = core::PlanEncoding(points, source_.compression);
  }
  point_count_ += static_cast<int64_t>(count);
  return points;
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
  // A choice counts on the points that were there.
  MAPSIEVE_ASSIGN_OR_RETURN(
      std::optional<AnswerSource::Part> part,
      source_.Read(*chunk, source_.columns.stored_names(),
                   choice_ == nullptr ? &missing_ : nullptr));
  if (!part.has_value()) return absl::OkStatus();
  auto& [points, passed] = *part;
  std::vector<LatticePoint> positions;
  if (choice_ != nullptr) {
    positions = KeepChosen(points, passed);
  } else {
    for (const uint32_t row : passed.rows) {
      positions.push_back(points.positions[row]);
    }
  }
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

std::vector<LatticePoint> AnswerStream::KeepChosen(
    const LatticeCloud& points, PointFilter::Passed& passed) {
  std::vector<LatticePoint> positions;
  PointFilter::Passed kept;
  const uint64_t end = candidates_seen_ + passed.rows.size();
  for (;
       next_chosen_ < choice_->rows.size() && choice_->rows[next_chosen_] < end;
       ++next_chosen_) {
    const size_t i = choice_->rows[next_chosen_] - candidates_seen_;
    kept.rows.push_back(passed.rows[i]);
    kept.labels.push_back(passed.labels[i]);
    const core::Point3& c = choice_->centroids[next_chosen_];
    positions.push_back(
        source_.representative == Representative::kNearest
            ? points.positions[passed.rows[i]]
            : LatticePoint{static_cast<int64_t>(std::nearbyint(c.x)),
                           static_cast<int64_t>(std::nearbyint(c.y)),
                           static_cast<int64_t>(std::nearbyint(c.z))});
  }
  candidates_seen_ = end;
  passed = std::move(kept);
  return positions;
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
