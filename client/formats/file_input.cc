#include "client/formats/file_input.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/formats/text_numbers.h"
#include "core/base/status.h"

namespace mapsieve::client {

absl::StatusOr<std::shared_ptr<const InputFile>> InputFile::Open(
    const std::filesystem::path& path) {
  std::string name = path.string();
  // Opening a pipe would wait for its writer, so the kind is asked first.
  struct stat kind {};
  if (::stat(name.c_str(), &kind) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat(name, ": cannot be read"));
  }
  if (S_ISDIR(kind.st_mode)) {
    return absl::InvalidArgumentError(
        absl::StrCat(name, ": is a directory; name a file"));
  }
  if (!S_ISREG(kind.st_mode)) {
    return absl::InvalidArgumentError(absl::StrCat(
        name, ": is not a regular file; write the data to a file first"));
  }
  const int descriptor = ::open(name.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat(name, ": cannot be opened"));
  }
  return std::shared_ptr<const InputFile>(
      new InputFile(std::move(name), descriptor, kind.st_size));
}

InputFile::~InputFile() { ::close(descriptor_); }

absl::Status InputFile::ReadAt(int64_t offset,
                               std::span<std::byte> bytes) const {
  size_t done = 0;
  while (done < bytes.size()) {
    const int64_t at = offset + static_cast<int64_t>(done);
    const ssize_t got =
        ::pread(descriptor_, bytes.data() + done, bytes.size() - done, at);
    if (got < 0) {
      if (errno == EINTR) continue;
      return absl::ErrnoToStatus(
          errno, absl::StrCat(name_, ", offset ", at, ": cannot be read"));
    }
    if (got == 0) {
      return Damaged(at, absl::StrCat("the file ends; expected ",
                                      bytes.size() - done, " more bytes"));
    }
    done += static_cast<size_t>(got);
  }
  return absl::OkStatus();
}

absl::Status InputFile::Damaged(int64_t offset, std::string_view what) const {
  return absl::DataLossError(
      absl::StrCat(name_, ", offset ", offset, ": ", ToAbsl(what)));
}

InputCursor::InputCursor(std::shared_ptr<const InputFile> file, int64_t offset,
                         size_t buffer_bytes)
    : file_(std::move(file)),
      read_bytes_(buffer_bytes),
      buffer_offset_(offset) {}

absl::Status InputCursor::Fill(size_t size) {
  if (end_ - at_ >= size) return absl::OkStatus();
  if (at_ > 0) {
    std::memmove(buffer_.data(), buffer_.data() + at_, end_ - at_);
    buffer_offset_ += static_cast<int64_t>(at_);
    end_ -= at_;
    at_ = 0;
  }
  const auto left =
      static_cast<size_t>(std::max<int64_t>(0, file_->size() - buffer_offset_));
  const size_t wanted = std::min(std::max(size, read_bytes_), left);
  if (wanted <= end_) return absl::OkStatus();
  if (buffer_.size() < wanted) buffer_.resize(wanted);
  MAPSIEVE_RETURN_IF_ERROR(
      file_->ReadAt(buffer_offset_ + static_cast<int64_t>(end_),
                    std::span(buffer_).subspan(end_, wanted - end_)));
  end_ = wanted;
  return absl::OkStatus();
}

absl::StatusOr<std::span<const std::byte>> InputCursor::Peek(size_t size) {
  MAPSIEVE_RETURN_IF_ERROR(Fill(size));
  return std::span<const std::byte>(buffer_).subspan(
      at_, std::min(size, end_ - at_));
}

absl::StatusOr<std::span<const std::byte>> InputCursor::Take(
    size_t size, std::string_view what) {
  if (remaining() < 0 || static_cast<uint64_t>(remaining()) < size) {
    return file_->Damaged(offset(),
                          absl::StrCat(ToAbsl(what), ": expected ", size,
                                       " bytes, the file has ", remaining()));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes, Peek(size));
  at_ += size;
  return bytes;
}

absl::Status InputCursor::Skip(int64_t size, std::string_view what) {
  if (size < 0 || size > remaining()) {
    return file_->Damaged(offset(),
                          absl::StrCat(ToAbsl(what), ": expected ", size,
                                       " bytes, the file has ", remaining()));
  }
  const auto buffered = static_cast<int64_t>(end_ - at_);
  if (size <= buffered) {
    at_ += static_cast<size_t>(size);
  } else {
    buffer_offset_ = offset() + size;
    at_ = 0;
    end_ = 0;
  }
  return absl::OkStatus();
}

absl::StatusOr<bool> InputCursor::NextLine(std::string_view& line) {
  size_t searched = 0;
  while (true) {
    const char* begin = text() + at_;
    const size_t have = end_ - at_;
    const void* newline =
        have == searched ? nullptr
                         : std::memchr(begin + searched, '\n', have - searched);
    size_t length = have;
    if (newline != nullptr) {
      length = static_cast<size_t>(static_cast<const char*>(newline) - begin);
    } else if (remaining() > static_cast<int64_t>(have)) {
      if (have > kMaxTextBytes) break;
      searched = have;
      MAPSIEVE_RETURN_IF_ERROR(Fill(have + read_bytes_));
      continue;
    } else if (have == 0) {
      return false;
    }
    if (length > kMaxTextBytes) break;
    at_ += length + (newline != nullptr ? 1 : 0);
    if (length > 0 && begin[length - 1] == '\r') --length;
    line = std::string_view(begin, length);
    line_number_ = ++lines_before_;
    return true;
  }
  line_number_ = lines_before_ + 1;
  return DamagedLine(absl::StrCat("longer than ", kMaxTextBytes,
                                  " bytes; this is not a text of points"));
}

absl::StatusOr<bool> InputCursor::NextToken(std::string_view& token) {
  while (true) {
    while (at_ < end_ && IsBlank(text()[at_])) {
      if (text()[at_] == '\n') ++lines_before_;
      ++at_;
    }
    if (at_ < end_) break;
    MAPSIEVE_RETURN_IF_ERROR(Fill(1));
    if (at_ == end_) return false;
  }
  line_number_ = lines_before_ + 1;
  size_t length = 1;
  while (true) {
    while (at_ + length < end_ && !IsBlank(text()[at_ + length])) ++length;
    if (length > kMaxTextBytes) {
      return DamagedLine(absl::StrCat("a word longer than ", kMaxTextBytes,
                                      " bytes; this is not a text of points"));
    }
    if (at_ + length < end_ || remaining() == static_cast<int64_t>(length)) {
      break;
    }
    MAPSIEVE_RETURN_IF_ERROR(Fill(length + read_bytes_));
  }
  token = std::string_view(text() + at_, length);
  at_ += length;
  return true;
}

absl::Status InputCursor::DamagedLine(std::string_view what) const {
  return absl::DataLossError(
      absl::StrCat(file_->name(), ", line ", line_number_, ": ", ToAbsl(what)));
}

}  // namespace mapsieve::client
