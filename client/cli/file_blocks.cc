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

FileListBlocks::FileListBlocks(std::vector<std::string> paths,
                               ReadOptions options, core::Lattice lattice)
    : paths_(std::move(paths)),
      options_(std::move(options)),
      lattice_(lattice) {}

absl::Status FileListBlocks::Rewind() {
  file_.reset();
  opened_count_ = 0;
  refused_before_ = {};
  return absl::OkStatus();
}

absl::Status FileListBlocks::OpenNext() {
  refused_before_ = refused();
  const std::string& path = paths_[opened_count_++];
  file_.emplace(path, options_, lattice_);
  return Annotate(file_->Rewind(), path);
}

absl::StatusOr<std::vector<std::byte>> FileListBlocks::NextBlock() {
  while (true) {
    if (file_.has_value()) {
      auto block = file_->NextBlock();
      if (!block.ok()) {
        return Annotate(block.status(), paths_[opened_count_ - 1]);
      }
      if (!block->empty()) return block;
    }
    if (opened_count_ == paths_.size()) return std::vector<std::byte>();
    MAPSIEVE_RETURN_IF_ERROR(OpenNext());
  }
}

core::RefusedCounts FileListBlocks::refused() const {
  core::RefusedCounts all = refused_before_;
  if (file_.has_value()) {
    all.non_finite += file_->refused().non_finite;
    all.out_of_lattice += file_->refused().out_of_lattice;
  }
  return all;
}

}  // namespace mapsieve::client
