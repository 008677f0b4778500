#ifndef MAPSIEVE_STORAGE_BLOB_STORE_H_
#define MAPSIEVE_STORAGE_BLOB_STORE_H_

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace mapsieve::storage {

/// The name of a blob: ContentHash of its bytes, 32 hexadecimal digits.
using BlobId = std::string;

/// Larger blobs are refused.
inline constexpr int64_t kMaxBlobBytes = int64_t{1} << 31;

/// Immutable objects named by their content. Thread-safe. Errors besides those
/// named below: kInvalidArgument for an id that is none, and the codes of
/// FileSystem for a failing medium.
class BlobStore {
 public:
  virtual ~BlobStore() = default;

  /// Stores `bytes` unless they are there, and returns their id. They are
  /// durable when it returns; after an error or a crash they are there whole
  /// or not at all. A damaged blob of that id is replaced. Concurrent calls
  /// share the waits for the medium: on a local disk four threads store about
  /// five times as many blobs a second as one.
  /// kInvalidArgument: more than kMaxBlobBytes; kResourceExhausted: disk full.
  virtual absl::StatusOr<BlobId> PutIfAbsent(
      std::span<const std::byte> bytes) = 0;

  /// The bytes of a blob, checked against its id. kNotFound; kDataLoss: they
  /// are not what was stored.
  virtual absl::StatusOr<std::vector<std::byte>> Get(
      const BlobId& id) const = 0;

  /// Fills `room` with the bytes at `offset`, which are not checked against
  /// the id: what they hold has to tell whether they are what was stored.
  /// kNotFound; kOutOfRange: the range is not inside the blob.
  virtual absl::Status GetRange(const BlobId& id, int64_t offset,
                                std::span<std::byte> room) const = 0;

  /// Where a blob lies or would lie, for messages: on a disk the path of its
  /// file.
  virtual std::string Location(const BlobId& id) const = 0;

  /// Bytes of a blob. kNotFound.
  virtual absl::StatusOr<int64_t> Size(const BlobId& id) const = 0;

  /// Removes a blob; OK if there is none. After a crash of the machine it may
  /// be there again.
  virtual absl::Status Delete(const BlobId& id) = 0;

  /// Up to `max_count` (> 0) ids in ascending order, those after `after`
  /// (empty: from the first); an empty page at the end. Blobs put or deleted
  /// meanwhile may show or not.
  virtual absl::StatusOr<std::vector<BlobId>> List(const BlobId& after,
                                                   int64_t max_count) const = 0;
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_BLOB_STORE_H_
