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

absl::StatusOr<SpaceReserve::Claim> SpaceReserve::Take(int64_t bytes) const {
  // Counted before the free bytes are read: of two at the same time, at least
  // one sees the other.
  Claim claim(*this, bytes);
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t free,
                            file_system_.FreeBytes(directory_));
  if (free - reserve_bytes_ >= claimed_) return claim;
  return absl::ResourceExhaustedError(absl::StrCat(
      directory_, ": ", bytes, " bytes do not fit: ", free, " are free, ",
      reserve_bytes_, " of them kept in reserve; free some space"));
}

}  // namespace mapsieve::storage
