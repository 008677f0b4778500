#include "storage/space_reserve.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"

namespace mapsieve::storage {

SpaceReserve::SpaceReserve(FileSystem& file_system, std::string directory,
                           int64_t reserve_bytes)
    : file_system_(file_system),
      directory_(std::move(directory)),
      reserve_bytes_(reserve_bytes) {}

absl::Status SpaceReserve::Check(int64_t bytes) const {
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t free,
                            file_system_.FreeBytes(directory_));
  if (free - reserve_bytes_ >= bytes) return absl::OkStatus();
  return absl::ResourceExhaustedError(absl::StrCat(
      directory_, ": ", bytes, " bytes do not fit: ", free, " are free, ",
      reserve_bytes_, " of them kept in reserve; free some space"));
}

}  // namespace mapsieve::storage
