#ifndef MAPSIEVE_TESTS_TESTING_MEMORY_BLOB_STORE_H_
#define MAPSIEVE_TESTS_TESTING_MEMORY_BLOB_STORE_H_

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "core/base/mutex.h"
#include "storage/blob_store.h"

namespace mapsieve::testing {

/// A BlobStore that lives as long as the object: what the interface says, as
/// plainly as possible.
class MemoryBlobStore final : public storage::BlobStore {
 public:
  absl::StatusOr<storage::BlobId> PutIfAbsent(
      std::span<const std::byte> bytes) override;
  absl::StatusOr<std::vector<std::byte>> Get(
      const storage::BlobId& id) const override;
  absl::Status GetRange(const storage::BlobId& id, int64_t offset,
                        std::span<std::byte> room) const override;
  absl::StatusOr<int64_t> Size(const storage::BlobId& id) const override;
  std::string Location(const storage::BlobId& id) const override {
    return "memory, blob " + id;
  }
  absl::Status Delete(const storage::BlobId& id) override;
  absl::StatusOr<std::vector<storage::BlobId>> List(
      const storage::BlobId& after, int64_t max_count) const override;

 private:
  mutable Mutex mutex_;
  std::map<storage::BlobId, std::vector<std::byte>> blobs_
      ABSL_GUARDED_BY(mutex_);
};

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_MEMORY_BLOB_STORE_H_
