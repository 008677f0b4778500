#ifndef MAPSIEVE_CLIENT_CLI_SYNC_FOLDER_H_
#define MAPSIEVE_CLIENT_CLI_SYNC_FOLDER_H_

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/api/map_types.h"

namespace mapsieve::client {

/// A chunk of a map in a folder.
struct HeldChunk {
  std::string id;
  /// Smallest corner of its tile.
  core::Point3 corner;
  /// Name of its PCD file; empty: it has no points.
  std::string file;
  int64_t point_count = 0;
};

/// What a folder holds of a map.
struct SyncWindow {
  /// What its chunks are: of windows with other words nothing is of use. JSON.
  std::string source;
  int64_t revision = 0;
  double tile_edge = 0;
  std::vector<HeldChunk> chunks;
};

/// A folder that holds part of a map, one window after the other. Readers see
/// one window whole, whatever happens: `current` is a link to the folder of the
/// newest one, with a PCD file a chunk, pointcloud_map_metadata.yaml, which
/// says where they are as Autoware's map loader reads it, and window.json. The
/// window before stays for readers who are still in it. Files that do not
/// change are the same ones. Not thread-safe.
class SyncFolder {
 public:
  /// Opens the folder, which is made if absent, and removes what a break left
  /// in it. kAborted: another process has it; kFailedPrecondition: it holds
  /// other things.
  static absl::StatusOr<std::unique_ptr<SyncFolder>> Open(
      const std::filesystem::path& path);
  ~SyncFolder();
  SyncFolder(const SyncFolder&) = delete;
  SyncFolder& operator=(const SyncFolder&) = delete;

  /// The newest window, without chunks whose files are gone; without any if
  /// there is none, or if its description is damaged.
  const SyncWindow& current() const { return current_; }

  /// Makes a folder for the files of the next window and returns it.
  absl::StatusOr<std::filesystem::path> BeginWindow();
  /// Takes the file of a chunk of the current window into the next one.
  absl::Status Keep(const HeldChunk& chunk);
  /// Completes the next window, all of whose files are there, and makes it the
  /// current one.
  absl::Status Finish(const SyncWindow& window);

 private:
  SyncFolder(std::filesystem::path path, int lock);
  std::filesystem::path WindowPath(int64_t number) const;
  /// Reads `current`, and removes all windows but it and the one before.
  absl::Status ReadCurrent();
  absl::Status RemoveOtherWindows() const;

  const std::filesystem::path path_;
  const int lock_;
  /// 0: none.
  int64_t number_ = 0;
  SyncWindow current_;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_SYNC_FOLDER_H_
