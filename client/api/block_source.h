#ifndef MAPSIEVE_CLIENT_API_BLOCK_SOURCE_H_
#define MAPSIEVE_CLIENT_API_BLOCK_SOURCE_H_

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "client/api/map_types.h"
#include "core/cloud/point_cloud.h"

namespace mapsieve::client {

/// The point blocks (core/codec) of one upload, which can be produced again
/// and again with the same bytes: an offset into an upload always means the
/// same byte, so that it can be resumed. Not thread-safe.
class BlockSource {
 public:
  virtual ~BlockSource() = default;
  /// Starts again with the first block.
  virtual absl::Status Rewind() = 0;
  /// The next block; empty at the end.
  virtual absl::StatusOr<std::vector<std::byte>> NextBlock() = 0;
  /// Points left out of the blocks since the last Rewind.
  virtual core::RefusedCounts refused() const = 0;
  /// Where the points come from; known once a block was read.
  virtual UploadSource source() const { return {}; }
};

/// Points of a block of an upload at most, if each has these attributes: enough
/// to compress well, and few enough for the decoded block (4 MiB) to fit a
/// server of any memory.
size_t UploadBlockPoints(std::span<const core::ColumnSpec> attributes);

/// Blocks of a cloud in memory, which must outlive the source.
class CloudBlocks final : public BlockSource {
 public:
  explicit CloudBlocks(const core::LatticeCloud& cloud);
  absl::Status Rewind() override;
  absl::StatusOr<std::vector<std::byte>> NextBlock() override;
  core::RefusedCounts refused() const override { return {}; }

 private:
  const core::LatticeCloud& cloud_;
  const size_t block_points_;
  size_t next_ = 0;
};

/// The blocks of another source, which must outlive it; those of a source of up
/// to `max_bytes` are made once and kept.
class KeptBlocks final : public BlockSource {
 public:
  explicit KeptBlocks(BlockSource& source, int64_t max_bytes = int64_t{1} << 28)
      : source_(source), max_bytes_(max_bytes) {}
  absl::Status Rewind() override;
  absl::StatusOr<std::vector<std::byte>> NextBlock() override;
  core::RefusedCounts refused() const override { return source_.refused(); }
  UploadSource source() const override { return source_.source(); }

 private:
  enum class Keeping {
    kNothing,
    /// All blocks so far.
    kSoFar,
    kAll,
  };

  BlockSource& source_;
  const int64_t max_bytes_;
  Keeping keeping_ = Keeping::kNothing;
  std::vector<std::vector<std::byte>> kept_;
  int64_t kept_bytes_ = 0;
  size_t next_ = 0;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_API_BLOCK_SOURCE_H_
