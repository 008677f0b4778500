#include "storage/sqlite_vfs.h"

#include <sqlite3.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <new>
#include <span>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "storage/sqlite_format.h"

namespace mapsieve::storage {
namespace {

constexpr int kMaxPathBytes = 4096;
constexpr int kSectorBytes = 4096;

std::string DirectoryOf(const std::string& path) {
  const auto parent = std::filesystem::path(path).parent_path();
  return parent.empty() ? "." : parent.string();
}

// Only these and `io_error` make the pager give up a transaction.
int CodeOf(const absl::Status& status, int io_error) {
  if (status.ok()) return SQLITE_OK;
  if (absl::IsDataLoss(status)) return SQLITE_IOERR_DATA;
  return absl::IsResourceExhausted(status) ? SQLITE_FULL : io_error;
}

OpenMode ModeOf(int flags) {
  if ((flags & SQLITE_OPEN_READONLY) != 0) return OpenMode::kRead;
  if ((flags & SQLITE_OPEN_CREATE) == 0) return OpenMode::kReadWrite;
  return (flags & SQLITE_OPEN_EXCLUSIVE) != 0 ? OpenMode::kCreateNew
                                              : OpenMode::kCreateIfAbsent;
}

}  // namespace

class SqliteVfs::Impl {
 public:
  explicit Impl(FileSystem& file_system);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  const char* name() const { return is_registered_ ? name_.c_str() : nullptr; }
  const absl::Status& last_failure() const { return failure_; }
  bool has_page_checksums() const { return has_page_checksums_; }

 private:
  // A file of the FileSystem. SQLite allots its memory, and behind it that of
  // a file of its own implementation.
  struct OpenFile {
    sqlite3_file base;
    Impl* vfs;
    std::string path;
    std::unique_ptr<File> file;
    // The own file of the database holds its locks and its shared memory.
    sqlite3_file* own;
    bool is_log;
    bool name_may_be_new;
    bool is_stale;
    // Its pages have checksums: it is a database that has them, or the log of
    // one.
    bool is_sealed;
    // Of a log: the header that was written last, of the frame whose page
    // comes next.
    int64_t frame_at;
    std::array<std::byte, kFrameHeaderBytes> frame_header;
  };

  static Impl& Of(sqlite3_vfs* vfs) {
    return *static_cast<Impl*>(vfs->pAppData);
  }
  static OpenFile& Of(sqlite3_file* file) {
    return *reinterpret_cast<OpenFile*>(file);
  }

  // The code of `status`, which is kept if it is an error.
  int Keep(const absl::Status& status, int io_error) {
    if (!status.ok()) failure_ = status;
    return CodeOf(status, io_error);
  }
  // The code of SQLite's own implementation.
  int KeepOwn(int code) {
    if (code != SQLITE_OK) failure_ = absl::OkStatus();
    return code;
  }

  int Open(const char* path, sqlite3_file* memory, int flags, int* out_flags);
  absl::Status Refresh(OpenFile& file);
  absl::StatusOr<bool> IsSealed(const char* path, OpenFile& file, int flags);
  absl::StatusOr<size_t> ReadChecked(const OpenFile& file, int64_t offset,
                                     std::span<std::byte> buffer);
  absl::Status Write(OpenFile& file, int64_t offset,
                     std::span<const std::byte> bytes);
  absl::Status WriteSealed(OpenFile& file, int64_t offset,
                           std::span<const std::byte> page);
  absl::Status Truncate(OpenFile& file, int64_t size);
  absl::Status Sync(OpenFile& file);
  absl::Status Delete(const std::string& path, bool sync_directory);

  // Methods of files.
  static int Close(sqlite3_file* file);
  static int Read(sqlite3_file* file, void* data, int size,
                  sqlite3_int64 offset);
  static int FileSize(sqlite3_file* file, sqlite3_int64* size);
  static int FileControl(sqlite3_file* file, int operation, void* argument);
  static const sqlite3_io_methods kMethods;

