#include <cstring>
#include <random>
#include <set>
#include <string>

#include "core/base/bytes.h"
#include "core/codec/block_head.h"
#include "core/codec/compression.h"
#include "core/codec/points_codec.h"
#include "tests/codec/codec_test_util.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// Blocks that together use every transform, compression and kind of position
/// columns; checked to do so.
std::vector<std::vector<std::byte>> SmallBlocks() {
  std::vector<std::vector<std::byte>> blocks;
  for (const Compression compression : kCompressions) {
    const EncodeOptions options{.compression = compression};
    for (const bool sorted : {false, true}) {
      blocks.push_back(EncodePoints(VariedCloud(33, sorted), options).value());
    }
    blocks.push_back(
        EncodePoints(RandomCloud(5, 17, int64_t{1} << 40), options).value());
    blocks.push_back(EncodePoints(LatticeCloud(), options).value());
  }
  for (size_t first = 0; first < kTransforms.size(); first += 3) {
    blocks.push_back(BlockOfTransforms(VariedCloud(17, false), first));
  }
  std::set<std::string> used;
  for (const auto& block : blocks) {
    const BlockHead head = ReadBlockHead(block).value();
    for (const ColumnEntry& entry : head.columns) {
      used.insert(std::string(TransformName(entry.transform)));
      used.insert(std::string(CompressionName(entry.compression)));
      if (entry.has_missing) used.insert("missing");
    }
    used.insert(head.columns[0].spec.name +
                std::string(ScalarTypeName(head.columns[0].spec.type)));
  }
  EXPECT_THAT(
      used, ::testing::UnorderedElementsAre(
                "plain", "shuffle", "delta-shuffle", "delta-packed",
                "ascending-packed", "coded", "delta-coded", "ascending-coded",
                "median-coded", "halves-coded", "scaled-halves-coded", "none",
                "lz4", "zstd", "missing", "xint32", "xint64", "mortonuint64"));
  return blocks;
}

TEST(DamagedBlock, EveryFlippedByteIsDataLoss) {
  for (const auto& block : SmallBlocks()) {
    MAPSIEVE_ASSERT_OK(DecodePoints(block));
    auto damaged = block;
    for (size_t at = 0; at < block.size(); ++at) {
      for (const int mask : {1, 128, 255}) {
        damaged[at] = block[at] ^ static_cast<std::byte>(mask);
        EXPECT_THAT(DecodePoints(damaged), StatusIs(absl::StatusCode::kDataLoss,
                                                    HasSubstr("expected")))
            << "byte " << at << ", mask " << mask;
      }
      damaged[at] = block[at];
    }
  }
}

TEST(DamagedBlock, EveryTruncationIsDataLoss) {
  for (const auto& block : SmallBlocks()) {
    for (size_t size = 0; size < block.size(); ++size) {
      // A copy, so that a read beyond the end is one beyond the allocation.
      const std::vector<std::byte> cut(
          block.begin(), block.begin() + static_cast<ptrdiff_t>(size));
      EXPECT_THAT(DecodePoints(cut),
                  StatusIs(absl::StatusCode::kDataLoss, HasSubstr("expected")));
    }
    auto longer = block;
    longer.push_back(std::byte{0});
    EXPECT_THAT(DecodePoints(longer),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("expected")));
  }
}

/// What a hostile writer may do: any bytes under right checksums.
void ExpectRefusedOrRead(std::span<const std::byte> block) {
  const auto cloud = DecodePoints(block, {.max_decoded_bytes = 1 << 20});
  if (!cloud.ok()) {
    EXPECT_TRUE(absl::IsDataLoss(cloud.status()) ||
                absl::IsResourceExhausted(cloud.status()))
        << cloud.status();
    return;
  }
  const BlockHeader header = ReadBlockHeader(block).value();
  EXPECT_EQ(static_cast<int64_t>(cloud->size()), header.point_count);
  for (const LatticePoint& q : cloud->positions) {
    for (const auto& [v, low, high] :
         {std::tuple(q.x, header.min.x, header.max.x),
          std::tuple(q.y, header.min.y, header.max.y),
          std::tuple(q.z, header.min.z, header.max.z)}) {
      EXPECT_GT(v, -kLatticeLimit);
      EXPECT_LT(v, kLatticeLimit);
      EXPECT_GE(v, low);
      EXPECT_LE(v, high);
    }
  }
  for (const Column& column : cloud->attributes.columns()) {
    EXPECT_EQ(column.size(), cloud->size());
  }
}

