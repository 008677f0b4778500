#ifndef MAPSIEVE_CLIENT_CLI_FILE_BLOCKS_H_
#define MAPSIEVE_CLIENT_CLI_FILE_BLOCKS_H_

#include <cstddef>
#include <deque>
#include <filesystem>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "client/api/block_source.h"
#include "client/formats/point_file.h"
#include "core/base/executor.h"
#include "core/codec/points_codec.h"
#include "core/geometry/lattice.h"

namespace mapsieve::client {

/// The blocks of a point file on a map's lattice, in file order. One batch for
/// each processor is in memory at a time, and four blocks.
class FileBlocks final : public BlockSource {
 public:
  FileBlocks(std::filesystem::path path, ReadOptions options,
             core::Lattice lattice);

  absl::Status Rewind() override;
  absl::StatusOr<std::vector<std::byte>> NextBlock() override;
  /// Of all batches read, those whose blocks are still to come included.
  core::RefusedCounts refused() const override { return refused_; }
  /// Of the open file; Rewind comes first. What a server would not take as text
  /// is left out.
  UploadSource source() const override;
  /// That of PointFileInfo.
  const std::string& crs_problem() const { return reader_->info().crs_problem; }

 private:
  const std::filesystem::path path_;
  const ReadOptions options_;
  const core::Lattice lattice_;
  /// Encodes batches.
  const std::unique_ptr<Executor> workers_;
  std::unique_ptr<PointReader> reader_;
  std::deque<std::vector<std::byte>> ready_;
  /// Of the first block, for all.
  std::optional<core::EncodePlan> plan_;
  core::RefusedCounts refused_;
};

/// The blocks of several point files, one file after the other. An error names
/// its file. Their source is what those files that tell it agree on, and the
/// finest step.
class FileListBlocks final : public BlockSource {
 public:
  FileListBlocks(std::vector<std::string> paths, ReadOptions options,
                 core::Lattice lattice);

  absl::Status Rewind() override;
  absl::StatusOr<std::vector<std::byte>> NextBlock() override;
  core::RefusedCounts refused() const override;
  UploadSource source() const override { return source_; }
  /// What the files opened so far do not agree on, in words.
  const std::set<std::string>& differences() const { return differences_; }
  /// The crs_problem of each file opened so far that has one, behind its path.
  const std::vector<std::string>& crs_problems() const { return crs_problems_; }

 private:
  absl::Status OpenNext();
  void AddSource(const UploadSource& source);

  const std::vector<std::string> paths_;
  const ReadOptions options_;
  const core::Lattice lattice_;
  /// The file of paths_[opened_count_ - 1]; none before Rewind.
  std::optional<FileBlocks> file_;
  size_t opened_count_ = 0;
  /// Of the files before it.
  core::RefusedCounts refused_before_;
  UploadSource source_;
  std::set<std::string> differences_;
  std::vector<std::string> crs_problems_;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_FILE_BLOCKS_H_
