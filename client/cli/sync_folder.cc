#include "client/cli/sync_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <fstream>
#include <string_view>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/output.h"
#include "client/formats/output_file.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kCurrent = "current";
constexpr std::string_view kLock = "lock";
constexpr std::string_view kWindowPrefix = "window-";
constexpr std::string_view kMetadata = "pointcloud_map_metadata.yaml";
constexpr std::string_view kDescription = "window.json";

absl::Status Failed(const fs::path& path, std::string_view what,
                    const std::error_code& error) {
  return absl::ErrnoToStatus(
      error.value(), absl::StrCat(path.string(), ": cannot ", ToAbsl(what)));
}

/// The number of a window's folder; 0: it is none.
int64_t NumberOf(const fs::path& path) {
  const std::string name = path.filename().string();
  if (!name.starts_with(kWindowPrefix)) return 0;
  int64_t number = 0;
  const char* begin = name.data() + kWindowPrefix.size();
  const char* end = name.data() + name.size();
  const auto result = std::from_chars(begin, end, number);
  return result.ec == std::errc() && result.ptr == end && number > 0 ? number
                                                                     : 0;
}

absl::Status SyncDirectory(const fs::path& path) {
  const int descriptor = open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  const bool synced = descriptor >= 0 && fsync(descriptor) == 0;
  const std::error_code error(errno, std::generic_category());
  if (descriptor >= 0) close(descriptor);
  if (!synced) return Failed(path, "be synced", error);
  return absl::OkStatus();
}

absl::Status WriteText(const fs::path& path, std::string_view text) {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto file, OutputFile::Create(path));
  MAPSIEVE_RETURN_IF_ERROR(file->Append(text));
  return file->Finish();
}

/// The loader takes whole corners alone: they are rounded down, and cells are
/// as much wider as their tiles need.
std::string MetadataOf(const SyncWindow& window) {
  std::string corners;
  double most_off_x = 0;
  double most_off_y = 0;
  for (const HeldChunk& chunk : window.chunks) {
    if (chunk.file.empty()) continue;
    const double x = std::floor(chunk.corner.x);
    const double y = std::floor(chunk.corner.y);
    most_off_x = std::max(most_off_x, chunk.corner.x - x);
    most_off_y = std::max(most_off_y, chunk.corner.y - y);
    absl::StrAppendFormat(&corners, "%s: [%.0f, %.0f]\n", chunk.file, x, y);
  }
  return absl::StrFormat("x_resolution: %.9g\ny_resolution: %.9g\n%s",
                         window.tile_edge + most_off_x,
                         window.tile_edge + most_off_y, corners);
}

std::string DescriptionOf(const SyncWindow& window) {
  Json chunks = Json::array();
  for (const HeldChunk& chunk : window.chunks) {
    chunks.push_back(
        {{"id", chunk.id},
         {"corner", {chunk.corner.x, chunk.corner.y, chunk.corner.z}},
         {"file", chunk.file},
         {"point_count", chunk.point_count}});
  }
  return Json{{"source", Json::parse(window.source)},
              {"revision", window.revision},
              {"tile_edge", window.tile_edge},
              {"chunks", std::move(chunks)}}
      .dump(1);
}

/// Nothing: it is no description.
std::optional<SyncWindow> ReadDescription(const fs::path& path) {
  std::ifstream file(path);
  const Json json = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  try {
    SyncWindow window{.source = json.at("source").dump(),
                      .revision = json.at("revision"),
                      .tile_edge = json.at("tile_edge")};
    for (const Json& chunk : json.at("chunks")) {
      const Json& corner = chunk.at("corner");
      window.chunks.push_back(
          {.id = chunk.at("id"),
           .corner = {corner.at(0), corner.at(1), corner.at(2)},
           .file = chunk.at("file"),
           .point_count = chunk.at("point_count")});
    }
    return window;
  } catch (const Json::exception&) {
    return std::nullopt;
  }
}

}  // namespace

