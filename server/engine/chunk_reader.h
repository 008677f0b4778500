#ifndef MAPSIEVE_SERVER_ENGINE_CHUNK_READER_H_
#define MAPSIEVE_SERVER_ENGINE_CHUNK_READER_H_

#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"
#include "core/codec/points_codec.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// The points of a chunk in Morton order. Of a large chunk only the columns
/// that `options` want are read; those are checked, damage of others is not
/// noticed. Errors of ReadSnapshot::ReadChunk and DecodePoints, with
/// ReadSnapshot::Describe; kDataLoss: not as many points as the catalogue says.
absl::StatusOr<core::LatticeCloud> ReadPoints(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk,
    const core::DecodeOptions& options = {});

/// The positions of a chunk's points in the chunk's order, without decoding
/// anything else. Errors of ReadPoints.
absl::StatusOr<std::vector<core::LatticePoint>> ReadPositions(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk);

/// The attributes `names` of a chunk's points, in the chunk's order and without
/// decoding anything else: one or more, which it has. Errors of ReadPoints.
absl::StatusOr<core::ColumnSet> ReadColumns(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk,
    const std::vector<std::string>& names);

/// The points of some chunks of a tile together, in Morton order. Errors of
/// the other ReadPoints.
absl::StatusOr<core::LatticeCloud> ReadPoints(
    const storage::ReadSnapshot& snapshot,
    std::span<const storage::ChunkRef> chunks,
    const core::DecodeOptions& options);

/// The contents of chunks, whatever their order and numbers: equal lists hold
/// the same.
std::vector<storage::BlobId> ContentsOf(
    std::span<const storage::ChunkRef> chunks);

/// The product of a tile in Morton order: kDepthColumn and the columns of the
/// filter's answer, without the attributes of the raw points. Errors of
/// ReadPoints.
absl::StatusOr<core::LatticeCloud> ReadProduct(
    const storage::ReadSnapshot& snapshot, const core::CellKey& tile);

/// The points of a chunk, with all attributes, that lie at one of `positions`,
/// which are in Morton order, as they are. Errors of ReadPoints.
absl::StatusOr<core::LatticeCloud> ReadPointsAt(
    const storage::ReadSnapshot& snapshot, const storage::ChunkRef& chunk,
    std::span<const core::LatticePoint> positions);

/// The distinct points of some chunks of a tile in Morton order. Errors of
/// ReadPoints.
absl::StatusOr<std::vector<core::LatticePoint>> ReadDistinctPoints(
    const storage::ReadSnapshot& snapshot,
    std::span<const storage::ChunkRef> chunks);

/// The distinct raw points of a tile in Morton order. Errors of ReadPoints.
absl::StatusOr<std::vector<core::LatticePoint>> ReadDistinctPoints(
    const storage::ReadSnapshot& snapshot, const core::CellKey& tile);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_CHUNK_READER_H_
