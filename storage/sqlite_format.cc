#include "storage/sqlite_format.h"

#include <algorithm>
#include <array>
#include <bit>
#include <optional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"

namespace mapsieve::storage {
namespace {

constexpr size_t kChecksumAt = kPageBytes - kPageChecksumBytes;
// What a database begins with, the final zero included.
const auto kMagic = std::as_bytes(std::span("SQLite format 3"));
// In the header of a database: how many bytes of a page are reserved.
constexpr size_t kReservedBytesAt = 20;

// Words of the log's header and of a frame's.
constexpr uint32_t kLogMagic = 0x377f0682;
constexpr size_t kLogSaltsAt = 16;
constexpr size_t kLogSumsAt = 24;
constexpr size_t kCommitAt = 4;
constexpr size_t kFrameSaltsAt = 8;
constexpr size_t kFrameSumsAt = 16;
// What a disk writes whole or not at all.
constexpr int64_t kSectorBytes = 512;
// The log's sums go over this much of the two headers.
constexpr size_t kSummedOfLogHeader = 24;
constexpr size_t kSummedOfFrameHeader = 8;

// SQLite's headers hold big-endian words.
uint32_t LoadWord(std::span<const std::byte> bytes, size_t at) {
  return __builtin_bswap32(LoadLittleEndian<uint32_t>(bytes.data() + at));
}

void StoreWord(uint32_t word, std::byte* to) {
  const uint32_t swapped = __builtin_bswap32(word);
  std::copy_n(reinterpret_cast<const std::byte*>(&swapped), sizeof(swapped),
              to);
}

// The sums with which a log goes on from frame to frame.
struct LogSums {
  uint32_t first = 0;
  uint32_t second = 0;

  static LogSums Load(std::span<const std::byte> header, size_t at) {
    return {LoadWord(header, at), LoadWord(header, at + 4)};
  }
  // `bytes`: a multiple of eight. Its words are as the machine that began the
  // log has them: little-endian.
  void Add(std::span<const std::byte> bytes) {
    for (size_t at = 0; at < bytes.size(); at += 8) {
      first += LoadLittleEndian<uint32_t>(bytes.data() + at) + second;
      second += LoadLittleEndian<uint32_t>(bytes.data() + at + 4) + first;
    }
  }
  friend bool operator==(const LogSums&, const LogSums&) = default;
};

LogSums SumsAfter(LogSums sums, std::span<const std::byte> frame) {
  sums.Add(frame.first(kSummedOfFrameHeader));
  sums.Add(frame.subspan(kFrameHeaderBytes));
  return sums;
}

uint64_t ChecksumOfPage(int64_t number, std::span<const std::byte> page) {
  // With its number, a page in the place of another is noticed too.
  return Hash64(page.first(kChecksumAt)) + static_cast<uint64_t>(number);
}

// What CheckLog remembers of the frame before.
struct FrameBefore {
  // The sums in it, and those that follow from the frame before it.
  LogSums stored;
  LogSums computed;
  bool ends_transaction = false;
  // Its header was written whole or not at all.
  bool is_in_one_sector = false;
};

absl::Status DamagedLog(const std::string& path, int64_t offset,
                        const char* what, LogSums expected, LogSums actual) {
  return absl::DataLossError(absl::StrFormat(
      "%s, offset %d: damaged: expected checksum %08x%08x of %s, it has "
      "%08x%08x, and committed changes follow; restore the data directory from "
      "a backup",
      path, offset, expected.first, expected.second, what, actual.first,
      actual.second));
}

}  // namespace

absl::StatusOr<bool> HasPageChecksums(const File& database) {
  std::array<std::byte, kDatabaseHeaderBytes> header;
  MAPSIEVE_ASSIGN_OR_RETURN(const size_t got, database.ReadAt(0, header));
  if (got < header.size() ||
      !std::equal(kMagic.begin(), kMagic.end(), header.begin())) {
    return true;
  }
  return header[kReservedBytesAt] == std::byte{kPageChecksumBytes};
}

void SealPage(int64_t number, std::span<std::byte> page) {
  const uint64_t checksum = ChecksumOfPage(number, page);
  std::copy_n(reinterpret_cast<const std::byte*>(&checksum), sizeof(checksum),
              page.data() + kChecksumAt);
}

absl::Status CheckPage(int64_t number, std::span<const std::byte> page) {
  const uint64_t expected = ChecksumOfPage(number, page);
  const auto actual = LoadLittleEndian<uint64_t>(page.data() + kChecksumAt);
  if (actual == expected) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrFormat("damaged page %d: expected checksum %016x, it has %016x",
                      number, expected, actual));
}

