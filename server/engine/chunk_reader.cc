#include "server/engine/chunk_reader.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/codec/block_parts.h"
#include "core/geometry/morton.h"
#include "server/engine/product_chunk.h"

namespace mapsieve::engine {
namespace {

bool IsBefore(const core::LatticePoint& a, const core::LatticePoint& b) {
  return core::MortonLess(a, b);
}

/// What decoding a chunk came to: `status`, or kDataLoss if it has not as many
/// points as the catalogue says, with where the chunk is.
absl::Status CheckDecoded(const storage::ReadSnapshot& snapshot,
                          const storage::ChunkRef& chunk, absl::Status status,
                          size_t point_count) {
  if (status.ok() && point_count != static_cast<size_t>(chunk.point_count)) {
    status = absl::DataLossError(absl::StrCat("expected ", chunk.point_count,
                                              " points, found ", point_count));
  }
  return status.ok() ? status : Annotate(status, snapshot.Describe(chunk));
}

size_t SizeOf(const core::LatticeCloud& points) { return points.size(); }
size_t SizeOf(const core::ColumnSet& columns) {
  return columns.columns().empty() ? 0 : columns.columns().front().size();
}

/// A block of which some bytes were read; the others have no value.
struct PartialBlock {
  std::unique_ptr<std::byte[]> data;
  size_t size = 0;

  std::span<std::byte> bytes() const { return {data.get(), size}; }
};

/// Smaller chunks are read whole: calls would take longer than bytes.
constexpr int64_t kMinPartialBytes = int64_t{64} << 10;
/// Most heads are shorter.
constexpr size_t kHeadBytes = 4096;

/// Reads of a chunk of at least kMinPartialBytes what decoding it takes. The
/// catalogue tells whether the block is the chunk's: the size, which decoding
/// compares, and the bounds. kDataLoss, kNotFound, kOutOfRange: it is not as
/// it was stored, or its head is longer than kHeadBytes.
absl::StatusOr<PartialBlock> ReadPartially(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk,
    std::span<const std::string> attributes, core::BlockPositions positions) {
  PartialBlock block = {.size = static_cast<size_t>(chunk.stored_bytes)};
  block.data = std::make_unique_for_overwrite<std::byte[]>(block.size);
  const std::span<std::byte> head = block.bytes().first(kHeadBytes);
  MAPSIEVE_RETURN_IF_ERROR(snapshot.ReadChunkRange(chunk, 0, head));
  MAPSIEVE_ASSIGN_OR_RETURN(const core::BlockHeader header,
                            core::ReadBlockHeader(head));
  const core::LatticeBox bounds =
      core::BoxOf(header.min).Union(core::BoxOf(header.max));
  if (header.block_bytes != chunk.stored_bytes || bounds != chunk.bounds) {
    return absl::DataLossError(
        "size or bounds of the points are not those in the catalogue");
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<core::BlockPart> parts,
                            core::FindParts(head, attributes, positions));
  for (const auto& [begin, end] : parts) {
    MAPSIEVE_RETURN_IF_ERROR(
        snapshot.ReadChunkRange(chunk, static_cast<int64_t>(begin),
                                block.bytes().subspan(begin, end - begin)));
  }
  return block;
}

/// decode(block) of a chunk, which looks at `attributes` (nothing: all) and
/// perhaps the positions. Where these are not the whole chunk, only they are
/// read, and the checksums of the block tell damage; what it is then, reading
/// all of it tells.
template <typename Decode>
auto DecodeChunk(const storage::ReadSnapshot& snapshot,
                 const storage::ChunkRef& chunk,
                 const std::optional<std::vector<std::string>>& attributes,
                 core::BlockPositions positions, const Decode& decode)
    -> decltype(decode(std::span<const std::byte>())) {
  if (attributes.has_value() && chunk.stored_bytes >= kMinPartialBytes) {
    const absl::StatusOr<PartialBlock> block =
        ReadPartially(snapshot, chunk, *attributes, positions);
    if (block.ok()) {
      auto decoded = decode(block->bytes());
      if (decoded.ok() &&
          SizeOf(*decoded) == static_cast<size_t>(chunk.point_count)) {
        return decoded;
      }
    } else if (!absl::IsDataLoss(block.status()) &&
               !absl::IsNotFound(block.status()) &&
               !absl::IsOutOfRange(block.status())) {
      return block.status();
    }
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> block,
                            snapshot.ReadChunk(chunk));
  auto decoded = decode(std::span<const std::byte>(block));
  MAPSIEVE_RETURN_IF_ERROR(CheckDecoded(snapshot, chunk, decoded.status(),
                                        decoded.ok() ? SizeOf(*decoded) : 0));
  return decoded;
}

/// The points of a chunk in the chunk's order.
absl::StatusOr<core::LatticeCloud> ReadUnsorted(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk,
    const core::DecodeOptions& options) {
  return DecodeChunk(snapshot, chunk, options.attributes,
                     core::BlockPositions::kWanted,
                     [&](std::span<const std::byte> block) {
                       return core::DecodePoints(block, options);
                     });
}

}  // namespace

absl::StatusOr<core::LatticeCloud> ReadPoints(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk,
    const core::DecodeOptions& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(core::LatticeCloud points,
                            ReadUnsorted(snapshot, chunk, options));
  if (core::IsMortonSorted(points.positions)) return points;
  return points.Select(core::MortonOrder(points.positions));
}

absl::StatusOr<std::vector<core::LatticePoint>> ReadPositions(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      core::LatticeCloud points,
      ReadUnsorted(snapshot, chunk,
                   {.attributes = std::vector<std::string>()}));
  return std::move(points.positions);
}

