#include "client/cli/file_blocks.h"

#include <utility>

#include "core/base/status.h"
#include "core/codec/points_codec.h"

namespace mapsieve::client {

FileBlocks::FileBlocks(std::filesystem::path path, ReadOptions options,
                       core::Lattice lattice)
    : path_(std::move(path)), options_(std::move(options)), lattice_(lattice) {}

absl::Status FileBlocks::Rewind() {
  MAPSIEVE_ASSIGN_OR_RETURN(reader_, OpenPointFile(path_, options_));
  refused_ = {};
  return absl::OkStatus();
}

absl::StatusOr<std::vector<std::byte>> FileBlocks::NextBlock() {
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const core::PointCloud batch,
                              reader_->ReadBatch(kUploadBlockPoints));
    if (batch.size() == 0) return std::vector<std::byte>();
    const core::LatticeCloud cloud = core::Quantize(batch, lattice_, refused_);
    if (cloud.size() > 0) return core::EncodePoints(cloud);
  }
}

}  // namespace mapsieve::client