int64_t PageNumberOf(std::span<const std::byte> frame_header) {
  return LoadWord(frame_header, 0);
}

absl::Status SealFrame(const File& log, const std::string& path, int64_t offset,
                       std::span<std::byte> frame) {
  // The sums are at the end of the log's header, and before a frame's page.
  const bool is_first = offset == kLogHeaderBytes;
  MAPSIEVE_ASSIGN_OR_RETURN(
      const auto before,
      ReadExactly(log, path,
                  is_first ? int64_t{kLogSumsAt}
                           : offset - kFrameBytes + int64_t{kFrameSumsAt},
                  int64_t{sizeof(LogSums)}));
  const LogSums sums = SumsAfter(LogSums::Load(before, 0), frame);
  StoreWord(sums.first, frame.data() + kFrameSumsAt);
  StoreWord(sums.second, frame.data() + kFrameSumsAt + 4);
  return absl::OkStatus();
}

absl::Status CheckLog(const File& log, const std::string& path) {
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, log.Size());
  if (size < kLogHeaderBytes + kFrameBytes) return absl::OkStatus();
  MAPSIEVE_ASSIGN_OR_RETURN(const auto header,
                            ReadExactly(log, path, 0, kLogHeaderBytes));
  const auto has_salt = [&](std::span<const std::byte> frame, size_t at) {
    return LoadWord(frame, kFrameSaltsAt + at) ==
           LoadWord(header, kLogSaltsAt + at);
  };
  LogSums sums;
  sums.Add(std::span(header).first(kSummedOfLogHeader));
  const LogSums stored = LogSums::Load(header, kLogSumsAt);
  const bool is_whole = sums == stored && LoadWord(header, 0) == kLogMagic;

  FrameBefore before;
  std::optional<absl::Status> damage;
  for (int64_t at = kLogHeaderBytes; at + kFrameBytes <= size;
       at += kFrameBytes) {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto frame,
                              ReadExactly(log, path, at, kFrameBytes));
    const LogSums actual = LogSums::Load(frame, kFrameSumsAt);
    if (!is_whole) {
      // It was durable before the first frame was written. One that never was
      // has no salt in common with what follows.
      const bool is_ours = has_salt(frame, 0) || has_salt(frame, 4);
      if (is_ours && (SumsAfter(stored, frame) == actual ||
                      SumsAfter(sums, frame) == actual)) {
        return DamagedLog(path, 0, "the header", sums, stored);
      }
      return absl::OkStatus();
    }
    const bool has_salts = has_salt(frame, 0) && has_salt(frame, 4);
    if (damage.has_value()) {
      // A transaction is begun after the one before it is durable, and its
      // first frame goes on from the last one of that. What goes on from the
      // right sums of a frame vouches for all of it; what goes on from the sums
      // that are in it, for what was written together with them.
      const bool goes_on = SumsAfter(before.computed, frame) == actual ||
                           (before.is_in_one_sector &&
                            SumsAfter(before.stored, frame) == actual);
      if (before.ends_transaction && has_salts && goes_on) return *damage;
    }
    const LogSums computed =
        SumsAfter(at == kLogHeaderBytes ? stored : before.stored, frame);
    if (!damage.has_value() && (!has_salts || computed != actual)) {
      damage = DamagedLog(path, at, "a frame", computed, actual);
    }
    before = {.stored = actual,
              .computed = computed,
              .ends_transaction = LoadWord(frame, kCommitAt) != 0,
              .is_in_one_sector = at / kSectorBytes ==
                                  (at + kFrameHeaderBytes - 1) / kSectorBytes};
  }
  return absl::OkStatus();
}

}  // namespace mapsieve::storage
