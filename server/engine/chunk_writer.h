#ifndef MAPSIEVE_SERVER_ENGINE_CHUNK_WRITER_H_
#define MAPSIEVE_SERVER_ENGINE_CHUNK_WRITER_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/cloud/point_cloud.h"
#include "core/codec/points_codec.h"
#include "core/geometry/cell_key.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// More tiles are not collected to be written at once: their bookkeeping is
/// not counted.
inline constexpr size_t kMaxPendingTiles = 64;

/// Points of one tile.
struct TileCloud {
  core::CellKey tile;
  core::LatticeCloud points;
};

/// Memory of a decoded point of `cloud`, its flags of missing values included.
int64_t DecodedPointBytes(const core::LatticeCloud& cloud);

/// What a reference says of the content of a chunk: kind, tile, counts, box,
/// depths. kDataLoss: product columns are missing, or hold what they cannot.
absl::StatusOr<storage::ChunkRef> DescribeChunk(
    storage::ChunkKind kind, const core::CellKey& tile,
    const core::LatticeCloud& points);

/// Makes chunks of one kind out of the points of tiles and stores them. The
/// chunks are safe from collection while the writer lives: destroy it after
/// the commit. Used by one thread at a time.
class ChunkWriter {
 public:
  /// A tile's points are divided into chunks of at most `max_chunk_bytes`
  /// decoded (but a point at least). `executor` outlives the writer; as many
  /// chunks as it has workers are encoded at a time.
  ChunkWriter(storage::Store& store, storage::ChunkKind kind,
              int64_t max_chunk_bytes, Executor& executor);

  /// Stores the points of each cloud, divided by Morton order where that takes
  /// several chunks. In a chunk they lie in Morton order, those of one place in
  /// the order given; or, raw points, all in the order given, where a sample
  /// of the largest cloud of the first call is smaller so: scanners give
  /// attributes in an order that only theirs has. That sample also plans how
  /// raw chunks are encoded. All are durable when it returns. Product clouds
  /// are those of SplitByDepth. Errors of storage; kCancelled.
  absl::Status Write(std::vector<TileCloud> clouds,
                     const std::stop_token& stop);

  /// References to all chunks written, in the order of Write.
  const std::vector<storage::ChunkRef>& chunks() const { return chunks_; }

 private:
  /// How raw points are written.
  struct RawStyle {
    /// All in the order given, and not in Morton order.
    bool keeps_order = false;
    core::EncodePlan plan;
  };
  static absl::StatusOr<RawStyle> ChooseStyle(const core::LatticeCloud& points);

  /// The rows of each chunk; no rows: all, as they are.
  std::vector<std::vector<uint32_t>> DivideRows(
      const core::LatticeCloud& points) const;
  absl::StatusOr<storage::ChunkRef> WriteChunk(
      const core::CellKey& tile, const core::LatticeCloud& points) const;

  const storage::ChunkKind kind_;
  const int64_t max_chunk_bytes_;
  Executor& executor_;
  const std::unique_ptr<storage::BlobWriter> blobs_;
  /// Set by the first raw cloud.
  std::optional<RawStyle> raw_style_;
  std::vector<storage::ChunkRef> chunks_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_CHUNK_WRITER_H_
