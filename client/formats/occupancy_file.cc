#include "client/formats/occupancy_file.h"

#include <octomap/OcTree.h>

#include <cmath>
#include <sstream>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/formats/output_file.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

class OccupancyWriter final : public PointWriter {
 public:
  OccupancyWriter(std::unique_ptr<OutputFile> file, bool is_binary,
                  const OccupancyOptions& options)
      : file_(std::move(file)),
        is_binary_(is_binary),
        options_(options),
        tree_(options.voxel_edge) {}

  absl::Status Write(const core::PointCloud& batch) override {
    // The bound of the log-odds: a voxel does not depend on how many points it
    // holds, so that full ones of equal depth can be one.
    const float occupied = tree_.getClampingThresMaxLog();
    octomap::OcTreeKey key;
    for (const core::Point3& p : batch.positions) {
      if (!tree_.coordToKeyChecked(p.x - options_.origin.x,
                                   p.y - options_.origin.y,
                                   p.z - options_.origin.z, key)) {
        return absl::InvalidArgumentError(absl::StrCat(
            file_->name(), ": the point (", p.x, ", ", p.y, ", ", p.z,
            ") is more than 2^15 voxels of ", options_.voxel_edge,
            " from the origin (", options_.origin.x, ", ", options_.origin.y,
            ", ", options_.origin.z,
            "); move the origin, or take larger voxels or a smaller region"));
      }
      tree_.setNodeValue(key, occupied, /*lazy_eval=*/true);
    }
    return absl::OkStatus();
  }

  absl::Status Finish() override {
    tree_.updateInnerOccupancy();
    tree_.prune();
    // What writes the heads in OctoMap talks on stderr.
    std::ostringstream bytes;
    bytes << (is_binary_ ? "# Octomap OcTree binary file\n"
                         : "# Octomap OcTree file\n")
          << "id " << tree_.getTreeType() << "\nsize " << tree_.size()
          << "\nres " << tree_.getResolution() << "\ndata\n";
    if (!(is_binary_ ? tree_.writeBinaryData(bytes) : tree_.writeData(bytes))) {
      return absl::InternalError(
          absl::StrCat(file_->name(), ": OctoMap cannot write the tree"));
    }
    MAPSIEVE_RETURN_IF_ERROR(file_->Append(bytes.view()));
    return file_->Finish();
  }

 private:
  const std::unique_ptr<OutputFile> file_;
  const bool is_binary_;
  const OccupancyOptions options_;
  octomap::OcTree tree_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<PointWriter>> CreateOccupancyFile(
    const std::filesystem::path& path, const OccupancyOptions& options) {
  const std::string extension = path.extension().string();
  if (extension != ".bt" && extension != ".ot") {
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(),
                     ": the extension names no kind of OctoMap file; use .bt, "
                     "or .ot for one with log-odds"));
  }
  if (!std::isfinite(options.voxel_edge) || options.voxel_edge <= 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "voxel_edge is ", options.voxel_edge, "; it must be above 0"));
  }
  const core::Point3& o = options.origin;
  if (!std::isfinite(o.x) || !std::isfinite(o.y) || !std::isfinite(o.z)) {
    return absl::InvalidArgumentError("origin must be finite");
  }
  MAPSIEVE_ASSIGN_OR_RETURN(auto file, OutputFile::Create(path));
  return std::make_unique<OccupancyWriter>(std::move(file), extension == ".bt",
                                           options);
}

}  // namespace mapsieve::client
