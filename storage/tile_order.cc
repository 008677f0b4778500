#include "storage/tile_order.h"

#include <cstdint>

#include "absl/strings/str_cat.h"

namespace mapsieve::storage {
namespace {

constexpr int kPartBits = 21;
constexpr uint64_t kBias = static_cast<uint64_t>(core::kLatticeLimit);

void AppendBigEndian(uint64_t value, std::string& key) {
  for (int shift = 56; shift >= 0; shift -= 8) {
    key += static_cast<char>(value >> shift & 0xff);
  }
}

uint64_t LoadBigEndian(std::string_view bytes) {
  uint64_t value = 0;
  for (const char c : bytes) value = value << 8 | static_cast<uint8_t>(c);
  return value;
}

// Bits [low, low + 21) of the three coordinates.
uint64_t CodeOfPart(uint64_t x, uint64_t y, uint64_t z, int low) {
  return core::MortonCode(x >> low, y >> low, z >> low);
}

}  // namespace

bool IsValidCell(const core::CellKey& cell) {
  if (cell.level < 0 || cell.level > core::kMaxCellLevel) return false;
  const int64_t first = -core::kLatticeLimit >> cell.level;
  const int64_t last = (core::kLatticeLimit - 1) >> cell.level;
  const auto inside = [&](int64_t v) { return v >= first && v <= last; };
  return inside(cell.x) && inside(cell.y) && inside(cell.z);
}

std::string TileOrderKey(const core::CellKey& cell) {
  const uint64_t x = static_cast<uint64_t>(cell.x) + kBias;
  const uint64_t y = static_cast<uint64_t>(cell.y) + kBias;
  const uint64_t z = static_cast<uint64_t>(cell.z) + kBias;
  std::string key;
  key.reserve(kTileOrderKeyBytes);
  key += static_cast<char>(cell.level);
  key += static_cast<char>(CodeOfPart(x, y, z, 2 * kPartBits));
  AppendBigEndian(CodeOfPart(x, y, z, kPartBits), key);
  AppendBigEndian(CodeOfPart(x, y, z, 0), key);
  return key;
}

absl::StatusOr<core::CellKey> ParseTileOrderKey(std::string_view key) {
  if (key.size() != kTileOrderKeyBytes) {
    return absl::DataLossError(absl::StrCat(
        "tile key: expected ", kTileOrderKeyBytes, " bytes, got ", key.size()));
  }
  const auto top = static_cast<uint8_t>(key[1]);
  const uint64_t middle = LoadBigEndian(key.substr(2, 8));
  const uint64_t low = LoadBigEndian(key.substr(10, 8));
  const auto coordinate = [&](int axis) {
    const uint64_t value = core::GatherBits3(top >> axis) << 2 * kPartBits |
                           core::GatherBits3(middle >> axis) << kPartBits |
                           core::GatherBits3(low >> axis);
    return static_cast<int64_t>(value - kBias);
  };
  const core::CellKey cell{static_cast<uint8_t>(key[0]), coordinate(0),
                           coordinate(1), coordinate(2)};
  if (!IsValidCell(cell) || TileOrderKey(cell) != key) {
    return absl::DataLossError(
        absl::StrCat("tile key: no cell of the octree: ", cell.ToString()));
  }
  return cell;
}

}  // namespace mapsieve::storage
