#ifndef MAPSIEVE_TESTS_CODEC_CODEC_TEST_UTIL_H_
#define MAPSIEVE_TESTS_CODEC_CODEC_TEST_UTIL_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <numeric>
#include <random>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/cloud/point_cloud.h"
#include "core/codec/block_head.h"
#include "core/codec/points_codec.h"
#include "core/geometry/morton.h"

namespace mapsieve::core {

inline constexpr Compression kCompressions[] = {
    Compression::kNone, Compression::kLz4, Compression::kZstd};

inline LatticeCloud InMortonOrder(const LatticeCloud& cloud) {
  std::vector<uint32_t> rows(cloud.size());
  std::iota(rows.begin(), rows.end(), uint32_t{0});
  std::stable_sort(rows.begin(), rows.end(), [&](uint32_t a, uint32_t b) {
    return MortonLess(cloud.positions[a], cloud.positions[b]);
  });
  return cloud.Select(rows);
}

/// Adds a column of `type` whose value i has the low bytes of `bits(i)`.
template <typename Bits>
void AddColumn(LatticeCloud& cloud, std::string_view name, ScalarType type,
               Bits bits) {
  Column column({std::string(name), type}, cloud.size());
  const size_t width = column.value_size();
  for (size_t i = 0; i < cloud.size(); ++i) {
    const auto value = static_cast<uint64_t>(bits(i));
    std::memcpy(column.mutable_bytes().data() + i * width, &value, width);
  }
  cloud.attributes.columns().push_back(std::move(column));
}

/// `count` points with |q| <= `spread` on every axis around `centre`, and one
/// column of each type with bits of random length, every third column with
/// missing values.
inline LatticeCloud RandomCloud(uint64_t seed, size_t count, int64_t spread,
                                const LatticePoint& centre = {}) {
  std::mt19937_64 random(seed);
  std::uniform_int_distribution<int64_t> offset(-spread, spread);
  LatticeCloud cloud;
  cloud.lattice = Lattice(static_cast<int64_t>(random() % kMaxStepNm) + 1);
  for (size_t i = 0; i < count; ++i) {
    const int64_t x = offset(random);
    const int64_t y = offset(random);
    const int64_t z = offset(random);
    cloud.positions.push_back({centre.x + x, centre.y + y, centre.z + z});
  }
  for (int type = 1; type <= 10; ++type) {
    const uint64_t length = random() % 65;
    AddColumn(
        cloud, "column " + std::to_string(type), static_cast<ScalarType>(type),
        [&](size_t) { return length == 0 ? 0 : random() >> (64 - length); });
    if (type % 3 != 0) continue;
    Column& column = cloud.attributes.columns().back();
    for (size_t i = random() % 4; i < count; i += 1 + random() % 8) {
      column.SetMissing(i);
    }
  }
  return cloud;
}

/// A cloud of columns that each suit another transform.
/// `sorted`: along the Morton curve, for Morton codes. The clouds of the blocks
/// in testdata: never change it.
inline LatticeCloud VariedCloud(size_t count, bool sorted) {
  LatticeCloud cloud;
  const auto hash = [](size_t i, int64_t salt) {
    return HashIntegers(std::vector<int64_t>{static_cast<int64_t>(i), salt});
  };
  for (size_t i = 0; i < count; ++i) {
    cloud.positions.push_back(
        {331'050'000 + static_cast<int64_t>(hash(i, 1) % 30'000),
         5'183'020'000 + static_cast<int64_t>(hash(i, 2) % 20'000),
         -92'000 + static_cast<int64_t>(hash(i, 3) % 100)});
  }
  if (sorted) cloud = InMortonOrder(cloud);
  AddColumn(cloud, "noise", ScalarType::kUint8,
            [&](size_t i) { return hash(i, 4); });
  AddColumn(cloud, "class", ScalarType::kInt8,
            [](size_t i) { return i % 7 == 3 ? 2 : 1; });
  AddColumn(cloud, "intensity", ScalarType::kFloat32, [&](size_t i) {
    return 0x3f800000 | (hash(i, 5) & 0x3) << 21 | (hash(i, 6) & 0xff);
  });
  AddColumn(cloud, "beam", ScalarType::kUint32, [&](size_t i) {
    return 1'000'000 + 3 * i + hash(i % 53, 11) % 50'000;
  });
  AddColumn(cloud, "offset", ScalarType::kInt16, [&](size_t i) {
    return 500 + (hash(i, 7) & 0xf) - (hash(i, 8) & 0xf);
  });
  AddColumn(cloud, "time", ScalarType::kUint64, [&](size_t i) {
    return (uint64_t{1} << 60) + 1000 * i + hash(i, 9) % 1000;
  });
  AddColumn(cloud, "range", ScalarType::kFloat64, [&](size_t i) {
    return 0x4024000000000000 + (hash(i, 10) & 0xffffffff);
  });
  Column& range = cloud.attributes.columns().back();
  for (size_t i = 0; i < count; i += 5) range.SetMissing(i);
  return cloud;
}

/// The bytes of a block as its parts, so that a test can change one.
struct BlockParts {
  BlockHead head;
  std::vector<std::vector<std::byte>> stored;

  /// `block` is valid.
  static BlockParts Of(std::span<const std::byte> block) {
    BlockParts parts{ReadBlockHead(block).value(), {}};
    size_t at = parts.head.head_bytes;
    for (const ColumnEntry& entry : parts.head.columns) {
      const auto stored = block.subspan(at, entry.stored_bytes);
      parts.stored.emplace_back(stored.begin(), stored.end());
      at += entry.stored_bytes;
    }
    return parts;
  }

  /// A block of the parts with the checksums of the columns made right.
  std::vector<std::byte> Join() {
    for (size_t i = 0; i < stored.size(); ++i) {
      head.columns[i].checksum = Hash64(stored[i]);
    }
    std::vector<std::byte> block = FormatBlockHead(head);
    for (const auto& bytes : stored) {
      block.insert(block.end(), bytes.begin(), bytes.end());
    }
    return block;
  }
};

/// A block of `cloud` without compression whose columns x, y, z and attributes
/// have one transform after the other, beginning with kTransforms[first].
inline std::vector<std::byte> BlockOfTransforms(const LatticeCloud& cloud,
                                                size_t first) {
  BlockParts parts = BlockParts::Of(
      EncodePoints(cloud, {.compression = Compression::kNone}).value());
  for (size_t i = 0; i < parts.stored.size(); ++i) {
    ColumnEntry& entry = parts.head.columns[i];
    const size_t width = ScalarSize(entry.spec.type);
    entry.transform = kTransforms[(first + i) % kTransforms.size()];
    if (!SuitsWidth(entry.transform, width))
      entry.transform = Transform::kCoded;
    const size_t bitmap =
        entry.has_missing ? MissingBitmapBytes(cloud.size()) : 0;
    std::vector<std::byte>& stored = parts.stored[i];
    const std::vector<std::byte> values(
        stored.begin() + static_cast<ptrdiff_t>(bitmap), stored.end());
    stored.resize(bitmap);
    AppendTransformed(entry.transform, values, width, stored);
    entry.coded_bytes = static_cast<uint32_t>(stored.size());
    entry.stored_bytes = entry.coded_bytes;
  }
  return parts.Join();
}

/// Makes the checksum of the head right.
inline void SealHead(std::span<std::byte> block, size_t head_bytes) {
  const uint64_t checksum = Hash64(block.first(head_bytes - 8));
  std::memcpy(block.data() + head_bytes - 8, &checksum, 8);
}

}  // namespace mapsieve::core

#endif  // MAPSIEVE_TESTS_CODEC_CODEC_TEST_UTIL_H_
