#ifndef MAPSIEVE_TESTS_TESTING_FAULT_FILE_SYSTEM_H_
#define MAPSIEVE_TESTS_TESTING_FAULT_FILE_SYSTEM_H_

#include <algorithm>
#include <cstdint>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/base/mutex.h"
#include "storage/file_system.h"

namespace mapsieve::testing {

/// A file system that fails on demand and can lose power: it forwards to
/// another one and remembers what was synced. Only files that are opened
/// through it are its own. Thread-safe, but for LosePower.
class FaultFileSystem final : public storage::FileSystem {
 public:
  explicit FaultFileSystem(storage::FileSystem& base) : base_(base) {}

  /// An operation that fails. Every call counts but Lock and FreeBytes.
  struct Fault {
    /// 1: the next one.
    int64_t operation = 1;
    absl::Status status;
    /// All later ones fail too.
    bool lasts = false;
    /// It is done all the same; otherwise a write is half done, nothing else is
    /// done at all, and what a sync was for stays unsynced whatever syncs the
    /// file later, as systems have it.
    bool takes_effect = false;
  };
  void Arm(const Fault& fault);
  void Disarm();
  /// Whether the armed fault came to pass.
  bool fired() const;
  /// Kind of the call that the fault met first; "" before.
  std::string fault_kind() const;
  /// Calls so far, of one kind: "open", "write", "sync", "rename", …
  int64_t call_count(const std::string& kind) const;

  /// FreeBytes answers this from now on.
  void SetFreeBytes(int64_t bytes);

  /// Open of a path that contains `part` waits until Release is called.
  void Hold(const std::string& part);
  /// Returns once an Open waits.
  void AwaitHeld();
  void Release();

  enum class Loss {
    /// Neither names nor bytes that were not synced survive.
    kEverything,
    /// Names survive, and sizes; bytes that were not synced are garbage.
    kContent,
    /// Names survive, and sizes; of what was not synced, every 512 bytes
    /// survive or not.
    kSomeContent,
  };
  /// What a power failure leaves behind. Files must be closed.
  void LosePower(Loss loss);

  absl::StatusOr<std::unique_ptr<storage::File>> Open(
      const std::string& path, storage::OpenMode mode) override;
  absl::Status Rename(const std::string& from, const std::string& to) override;
  absl::Status Remove(const std::string& path) override;
  /// Is durable at once, as MakeDirectories is.
  absl::Status RemoveTree(const std::string& path) override;
  absl::Status MakeDirectories(const std::string& path) override;
  absl::StatusOr<std::vector<std::string>> List(
      const std::string& directory) override;
  absl::Status SyncDirectory(const std::string& directory) override;
  absl::StatusOr<bool> Exists(const std::string& path) override;
  absl::StatusOr<int64_t> FileSize(const std::string& path) override;
  absl::StatusOr<int64_t> FreeBytes(const std::string& path) override;
  absl::StatusOr<std::unique_ptr<storage::FileLock>> Lock(
      const std::string& path) override;

 private:
  class FaultFile;
  // A file, whatever its name.
  struct Node {
    std::string synced;
    // What may differ from it.
    int64_t changed_begin = std::numeric_limits<int64_t>::max();
    int64_t changed_end = 0;

    void Change(int64_t begin, int64_t end) {
      changed_begin = std::min(changed_begin, begin);
      changed_end = std::max(changed_end, end);
    }
  };
  using Names = std::map<std::string, std::shared_ptr<Node>>;

  struct Verdict {
    absl::Status status;
    bool perform = true;
  };
  // Counts a call and says whether it fails.
  Verdict Judge(const char* kind);
  // `call` as the verdict has it.
  template <typename Call>
  absl::Status Perform(const char* kind, const Call& call);
  // The node of an existing file; one that is new to us counts as synced.
  std::shared_ptr<Node> NodeOf(const std::string& path)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  storage::FileSystem& base_;
  mutable Mutex mutex_;
  std::optional<Fault> fault_ ABSL_GUARDED_BY(mutex_);
  bool fired_ ABSL_GUARDED_BY(mutex_) = false;
  std::string fault_kind_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, int64_t> calls_ ABSL_GUARDED_BY(mutex_);
  std::optional<int64_t> free_bytes_ ABSL_GUARDED_BY(mutex_);
  std::optional<std::string> held_ ABSL_GUARDED_BY(mutex_);
  int waiting_count_ ABSL_GUARDED_BY(mutex_) = 0;
  ConditionVariable hold_changed_;
  Names names_ ABSL_GUARDED_BY(mutex_);
  Names durable_names_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_FAULT_FILE_SYSTEM_H_
