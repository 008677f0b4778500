#include "client/formats/output_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/bytes.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

constexpr size_t kBufferBytes = size_t{1} << 20;
constexpr int kMaxAttempts = 1000;

}  // namespace

absl::StatusOr<std::unique_ptr<OutputFile>> OutputFile::Create(
    const std::filesystem::path& target) {
  std::error_code ignored;
  if (!target.has_filename() ||
      std::filesystem::is_directory(target, ignored)) {
    return absl::InvalidArgumentError(absl::StrCat(
        target.string(), ": is a directory; name a file inside it"));
  }
  for (int attempt = 0; attempt < kMaxAttempts; ++attempt) {
    std::filesystem::path temporary = target;
    temporary.replace_filename(absl::StrCat(".", target.filename().string(),
                                            ".", ::getpid(), ".", attempt,
                                            ".tmp"));
    const int descriptor =
        ::open(temporary.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (descriptor >= 0) {
      return std::unique_ptr<OutputFile>(
          new OutputFile(target.string(), temporary.string(), descriptor));
    }
    if (errno != EEXIST) {
      return absl::ErrnoToStatus(
          errno, absl::StrCat(target.string(), ": cannot be created"));
    }
  }
  return absl::AlreadyExistsError(
      absl::StrCat(target.string(), ": ", kMaxAttempts,
                   " temporary files lie beside it; remove them"));
}

OutputFile::OutputFile(std::string name, std::string temporary, int descriptor)
    : name_(std::move(name)),
      temporary_(std::move(temporary)),
      descriptor_(descriptor) {}

OutputFile::~OutputFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

absl::Status OutputFile::Keep(const absl::Status& status) {
  failure_.Update(status);
  return failure_;
}

absl::Status OutputFile::WriteAll(int64_t offset,
                                  std::span<const std::byte> bytes) {
  MAPSIEVE_RETURN_IF_ERROR(failure_);
  while (!bytes.empty()) {
    const ssize_t done =
        ::pwrite(descriptor_, bytes.data(), bytes.size(), offset);
    if (done < 0) {
      if (errno == EINTR) continue;
      return Keep(absl::ErrnoToStatus(
          errno,
          absl::StrCat(name_, ", offset ", offset, ": cannot be written")));
    }
    bytes = bytes.subspan(static_cast<size_t>(done));
    offset += done;
  }
  return absl::OkStatus();
}

absl::Status OutputFile::Flush() {
  MAPSIEVE_RETURN_IF_ERROR(WriteAll(written_, buffer_));
  written_ += static_cast<int64_t>(buffer_.size());
  buffer_.clear();
  return absl::OkStatus();
}

absl::Status OutputFile::Append(std::span<const std::byte> bytes) {
  MAPSIEVE_RETURN_IF_ERROR(failure_);
  if (buffer_.size() + bytes.size() > kBufferBytes) {
    MAPSIEVE_RETURN_IF_ERROR(Flush());
  }
  if (bytes.size() >= kBufferBytes) {
    MAPSIEVE_RETURN_IF_ERROR(WriteAll(written_, bytes));
    written_ += static_cast<int64_t>(bytes.size());
    return absl::OkStatus();
  }
  buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
  return absl::OkStatus();
}

absl::Status OutputFile::Append(std::string_view text) {
  return Append(TextBytes(text));
}

absl::Status OutputFile::Overwrite(int64_t offset,
                                   std::span<const std::byte> bytes) {
  MAPSIEVE_RETURN_IF_ERROR(Flush());
  return WriteAll(offset, bytes);
}

absl::Status OutputFile::Finish() {
  MAPSIEVE_RETURN_IF_ERROR(Flush());
  const auto fail = [&](const char* what) {
    return Keep(absl::ErrnoToStatus(errno, absl::StrCat(name_, ": ", what)));
  };
  // A full disk may show only here.
  if (::fsync(descriptor_) != 0) return fail("cannot be written");
  const int descriptor = std::exchange(descriptor_, -1);
  if (::close(descriptor) != 0) return fail("cannot be written");
  if (::rename(temporary_.c_str(), name_.c_str()) != 0) {
    return fail("cannot be replaced");
  }
  temporary_.clear();
  return absl::OkStatus();
}

}  // namespace mapsieve::client
