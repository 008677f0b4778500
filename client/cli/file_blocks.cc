#include "client/cli/file_blocks.h"

#include <thread>
#include <utility>

#include "core/base/status.h"
#include "core/codec/points_codec.h"

namespace mapsieve::client {

FileBlocks::FileBlocks(std::filesystem::path path, ReadOptions options,
                       core::Lattice lattice)
    : path_(std::move(path)),
      options_(std::move(options)),
      lattice_(lattice),
      workers_(MakeWorkerPool(
          static_cast<int>(std::thread::hardware_concurrency()))) {}

absl::Status FileBlocks::Rewind() {
  MAPSIEVE_ASSIGN_OR_RETURN(reader_, OpenPointFile(path_, options_));
  refused_ = {};
  ready_.clear();
  return absl::OkStatus();
}

absl::StatusOr<std::vector<std::byte>> FileBlocks::NextBlock() {
  while (ready_.empty()) {
    std::vector<core::PointCloud> batches;
    while (batches.size() < static_cast<size_t>(workers_->worker_count())) {
      MAPSIEVE_ASSIGN_OR_RETURN(core::PointCloud batch,
                                reader_->ReadBatch(kUploadBlockPoints));
      if (batch.size() == 0) break;
      batches.push_back(std::move(batch));
    }
    if (batches.empty()) return std::vector<std::byte>();
    std::vector<std::vector<std::byte>> blocks(batches.size());
    std::vector<core::RefusedCounts> refused(batches.size());
    MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
        *workers_, static_cast<int64_t>(batches.size()),
        [&](int64_t i) -> absl::Status {
          const auto b = static_cast<size_t>(i);
          const core::LatticeCloud cloud =
              core::Quantize(std::move(batches[b]), lattice_, refused[b]);
          if (cloud.size() == 0) return absl::OkStatus();
          MAPSIEVE_ASSIGN_OR_RETURN(blocks[b], core::EncodePoints(cloud));
          return absl::OkStatus();
        }));
    for (size_t b = 0; b < batches.size(); ++b) {
      refused_.non_finite += refused[b].non_finite;
      refused_.out_of_lattice += refused[b].out_of_lattice;
      // A batch may have no point that fits.
      if (!blocks[b].empty()) ready_.push_back(std::move(blocks[b]));
    }
  }
  std::vector<std::byte> block = std::move(ready_.front());
  ready_.pop_front();
  return block;
}

}  // namespace mapsieve::client
