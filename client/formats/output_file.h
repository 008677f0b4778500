#ifndef MAPSIEVE_CLIENT_FORMATS_OUTPUT_FILE_H_
#define MAPSIEVE_CLIENT_FORMATS_OUTPUT_FILE_H_

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

/// A file being written under a temporary name beside its target. Finish gives
/// it the target's name, replacing what was there; destroyed before that, it
/// leaves nothing. Once a call failed, every later one returns its error.
/// Buffered. Not thread-safe.
class OutputFile {
 public:
  /// kNotFound, kPermissionDenied: the folder; kInvalidArgument: the target is
  /// a directory.
  static absl::StatusOr<std::unique_ptr<OutputFile>> Create(
      const std::filesystem::path& target);
  ~OutputFile();
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;

  /// The target, for messages.
  const std::string& name() const { return name_; }
  /// Bytes appended so far.
  int64_t size() const {
    return written_ + static_cast<int64_t>(buffer_.size());
  }

  /// Appends bytes. kResourceExhausted: the disk is full.
  absl::Status Append(std::span<const std::byte> bytes);
  absl::Status Append(std::string_view text);
  /// Replaces bytes that were appended before: [offset, offset + size) lies
  /// below size().
  absl::Status Overwrite(int64_t offset, std::span<const std::byte> bytes);

  /// Writes all out, waits until the disk has it, and renames. Call it once,
  /// last.
  absl::Status Finish();

 private:
  OutputFile(std::string name, std::string temporary, int descriptor);
  // Remembers the first error.
  absl::Status Keep(const absl::Status& status);
  absl::Status Flush();
  absl::Status WriteAll(int64_t offset, std::span<const std::byte> bytes);

  std::string name_;
  std::string temporary_;
  int descriptor_;
  std::vector<std::byte> buffer_;
  int64_t written_ = 0;
  absl::Status failure_;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_OUTPUT_FILE_H_
