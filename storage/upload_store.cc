#include "storage/upload_store.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "storage/names.h"

namespace mapsieve::storage {
namespace {

absl::Status CheckUid(const std::string& uid) {
  if (IsHexId(uid)) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      "upload uid ", Quoted(uid), ": expected 32 hexadecimal digits"));
}

absl::Status CheckLength(const std::string& path, int64_t committed,
                         int64_t size) {
  if (size >= committed) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(
      path, ": expected ", committed, " committed bytes, the file holds ", size,
      "; delete the upload and send it again"));
}

}  // namespace

UploadWriter::UploadWriter(UploadStore& store, const UploadRecord& record,
                           std::unique_ptr<File> file)
    : store_(store),
      record_(record),
      file_(std::move(file)),
      written_bytes_(record.committed_bytes),
      committed_bytes_(record.committed_bytes) {}

UploadWriter::~UploadWriter() { store_.ReleaseWriter(record_.uid); }

absl::Status UploadWriter::Append(int64_t offset,
                                  std::span<const std::byte> bytes) {
  if (offset < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("upload ", record_.spec.id, ": offset ", offset, " < 0"));
  }
  if (offset > written_bytes_) {
    return absl::OutOfRangeError(absl::StrCat(
        "upload ", record_.spec.id, ": gap: expected offset ", written_bytes_,
        ", got ", offset, "; go on from committed_bytes"));
  }
  const auto repeated = static_cast<size_t>(written_bytes_ - offset);
  if (repeated >= bytes.size()) return absl::OkStatus();
  bytes = bytes.subspan(repeated);
  const auto size = static_cast<int64_t>(bytes.size());
  if (const auto& expected = record_.spec.expected_bytes;
      expected.has_value() && size > *expected - written_bytes_) {
    return absl::OutOfRangeError(
        absl::StrCat("upload ", record_.spec.id, ": declared with ", *expected,
                     " bytes, got bytes up to ", written_bytes_ + size));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const auto room, store_.reserve_.Take(size));
  MAPSIEVE_RETURN_IF_ERROR(file_->WriteAt(written_bytes_, bytes));
  written_bytes_ += size;
  return absl::OkStatus();
}

absl::StatusOr<int64_t> UploadWriter::Commit() {
  MAPSIEVE_RETURN_IF_ERROR(file_->Sync());
  MAPSIEVE_RETURN_IF_ERROR(
      store_.catalogue_.SetCommittedBytes(record_.uid, written_bytes_));
  committed_bytes_ = written_bytes_;
  return committed_bytes_;
}

UploadReader::UploadReader(std::string path, std::unique_ptr<File> file,
                           int64_t size)
    : path_(std::move(path)), file_(std::move(file)), size_(size) {}

absl::StatusOr<std::vector<std::byte>> UploadReader::Read(int64_t offset,
                                                          int64_t size) const {
  if (offset < 0 || size < 0 || offset > size_ || size > size_ - offset) {
    return absl::OutOfRangeError(
        absl::StrCat(path_, ": ", size, " bytes at offset ", offset,
                     " asked for, ", size_, " are committed"));
  }
  if (size == 0) return std::vector<std::byte>();
  return ReadExactly(*file_, path_, offset, size);
}

UploadStore::UploadStore(FileSystem& file_system, std::string directory,
                         Catalogue& catalogue, const SpaceReserve& reserve)
    : file_system_(file_system),
      directory_(std::move(directory)),
      catalogue_(catalogue),
      reserve_(reserve) {}

absl::StatusOr<std::unique_ptr<UploadStore>> UploadStore::Open(
    FileSystem& file_system, std::string directory, Catalogue& catalogue,
    const SpaceReserve& reserve) {
  MAPSIEVE_RETURN_IF_ERROR(file_system.MakeDirectories(directory));
  return std::unique_ptr<UploadStore>(
      new UploadStore(file_system, std::move(directory), catalogue, reserve));
}

std::string UploadStore::PathOf(const std::string& upload_uid) const {
  return JoinPath(directory_, upload_uid);
}