  FileSystem& file_system_;
  sqlite3_vfs* const own_;
  const std::string name_;
  sqlite3_vfs vfs_ = {};
  bool is_registered_ = false;
  absl::Status failure_;
  bool has_database_ = false;
  // Of the database opened first.
  bool has_page_checksums_ = false;
};

SqliteVfs::Impl::Impl(FileSystem& file_system)
    : file_system_(file_system),
      own_(sqlite3_vfs_find(nullptr)),
      name_(absl::StrCat("mapsieve-", reinterpret_cast<uintptr_t>(this))) {
  if (own_ == nullptr) return;
  vfs_.iVersion = 2;
  vfs_.szOsFile = static_cast<int>(sizeof(OpenFile)) + own_->szOsFile;
  vfs_.mxPathname = kMaxPathBytes;
  vfs_.zName = name_.c_str();
  vfs_.pAppData = this;
  vfs_.xOpen = [](sqlite3_vfs* vfs, const char* path, sqlite3_file* file,
                  int flags, int* out_flags) {
    return Of(vfs).Open(path, file, flags, out_flags);
  };
  vfs_.xDelete = [](sqlite3_vfs* vfs, const char* path, int sync_directory) {
    const absl::Status status = Of(vfs).Delete(path, sync_directory != 0);
    if (absl::IsNotFound(status)) return SQLITE_IOERR_DELETE_NOENT;
    return Of(vfs).Keep(status, SQLITE_IOERR_DELETE);
  };
  // Whether there is anything in it.
  vfs_.xAccess = [](sqlite3_vfs* vfs, const char* path, int, int* result) {
    const auto size = Of(vfs).file_system_.FileSize(path);
    *result = size.ok() && *size > 0 ? 1 : 0;
    if (size.ok() || absl::IsNotFound(size.status())) return SQLITE_OK;
    return Of(vfs).Keep(size.status(), SQLITE_IOERR_ACCESS);
  };
  vfs_.xFullPathname = [](sqlite3_vfs*, const char* path, int size, char* out) {
    const size_t length = std::strlen(path);
    if (length >= static_cast<size_t>(size)) return SQLITE_CANTOPEN_FULLPATH;
    std::copy_n(path, length + 1, out);
    return SQLITE_OK;
  };
  vfs_.xRandomness = [](sqlite3_vfs* vfs, int size, char* out) {
    return Of(vfs).own_->xRandomness(Of(vfs).own_, size, out);
  };
  vfs_.xSleep = [](sqlite3_vfs* vfs, int micros) {
    return Of(vfs).own_->xSleep(Of(vfs).own_, micros);
  };
  vfs_.xCurrentTime = [](sqlite3_vfs* vfs, double* now) {
    return Of(vfs).own_->xCurrentTime(Of(vfs).own_, now);
  };
  vfs_.xCurrentTimeInt64 = [](sqlite3_vfs* vfs, sqlite3_int64* now) {
    return Of(vfs).own_->xCurrentTimeInt64(Of(vfs).own_, now);
  };
  vfs_.xGetLastError = [](sqlite3_vfs* vfs, int size, char* out) {
    return Of(vfs).own_->xGetLastError(Of(vfs).own_, size, out);
  };
  is_registered_ = sqlite3_vfs_register(&vfs_, /*makeDflt=*/0) == SQLITE_OK;
}

SqliteVfs::Impl::~Impl() {
  if (is_registered_) sqlite3_vfs_unregister(&vfs_);
}

int SqliteVfs::Impl::Open(const char* path, sqlite3_file* memory, int flags,
                          int* out_flags) {
  memory->pMethods = nullptr;
  if (path == nullptr) {
    return KeepOwn(own_->xOpen(own_, path, memory, flags, out_flags));
  }
  auto* file = new (memory) OpenFile{};
  file->vfs = this;
  file->path = path;
  file->is_log = (flags & SQLITE_OPEN_WAL) != 0;
  file->name_may_be_new = (flags & SQLITE_OPEN_CREATE) != 0;
  auto opened = file_system_.Open(file->path, ModeOf(flags));
  int code = Keep(opened.status(), SQLITE_CANTOPEN);
  if (code == SQLITE_OK) {
    file->file = *std::move(opened);
    const auto is_sealed = IsSealed(path, *file, flags);
    code = Keep(is_sealed.status(), SQLITE_IOERR_READ);
    file->is_sealed = is_sealed.value_or(false);
  }
  if (code == SQLITE_OK && (flags & SQLITE_OPEN_MAIN_DB) != 0) {
    file->own = reinterpret_cast<sqlite3_file*>(file + 1);
    // It needs the very pointer: behind the name are parameters.
    code = KeepOwn(own_->xOpen(
        own_, path, file->own,
        flags & ~(SQLITE_OPEN_CREATE | SQLITE_OPEN_EXCLUSIVE), nullptr));
    if (!std::exchange(has_database_, true)) {
      has_page_checksums_ = file->is_sealed;
    }
  }
  if (code != SQLITE_OK) {
    file->~OpenFile();
    memory->pMethods = nullptr;
    return code;
  }
  file->base.pMethods = &kMethods;
  if (out_flags != nullptr) *out_flags = flags;
  return SQLITE_OK;
}

absl::StatusOr<bool> SqliteVfs::Impl::IsSealed(const char* path, OpenFile& file,
                                               int flags) {
  if (file.is_log) return Of(sqlite3_database_file_object(path)).is_sealed;
  if ((flags & SQLITE_OPEN_MAIN_DB) == 0) return false;
  return HasPageChecksums(*file.file);
}

absl::StatusOr<size_t> SqliteVfs::Impl::ReadChecked(
    const OpenFile& file, int64_t offset, std::span<std::byte> buffer) {
  const auto located = [&](const absl::Status& status) {
    return Annotate(status, absl::StrCat(file.path, ", offset ", offset));
  };
  const bool is_page = buffer.size() == kPageBytes;
  if (!file.is_sealed || (file.is_log && !is_page)) {
    return file.file->ReadAt(offset, buffer);
  }
  if (file.is_log) {
    std::array<std::byte, kFrameBytes> frame;
    MAPSIEVE_ASSIGN_OR_RETURN(
        const size_t got, file.file->ReadAt(offset - kFrameHeaderBytes, frame));
    if (got != frame.size()) {
      return located(absl::DataLossError(absl::StrCat(
          "the log ends in the middle of a frame, after ", got, " bytes")));
    }
    const std::span page = std::span(frame).subspan(kFrameHeaderBytes);
    MAPSIEVE_RETURN_IF_ERROR(located(CheckPage(PageNumberOf(frame), page)));
    std::copy(page.begin(), page.end(), buffer.begin());
    return buffer.size();
  }
  const auto size = static_cast<int64_t>(buffer.size());
  MAPSIEVE_ASSIGN_OR_RETURN(const size_t got,
                            file.file->ReadAt(offset, buffer));
  // Before SQLite knows the size of a page.
  if (offset + size <= kDatabaseHeaderBytes) return got;
  if (!is_page || offset % kPageBytes != 0) {
    return located(absl::DataLossError(
        absl::StrCat("damaged header: expected pages of ", kPageBytes,
                     " bytes, it says ", size)));
  }
  if (got != buffer.size()) {
    return located(absl::DataLossError(absl::StrCat(
        "expected a page of ", size, " bytes, the file holds ", got)));
  }
  MAPSIEVE_RETURN_IF_ERROR(located(CheckPage(offset / kPageBytes + 1, buffer)));
  return got;
}

absl::Status SqliteVfs::Impl::Refresh(OpenFile& file) {
  if (!file.is_stale) return absl::OkStatus();
  MAPSIEVE_ASSIGN_OR_RETURN(file.file,
                            file_system_.Open(file.path, OpenMode::kReadWrite));
  file.is_stale = false;
  return absl::OkStatus();
}

absl::Status SqliteVfs::Impl::Write(OpenFile& file, int64_t offset,
                                    std::span<const std::byte> bytes) {
  MAPSIEVE_RETURN_IF_ERROR(Refresh(file));
  if (file.is_sealed && bytes.size() == kPageBytes) {
    return WriteSealed(file, offset, bytes);
  }
  if (file.is_log && bytes.size() == kFrameHeaderBytes) {
    file.frame_at = offset;
    std::copy(bytes.begin(), bytes.end(), file.frame_header.begin());
  }
  return file.file->WriteAt(offset, bytes);
}

absl::Status SqliteVfs::Impl::WriteSealed(OpenFile& file, int64_t offset,
                                          std::span<const std::byte> bytes) {
  std::array<std::byte, kFrameBytes> frame;
  const std::span page = std::span(frame).subspan(kFrameHeaderBytes);
  std::copy(bytes.begin(), bytes.end(), page.begin());
  if (!file.is_log) {
    SealPage(offset / kPageBytes + 1, page);
    return file.file->WriteAt(offset, page);
  }
  // SQLite has summed up the page as it was before it was sealed, so the sums
  // are ours as well. A page that a transaction writes anew into its frame
  // comes without a header; SQLite makes those from the file when it commits.
  const int64_t frame_at = offset - kFrameHeaderBytes;
  const bool is_rewrite = frame_at != std::exchange(file.frame_at, 0);
  if (is_rewrite) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const auto header,
        ReadExactly(*file.file, file.path, frame_at, kFrameHeaderBytes));
    SealPage(PageNumberOf(header), page);
    return file.file->WriteAt(offset, page);
  }
  std::copy(file.frame_header.begin(), file.frame_header.end(), frame.begin());
  SealPage(PageNumberOf(frame), page);
  MAPSIEVE_RETURN_IF_ERROR(SealFrame(*file.file, file.path, frame_at, frame));
  return file.file->WriteAt(frame_at, frame);
}

