#include "client/cli/file_blocks.h"

#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/mutex.h"
#include "core/base/status.h"
#include "core/geometry/crs.h"

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
  plan_.reset();
  return absl::OkStatus();
}

UploadSource FileBlocks::source() const {
  // Limits of proto/mapsieve/v1/map_service.proto and upload_service.proto.
  const auto fitting = [](const std::string& text, size_t max_bytes) {
    return text.size() <= max_bytes ? text : "";
  };
  const PointFileInfo& info = reader_->info();
  return {.crs_wkt = fitting(info.crs_wkt, 64 * 1024),
          .frame_id = fitting(info.frame_id, 255),
          .unit = fitting(info.unit, 64),
          .coordinate_step = info.coordinate_step};
}

absl::StatusOr<std::vector<std::byte>> FileBlocks::NextBlock() {
  const size_t block_points = UploadBlockPoints(reader_->info().attributes);
  // Workers take turns in reading: one reads while the others encode.
  const int64_t count = 4 * int64_t{workers_->worker_count()};
  while (ready_.empty()) {
    Mutex mutex;
    size_t read_count = 0;
    bool is_over = false;
    std::vector<std::vector<std::byte>> blocks(static_cast<size_t>(count));
    std::vector<core::RefusedCounts> refused(blocks.size());
    MAPSIEVE_RETURN_IF_ERROR(
        TryParallelFor(*workers_, count, [&](int64_t) -> absl::Status {
          core::PointCloud batch;
          core::LatticeCloud cloud;
          size_t b = 0;
          {
            MutexLock lock(mutex);
            if (is_over) return absl::OkStatus();
            is_over = true;
            MAPSIEVE_ASSIGN_OR_RETURN(batch, reader_->ReadBatch(block_points));
            if (batch.size() == 0) return absl::OkStatus();
            is_over = false;
            b = read_count++;
            // The first block makes the plan, however many workers there are.
            if (!plan_.has_value()) {
              cloud = core::Quantize(std::move(batch), lattice_, refused[b]);
              batch = {};
              if (cloud.size() > 0) plan_ = core::PlanEncoding(cloud);
            }
          }
          if (batch.size() > 0) {
            cloud = core::Quantize(std::move(batch), lattice_, refused[b]);
          }
          if (cloud.size() == 0) return absl::OkStatus();
          MAPSIEVE_ASSIGN_OR_RETURN(
              blocks[b], core::EncodePoints(cloud, {.plan = &*plan_}));
          return absl::OkStatus();
        }));
    if (read_count == 0) return std::vector<std::byte>();
    for (size_t b = 0; b < read_count; ++b) {
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

FileListBlocks::FileListBlocks(std::vector<std::string> paths,
                               ReadOptions options, core::Lattice lattice)
    : paths_(std::move(paths)),
      options_(std::move(options)),
      lattice_(lattice) {}

absl::Status FileListBlocks::Rewind() {
  file_.reset();
  opened_count_ = 0;
  refused_before_ = {};
  source_ = {};
  differences_.clear();
  crs_problems_.clear();
  return absl::OkStatus();
}

absl::Status FileListBlocks::OpenNext() {
  refused_before_ = refused();
  const std::string& path = paths_[opened_count_++];
  file_.emplace(path, options_, lattice_);
  MAPSIEVE_RETURN_IF_ERROR(Annotate(file_->Rewind(), path));
  AddSource(file_->source());
  if (const std::string& problem = file_->crs_problem(); !problem.empty()) {
    crs_problems_.push_back(absl::StrCat(path, ": ", problem));
  }
  return absl::OkStatus();
}

void FileListBlocks::AddSource(const UploadSource& source) {
  const auto add = [this](const char* what, bool is_same,
                          const std::string& from, std::string& to) {
    if (from.empty() || differences_.contains(what)) return;
    if (to.empty()) {
      to = from;
    } else if (!is_same) {
      to.clear();
      differences_.insert(what);
    }
  };
  add("CRS", core::IsSameCrs(source.crs_wkt, source_.crs_wkt), source.crs_wkt,
      source_.crs_wkt);
  add("frame", source.frame_id == source_.frame_id, source.frame_id,
      source_.frame_id);
  add("unit", source.unit == source_.unit, source.unit, source_.unit);
  const double step = source.coordinate_step;
  if (step > 0 &&
      (source_.coordinate_step == 0 || step < source_.coordinate_step)) {
    source_.coordinate_step = step;
  }
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