TEST(HostileBlock, AnyByteOfTheHeadIsRefusedOrRead) {
  for (const auto& block : SmallBlocks()) {
    const size_t head_bytes = ReadBlockHead(block)->head_bytes;
    auto hostile = block;
    for (size_t at = 0; at < head_bytes - 8; ++at) {
      for (const int mask : {1, 2, 4, 8, 16, 32, 64, 128, 255}) {
        hostile[at] = block[at] ^ static_cast<std::byte>(mask);
        SealHead(hostile, head_bytes);
        ExpectRefusedOrRead(hostile);
      }
      hostile[at] = block[at];
    }
  }
}

TEST(HostileBlock, AnyByteOfAColumnIsRefusedOrRead) {
  std::mt19937_64 random(7);
  for (const auto& block : SmallBlocks()) {
    BlockParts parts = BlockParts::Of(block);
    for (auto& stored : parts.stored) {
      const auto original = stored;
      for (size_t at = 0; at < stored.size(); ++at) {
        for (const uint64_t mask :
             {uint64_t{1}, uint64_t{16}, uint64_t{128}, random() % 255 + 1}) {
          stored[at] = original[at] ^ static_cast<std::byte>(mask);
          ExpectRefusedOrRead(parts.Join());
        }
        stored[at] = original[at];
      }
    }
  }
}

/// Changes a head by `edit` and expects an error of `message`.
template <typename Edit>
void ExpectHeadRefused(const std::string& message, Edit edit) {
  BlockParts parts = BlockParts::Of(
      EncodePoints(VariedCloud(20, false), {.compression = Compression::kNone})
          .value());
  edit(parts.head);
  parts.stored.resize(parts.head.columns.size());
  for (size_t i = 0; i < parts.stored.size(); ++i) {
    parts.stored[i].resize(parts.head.columns[i].stored_bytes);
  }
  const auto block = parts.Join();
  EXPECT_THAT(DecodePoints(block),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr(message)));
  EXPECT_THAT(ReadBlockHeader(block),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr(message)));
}

TEST(HostileBlock, LyingNumbersAreRefusedByName) {
  ExpectHeadRefused("points: expected 0 to 16777216, have 16777217",
                    [](BlockHead& h) { h.point_count = 16'777'217; });
  ExpectHeadRefused("column \"x\": 21 values of 4 bytes: expected 84 to 84",
                    [](BlockHead& h) { h.point_count = 21; });
  ExpectHeadRefused("step in nm", [](BlockHead& h) { h.step_nm = 0; });
  ExpectHeadRefused("step in nm", [](BlockHead& h) { h.step_nm = -1; });
  ExpectHeadRefused("step in nm",
                    [](BlockHead& h) { h.step_nm = kMaxStepNm + 1; });
  ExpectHeadRefused("corner", [](BlockHead& h) { h.corner.y = kLatticeLimit; });
  ExpectHeadRefused("corner",
                    [](BlockHead& h) { h.corner.z = -kLatticeLimit - 1; });
  ExpectHeadRefused("min", [](BlockHead& h) { h.min.x = -kLatticeLimit; });
  ExpectHeadRefused("max", [](BlockHead& h) { h.max.x = h.min.x - 1; });
  ExpectHeadRefused("type of 1 to 10, have 11", [](BlockHead& h) {
    h.columns[3].spec.type = static_cast<ScalarType>(11);
  });
  ExpectHeadRefused("transform of 0 to 10 in version 2, have 11",
                    [](BlockHead& h) {
                      h.columns[3].transform = static_cast<Transform>(11);
                    });
  ExpectHeadRefused(
      "type of at least 2 bytes for transform 9",
      [](BlockHead& h) { h.columns[3].transform = Transform::kHalvesCoded; });
  ExpectHeadRefused("compression of 0 to 2, have 3", [](BlockHead& h) {
    h.columns[3].compression = static_cast<Compression>(3);
  });
  ExpectHeadRefused("have 4294967295", [](BlockHead& h) {
    h.columns[3].coded_bytes = 0xffffffff;
  });
  ExpectHeadRefused("expected 20 stored bytes, have 21",
                    [](BlockHead& h) { h.columns[3].stored_bytes = 21; });
  ExpectHeadRefused(
      "expected less than 20 stored bytes, have 20",
      [](BlockHead& h) { h.columns[3].compression = Compression::kLz4; });
  ExpectHeadRefused("length of a column name",
                    [](BlockHead& h) { h.columns[3].spec.name.clear(); });
  ExpectHeadRefused("length of a column name", [](BlockHead& h) {
    h.columns[3].spec.name.assign(256, 'n');
  });
  ExpectHeadRefused("two attributes are named \"class\"",
                    [](BlockHead& h) { h.columns[3].spec.name = "class"; });
  ExpectHeadRefused("expected to begin with the columns x, y, z",
                    [](BlockHead& h) { h.columns[1].spec.name = "x"; });
  ExpectHeadRefused(
      "expected to begin with the columns x, y, z",
      [](BlockHead& h) { h.columns[2].spec.type = ScalarType::kUint32; });
  ExpectHeadRefused("expected to begin with the columns x, y, z",
                    [](BlockHead& h) { h.columns.resize(2); });
}

