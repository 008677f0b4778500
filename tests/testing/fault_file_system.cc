#include "tests/testing/fault_file_system.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include "core/base/status.h"

namespace mapsieve::testing {
namespace {

constexpr char kGarbage = '\xa5';
constexpr size_t kSectorBytes = 512;

std::string ReadAll(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void WriteAll(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
}

std::string ParentOf(const std::string& path) {
  return std::filesystem::path(path).parent_path().string();
}

}  // namespace

class FaultFileSystem::FaultFile final : public storage::File {
 public:
  FaultFile(FaultFileSystem& owner, std::unique_ptr<storage::File> base,
            std::shared_ptr<Node> node)
      : owner_(owner), base_(std::move(base)), node_(std::move(node)) {}

  absl::StatusOr<size_t> ReadAt(int64_t offset,
                                std::span<std::byte> buffer) const override {
    MAPSIEVE_RETURN_IF_ERROR(owner_.Judge("read").status);
    return base_->ReadAt(offset, buffer);
  }
  absl::Status WriteAt(int64_t offset,
                       std::span<const std::byte> bytes) override {
    const Verdict verdict = owner_.Judge("write");
    const size_t size = verdict.perform ? bytes.size() : bytes.size() / 2;
    {
      MutexLock lock(owner_.mutex_);
      node_->Change(offset, offset + static_cast<int64_t>(size));
    }
    MAPSIEVE_RETURN_IF_ERROR(base_->WriteAt(offset, bytes.first(size)));
    return verdict.status;
  }
  absl::Status Truncate(int64_t size) override {
    return owner_.Perform("truncate", [&]() -> absl::Status {
      MAPSIEVE_ASSIGN_OR_RETURN(const int64_t before, base_->Size());
      {
        MutexLock lock(owner_.mutex_);
        node_->Change(std::min(before, size), std::max(before, size));
      }
      return base_->Truncate(size);
    });
  }
  absl::Status Sync() override {
    if (!sync_failure_.ok()) return sync_failure_;
    const Verdict verdict = owner_.Judge("sync");
    sync_failure_ = verdict.status;
    MutexLock lock(owner_.mutex_);
    const int64_t begin = std::exchange(node_->changed_begin,
                                        std::numeric_limits<int64_t>::max());
    const int64_t end = std::exchange(node_->changed_end, 0);
    if (!verdict.perform) return sync_failure_;
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, base_->Size());
    std::string& synced = node_->synced;
    synced.resize(static_cast<size_t>(size));
    if (begin < std::min(end, size)) {
      const auto changed = std::span(synced).subspan(
          static_cast<size_t>(begin),
          static_cast<size_t>(std::min(end, size) - begin));
      MAPSIEVE_RETURN_IF_ERROR(
          base_->ReadAt(begin, std::as_writable_bytes(changed)).status());
    }
    return sync_failure_;
  }
  absl::StatusOr<int64_t> Size() const override {
    MAPSIEVE_RETURN_IF_ERROR(owner_.Judge("size").status);
    return base_->Size();
  }