absl::StatusOr<core::ColumnSet> ReadColumns(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk,
    const std::vector<std::string>& names) {
  return DecodeChunk(snapshot, chunk, names, core::BlockPositions::kNotWanted,
                     [&](std::span<const std::byte> block) {
                       return core::DecodeColumns(block, names);
                     });
}

absl::StatusOr<core::LatticeCloud> ReadPoints(
    const storage::ReadSnapshot& snapshot,
    std::span<const storage::ChunkRef> chunks,
    const core::DecodeOptions& options) {
  if (chunks.size() == 1) return ReadPoints(snapshot, chunks.front(), options);
  core::LatticeCloud points;
  for (const storage::ChunkRef& chunk : chunks) {
    MAPSIEVE_ASSIGN_OR_RETURN(const core::LatticeCloud part,
                              ReadUnsorted(snapshot, chunk, options));
    points.lattice = part.lattice;
    MAPSIEVE_RETURN_IF_ERROR(points.attributes.AppendAll(
        points.size(), part.attributes, part.size()));
    points.positions.insert(points.positions.end(), part.positions.begin(),
                            part.positions.end());
  }
  return points.Select(core::MortonOrder(points.positions));
}

std::vector<storage::BlobId> ContentsOf(
    std::span<const storage::ChunkRef> chunks) {
  std::vector<storage::BlobId> blobs;
  for (const storage::ChunkRef& chunk : chunks) blobs.push_back(chunk.blob_id);
  std::sort(blobs.begin(), blobs.end());
  return blobs;
}

absl::StatusOr<core::LatticeCloud> ReadProduct(
    const storage::ReadSnapshot& snapshot, const core::CellKey& tile) {
  core::DecodeOptions columns = {.attributes = std::vector<std::string>()};
  for (const std::string_view name :
       {kDepthColumn, kLabelColumn, kConfidenceColumn, kLambdaColumns[0],
        kLambdaColumns[1], kLambdaColumns[2], kNormalColumn, kTangentColumn}) {
    columns.attributes->emplace_back(name);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<storage::ChunkRef> chunks,
      snapshot.ListTileChunks(storage::ChunkKind::kProduct, tile));
  return ReadPoints(snapshot, chunks, columns);
}

absl::StatusOr<core::LatticeCloud> ReadPointsAt(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk,
    std::span<const core::LatticePoint> positions) {
  MAPSIEVE_ASSIGN_OR_RETURN(const core::LatticeCloud points,
                            ReadUnsorted(snapshot, chunk, {}));
  std::vector<uint32_t> rows;
  auto next = positions.begin();
  for (const uint32_t row : core::MortonOrder(points.positions)) {
    const core::LatticePoint& q = points.positions[row];
    while (next != positions.end() && IsBefore(*next, q)) ++next;
    if (next == positions.end()) break;
    if (*next == q) rows.push_back(row);
  }
  return points.Select(rows);
}

absl::StatusOr<std::vector<core::LatticePoint>> ReadDistinctPoints(
    const storage::ReadSnapshot& snapshot, const core::CellKey& tile) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<storage::ChunkRef> chunks,
      snapshot.ListTileChunks(storage::ChunkKind::kRaw, tile));
  return ReadDistinctPoints(snapshot, chunks);
}

absl::StatusOr<std::vector<core::LatticePoint>> ReadDistinctPoints(
    const storage::ReadSnapshot& snapshot,
    std::span<const storage::ChunkRef> chunks) {
  std::vector<core::LatticePoint> points;
  for (const storage::ChunkRef& chunk : chunks) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        core::LatticeCloud cloud,
        ReadPoints(snapshot, chunk,
                   {.attributes = std::vector<std::string>()}));
    std::vector<core::LatticePoint>& part = cloud.positions;
    if (points.empty()) {
      points = std::move(part);
      continue;
    }
    const auto middle = static_cast<ptrdiff_t>(points.size());
    points.insert(points.end(), part.begin(), part.end());
    if (IsBefore(points[static_cast<size_t>(middle)],
                 points[static_cast<size_t>(middle) - 1])) {
      std::inplace_merge(points.begin(), points.begin() + middle, points.end(),
                         IsBefore);
    }
  }
  points.erase(std::unique(points.begin(), points.end()), points.end());
  return points;
}

}  // namespace mapsieve::engine