absl::StatusOr<std::unique_ptr<SyncFolder>> SyncFolder::Open(
    const fs::path& path) {
  std::error_code error;
  const bool is_new = fs::create_directories(path, error);
  if (error) return Failed(path, "be made", error);
  if (!is_new && !fs::exists(path / kLock) && !fs::is_empty(path, error)) {
    return absl::FailedPreconditionError(absl::StrCat(
        path.string(),
        ": holds other things than windows of a map; give a new folder"));
  }
  const fs::path lock_path = path / kLock;
  const int lock = open(lock_path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (lock < 0) {
    return Failed(lock_path, "be opened",
                  std::error_code(errno, std::generic_category()));
  }
  auto folder = std::unique_ptr<SyncFolder>(new SyncFolder(path, lock));
  if (flock(lock, LOCK_EX | LOCK_NB) != 0) {
    return absl::AbortedError(
        absl::StrCat(path.string(), ": another sync is using this folder"));
  }
  MAPSIEVE_RETURN_IF_ERROR(folder->ReadCurrent());
  return folder;
}

SyncFolder::SyncFolder(fs::path path, int lock)
    : path_(std::move(path)), lock_(lock) {}

SyncFolder::~SyncFolder() { close(lock_); }

fs::path SyncFolder::WindowPath(int64_t number) const {
  return path_ / absl::StrCat(ToAbsl(kWindowPrefix), number);
}

absl::Status SyncFolder::ReadCurrent() {
  std::error_code error;
  const fs::path target = fs::read_symlink(path_ / kCurrent, error);
  if (!error) {
    number_ = NumberOf(target);
    auto window = ReadDescription(path_ / target / kDescription);
    if (window.has_value()) current_ = *std::move(window);
    // What was taken away is asked for again.
    std::erase_if(current_.chunks, [&](const HeldChunk& chunk) {
      return !chunk.file.empty() &&
             !fs::is_regular_file(path_ / target / chunk.file);
    });
  }
  return RemoveOtherWindows();
}

absl::Status SyncFolder::RemoveOtherWindows() const {
  std::error_code error;
  std::vector<fs::path> others;
  for (auto entry = fs::directory_iterator(path_, error);
       !error && entry != fs::directory_iterator(); entry.increment(error)) {
    const int64_t number = NumberOf(entry->path());
    if (number > 0 && number != number_ && number != number_ - 1) {
      others.push_back(entry->path());
    }
  }
  for (const fs::path& other : others) {
    if (!error) fs::remove_all(other, error);
  }
  if (error) return Failed(path_, "be tidied", error);
  return absl::OkStatus();
}

absl::StatusOr<fs::path> SyncFolder::BeginWindow() {
  const fs::path path = WindowPath(number_ + 1);
  std::error_code error;
  fs::create_directory(path, error);
  if (error) return Failed(path, "be made", error);
  return path;
}

absl::Status SyncFolder::Keep(const HeldChunk& chunk) {
  if (chunk.file.empty()) return absl::OkStatus();
  const fs::path from = WindowPath(number_) / chunk.file;
  const fs::path to = WindowPath(number_ + 1) / chunk.file;
  std::error_code error;
  fs::create_hard_link(from, to, error);
  // Not all file systems have links.
  if (error) fs::copy_file(from, to, error);
  if (error) return Failed(from, "be kept", error);
  return absl::OkStatus();
}

absl::Status SyncFolder::Finish(const SyncWindow& window) {
  const fs::path path = WindowPath(number_ + 1);
  MAPSIEVE_RETURN_IF_ERROR(WriteText(path / kMetadata, MetadataOf(window)));
  MAPSIEVE_RETURN_IF_ERROR(
      WriteText(path / kDescription, DescriptionOf(window)));
  MAPSIEVE_RETURN_IF_ERROR(SyncDirectory(path));
  const fs::path link = path_ / absl::StrCat(ToAbsl(kCurrent), ".new");
  std::error_code error;
  fs::remove(link, error);
  fs::create_directory_symlink(path.filename(), link, error);
  if (!error) fs::rename(link, path_ / kCurrent, error);
  if (error) return Failed(link, "become the current window", error);
  MAPSIEVE_RETURN_IF_ERROR(SyncDirectory(path_));
  ++number_;
  current_ = window;
  return RemoveOtherWindows();
}

}  // namespace mapsieve::client
