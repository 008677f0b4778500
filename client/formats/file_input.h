#ifndef MAPSIEVE_CLIENT_FORMATS_FILE_INPUT_H_
#define MAPSIEVE_CLIENT_FORMATS_FILE_INPUT_H_

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace mapsieve::client {

/// A regular file open for reading by position. Thread-safe.
class InputFile {
 public:
  /// kNotFound, kPermissionDenied: the file; kInvalidArgument: a directory or
  /// another thing that has no positions.
  static absl::StatusOr<std::shared_ptr<const InputFile>> Open(
      const std::filesystem::path& path);
  ~InputFile();
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;

  /// The path, for messages.
  const std::string& name() const { return name_; }
  /// Bytes of the file when it was opened.
  int64_t size() const { return size_; }

  /// Fills `bytes` from `offset` on. kDataLoss if the file ends before.
  absl::Status ReadAt(int64_t offset, std::span<std::byte> bytes) const;

  /// kDataLoss: "NAME, offset N: WHAT".
  absl::Status Damaged(int64_t offset, std::string_view what) const;

 private:
  InputFile(std::string name, int descriptor, int64_t size)
      : name_(std::move(name)), descriptor_(descriptor), size_(size) {}

  std::string name_;
  int descriptor_;
  int64_t size_;
};

/// Reads a file front to back from any offset through a buffer of its own;
/// several cursors may share a file. What a call returns points into the
/// buffer and lives until the next call. Not thread-safe.
class InputCursor {
 public:
  /// Lines and tokens beyond this many bytes are refused.
  static constexpr size_t kMaxTextBytes = size_t{1} << 20;
  static constexpr size_t kDefaultBufferBytes = size_t{1} << 20;

  /// Reads `buffer_bytes` (at least 1) at a time.
  explicit InputCursor(std::shared_ptr<const InputFile> file,
                       int64_t offset = 0,
                       size_t buffer_bytes = kDefaultBufferBytes);

  const InputFile& file() const { return *file_; }
  /// Offset of the next byte.
  int64_t offset() const { return buffer_offset_ + static_cast<int64_t>(at_); }
  /// Bytes from offset() to the end of the file.
  int64_t remaining() const { return file_->size() - offset(); }
  bool at_end() const { return remaining() <= 0; }

  /// The next `size` bytes, which stay next; fewer only where the file ends.
  /// The buffer grows to `size`, never beyond the rest of the file.
  absl::StatusOr<std::span<const std::byte>> Peek(size_t size);
  /// The next `size` bytes. kDataLoss, naming `what`, if the file ends before;
  /// nothing is allocated then.
  absl::StatusOr<std::span<const std::byte>> Take(size_t size,
                                                  std::string_view what);
  /// Passes over `size` bytes. kDataLoss, naming `what`, beyond the end.
  absl::Status Skip(int64_t size, std::string_view what);

  /// The next line without its LF or CR LF; false at the end of the file. A
  /// last line without LF is a line. kDataLoss beyond kMaxTextBytes.
  absl::StatusOr<bool> NextLine(std::string_view& line);
  /// The next word between blanks and line ends; false at the end of the file.
  /// kDataLoss beyond kMaxTextBytes.
  absl::StatusOr<bool> NextToken(std::string_view& token);

  /// Number of the line that NextLine or NextToken gave last, from 1 at the
  /// offset given at construction. Peek, Take and Skip count no lines.
  int64_t line_number() const { return line_number_; }
  /// For a cursor that begins inside a text: `line` is the number of the line
  /// at its offset.
  void StartAtLine(int64_t line) { lines_before_ = line - 1; }

  /// kDataLoss: "NAME, line N: WHAT", of line_number().
  absl::Status DamagedLine(std::string_view what) const;

 private:
  // Moves what is left to the front and reads more, so that at least `size`
  // bytes are there or all that the file still has.
  absl::Status Fill(size_t size);
  const char* text() const {
    return reinterpret_cast<const char*>(buffer_.data());
  }

  std::shared_ptr<const InputFile> file_;
  size_t read_bytes_;
  std::vector<std::byte> buffer_;
  int64_t buffer_offset_;
  size_t at_ = 0;
  size_t end_ = 0;
  int64_t lines_before_ = 0;
  int64_t line_number_ = 0;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_FILE_INPUT_H_
