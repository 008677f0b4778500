#include "storage/file_system.h"

#include "absl/strings/str_cat.h"
#include "core/base/status.h"

namespace mapsieve::storage {

std::string JoinPath(const std::string& directory, const std::string& name) {
  return absl::StrCat(directory, "/", name);
}

absl::Status ReadExactly(const File& file, const std::string& path,
                         int64_t offset, std::span<std::byte> room) {
  MAPSIEVE_ASSIGN_OR_RETURN(const size_t got, file.ReadAt(offset, room));
  if (got == room.size()) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(path, ", offset ", offset,
                                          ": expected ", room.size(),
                                          " bytes, the file holds ", got));
}

absl::StatusOr<std::vector<std::byte>> ReadExactly(const File& file,
                                                   const std::string& path,
                                                   int64_t offset,
                                                   int64_t size) {
  std::vector<std::byte> bytes(static_cast<size_t>(size));
  MAPSIEVE_RETURN_IF_ERROR(ReadExactly(file, path, offset, bytes));
  return bytes;
}

}  // namespace mapsieve::storage
