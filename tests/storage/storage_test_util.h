#ifndef MAPSIEVE_TESTS_STORAGE_STORAGE_TEST_UTIL_H_
#define MAPSIEVE_TESTS_STORAGE_STORAGE_TEST_UTIL_H_

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <iterator>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "storage/catalogue.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::storage {

using mapsieve::testing::TemporaryDirectory;

inline std::vector<std::byte> Bytes(std::string_view text) {
  const auto bytes = TextBytes(text);
  return {bytes.begin(), bytes.end()};
}

inline std::string Text(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

inline std::string ReadWholeFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

inline void WriteWholeFile(const std::string& path, std::string_view text) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << text;
}

/// A map of tiles with an edge of 1024 steps.
inline MapSpec TestMap(const std::string& id) {
  MapSpec spec;
  spec.id = id;
  spec.tile_level = 10;
  return spec;
}

/// A reference to the blob of `content` for tile (x, y, z) of a TestMap;
/// product points are curves. The bounds are one step at the tile's corner.
inline ChunkRef TestChunk(ChunkKind kind, int64_t x, int64_t y, int64_t z,
                          std::string_view content, int64_t point_count) {
  ChunkRef chunk;
  chunk.kind = kind;
  chunk.tile = {10, x, y, z};
  chunk.blob_id = ContentHash(TextBytes(content));
  chunk.stored_bytes = static_cast<int64_t>(content.size());
  chunk.point_count = point_count;
  if (kind == ChunkKind::kProduct) {
    chunk.label_counts[static_cast<size_t>(core::Label::kCurve)] = point_count;
  }
  const core::LatticePoint corner = chunk.tile.corner();
  chunk.bounds = {corner, {corner.x + 1, corner.y + 1, corner.z + 1}};
  return chunk;
}

inline RevisionChange Adding(std::vector<ChunkRef> added) {
  RevisionChange change;
  change.added = std::move(added);
  return change;
}

/// A change that makes a complete product of `added`.
inline RevisionChange Processing(std::vector<ChunkRef> added) {
  RevisionChange change;
  change.spec.kind = RevisionKind::kProcess;
  change.spec.product.emplace().options = "options";
  change.added = std::move(added);
  change.removes_product = true;
  return change;
}

/// `chunks` without their numbers, for comparison with what was added.
inline std::vector<ChunkRef> WithoutNumbers(std::vector<ChunkRef> chunks) {
  for (ChunkRef& chunk : chunks) chunk.number = 0;
  return chunks;
}

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_TESTS_STORAGE_STORAGE_TEST_UTIL_H_
