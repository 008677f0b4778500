#include "server/engine/answer_stream.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/base/status.h"
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
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint32_t> rows, TakeRows());
  if (rows.empty()) return std::nullopt;
  return core::EncodePoints(pending_.Select(rows));
}

absl::StatusOr<bool> AnswerStream::Skip() {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint32_t> rows, TakeRows());
  return !rows.empty();
}

absl::StatusOr<std::vector<uint32_t>> AnswerStream::TakeRows() {
  const size_t wanted = source_.columns.PointsPerBlock(kMaxBatchBytes);
  while (!is_walked_ && pending_.size() - taken_ < wanted) {
    MAPSIEVE_RETURN_IF_ERROR(LoadChunk());
  }
  std::vector<uint32_t> rows(std::min(wanted, pending_.size() - taken_));
  std::iota(rows.begin(), rows.end(), static_cast<uint32_t>(taken_));
  for (const uint32_t row : rows) {
    ++label_counts_[static_cast<size_t>(pending_labels_[row])];
  }
  point_count_ += static_cast<int64_t>(rows.size());
  taken_ += rows.size();
  return rows;
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
  std::vector<uint32_t> rest(pending_.size() - taken_);
  std::iota(rest.begin(), rest.end(), static_cast<uint32_t>(taken_));
  pending_ = pending_.Select(rest);
  pending_labels_.erase(
      pending_labels_.begin(),
      pending_labels_.begin() + static_cast<ptrdiff_t>(taken_));
  taken_ = 0;
}

}  // namespace mapsieve::engine
