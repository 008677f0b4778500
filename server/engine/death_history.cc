#include "server/engine/death_history.h"

#include <algorithm>
#include <utility>

#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/codec/compression.h"
#include "core/codec/points_codec.h"

namespace mapsieve::engine {
namespace {

using core::DeathRound;
using storage::ChunkRef;

constexpr uint8_t kVersion = 1;

}  // namespace

std::vector<std::byte> EncodeDeaths(std::span<const DeathRound> deaths) {
  const auto plain = std::as_bytes(deaths);
  const std::vector<std::byte> packed =
      core::Compress(core::Compression::kLz4, plain);
  ByteWriter writer;
  writer.Put(kVersion);
  writer.Put(packed.empty() ? core::Compression::kNone
                            : core::Compression::kLz4);
  writer.Put(static_cast<uint32_t>(deaths.size()));
  writer.PutBytes(packed.empty() ? plain : packed);
  return std::move(writer.bytes());
}

namespace {

/// Appends the `point_count` entries of a chunk's bytes to `deaths`.
absl::Status Decode(std::span<const std::byte> bytes, int64_t point_count,
                    std::vector<DeathRound>& deaths) {
  ByteReader reader(bytes);
  MAPSIEVE_ASSIGN_OR_RETURN(const uint8_t version,
                            reader.Take<uint8_t>("version"));
  MAPSIEVE_ASSIGN_OR_RETURN(const auto compression,
                            reader.Take<core::Compression>("compression"));
  MAPSIEVE_ASSIGN_OR_RETURN(const uint32_t count,
                            reader.Take<uint32_t>("point count"));
  if (version != kVersion || count != point_count) {
    return absl::DataLossError(absl::StrCat(
        "history of version ", int{version}, " and ", count,
        " points: expected version ", int{kVersion}, " and ", point_count));
  }
  const size_t begin = deaths.size();
  deaths.resize(begin + count);
  return core::Decompress(
      compression, bytes.subspan(reader.offset()),
      std::as_writable_bytes(std::span(deaths).subspan(begin)));
}

}  // namespace

DeathHistoryWriter::DeathHistoryWriter(storage::Store& store)
    : blobs_(store.NewBlobWriter()) {}

absl::StatusOr<std::vector<ChunkRef>> DeathHistoryWriter::Write(
    const core::CellKey& tile, std::span<const DeathRound> deaths) const {
  constexpr auto kChunkPoints = static_cast<size_t>(core::kMaxBlockPoints);
  std::vector<ChunkRef> chunks;
  for (size_t begin = 0; begin < deaths.size(); begin += kChunkPoints) {
    const size_t count = std::min(kChunkPoints, deaths.size() - begin);
    const std::vector<std::byte> bytes =
        EncodeDeaths(deaths.subspan(begin, count));
    ChunkRef chunk = {.kind = storage::ChunkKind::kHistory,
                      .tile = tile,
                      .point_count = static_cast<int64_t>(count),
                      .stored_bytes = static_cast<int64_t>(bytes.size()),
                      .bounds = tile.box()};
    MAPSIEVE_ASSIGN_OR_RETURN(chunk.blob_id, blobs_->Put(bytes));
    chunks.push_back(std::move(chunk));
  }
  return chunks;
}

absl::StatusOr<std::vector<DeathRound>> ReadDeaths(
    const storage::ReadSnapshot& snapshot, const ChunkRef& chunk) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> bytes,
                            snapshot.ReadChunk(chunk));
  std::vector<DeathRound> deaths;
  MAPSIEVE_RETURN_IF_ERROR(Annotate(Decode(bytes, chunk.point_count, deaths),
                                    snapshot.Describe(chunk)));
  return deaths;
}

absl::StatusOr<std::vector<DeathRound>> ReadDeaths(
    const storage::ReadSnapshot& snapshot, const core::CellKey& tile) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<ChunkRef> chunks,
      snapshot.ListTileChunks(storage::ChunkKind::kHistory, tile));
  std::vector<DeathRound> deaths;
  for (const ChunkRef& chunk : chunks) {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<DeathRound> part,
                              ReadDeaths(snapshot, chunk));
    deaths.insert(deaths.end(), part.begin(), part.end());
  }
  return deaths;
}

}  // namespace mapsieve::engine
