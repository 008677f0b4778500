#ifndef MAPSIEVE_STORAGE_SQLITE_FORMAT_H_
#define MAPSIEVE_STORAGE_SQLITE_FORMAT_H_

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/file_system.h"

/// What we add to SQLite's files, and what we need to know of them for it:
/// checksums of pages, and the frames of its write-ahead log. FORMAT.md
/// describes the bytes. All functions are thread-safe.
namespace mapsieve::storage {

/// Bytes of every page of a database that we make.
inline constexpr int kPageBytes = 4096;
/// Bytes at the end of a page that SQLite leaves to us.
inline constexpr int kPageChecksumBytes = 8;
/// Bytes at the begin of a database that SQLite reads before it knows the size
/// of a page.
inline constexpr int kDatabaseHeaderBytes = 100;

/// Bytes of the log's header, of a frame's header, and of a frame.
inline constexpr int kLogHeaderBytes = 32;
inline constexpr int kFrameHeaderBytes = 24;
inline constexpr int kFrameBytes = kFrameHeaderBytes + kPageBytes;

/// Whether the pages of a database carry checksums. One without a header will:
/// it is new, or its first page was not written to the end and is in the log.
absl::StatusOr<bool> HasPageChecksums(const File& database);

/// Writes its checksum into a whole page; `number` counts from 1.
void SealPage(int64_t number, std::span<std::byte> page);
/// kDataLoss, with expected and actual, if a page is not as it was sealed.
absl::Status CheckPage(int64_t number, std::span<const std::byte> page);

/// The number of the page in a frame, from the frame's header.
int64_t PageNumberOf(std::span<const std::byte> frame_header);
/// Makes the checksum of a whole frame, which is to be written at `offset` of
/// the log, follow from what the log holds before it.
absl::Status SealFrame(const File& log, const std::string& path, int64_t offset,
                       std::span<std::byte> frame);

/// kDataLoss if SQLite would not replay a transaction of the log that was
/// committed for sure: because it has a frame that is not what was written, and
/// another transaction follows, or because the log's header is not what was
/// written. The last transaction of a log cannot be told from one that was
/// never finished. `path` names the log in messages. Cost: reads all of it.
absl::Status CheckLog(const File& log, const std::string& path);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_SQLITE_FORMAT_H_