TEST(HostileBlock, LyingLengthsAreRefused) {
  const auto block = EncodePoints(VariedCloud(20, false)).value();
  const size_t head_bytes = ReadBlockHead(block)->head_bytes;
  const auto expect_refused = [&](size_t at, auto value, size_t size,
                                  const std::string& message) {
    std::vector<std::byte> lying = block;
    lying.resize(size);
    std::memcpy(lying.data() + at, &value, sizeof(value));
    SealHead(lying, head_bytes);
    EXPECT_THAT(DecodePoints(lying),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr(message)));
  };
  const auto bytes = uint64_t{block.size()};
  expect_refused(8, bytes + 1, block.size() + 1, "head and columns have");
  expect_refused(8, bytes - 1, block.size() - 1, "head and columns have");
  expect_refused(8, bytes + 1, block.size(), "point block: expected");
  expect_refused(8, ~uint64_t{0}, block.size(), "bytes of the block");
  for (const uint32_t lie : {uint32_t{0}, uint32_t{133}, ~uint32_t{0},
                             static_cast<uint32_t>(bytes + 1)}) {
    expect_refused(16, lie, block.size(), "bytes of the head: expected 134 to");
  }
  for (const uint32_t lie :
       {uint32_t{134}, static_cast<uint32_t>(head_bytes - 1),
        static_cast<uint32_t>(head_bytes + 1), static_cast<uint32_t>(bytes)}) {
    expect_refused(16, lie, block.size(),
                   "head of a point block: expected the checksum");
  }
  const auto columns =
      static_cast<uint16_t>(ReadBlockHead(block)->columns.size());
  expect_refused(6, static_cast<uint16_t>(columns + 1), block.size(),
                 "type at offset");
  expect_refused(6, static_cast<uint16_t>(columns - 1), block.size(),
                 "columns to end at offset");
}

TEST(HostileBlock, MessagesShowAnyNameAsText) {
  ExpectHeadRefused("column \"\\000\\377\\n\": expected a type",
                    [](BlockHead& h) {
                      h.columns[3].spec.name.assign("\0\xff\n", 3);
                      h.columns[3].spec.type = static_cast<ScalarType>(0);
                    });
}

TEST(HostileBlock, MissingPositionsAreRefused) {
  BlockParts parts = BlockParts::Of(
      EncodePoints(VariedCloud(8, false), {.compression = Compression::kNone})
          .value());
  parts.head.columns[2].has_missing = true;
  parts.head.columns[2].coded_bytes += 1;
  parts.head.columns[2].stored_bytes += 1;
  parts.stored[2].insert(parts.stored[2].begin(), std::byte{0});
  EXPECT_THAT(DecodePoints(parts.Join()),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("none with missing values")));
}

TEST(HostileBlock, BoundsThatAreNotThoseOfThePointsAreRefused) {
  for (const bool sorted : {false, true}) {
    BlockParts parts =
        BlockParts::Of(EncodePoints(VariedCloud(20, sorted)).value());
    const BlockHead head = parts.head;
    parts.head.max.z += 1;
    EXPECT_THAT(DecodePoints(parts.Join()),
                StatusIs(absl::StatusCode::kDataLoss,
                         HasSubstr("expected points from")));
    parts.head = head;
    parts.head.corner.x -= 1;
    EXPECT_THAT(DecodePoints(parts.Join()),
                StatusIs(absl::StatusCode::kDataLoss,
                         HasSubstr("expected points from")));
  }
  BlockParts empty = BlockParts::Of(EncodePoints(LatticeCloud()).value());
  empty.head.max.x = 1;
  EXPECT_THAT(DecodePoints(empty.Join()),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("empty block")));
}