absl::Status SqliteVfs::Impl::Truncate(OpenFile& file, int64_t size) {
  MAPSIEVE_RETURN_IF_ERROR(Refresh(file));
  return file.file->Truncate(size);
}

absl::Status SqliteVfs::Impl::Sync(OpenFile& file) {
  const absl::Status status = file.file->Sync();
  if (!status.ok()) {
    file.is_stale = file.is_log;
    return status;
  }
  if (!file.name_may_be_new) return absl::OkStatus();
  MAPSIEVE_RETURN_IF_ERROR(file_system_.SyncDirectory(DirectoryOf(file.path)));
  file.name_may_be_new = false;
  return absl::OkStatus();
}

absl::Status SqliteVfs::Impl::Delete(const std::string& path,
                                     bool sync_directory) {
  MAPSIEVE_RETURN_IF_ERROR(file_system_.Remove(path));
  if (!sync_directory) return absl::OkStatus();
  return file_system_.SyncDirectory(DirectoryOf(path));
}

int SqliteVfs::Impl::Close(sqlite3_file* memory) {
  OpenFile& file = Of(memory);
  int code = SQLITE_OK;
  if (file.own != nullptr && file.own->pMethods != nullptr) {
    code = file.vfs->KeepOwn(file.own->pMethods->xClose(file.own));
  }
  file.~OpenFile();
  return code;
}

