#include "server/engine/chunk_writer.h"

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <span>
#include <stop_token>
#include <utility>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/codec/points_codec.h"
#include "server/engine/product_chunk.h"

namespace mapsieve::engine {
namespace {

using core::LatticeBox;
using core::LatticeCloud;
using core::LatticePoint;
using storage::ChunkRef;

LatticeBox TightBox(std::span<const LatticePoint> points) {
  LatticeBox box = {points.front(), points.front()};
  for (const LatticePoint& q : points) {
    box.min = {std::min(box.min.x, q.x), std::min(box.min.y, q.y),
               std::min(box.min.z, q.z)};
    box.max = {std::max(box.max.x, q.x), std::max(box.max.y, q.y),
               std::max(box.max.z, q.z)};
  }
  box.max = {box.max.x + 1, box.max.y + 1, box.max.z + 1};
  return box;
}

/// Runs of rows, spread evenly over `rows`.
std::vector<uint32_t> SampleRuns(std::span<const uint32_t> rows) {
  constexpr size_t kRuns = 8;
  constexpr size_t kRunRows = 512;
  if (rows.size() <= kRuns * kRunRows) return {rows.begin(), rows.end()};
  std::vector<uint32_t> sample;
  for (size_t run = 0; run < kRuns; ++run) {
    const auto part =
        rows.subspan(run * (rows.size() - kRunRows) / (kRuns - 1), kRunRows);
    sample.insert(sample.end(), part.begin(), part.end());
  }
  return sample;
}

}  // namespace

int64_t DecodedPointBytes(const LatticeCloud& cloud) {
  size_t bytes = sizeof(LatticePoint);
  for (const core::Column& column : cloud.attributes.columns()) {
    bytes += column.value_size() + (column.has_missing() ? 1 : 0);
  }
  return static_cast<int64_t>(bytes);
}

absl::StatusOr<ChunkRef> DescribeChunk(storage::ChunkKind kind,
                                       const core::CellKey& tile,
                                       const LatticeCloud& points) {
  ChunkRef chunk = {.kind = kind,
                    .tile = tile,
                    .point_count = static_cast<int64_t>(points.size()),
                    .bounds = TightBox(points.positions)};
  if (kind == storage::ChunkKind::kProduct) {
    MAPSIEVE_ASSIGN_OR_RETURN(chunk.label_counts,
                              CountLabels(points.attributes));
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> depths,
                              DepthsOf(points.attributes));
    const auto [min, max] = std::minmax_element(depths.begin(), depths.end());
    chunk.min_depth = *min;
    chunk.max_depth = *max;
  }
  return chunk;
}

ChunkWriter::ChunkWriter(storage::Store& store, storage::ChunkKind kind,
                         int64_t max_chunk_bytes, Executor& executor)
    : kind_(kind),
      max_chunk_bytes_(max_chunk_bytes),
      executor_(executor),
      blobs_(store.NewBlobWriter()) {}

absl::StatusOr<ChunkWriter::RawStyle> ChunkWriter::ChooseStyle(
    const LatticeCloud& points) {
  std::vector<uint32_t> rows(points.size());
  std::iota(rows.begin(), rows.end(), uint32_t{0});
  const LatticeCloud unsorted = points.Select(SampleRuns(rows));
  const LatticeCloud sorted =
      points.Select(SampleRuns(core::MortonOrder(points.positions)));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> unsorted_block,
                            core::EncodePoints(unsorted));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> sorted_block,
                            core::EncodePoints(sorted));
  const bool keeps_order = unsorted_block.size() < sorted_block.size();
  return RawStyle{keeps_order,
                  core::PlanEncoding(keeps_order ? unsorted : sorted)};
}