TEST(HostileBlock, MortonCodesOf64BitsAreRefused) {
  LatticeCloud cloud;
  cloud.positions = {{1, 2, 3}};
  BlockParts parts = BlockParts::Of(EncodePoints(cloud).value());
  ColumnEntry& entry = parts.head.columns[0];
  ASSERT_EQ(entry.spec.name, kMortonName);
  entry.transform = Transform::kPlain;
  entry.compression = Compression::kNone;
  entry.coded_bytes = entry.stored_bytes = 8;
  const uint64_t code = MortonCode(1, 2, 3);
  for (const uint64_t top : {uint64_t{0}, uint64_t{1} << 63}) {
    ByteWriter writer;
    writer.Put(code | top);
    parts.stored[0] = writer.bytes();
    const auto result = DecodePoints(parts.Join());
    EXPECT_EQ(result.ok(), top == 0) << result.status();
  }
}

TEST(HostileBlock, BitmapBitsBeyondThePointsAreRefused) {
  LatticeCloud cloud;
  cloud.positions.resize(3);
  AddColumn(cloud, "a", ScalarType::kUint8, [](size_t) { return 9; });
  cloud.attributes.Find("a")->SetMissing(1);
  BlockParts parts = BlockParts::Of(
      EncodePoints(cloud, {.compression = Compression::kNone}).value());
  ASSERT_EQ(parts.stored[3].size(), 4u);
  EXPECT_EQ(parts.stored[3][0], std::byte{0b010});
  parts.stored[3][0] = std::byte{0b1010};
  EXPECT_THAT(DecodePoints(parts.Join()),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("beyond the last point")));
}

TEST(HostileBlock, TheValueOfAMissingPointIsNotRead) {
  LatticeCloud cloud;
  cloud.positions.resize(3);
  AddColumn(cloud, "a", ScalarType::kUint8, [](size_t) { return 9; });
  cloud.attributes.Find("a")->SetMissing(1);
  BlockParts parts = BlockParts::Of(
      EncodePoints(cloud, {.compression = Compression::kNone}).value());
  parts.stored[3][2] = std::byte{77};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud back,
                                DecodePoints(parts.Join()));
  EXPECT_EQ(back.attributes, cloud.attributes);
}

TEST(HostileBlock, ABombIsRefusedBeforeItIsDecompressed) {
  for (const Compression compression :
       {Compression::kLz4, Compression::kZstd}) {
    // Four million equal points and an attribute: 117 MB.
    const size_t count = kMaxBlockPoints / 4;
    const std::vector<std::byte> zeros(4 * count);
    const auto stored = Compress(compression, zeros);
    BlockParts bomb;
    bomb.head.step_nm = 1;
    bomb.head.point_count = static_cast<uint32_t>(count);
    for (const char* name : {"x", "y", "z", "a"}) {
      ColumnEntry entry;
      entry.spec = {name, ScalarType::kInt32};
      entry.compression = compression;
      entry.coded_bytes = static_cast<uint32_t>(zeros.size());
      entry.stored_bytes = static_cast<uint32_t>(stored.size());
      bomb.head.columns.push_back(entry);
      bomb.stored.push_back(stored);
    }
    const auto block = bomb.Join();
    EXPECT_LT(block.size(), size_t{1} << 19);
    EXPECT_EQ(ReadBlockHeader(block)->decoded_bytes, 7 * kMaxBlockPoints);
    EXPECT_THAT(DecodePoints(block, {.max_decoded_bytes = 64 << 20}),
                StatusIs(absl::StatusCode::kResourceExhausted,
                         HasSubstr("the limit is 67108864")));
  }
}

TEST(HostileBlock, CompressedBytesOfAnotherLengthAreRefused) {
  LatticeCloud cloud;
  cloud.positions.resize(1000);
  for (const Compression compression :
       {Compression::kLz4, Compression::kZstd}) {
    for (const size_t size : {3999, 4001, 100'000}) {
      BlockParts parts = BlockParts::Of(
          EncodePoints(cloud, {.compression = Compression::kNone}).value());
      ColumnEntry& entry = parts.head.columns[0];
      parts.stored[0] = Compress(compression, std::vector<std::byte>(size));
      entry.compression = compression;
      entry.stored_bytes = static_cast<uint32_t>(parts.stored[0].size());
      EXPECT_THAT(DecodePoints(parts.Join()),
                  StatusIs(absl::StatusCode::kDataLoss,
                           AllOf(HasSubstr("column \"x\""),
                                 HasSubstr("expected 4000 bytes"))));
    }
  }
}

}  // namespace
}  // namespace mapsieve::core
