#ifndef MAPSIEVE_STORAGE_TILE_ORDER_H_
#define MAPSIEVE_STORAGE_TILE_ORDER_H_

#include <cstddef>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/geometry/cell_key.h"

namespace mapsieve::storage {

/// Bytes of every TileOrderKey.
inline constexpr size_t kTileOrderKeyBytes = 18;

/// A cell as a byte string: comparing the strings bytewise compares the cells
/// by CellKeyLess. FORMAT.md describes the bytes. `cell` is valid (below).
std::string TileOrderKey(const core::CellKey& cell);

/// The inverse. kDataLoss for bytes that are no key.
absl::StatusOr<core::CellKey> ParseTileOrderKey(std::string_view key);

/// Whether the level is 0 to core::kMaxCellLevel and the cell holds points
/// whose coordinates obey core::kLatticeLimit.
bool IsValidCell(const core::CellKey& cell);

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_TILE_ORDER_H_