absl::StatusOr<std::unique_ptr<UploadWriter>> UploadStore::OpenWriter(
    const std::string& upload_uid) {
  MAPSIEVE_RETURN_IF_ERROR(CheckUid(upload_uid));
  {
    MutexLock lock(mutex_);
    if (!writing_.insert(upload_uid).second) {
      return absl::AbortedError(absl::StrCat(
          "upload ", upload_uid,
          ": another writer has it; wait until that one is finished"));
    }
  }
  auto writer = OpenFile(upload_uid);
  if (!writer.ok()) ReleaseWriter(upload_uid);
  return writer;
}

absl::StatusOr<std::unique_ptr<UploadWriter>> UploadStore::OpenFile(
    const std::string& upload_uid) {
  MAPSIEVE_ASSIGN_OR_RETURN(const UploadRecord record,
                            catalogue_.GetUploadByUid(upload_uid));
  if (record.state != UploadState::kActive) {
    return absl::FailedPreconditionError(absl::StrCat(
        "upload ", record.spec.id, ": its bytes are complete, or it failed"));
  }
  const std::string path = PathOf(upload_uid);
  MAPSIEVE_ASSIGN_OR_RETURN(std::unique_ptr<File> file,
                            file_system_.Open(path, OpenMode::kCreateIfAbsent));
  // The entry may be new, or left by a process that died before this line.
  MAPSIEVE_RETURN_IF_ERROR(file_system_.SyncDirectory(directory_));
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, file->Size());
  MAPSIEVE_RETURN_IF_ERROR(CheckLength(path, record.committed_bytes, size));
  if (size > record.committed_bytes) {
    MAPSIEVE_RETURN_IF_ERROR(file->Truncate(record.committed_bytes));
  }
  return std::unique_ptr<UploadWriter>(
      new UploadWriter(*this, record, std::move(file)));
}

void UploadStore::ReleaseWriter(const std::string& upload_uid) {
  MutexLock lock(mutex_);
  writing_.erase(upload_uid);
}

absl::StatusOr<std::unique_ptr<UploadReader>> UploadStore::OpenReader(
    const std::string& upload_uid) const {
  MAPSIEVE_RETURN_IF_ERROR(CheckUid(upload_uid));
  MAPSIEVE_ASSIGN_OR_RETURN(const UploadRecord record,
                            catalogue_.GetUploadByUid(upload_uid));
  const std::string path = PathOf(upload_uid);
  auto file = file_system_.Open(path, OpenMode::kRead);
  if (absl::IsNotFound(file.status()) &&
      record.state != UploadState::kFinalized) {
    MAPSIEVE_RETURN_IF_ERROR(CheckLength(path, record.committed_bytes, 0));
    // Nobody has written to it.
    return std::unique_ptr<UploadReader>(new UploadReader(path, nullptr, 0));
  }
  MAPSIEVE_RETURN_IF_ERROR(file.status());
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, (*file)->Size());
  MAPSIEVE_RETURN_IF_ERROR(CheckLength(path, record.committed_bytes, size));
  return std::unique_ptr<UploadReader>(
      new UploadReader(path, *std::move(file), record.committed_bytes));
}

absl::Status UploadStore::Remove(const std::string& upload_uid) {
  MAPSIEVE_RETURN_IF_ERROR(CheckUid(upload_uid));
  const absl::Status status = file_system_.Remove(PathOf(upload_uid));
  return absl::IsNotFound(status) ? absl::OkStatus() : status;
}

absl::StatusOr<int64_t> UploadStore::RemoveOrphans() {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::string> names,
                            file_system_.List(directory_));
  int64_t removed = 0;
  for (const std::string& name : names) {
    if (!IsHexId(name)) continue;
    const auto record = catalogue_.GetUploadByUid(name);
    if (!absl::IsNotFound(record.status())) {
      MAPSIEVE_RETURN_IF_ERROR(record.status());
      if (record->state != UploadState::kFinalized) continue;
    }
    MAPSIEVE_RETURN_IF_ERROR(Remove(name));
    ++removed;
  }
  return removed;
}

}  // namespace mapsieve::storage
