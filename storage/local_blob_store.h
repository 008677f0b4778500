#ifndef MAPSIEVE_STORAGE_LOCAL_BLOB_STORE_H_
#define MAPSIEVE_STORAGE_LOCAL_BLOB_STORE_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "storage/blob_store.h"
#include "storage/file_system.h"
#include "storage/space_reserve.h"

namespace mapsieve::storage {

/// Opens the blobs below `directory`, which is made if absent: one file a blob,
/// named by its id, in 256 folders named by the first two digits. Unfinished
/// files of an earlier process are removed. The caller sees to it that one
/// store at a time has the directory. Both references outlive the store.
absl::StatusOr<std::unique_ptr<BlobStore>> OpenLocalBlobStore(
    FileSystem& file_system, const std::string& directory,
    const SpaceReserve& reserve);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_LOCAL_BLOB_STORE_H_
