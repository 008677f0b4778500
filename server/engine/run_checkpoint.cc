#include "server/engine/run_checkpoint.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"

namespace mapsieve::engine {
namespace {

constexpr char kKeyName[] = "key";
constexpr char kLogName[] = "log";

std::string FileName(const std::string& state, uint32_t visit) {
  return absl::StrCat(state, "-v", visit);
}

/// One finished visit in the log.
struct LogEntry {
  struct State {
    std::string name;
    uint64_t hash = 0;
  };
  std::vector<State> states;
  std::vector<std::byte> record;

  /// The length of the rest, the rest, its hash.
  std::vector<std::byte> Format() const {
    ByteWriter rest;
    rest.Put(static_cast<uint32_t>(states.size()));
    for (const State& state : states) {
      rest.PutShortText(state.name);
      rest.Put(state.hash);
    }
    rest.PutBytes(record);
    ByteWriter writer;
    writer.Put(static_cast<uint32_t>(rest.size()));
    writer.PutBytes(rest.bytes());
    writer.Put(Hash64(rest.bytes()));
    return std::move(writer.bytes());
  }

  /// Takes the next one. kDataLoss: it is not whole.
  static absl::StatusOr<LogEntry> Take(ByteReader& log) {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto size, log.Take<uint32_t>("length"));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes, log.TakeBytes(size, "visit"));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto hash, log.Take<uint64_t>("hash"));
    if (hash != Hash64(bytes)) return absl::DataLossError("another hash");
    ByteReader rest(bytes);
    LogEntry entry;
    MAPSIEVE_ASSIGN_OR_RETURN(const auto count, rest.Take<uint32_t>("count"));
    for (uint32_t i = 0; i < count; ++i) {
      State state;
      MAPSIEVE_ASSIGN_OR_RETURN(state.name, rest.TakeShortText("name"));
      MAPSIEVE_ASSIGN_OR_RETURN(state.hash, rest.Take<uint64_t>("hash"));
      entry.states.push_back(std::move(state));
    }
    const auto record = bytes.subspan(rest.offset());
    entry.record.assign(record.begin(), record.end());
    return entry;
  }
};

}  // namespace

absl::StatusOr<std::unique_ptr<RunCheckpoint>> RunCheckpoint::Open(
    std::unique_ptr<storage::Scratch> scratch, const std::string& key) {
  std::unique_ptr<RunCheckpoint> checkpoint(
      new RunCheckpoint(std::move(scratch), key));
  const auto kept_key = checkpoint->scratch_->Read(kKeyName);
  const auto log = checkpoint->scratch_->Read(kLogName);
  const auto bytes = TextBytes(key);
  if (kept_key.ok() && log.ok() &&
      std::equal(kept_key->begin(), kept_key->end(), bytes.begin(),
                 bytes.end())) {
    const size_t size = checkpoint->ReadLog(*log);
    if (checkpoint->AreStatesWhole()) {
      // What is not whole goes, so that new visits follow whole ones.
      MAPSIEVE_RETURN_IF_ERROR(
          checkpoint->scratch_->Write(kLogName, std::span(*log).first(size)));
      checkpoint->has_begun_ = true;
      return checkpoint;
    }
    checkpoint->states_.clear();
    checkpoint->finished_.clear();
  }
  return checkpoint;
}

/// Up to the first visit that is not whole; returns how long that part is.
size_t RunCheckpoint::ReadLog(std::span<const std::byte> log) {
  ByteReader reader(log);
  while (true) {
    const size_t size = reader.offset();
    absl::StatusOr<LogEntry> entry = LogEntry::Take(reader);
    if (!entry.ok()) return size;
    for (const LogEntry::State& state : entry->states) {
      states_[state.name] = {static_cast<uint32_t>(finished_.size()),
                             state.hash};
    }
    finished_.push_back(std::move(entry->record));
  }
}

bool RunCheckpoint::AreStatesWhole() const {
  for (const auto& [name, version] : states_) {
    const auto bytes = scratch_->Read(FileName(name, version.visit));
    if (!bytes.ok() || Hash64(*bytes) != version.hash) return false;
  }
  return true;
}

absl::Status RunCheckpoint::Store(const std::string& name,
                                  std::span<const std::byte> bytes) {
  if (!has_begun_) {
    MAPSIEVE_RETURN_IF_ERROR(scratch_->Clear());
    MAPSIEVE_RETURN_IF_ERROR(scratch_->Write(kKeyName, TextBytes(key_)));
    has_begun_ = true;
  }
  const auto visit = static_cast<uint32_t>(finished_.size());
  MAPSIEVE_RETURN_IF_ERROR(scratch_->Write(FileName(name, visit), bytes));
  const auto before = states_.find(name);
  if (before == states_.end() || before->second.visit != visit) {
    if (before != states_.end()) {
      replaced_files_.push_back(FileName(name, before->second.visit));
    }
    stored_.push_back(name);
  }
  states_[name] = {visit, Hash64(bytes)};
  return absl::OkStatus();
}

absl::Status RunCheckpoint::Load(const std::string& name,
                                 std::span<const storage::ByteRange> parts,
                                 std::span<std::byte> room) const {
  const auto found = states_.find(name);
  if (found == states_.end()) {
    return absl::NotFoundError(absl::StrCat("no state ", name));
  }
  return scratch_->ReadParts(FileName(name, found->second.visit), parts, room);
}

absl::Status RunCheckpoint::FinishVisit(std::span<const std::byte> record) {
  LogEntry entry;
  for (std::string& name : std::exchange(stored_, {})) {
    const uint64_t hash = states_.at(name).hash;
    entry.states.push_back({std::move(name), hash});
  }
  entry.record.assign(record.begin(), record.end());
  MAPSIEVE_RETURN_IF_ERROR(scratch_->Append(kLogName, entry.Format()));
  finished_.push_back(std::move(entry.record));
  for (const std::string& file : std::exchange(replaced_files_, {})) {
    MAPSIEVE_RETURN_IF_ERROR(scratch_->Remove(file));
  }
  return absl::OkStatus();
}

}  // namespace mapsieve::engine
