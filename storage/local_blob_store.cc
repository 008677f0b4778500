#include "storage/local_blob_store.h"

#include <atomic>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/hash.h"
#include "core/base/mutex.h"
#include "core/base/status.h"
#include "storage/names.h"

namespace mapsieve::storage {
namespace {

constexpr char kTemporaryFolder[] = "tmp";
// Blobs lie in folders named by so many digits of their ids.
constexpr size_t kFolderDigits = 2;

std::string FolderName(const BlobId& id) { return id.substr(0, kFolderDigits); }

absl::Status CheckId(const BlobId& id) {
  if (IsHexId(id)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("blob id ", Quoted(id), ": expected 32 hexadecimal digits"));
}

class LocalBlobStore final : public BlobStore {
 public:
  LocalBlobStore(FileSystem& file_system, std::string directory,
                 const SpaceReserve& reserve)
      : file_system_(file_system),
        directory_(std::move(directory)),
        reserve_(reserve) {}

  absl::Status Prepare() {
    const std::string temporary = JoinPath(directory_, kTemporaryFolder);
    MAPSIEVE_RETURN_IF_ERROR(file_system_.MakeDirectories(temporary));
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::string> leftovers,
                              file_system_.List(temporary));
    for (const std::string& name : leftovers) {
      MAPSIEVE_RETURN_IF_ERROR(file_system_.Remove(JoinPath(temporary, name)));
    }
    // A process that died may have made folders and not come to this.
    return file_system_.SyncDirectory(directory_);
  }

  absl::StatusOr<BlobId> PutIfAbsent(
      std::span<const std::byte> bytes) override {
    const auto size = static_cast<int64_t>(bytes.size());
    if (size > kMaxBlobBytes) {
      return absl::InvalidArgumentError(absl::StrCat(
          "blob of ", size, " bytes: at most ", kMaxBlobBytes, " are stored"));
    }
    const BlobId id = ContentHash(bytes);
    // Whoever put it may not have synced its name yet.
    if (Get(id).ok()) {
      MAPSIEVE_RETURN_IF_ERROR(file_system_.SyncDirectory(FolderOf(id)));
      return id;
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const auto room, reserve_.Take(size));
    MAPSIEVE_RETURN_IF_ERROR(MakeFolder(FolderName(id)));
    const std::string temporary = absl::StrCat(
        directory_, "/", kTemporaryFolder, "/", temporary_count_++);
    absl::Status status = WriteFile(temporary, bytes);
    if (status.ok()) status = file_system_.Rename(temporary, PathOf(id));
    if (!status.ok()) {
      // What stays is removed when the store is opened again.
      file_system_.Remove(temporary).IgnoreError();
      return status;
    }
    MAPSIEVE_RETURN_IF_ERROR(file_system_.SyncDirectory(FolderOf(id)));
    return id;
  }

  absl::StatusOr<std::vector<std::byte>> Get(const BlobId& id) const override {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto file, OpenBlob(id));
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, file->Size());
    if (size > kMaxBlobBytes) {
      return absl::DataLossError(absl::StrCat(PathOf(id), ": expected at most ",
                                              kMaxBlobBytes,
                                              " bytes, the file holds ", size));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(std::vector<std::byte> bytes,
                              ReadExactly(*file, PathOf(id), 0, size));
    if (const std::string hash = ContentHash(bytes); hash != id) {
      return absl::DataLossError(absl::StrCat(PathOf(id), ", bytes 0 to ", size,
                                              ": expected content of hash ", id,
                                              ", found ", hash));
    }
    return bytes;
  }

  absl::Status GetRange(const BlobId& id, int64_t offset,
                        std::span<std::byte> room) const override {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto file, OpenBlob(id));
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t blob_size, file->Size());
    const auto size = static_cast<int64_t>(room.size());
    if (offset < 0 || offset > blob_size || size > blob_size - offset) {
      return absl::OutOfRangeError(
          absl::StrCat("blob ", id, ": ", size, " bytes at offset ", offset,
                       " asked for, it has ", blob_size));
    }
    return ReadExactly(*file, PathOf(id), offset, room);
  }

  std::string Location(const BlobId& id) const override { return PathOf(id); }

  absl::StatusOr<int64_t> Size(const BlobId& id) const override {
    MAPSIEVE_RETURN_IF_ERROR(CheckId(id));
    return file_system_.FileSize(PathOf(id));
  }

  absl::Status Delete(const BlobId& id) override {
    MAPSIEVE_RETURN_IF_ERROR(CheckId(id));
    const absl::Status status = file_system_.Remove(PathOf(id));
    return absl::IsNotFound(status) ? absl::OkStatus() : status;
  }

  absl::StatusOr<std::vector<BlobId>> List(const BlobId& after,
                                           int64_t max_count) const override {
    if (!after.empty()) MAPSIEVE_RETURN_IF_ERROR(CheckId(after));
    if (max_count < 1) {
      return absl::InvalidArgumentError(
          absl::StrCat("page of ", max_count, " blobs: at least 1"));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::string> folders,
                              file_system_.List(directory_));
    std::vector<BlobId> ids;
    for (const std::string& folder : folders) {
      if (folder.size() != kFolderDigits || folder < FolderName(after)) {
        continue;
      }
      MAPSIEVE_ASSIGN_OR_RETURN(
          const std::vector<std::string> names,
          file_system_.List(JoinPath(directory_, folder)));
      for (const std::string& name : names) {
        if (!IsHexId(name) || !name.starts_with(folder) || name <= after) {
          continue;
        }
        ids.push_back(name);
        if (static_cast<int64_t>(ids.size()) == max_count) return ids;
      }
    }
    return ids;
  }

 private:
  std::string FolderOf(const BlobId& id) const {
    return JoinPath(directory_, FolderName(id));
  }
  std::string PathOf(const BlobId& id) const {
    return JoinPath(FolderOf(id), id);
  }

  absl::StatusOr<std::unique_ptr<File>> OpenBlob(const BlobId& id) const {
    MAPSIEVE_RETURN_IF_ERROR(CheckId(id));
    return file_system_.Open(PathOf(id), OpenMode::kRead);
  }

  absl::Status MakeFolder(const std::string& name) {
    // Nobody may find a folder there whose own entry is not durable yet.
    MutexLock lock(mutex_);
    if (made_.contains(name)) return absl::OkStatus();
    MAPSIEVE_RETURN_IF_ERROR(
        file_system_.MakeDirectories(JoinPath(directory_, name)));
    made_.insert(name);
    return absl::OkStatus();
  }

  absl::Status WriteFile(const std::string& path,
                         std::span<const std::byte> bytes) {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto file,
                              file_system_.Open(path, OpenMode::kCreateNew));
    MAPSIEVE_RETURN_IF_ERROR(file->WriteAt(0, bytes));
    return file->Sync();
  }

  FileSystem& file_system_;
  const std::string directory_;
  const SpaceReserve& reserve_;
  std::atomic<int64_t> temporary_count_ = 0;
  Mutex mutex_;
  std::set<std::string> made_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace

absl::StatusOr<std::unique_ptr<BlobStore>> OpenLocalBlobStore(
    FileSystem& file_system, const std::string& directory,
    const SpaceReserve& reserve) {
  auto store =
      std::make_unique<LocalBlobStore>(file_system, directory, reserve);
  MAPSIEVE_RETURN_IF_ERROR(store->Prepare());
  return store;
}

}  // namespace mapsieve::storage
