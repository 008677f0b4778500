// Feeds bytes to what reads the records of the catalogue and the log of a run,
// and what they accept to the writers. The first byte chooses the reader.

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "server/engine/opaque_records.h"
#include "server/engine/run_checkpoint.h"
#include "storage/file_system.h"
#include "storage/record_checks.h"
#include "storage/scratch_store.h"
#include "storage/space_reserve.h"
#include "tests/fuzz/check.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::engine {
namespace {

using mapsieve::testing::Check;

/// `parse` refuses the bytes, or `format` gives what it reads again.
template <typename Parse, typename Format>
void CheckRecord(std::string_view bytes, const Parse& parse,
                 const Format& format) {
  const auto record = parse(bytes);
  if (!record.ok()) {
    Check(absl::IsDataLoss(record.status()), "a refusal is DATA_LOSS",
          record.status().ToString());
    return;
  }
  // Records may hold NaN, which equals nothing: their bytes are compared.
  const std::string again = format(*record);
  const auto back = parse(again);
  Check(back.ok() && format(*back) == again,
        "a record that was written is read");
}

/// What a run finds of an earlier one whose log is `log`.
std::vector<std::vector<std::byte>> FinishedVisits(
    std::span<const std::byte> log) {
  static const mapsieve::testing::TemporaryDirectory folder;
  static const storage::SpaceReserve reserve(storage::PosixFileSystem(),
                                             folder.path(), 0);
  const auto open = [] {
    return storage::Scratch::OpenLasting(storage::PosixFileSystem(),
                                         folder / "run", reserve);
  };
  const std::string key = "key";
  const auto scratch = open();
  Check(scratch->Clear().ok() && scratch->Write("key", TextBytes(key)).ok() &&
            scratch->Write("log", log).ok(),
        "files are written");
  auto checkpoint = RunCheckpoint::Open(open(), key);
  Check(checkpoint.ok(), "no log keeps a run from its begin");
  const auto found = (*checkpoint)->finished();

  const std::vector<std::byte> state(3, std::byte{7});
  const std::vector<std::byte> record(2, std::byte{9});
  Check((*checkpoint)->Store("state", state).ok() &&
            (*checkpoint)->FinishVisit(record).ok(),
        "a run goes on");
  checkpoint = RunCheckpoint::Open(open(), key);
  auto expected = found;
  expected.push_back(record);
  std::vector<std::byte> kept(state.size());
  const std::array parts = {
      storage::ByteRange{0, static_cast<int64_t>(kept.size())}};
  Check(checkpoint.ok() && (*checkpoint)->finished() == expected &&
            (*checkpoint)->Load("state", parts, kept).ok() && kept == state,
        "a run finds what was finished");
  return found;
}

/// `bytes` as a visit of a log, under the right hash.
std::vector<std::byte> Seal(std::span<const std::byte> bytes) {
  ByteWriter writer;
  writer.Put(static_cast<uint32_t>(bytes.size()));
  writer.PutBytes(bytes);
  writer.Put(Hash64(bytes));
  return std::move(writer.bytes());
}

void CheckBytes(uint8_t reader, std::string_view bytes) {
  constexpr uint8_t kReaders = 9;
  switch (reader % kReaders) {
    case 0:
      return CheckRecord(bytes, ParseSpdfOptions, FormatSpdfOptions);
    case 1:
      return CheckRecord(bytes, ParseUploadNotes, FormatUploadNotes);
    case 2:
      return CheckRecord(bytes, ParseProcessReport, FormatProcessReport);
    case 3:
      return CheckRecord(bytes, ParseEditRecord, FormatEditRecord);
    case 4:
      return CheckRecord(bytes, ParseJobSpec, FormatJobSpec);
    case 5:
      return CheckRecord(bytes, ParseJobOutcome, FormatJobOutcome);
    case 6:
      return CheckRecord(bytes, storage::DecodeAttributes,
                         storage::EncodeAttributes);
    case 7:
      FinishedVisits(TextBytes(bytes));
      return;
    default:
      FinishedVisits(Seal(TextBytes(bytes)));
  }
}

}  // namespace
}  // namespace mapsieve::engine

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  mapsieve::engine::CheckBytes(
      data[0], {reinterpret_cast<const char*>(data + 1), size - 1});
  return 0;
}