absl::Status ChunkWriter::Write(std::vector<TileCloud> clouds,
                                const std::stop_token& stop) {
  if (kind_ == storage::ChunkKind::kRaw && !clouds.empty() &&
      !raw_style_.has_value()) {
    const auto largest =
        std::max_element(clouds.begin(), clouds.end(),
                         [](const TileCloud& a, const TileCloud& b) {
                           return a.points.size() < b.points.size();
                         });
    MAPSIEVE_ASSIGN_OR_RETURN(raw_style_, ChooseStyle(largest->points));
  }
  // Tiles differ in size, and a chunk waits for the disk: by chunk, none of
  // the executor's workers is idle for long.
  std::vector<std::vector<std::vector<uint32_t>>> rows(clouds.size());
  executor_.ParallelFor(static_cast<int64_t>(clouds.size()), [&](int64_t n) {
    const auto i = static_cast<size_t>(n);
    rows[i] = DivideRows(clouds[i].points);
  });
  struct Part {
    size_t cloud;
    size_t part;
  };
  std::vector<Part> parts;
  for (size_t i = 0; i < clouds.size(); ++i) {
    for (size_t p = 0; p < rows[i].size(); ++p) parts.push_back({i, p});
  }
  std::vector<ChunkRef> written(parts.size());
  MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
      executor_, static_cast<int64_t>(parts.size()),
      [&](int64_t n) -> absl::Status {
        if (stop.stop_requested()) return absl::CancelledError("cancelled");
        const auto [i, p] = parts[static_cast<size_t>(n)];
        const auto& [tile, points] = clouds[i];
        const std::vector<uint32_t> of_part = std::move(rows[i][p]);
        MAPSIEVE_ASSIGN_OR_RETURN(
            written[static_cast<size_t>(n)],
            WriteChunk(tile,
                       of_part.empty() ? points : points.Select(of_part)));
        return absl::OkStatus();
      }));
  chunks_.insert(chunks_.end(), written.begin(), written.end());
  return absl::OkStatus();
}

std::vector<std::vector<uint32_t>> ChunkWriter::DivideRows(
    const LatticeCloud& points) const {
  const bool keeps_order = raw_style_.has_value() && raw_style_->keeps_order;
  const auto chunk_points = static_cast<size_t>(
      std::clamp(max_chunk_bytes_ / DecodedPointBytes(points), int64_t{1},
                 core::kMaxBlockPoints));
  if (points.size() <= chunk_points &&
      (keeps_order || core::IsMortonSorted(points.positions))) {
    return {{}};
  }
  const std::vector<uint32_t> order = core::MortonOrder(points.positions);
  std::vector<std::vector<uint32_t>> chunks(
      PartCount(order.size(), chunk_points));
  if (keeps_order) {
    std::vector<uint32_t> chunk_of(order.size());
    for (size_t i = 0; i < order.size(); ++i) {
      chunk_of[order[i]] = static_cast<uint32_t>(i / chunk_points);
    }
    for (std::vector<uint32_t>& rows : chunks) rows.reserve(chunk_points);
    for (uint32_t row = 0; row < chunk_of.size(); ++row) {
      chunks[chunk_of[row]].push_back(row);
    }
  } else {
    for (size_t c = 0; c < chunks.size(); ++c) {
      const std::span rows = std::span(order).subspan(c * chunk_points);
      chunks[c].assign(rows.begin(),
                       rows.begin() + static_cast<std::ptrdiff_t>(
                                          std::min(chunk_points, rows.size())));
    }
  }
  return chunks;
}

absl::StatusOr<ChunkRef> ChunkWriter::WriteChunk(
    const core::CellKey& tile, const LatticeCloud& points) const {
  MAPSIEVE_ASSIGN_OR_RETURN(ChunkRef chunk, DescribeChunk(kind_, tile, points));
  const core::EncodeOptions options = {
      .plan = raw_style_.has_value() ? &raw_style_->plan : nullptr};
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                            core::EncodePoints(points, options));
  chunk.stored_bytes = static_cast<int64_t>(block.size());
  MAPSIEVE_ASSIGN_OR_RETURN(chunk.blob_id, blobs_->Put(block));
  return chunk;
}

}  // namespace mapsieve::engine
