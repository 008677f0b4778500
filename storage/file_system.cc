#include "storage/file_system.h"

#include "absl/strings/str_cat.h"
#include "core/base/status.h"

namespace mapsieve::storage {

std::string JoinPath(const std::string& directory, const std::string& name) {
  return absl::StrCat(directory, "/", name);
}

absl::StatusOr<std::vector<std::byte>> ReadExactly(const File& file,
                                                   const std::string& path,
                                                   int64_t offset,
                                                   int64_t size) {
  std::vector<std::byte> bytes(static_cast<size_t>(size));
  MAPSIEVE_ASSIGN_OR_RETURN(const size_t got, file.ReadAt(offset, bytes));
  if (got != bytes.size()) {
    return absl::DataLossError(absl::StrCat(path, ", offset ", offset,
                                            ": expected ", size,
                                            " bytes, the file holds ", got));
  }
  return bytes;
}

}  // namespace mapsieve::storage
