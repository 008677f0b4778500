#include "server/engine/chunk_writer.h"

#include <algorithm>
#include <cstddef>
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
  std::vector<absl::StatusOr<std::vector<ChunkRef>>> written(
      clouds.size(), absl::CancelledError("cancelled"));
  executor_.ParallelFor(static_cast<int64_t>(clouds.size()), [&](int64_t i) {
    if (stop.stop_requested()) return;
    const auto slot = static_cast<size_t>(i);
    written[slot] = WriteTile(clouds[slot]);
    clouds[slot].points = LatticeCloud();
  });
  for (const auto& chunks : written) {
    MAPSIEVE_RETURN_IF_ERROR(chunks.status());
    chunks_.insert(chunks_.end(), chunks->begin(), chunks->end());
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<ChunkRef>> ChunkWriter::WriteTile(
    const TileCloud& cloud) const {
  std::vector<ChunkRef> chunks;
  const std::vector<uint32_t> order = core::MortonOrder(cloud.points.positions);
  const auto chunk_points = static_cast<size_t>(
      std::clamp(max_chunk_bytes_ / DecodedPointBytes(cloud.points), int64_t{1},
                 core::kMaxBlockPoints));
  for (size_t begin = 0; begin < order.size(); begin += chunk_points) {
    const size_t count = std::min(chunk_points, order.size() - begin);
    MAPSIEVE_ASSIGN_OR_RETURN(
        ChunkRef chunk,
        WriteChunk(cloud.tile, cloud.points.Select(
                                   std::span(order).subspan(begin, count))));
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
