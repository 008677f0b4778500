#ifndef MAPSIEVE_SERVER_ENGINE_RUN_CHECKPOINT_H_
#define MAPSIEVE_SERVER_ENGINE_RUN_CHECKPOINT_H_

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "storage/scratch_store.h"

namespace mapsieve::engine {

/// The states of tiles during a run of the filter, kept so that another process
/// can go on after the last finished visit, however this one ends
/// (storage/FORMAT.md, "Runs"). Nothing is synced: after a crash of the system
/// what is damaged is found out, and the run starts again. Load may be called
/// from several threads at once.
class RunCheckpoint {
 public:
  /// Goes on with what `scratch` holds, if that is of a run of the same `key`
  /// and whole; else the first Store begins anew.
  static absl::StatusOr<std::unique_ptr<RunCheckpoint>> Open(
      std::unique_ptr<storage::Scratch> scratch, const std::string& key);

  /// Replaces the state `name` (a-z, 0-9 and -). What it was before comes back
  /// if the process ends before the next FinishVisit. Errors of Scratch::Write.
  absl::Status Store(const std::string& name, std::span<const std::byte> bytes);
  /// Parts of a state. Errors of Scratch::ReadParts.
  absl::Status Load(const std::string& name,
                    std::span<const storage::ByteRange> parts,
                    std::span<std::byte> room) const;

  /// What was stored since the last call is what a later run finds, with
  /// `record`.
  absl::Status FinishVisit(std::span<const std::byte> record);
  /// Of all finished visits, those of earlier processes included.
  const std::vector<std::vector<std::byte>>& finished() const {
    return finished_;
  }

 private:
  /// The file that holds a state, and the hash of its bytes.
  struct Version {
    uint32_t visit = 0;
    uint64_t hash = 0;
  };

  RunCheckpoint(std::unique_ptr<storage::Scratch> scratch, std::string key)
      : scratch_(std::move(scratch)), key_(std::move(key)) {}
  size_t ReadLog(std::span<const std::byte> log);
  bool AreStatesWhole() const;

  const std::unique_ptr<storage::Scratch> scratch_;
  const std::string key_;
  /// The scratch holds a run of this key.
  bool has_begun_ = false;
  std::map<std::string, Version> states_;
  /// Names stored since the last finished visit, and what they replace.
  std::vector<std::string> stored_;
  std::vector<std::string> replaced_files_;
  std::vector<std::vector<std::byte>> finished_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_RUN_CHECKPOINT_H_
