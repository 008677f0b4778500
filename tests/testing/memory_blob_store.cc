#include "tests/testing/memory_blob_store.h"

#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "storage/names.h"
#include "storage/record_checks.h"

namespace mapsieve::testing {
namespace {

absl::Status CheckId(const storage::BlobId& id) {
  if (storage::IsHexId(id)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("blob id ", storage::Quoted(id)));
}

}  // namespace

absl::StatusOr<storage::BlobId> MemoryBlobStore::PutIfAbsent(
    std::span<const std::byte> bytes) {
  if (static_cast<int64_t>(bytes.size()) > storage::kMaxBlobBytes) {
    return absl::InvalidArgumentError("the blob is too large");
  }
  storage::BlobId id = ContentHash(bytes);
  MutexLock lock(mutex_);
  blobs_.try_emplace(id, bytes.begin(), bytes.end());
  return id;
}

absl::StatusOr<std::vector<std::byte>> MemoryBlobStore::Get(
    const storage::BlobId& id) const {
  MAPSIEVE_RETURN_IF_ERROR(CheckId(id));
  MutexLock lock(mutex_);
  const auto blob = blobs_.find(id);
  if (blob != blobs_.end()) return blob->second;
  return absl::NotFoundError(absl::StrCat("blob ", id));
}

absl::Status MemoryBlobStore::GetRange(const storage::BlobId& id,
                                       int64_t offset,
                                       std::span<std::byte> room) const {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes, Get(id));
  const auto whole = static_cast<int64_t>(bytes.size());
  const auto size = static_cast<int64_t>(room.size());
  if (offset < 0 || offset > whole || size > whole - offset) {
    return absl::OutOfRangeError(absl::StrCat(
        "blob ", id, ": ", size, " bytes at ", offset, " of ", whole));
  }
  std::copy_n(bytes.begin() + offset, size, room.begin());
  return absl::OkStatus();
}

absl::StatusOr<int64_t> MemoryBlobStore::Size(const storage::BlobId& id) const {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes, Get(id));
  return static_cast<int64_t>(bytes.size());
}

absl::Status MemoryBlobStore::Delete(const storage::BlobId& id) {
  MAPSIEVE_RETURN_IF_ERROR(CheckId(id));
  MutexLock lock(mutex_);
  blobs_.erase(id);
  return absl::OkStatus();
}

absl::StatusOr<std::vector<storage::BlobId>> MemoryBlobStore::List(
    const storage::BlobId& after, int64_t max_count) const {
  MAPSIEVE_RETURN_IF_ERROR(storage::CheckPageSize(max_count));
  if (!after.empty()) MAPSIEVE_RETURN_IF_ERROR(CheckId(after));
  MutexLock lock(mutex_);
  std::vector<storage::BlobId> ids;
  for (auto blob = blobs_.upper_bound(after);
       blob != blobs_.end() && std::ssize(ids) < max_count; ++blob) {
    ids.push_back(blob->first);
  }
  return ids;
}

}  // namespace mapsieve::testing