 private:
  FaultFileSystem& owner_;
  const std::unique_ptr<storage::File> base_;
  const std::shared_ptr<Node> node_;
  absl::Status sync_failure_;
};

void FaultFileSystem::Arm(const Fault& fault) {
  MutexLock lock(mutex_);
  fault_ = fault;
  fired_ = false;
  fault_kind_.clear();
}

void FaultFileSystem::Disarm() {
  MutexLock lock(mutex_);
  fault_.reset();
}

bool FaultFileSystem::fired() const {
  MutexLock lock(mutex_);
  return fired_;
}

std::string FaultFileSystem::fault_kind() const {
  MutexLock lock(mutex_);
  return fault_kind_;
}

int64_t FaultFileSystem::call_count(const std::string& kind) const {
  MutexLock lock(mutex_);
  const auto count = calls_.find(kind);
  return count == calls_.end() ? 0 : count->second;
}

void FaultFileSystem::SetFreeBytes(int64_t bytes) {
  MutexLock lock(mutex_);
  free_bytes_ = bytes;
}

void FaultFileSystem::Hold(const std::string& part) {
  MutexLock lock(mutex_);
  held_ = part;
}

void FaultFileSystem::Release() {
  {
    MutexLock lock(mutex_);
    held_.reset();
  }
  hold_changed_.notify_all();
}

void FaultFileSystem::AwaitHeld() {
  MutexLock lock(mutex_);
  while (waiting_count_ == 0) hold_changed_.wait(mutex_);
}

FaultFileSystem::Verdict FaultFileSystem::Judge(const char* kind) {
  MutexLock lock(mutex_);
  ++calls_[kind];
  if (!fault_.has_value() || --fault_->operation > 0) return {};
  if (fault_->operation < 0 && !fault_->lasts) return {};
  if (!fired_) fault_kind_ = kind;
  fired_ = true;
  return {fault_->status, fault_->takes_effect};
}

template <typename Call>
absl::Status FaultFileSystem::Perform(const char* kind, const Call& call) {
  const Verdict verdict = Judge(kind);
  if (!verdict.perform) return verdict.status;
  MAPSIEVE_RETURN_IF_ERROR(call());
  return verdict.status;
}

std::shared_ptr<FaultFileSystem::Node> FaultFileSystem::NodeOf(
    const std::string& path) {
  auto& node = names_[path];
  if (node == nullptr) {
    node = std::make_shared<Node>(Node{.synced = ReadAll(path)});
    durable_names_[path] = node;
  }
  return node;
}

absl::StatusOr<std::unique_ptr<storage::File>> FaultFileSystem::Open(
    const std::string& path, storage::OpenMode mode) {
  {
    MutexLock lock(mutex_);
    const auto is_held = [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
      return held_.has_value() && path.find(*held_) != std::string::npos;
    };
    if (is_held()) {
      ++waiting_count_;
      hold_changed_.notify_all();
      while (is_held()) hold_changed_.wait(mutex_);
      --waiting_count_;
    }
  }
  std::unique_ptr<storage::File> file;
  std::shared_ptr<Node> node;
  const absl::Status status = Perform("open", [&]() -> absl::Status {
    MutexLock lock(mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const bool existed, base_.Exists(path));
    MAPSIEVE_ASSIGN_OR_RETURN(file, base_.Open(path, mode));
    if (existed) {
      node = NodeOf(path);
    } else {
      node = names_[path] = std::make_shared<Node>();
    }
    return absl::OkStatus();
  });
  if (!status.ok()) return status;
  return std::make_unique<FaultFile>(*this, std::move(file), std::move(node));
}

absl::Status FaultFileSystem::Rename(const std::string& from,
                                     const std::string& to) {
  return Perform("rename", [&]() -> absl::Status {
    MutexLock lock(mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const bool replaces, base_.Exists(to));
    if (replaces) NodeOf(to);
    const auto node = NodeOf(from);
    MAPSIEVE_RETURN_IF_ERROR(base_.Rename(from, to));
    names_.erase(from);
    names_[to] = node;
    return absl::OkStatus();
  });
}

absl::Status FaultFileSystem::Remove(const std::string& path) {
  return Perform("remove", [&]() -> absl::Status {
    MutexLock lock(mutex_);
    MAPSIEVE_ASSIGN_OR_RETURN(const bool exists, base_.Exists(path));
    if (exists) NodeOf(path);
    MAPSIEVE_RETURN_IF_ERROR(base_.Remove(path));
    names_.erase(path);
    return absl::OkStatus();
  });
}

absl::Status FaultFileSystem::RemoveTree(const std::string& path) {
  return Perform("remove tree", [&]() -> absl::Status {
    MutexLock lock(mutex_);
    for (Names* names : {&names_, &durable_names_}) {
      std::erase_if(*names, [&](const auto& entry) {
        return entry.first.starts_with(path + "/");
      });
    }
    return base_.RemoveTree(path);
  });
}

absl::Status FaultFileSystem::MakeDirectories(const std::string& path) {
  return Perform("make directories",
                 [&] { return base_.MakeDirectories(path); });
}

absl::StatusOr<std::vector<std::string>> FaultFileSystem::List(
    const std::string& directory) {
  MAPSIEVE_RETURN_IF_ERROR(Judge("list").status);
  return base_.List(directory);
}

absl::Status FaultFileSystem::SyncDirectory(const std::string& directory) {
  return Perform("sync directory", [&]() -> absl::Status {
    MAPSIEVE_RETURN_IF_ERROR(base_.SyncDirectory(directory));
    MutexLock lock(mutex_);
    const auto inside = [&](const auto& entry) {
      return ParentOf(entry.first) == directory;
    };
    std::erase_if(durable_names_, inside);
    std::copy_if(names_.begin(), names_.end(),
                 std::inserter(durable_names_, durable_names_.end()), inside);
    return absl::OkStatus();
  });
}

absl::StatusOr<bool> FaultFileSystem::Exists(const std::string& path) {
  MAPSIEVE_RETURN_IF_ERROR(Judge("exists").status);
  return base_.Exists(path);
}

absl::StatusOr<int64_t> FaultFileSystem::FileSize(const std::string& path) {
  MAPSIEVE_RETURN_IF_ERROR(Judge("size").status);
  return base_.FileSize(path);
}

absl::StatusOr<int64_t> FaultFileSystem::FreeBytes(const std::string& path) {
  {
    MutexLock lock(mutex_);
    if (free_bytes_.has_value()) return *free_bytes_;
  }
  return base_.FreeBytes(path);
}

absl::StatusOr<std::unique_ptr<storage::FileLock>> FaultFileSystem::Lock(
    const std::string& path) {
  return base_.Lock(path);
}

void FaultFileSystem::LosePower(Loss loss) {
  MutexLock lock(mutex_);
  if (loss != Loss::kEverything) {
    std::mt19937_64 random(names_.size());
    for (const auto& [path, node] : names_) {
      const std::string written = ReadAll(path);
      std::string& synced = node->synced;
      synced.resize(written.size(), kGarbage);
      if (loss == Loss::kSomeContent) {
        for (size_t at = 0; at < written.size(); at += kSectorBytes) {
          if (random() % 2 == 0) continue;
          synced.replace(at, kSectorBytes, written, at, kSectorBytes);
        }
      }
      WriteAll(path, synced);
    }
  } else {
    for (const auto& [path, node] : names_) {
      if (!durable_names_.contains(path)) std::filesystem::remove(path);
    }
    for (const auto& [path, node] : durable_names_) {
      WriteAll(path, node->synced);
    }
    names_ = durable_names_;
  }
  durable_names_ = names_;
  for (const auto& [path, node] : names_) *node = {.synced = node->synced};
}

}  // namespace mapsieve::testing
