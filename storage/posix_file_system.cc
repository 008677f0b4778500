#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <filesystem>
#include <string_view>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/bytes.h"
#include "core/base/status.h"
#include "storage/file_system.h"

namespace mapsieve::storage {
namespace {

constexpr mode_t kFileMode = 0666;
constexpr mode_t kDirectoryMode = 0777;

absl::Status ErrnoStatus(int error, const std::string& path,
                         std::string_view what) {
  const std::string message =
      absl::StrCat(path, ": cannot ", ToAbsl(what), ": ",
                   std::generic_category().message(error));
  switch (error) {
    case ENOENT:
      return absl::NotFoundError(message);
    case EEXIST:
      return absl::AlreadyExistsError(message);
    case ENOSPC:
    case EDQUOT:
    case EFBIG:
      return absl::ResourceExhaustedError(
          absl::StrCat(message, "; free some space"));
    case EMFILE:
    case ENFILE:
      return absl::ResourceExhaustedError(
          absl::StrCat(message, "; raise the limit of open files"));
    case ENOMEM:
      return absl::ResourceExhaustedError(message);
    case EACCES:
    case EPERM:
    case EROFS:
      return absl::PermissionDeniedError(message);
    case EIO:
      return absl::UnavailableError(
          absl::StrCat(message, "; the device fails, see the system's log"));
    case EISDIR:
    case ENOTDIR:
    case ENOTEMPTY:
      return absl::FailedPreconditionError(message);
    default:
      return absl::InternalError(message);
  }
}

template <typename Call>
auto RetryInterrupted(const Call& call) {
  auto result = call();
  while (result < 0 && errno == EINTR) result = call();
  return result;
}

class Descriptor {
 public:
  explicit Descriptor(int value) : value_(value) {}
  ~Descriptor() {
    if (value_ >= 0) ::close(value_);
  }
  Descriptor(Descriptor&& other) noexcept
      : value_(std::exchange(other.value_, -1)) {}
  Descriptor& operator=(Descriptor&&) = delete;

  int get() const { return value_; }

 private:
  int value_;
};

absl::StatusOr<Descriptor> OpenDescriptor(const std::string& path, int flags) {
  const int descriptor = RetryInterrupted(
      [&] { return ::open(path.c_str(), flags | O_CLOEXEC, kFileMode); });
  if (descriptor < 0) return ErrnoStatus(errno, path, "open");
  return Descriptor(descriptor);
}

class PosixFile final : public File {
 public:
  PosixFile(std::string path, Descriptor descriptor)
      : path_(std::move(path)), descriptor_(std::move(descriptor)) {}

  absl::StatusOr<size_t> ReadAt(int64_t offset,
                                std::span<std::byte> buffer) const override {
    size_t total = 0;
    while (total < buffer.size()) {
      const ssize_t got = RetryInterrupted([&] {
        return ::pread(descriptor_.get(), buffer.data() + total,
                       buffer.size() - total,
                       offset + static_cast<int64_t>(total));
      });
      if (got < 0) {
        return ErrnoStatus(errno, path_, absl::StrCat("read at ", offset));
      }
      if (got == 0) break;
      total += static_cast<size_t>(got);
    }
    return total;
  }

  absl::Status WriteAt(int64_t offset,
                       std::span<const std::byte> bytes) override {
    while (!bytes.empty()) {
      const ssize_t done = RetryInterrupted([&] {
        return ::pwrite(descriptor_.get(), bytes.data(), bytes.size(), offset);
      });
      if (done < 0) {
        return ErrnoStatus(errno, path_, absl::StrCat("write at ", offset));
      }
      bytes = bytes.subspan(static_cast<size_t>(done));
      offset += done;
    }
    return absl::OkStatus();
  }

  absl::Status Truncate(int64_t size) override {
    if (RetryInterrupted([&] { return ::ftruncate(descriptor_.get(), size); }) <
        0) {
      return ErrnoStatus(errno, path_, absl::StrCat("cut to ", size));
    }
    return absl::OkStatus();
  }

  absl::Status Sync() override {
    if (!sync_failure_.ok()) return sync_failure_;
    if (RetryInterrupted([&] { return ::fdatasync(descriptor_.get()); }) < 0) {
      sync_failure_ = ErrnoStatus(errno, path_, "sync");
    }
    return sync_failure_;
  }

  absl::StatusOr<int64_t> Size() const override {
    struct stat info;
    if (::fstat(descriptor_.get(), &info) < 0) {
      return ErrnoStatus(errno, path_, "stat");
    }
    return info.st_size;
  }

 private:
  const std::string path_;
  const Descriptor descriptor_;
  absl::Status sync_failure_;
};

class PosixFileLock final : public FileLock {
 public:
  explicit PosixFileLock(Descriptor descriptor)
      : descriptor_(std::move(descriptor)) {}

