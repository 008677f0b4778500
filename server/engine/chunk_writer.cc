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
  constexpr size_t kRuns = 4;
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

/// Whether a sample of the points gets smaller in the order given than in
/// Morton order.
absl::StatusOr<bool> IsSmallerUnsorted(const LatticeCloud& points) {
  std::vector<uint32_t> rows(points.size());
  std::iota(rows.begin(), rows.end(), uint32_t{0});
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<std::byte> unsorted,
      core::EncodePoints(points.Select(SampleRuns(rows))));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> sorted,
                            core::EncodePoints(points.Select(SampleRuns(
                                core::MortonOrder(points.positions)))));
  return unsorted.size() < sorted.size();
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
    MAPSIEVE_ASSIGN_OR_RETURN(chunk.label_counts, CountLabels(points));
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> depths,
                              DepthsOf(points));
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

absl::Status ChunkWriter::Write(std::vector<TileCloud> clouds,
                                const std::stop_token& stop) {
  bool keeps_order = false;
  if (kind_ == storage::ChunkKind::kRaw && !clouds.empty()) {
    const auto largest =
        std::max_element(clouds.begin(), clouds.end(),
                         [](const TileCloud& a, const TileCloud& b) {
                           return a.points.size() < b.points.size();
                         });
    MAPSIEVE_ASSIGN_OR_RETURN(keeps_order, IsSmallerUnsorted(largest->points));
  }
  std::vector<absl::StatusOr<std::vector<ChunkRef>>> written(
      clouds.size(), absl::CancelledError("cancelled"));
  executor_.ParallelFor(static_cast<int64_t>(clouds.size()), [&](int64_t i) {
    if (stop.stop_requested()) return;
    const auto slot = static_cast<size_t>(i);
    written[slot] = WriteTile(clouds[slot], keeps_order);
    clouds[slot].points = LatticeCloud();
  });
  for (const auto& chunks : written) {
    MAPSIEVE_RETURN_IF_ERROR(chunks.status());
    chunks_.insert(chunks_.end(), chunks->begin(), chunks->end());
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<ChunkRef>> ChunkWriter::WriteTile(
    const TileCloud& cloud, bool keeps_order) const {
  std::vector<ChunkRef> chunks;
  const auto chunk_points = static_cast<size_t>(
      std::clamp(max_chunk_bytes_ / DecodedPointBytes(cloud.points), int64_t{1},
                 core::kMaxBlockPoints));
  if (keeps_order && cloud.points.size() <= chunk_points) {
    MAPSIEVE_ASSIGN_OR_RETURN(ChunkRef chunk,
                              WriteChunk(cloud.tile, cloud.points));
    chunks.push_back(std::move(chunk));
    return chunks;
  }
  std::vector<uint32_t> order = core::MortonOrder(cloud.points.positions);
  for (size_t begin = 0; begin < order.size(); begin += chunk_points) {
    const std::span rows = std::span(order).subspan(
        begin, std::min(chunk_points, order.size() - begin));
    if (keeps_order) std::sort(rows.begin(), rows.end());
    MAPSIEVE_ASSIGN_OR_RETURN(
        ChunkRef chunk, WriteChunk(cloud.tile, cloud.points.Select(rows)));
    chunks.push_back(std::move(chunk));
  }
  return chunks;
}

absl::StatusOr<ChunkRef> ChunkWriter::WriteChunk(
    const core::CellKey& tile, const LatticeCloud& points) const {
  MAPSIEVE_ASSIGN_OR_RETURN(ChunkRef chunk, DescribeChunk(kind_, tile, points));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                            core::EncodePoints(points));
  chunk.stored_bytes = static_cast<int64_t>(block.size());
  MAPSIEVE_ASSIGN_OR_RETURN(chunk.blob_id, blobs_->Put(block));
  return chunk;
}

}  // namespace mapsieve::engine