int SqliteVfs::Impl::Read(sqlite3_file* memory, void* data, int size,
                          sqlite3_int64 offset) {
  OpenFile& file = Of(memory);
  const std::span buffer(static_cast<std::byte*>(data),
                         static_cast<size_t>(size));
  const auto got = file.vfs->ReadChecked(file, offset, buffer);
  if (!got.ok()) return file.vfs->Keep(got.status(), SQLITE_IOERR_READ);
  if (*got == buffer.size()) return SQLITE_OK;
  std::fill(buffer.begin() + static_cast<ptrdiff_t>(*got), buffer.end(),
            std::byte{0});
  return SQLITE_IOERR_SHORT_READ;
}

int SqliteVfs::Impl::FileSize(sqlite3_file* memory, sqlite3_int64* size) {
  OpenFile& file = Of(memory);
  const auto actual = file.file->Size();
  if (actual.ok()) *size = *actual;
  return file.vfs->Keep(actual.status(), SQLITE_IOERR_FSTAT);
}

int SqliteVfs::Impl::FileControl(sqlite3_file* memory, int operation,
                                 void* argument) {
  OpenFile& file = Of(memory);
  // Whether the database is still what its name stands for.
  if (operation != SQLITE_FCNTL_HAS_MOVED || file.own == nullptr) {
    return SQLITE_NOTFOUND;
  }
  return file.own->pMethods->xFileControl(file.own, operation, argument);
}