 private:
  const Descriptor descriptor_;
};

std::string ReadOwner(int descriptor) {
  char text[32];
  const ssize_t size = ::pread(descriptor, text, sizeof text, 0);
  int64_t process = 0;
  if (size > 0 &&
      std::from_chars(text, text + size, process).ec == std::errc()) {
    return absl::StrCat("process ", process);
  }
  return "another process";
}

class Posix final : public FileSystem {
 public:
  absl::StatusOr<std::unique_ptr<File>> Open(const std::string& path,
                                             OpenMode mode) override {
    int flags = O_RDONLY;
    switch (mode) {
      case OpenMode::kRead:
        break;
      case OpenMode::kReadWrite:
        flags = O_RDWR;
        break;
      case OpenMode::kCreateNew:
        flags = O_RDWR | O_CREAT | O_EXCL;
        break;
      case OpenMode::kCreateIfAbsent:
        flags = O_RDWR | O_CREAT;
        break;
    }
    MAPSIEVE_ASSIGN_OR_RETURN(Descriptor descriptor,
                              OpenDescriptor(path, flags));
    struct stat info;
    if (::fstat(descriptor.get(), &info) < 0) {
      return ErrnoStatus(errno, path, "stat");
    }
    if (S_ISDIR(info.st_mode)) return ErrnoStatus(EISDIR, path, "open");
    return std::make_unique<PosixFile>(path, std::move(descriptor));
  }

  absl::Status Rename(const std::string& from, const std::string& to) override {
    if (::rename(from.c_str(), to.c_str()) < 0) {
      return ErrnoStatus(errno, from, absl::StrCat("rename to ", to));
    }
    return absl::OkStatus();
  }

  absl::Status Remove(const std::string& path) override {
    if (::unlink(path.c_str()) < 0) return ErrnoStatus(errno, path, "remove");
    return absl::OkStatus();
  }

  absl::Status RemoveTree(const std::string& path) override {
    std::error_code error;
    std::filesystem::remove_all(path, error);
    if (error) return ErrnoStatus(error.value(), path, "remove");
    return absl::OkStatus();
  }

  absl::Status MakeDirectories(const std::string& path) override {
    struct stat info;
    if (::stat(path.c_str(), &info) == 0) {
      if (S_ISDIR(info.st_mode)) return absl::OkStatus();
      return ErrnoStatus(ENOTDIR, path, "make directory");
    }
    if (errno != ENOENT) return ErrnoStatus(errno, path, "make directory");
    const std::filesystem::path full(path);
    // "a/b/" has an empty last part.
    const std::string directory =
        full.has_filename() ? path : full.parent_path().string();
    const std::filesystem::path above =
        std::filesystem::path(directory).parent_path();
    const std::string parent =
        above.empty() ? std::string(".") : above.string();
    MAPSIEVE_RETURN_IF_ERROR(MakeDirectories(parent));
    if (::mkdir(directory.c_str(), kDirectoryMode) < 0 && errno != EEXIST) {
      return ErrnoStatus(errno, directory, "make directory");
    }
    return SyncDirectory(parent);
  }

  absl::StatusOr<std::vector<std::string>> List(
      const std::string& directory) override {
    std::error_code error;
    std::vector<std::string> names;
    std::filesystem::directory_iterator entry(directory, error);
    while (!error && entry != std::filesystem::directory_iterator()) {
      names.push_back(entry->path().filename().string());
      entry.increment(error);
    }
    if (error) return ErrnoStatus(error.value(), directory, "list");
    std::sort(names.begin(), names.end());
    return names;
  }

  absl::Status SyncDirectory(const std::string& directory) override {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const Descriptor descriptor,
        OpenDescriptor(directory, O_RDONLY | O_DIRECTORY));
    if (RetryInterrupted([&] { return ::fsync(descriptor.get()); }) < 0) {
      return ErrnoStatus(errno, directory, "sync");
    }
    return absl::OkStatus();
  }

  absl::StatusOr<bool> Exists(const std::string& path) override {
    struct stat info;
    if (::lstat(path.c_str(), &info) == 0) return true;
    if (errno == ENOENT) return false;
    return ErrnoStatus(errno, path, "stat");
  }

  absl::StatusOr<int64_t> FileSize(const std::string& path) override {
    struct stat info;
    if (::stat(path.c_str(), &info) < 0) {
      return ErrnoStatus(errno, path, "stat");
    }
    if (S_ISDIR(info.st_mode)) return ErrnoStatus(EISDIR, path, "stat");
    return info.st_size;
  }

  absl::StatusOr<int64_t> FreeBytes(const std::string& path) override {
    struct statvfs info;
    if (RetryInterrupted([&] { return ::statvfs(path.c_str(), &info); }) < 0) {
      return ErrnoStatus(errno, path, "stat the file system");
    }
    return static_cast<int64_t>(info.f_bavail) *
           static_cast<int64_t>(info.f_frsize);
  }

  absl::StatusOr<std::unique_ptr<FileLock>> Lock(
      const std::string& path) override {
    MAPSIEVE_ASSIGN_OR_RETURN(Descriptor descriptor,
                              OpenDescriptor(path, O_RDWR | O_CREAT));
    if (RetryInterrupted(
            [&] { return ::flock(descriptor.get(), LOCK_EX | LOCK_NB); }) < 0) {
      if (errno == EWOULDBLOCK) {
        return absl::AbortedError(
            absl::StrCat(path, ": held by ", ReadOwner(descriptor.get())));
      }
      return ErrnoStatus(errno, path, "lock");
    }
    // Only the message above is poorer without it, on a full disk for example.
    const std::string owner = absl::StrCat(::getpid(), "\n");
    if (::ftruncate(descriptor.get(), 0) < 0 ||
        ::pwrite(descriptor.get(), owner.data(), owner.size(), 0) < 0) {
      errno = 0;
    }
    return std::make_unique<PosixFileLock>(std::move(descriptor));
  }
};

}  // namespace

FileSystem& PosixFileSystem() {
  static Posix file_system;
  return file_system;
}

}  // namespace mapsieve::storage
