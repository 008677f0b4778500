#ifndef MAPSIEVE_SERVER_ENGINE_REQUEST_CHECKS_H_
#define MAPSIEVE_SERVER_ENGINE_REQUEST_CHECKS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/engine/types.h"

/// What callers of Engine ask for: refused with kInvalidArgument, which names
/// the field and the limit, or turned into what storage wants.
namespace mapsieve::engine {

absl::Status CheckAtLeastOne(const char* field, int value);

/// At most `limit` bytes.
absl::Status CheckLength(const char* field, const std::string& text,
                         size_t limit);

/// At most `limit` bytes and no control characters.
absl::Status CheckName(const char* field, const std::string& text,
                       size_t limit);

absl::Status CheckUploadSpec(const UploadSpec& spec);

/// How many records a page holds.
absl::StatusOr<int64_t> PageSize(const PageRequest& page);

/// Cuts `records`, of which one more than a page was asked for, to a page, and
/// returns the token of the next one.
template <typename Record, typename ToToken>
std::string CutPage(std::vector<Record>& records, int64_t size,
                    const ToToken& to_token) {
  if (static_cast<int64_t>(records.size()) <= size) return "";
  records.resize(static_cast<size_t>(size));
  return to_token(records.back());
}

/// The smallest level of tiles at least as large as asked for.
absl::StatusOr<int> TileLevel(const MapSpec& spec);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_REQUEST_CHECKS_H_