const sqlite3_io_methods SqliteVfs::Impl::kMethods = {
    .iVersion = 2,
    .xClose = Close,
    .xRead = Read,
    .xWrite =
        [](sqlite3_file* memory, const void* data, int size,
           sqlite3_int64 offset) {
          OpenFile& file = Of(memory);
          const std::span bytes(static_cast<const std::byte*>(data),
                                static_cast<size_t>(size));
          return file.vfs->Keep(file.vfs->Write(file, offset, bytes),
                                SQLITE_IOERR_WRITE);
        },
    .xTruncate =
        [](sqlite3_file* memory, sqlite3_int64 size) {
          OpenFile& file = Of(memory);
          return file.vfs->Keep(file.vfs->Truncate(file, size),
                                SQLITE_IOERR_TRUNCATE);
        },
    .xSync =
        [](sqlite3_file* memory, int) {
          OpenFile& file = Of(memory);
          return file.vfs->Keep(file.vfs->Sync(file), SQLITE_IOERR_FSYNC);
        },
    .xFileSize = FileSize,
    // Only the database is locked.
    .xLock =
        [](sqlite3_file* memory, int level) {
          OpenFile& file = Of(memory);
          return file.vfs->KeepOwn(file.own->pMethods->xLock(file.own, level));
        },
    .xUnlock =
        [](sqlite3_file* memory, int level) {
          OpenFile& file = Of(memory);
          return file.vfs->KeepOwn(
              file.own->pMethods->xUnlock(file.own, level));
        },
    .xCheckReservedLock =
        [](sqlite3_file* memory, int* result) {
          OpenFile& file = Of(memory);
          return file.vfs->KeepOwn(
              file.own->pMethods->xCheckReservedLock(file.own, result));
        },
    .xFileControl = FileControl,
    .xSectorSize = [](sqlite3_file*) { return kSectorBytes; },
    // A write that is cut short by a power failure leaves what was synced
    // before as it was; nothing else is sure.
    .xDeviceCharacteristics =
        [](sqlite3_file*) { return SQLITE_IOCAP_POWERSAFE_OVERWRITE; },
    .xShmMap =
        [](sqlite3_file* memory, int region, int size, int extend,
           void volatile** out) {
          OpenFile& file = Of(memory);
          return file.vfs->KeepOwn(
              file.own->pMethods->xShmMap(file.own, region, size, extend, out));
        },
    .xShmLock =
        [](sqlite3_file* memory, int offset, int count, int flags) {
          OpenFile& file = Of(memory);
          return file.vfs->KeepOwn(
              file.own->pMethods->xShmLock(file.own, offset, count, flags));
        },
    .xShmBarrier =
        [](sqlite3_file* memory) {
          OpenFile& file = Of(memory);
          file.own->pMethods->xShmBarrier(file.own);
        },
    .xShmUnmap =
        [](sqlite3_file* memory, int remove) {
          OpenFile& file = Of(memory);
          return file.vfs->KeepOwn(
              file.own->pMethods->xShmUnmap(file.own, remove));
        },
    .xFetch = nullptr,
    .xUnfetch = nullptr};

SqliteVfs::SqliteVfs(FileSystem& file_system)
    : impl_(std::make_unique<Impl>(file_system)) {}

SqliteVfs::~SqliteVfs() = default;

const char* SqliteVfs::name() const { return impl_->name(); }

const absl::Status& SqliteVfs::last_failure() const {
  return impl_->last_failure();
}

bool SqliteVfs::has_page_checksums() const {
  return impl_->has_page_checksums();
}

}  // namespace mapsieve::storage
