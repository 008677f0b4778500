#include <algorithm>
#include <fstream>
#include <iterator>
#include <set>
#include <sstream>
#include <string>

#include "core/base/bytes.h"
#include "core/codec/block_head.h"
#include "core/codec/points_codec.h"
#include "tests/codec/codec_test_util.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

const std::string kRoot = MAPSIEVE_SOURCE_DIR;

/// The bytes of a text of hexadecimal pairs.
std::vector<std::byte> FromHex(const std::string& text) {
  std::istringstream pairs(text);
  std::vector<std::byte> bytes;
  for (std::string pair; pairs >> pair;) {
    bytes.push_back(static_cast<std::byte>(std::stoi(pair, nullptr, 16)));
  }
  return bytes;
}

std::vector<std::byte> ReadGoldenBlock(const std::string& name) {
  std::ifstream file(kRoot + "/tests/codec/testdata/" + name, std::ios::binary);
  EXPECT_TRUE(file.is_open()) << name;
  const std::string bytes{std::istreambuf_iterator<char>(file), {}};
  const auto view = TextBytes(bytes);
  return {view.begin(), view.end()};
}

/// The bytes of the example of FORMAT.md: lines "offset | bytes | meaning".
std::vector<std::byte> ExampleOfTheFormat() {
  std::ifstream file(kRoot + "/core/codec/FORMAT.md");
  std::vector<std::byte> bytes;
  bool inside = false;
  for (std::string line; std::getline(file, line);) {
    if (line == "```") {
      inside = !inside;
    } else if (inside) {
      const size_t bar = line.find('|');
      const size_t offset = std::stoul(line.substr(0, bar), nullptr, 16);
      EXPECT_EQ(offset, bytes.size()) << line;
      const auto more =
          FromHex(line.substr(bar + 1, line.find('|', bar + 1) - bar - 1));
      bytes.insert(bytes.end(), more.begin(), more.end());
    }
  }
  return bytes;
}

TEST(BlockFormat, ExampleIsWhatIsReadAndWritten) {
  LatticeCloud cloud;
  cloud.positions = {{1000, -2002, 3005}, {1001, -2000, 3000}};
  AddColumn(cloud, "intensity", ScalarType::kUint16,
            [](size_t i) { return i == 0 ? 7 : 65535; });
  const std::vector<std::byte> example = ExampleOfTheFormat();
  ASSERT_EQ(example.size(), 240u);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud read, DecodePoints(example));
  EXPECT_EQ(read.lattice, cloud.lattice);
  EXPECT_EQ(read.positions, cloud.positions);
  EXPECT_EQ(read.attributes, cloud.attributes);
  EXPECT_EQ(EncodePoints(cloud, {.compression = Compression::kNone}).value(),
            example);
}

TEST(BlockFormat, Version1HasNoCodedColumns) {
  std::vector<std::byte> block = ReadGoldenBlock("v1_axes_plain.block");
  const size_t head_bytes = ReadBlockHead(block)->head_bytes;
  // The transform of column x.
  block[105] = static_cast<std::byte>(Transform::kCoded);
  SealHead(block, head_bytes);
  EXPECT_THAT(
      DecodePoints(block),
      ::mapsieve::testing::StatusIs(
          absl::StatusCode::kDataLoss,
          ::testing::HasSubstr("transform of 0 to 4 in version 1, have 5")));
}

struct GoldenBlock {
  const char* file;
  LatticeCloud cloud;
};

/// Blocks that a version wrote once. They are read for ever: never replace one.
std::vector<GoldenBlock> GoldenBlocks() {
  LatticeCloud wide;
  for (const int64_t x : {-1, 1}) {
    for (const int64_t y : {-1, 1}) {
      wide.positions.push_back(
          {x * (kLatticeLimit - 1), y * (kLatticeLimit - 1), x * y});
    }
  }
  LatticeCloud empty;
  empty.lattice = Lattice(250'000);
  return {{"v1_axes_plain.block", VariedCloud(20, false)},
          {"v1_axes_lz4.block", VariedCloud(60, false)},
          {"v1_axes_zstd.block", VariedCloud(60, false)},
          {"v1_morton_lz4.block", VariedCloud(60, true)},
          {"v1_morton_zstd.block", VariedCloud(60, true)},
          {"v1_all_transforms.block", VariedCloud(30, false)},
          {"v1_wide_zstd.block", wide},
          {"v1_empty.block", empty},
          {"v2_axes_lz4.block", VariedCloud(60, false)},
          {"v2_axes_zstd.block", VariedCloud(60, false)},
          {"v2_morton_lz4.block", VariedCloud(60, true)},
          {"v2_transforms_0.block", VariedCloud(30, false)},
          {"v2_transforms_3.block", VariedCloud(30, false)},
          {"v2_transforms_6.block", VariedCloud(30, false)}};
}

TEST(BlockFormat, BlocksOfEveryVersionAreReadForEver) {
  for (const auto& [file, cloud] : GoldenBlocks()) {
    SCOPED_TRACE(file);
    const std::vector<std::byte> block = ReadGoldenBlock(file);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud read, DecodePoints(block));
    EXPECT_EQ(read.lattice, cloud.lattice);
    EXPECT_EQ(read.positions, cloud.positions);
    EXPECT_EQ(read.attributes, cloud.attributes);
  }
}

TEST(BlockFormat, GoldenBlocksUseAllOfTheFormat) {
  std::set<int> transforms;
  std::set<int> compressions;
  std::set<std::string> positions;
  for (const GoldenBlock& golden : GoldenBlocks()) {
    const BlockHead head = ReadBlockHead(ReadGoldenBlock(golden.file)).value();
    positions.insert(head.columns[0].spec.name +
                     std::string(ScalarTypeName(head.columns[0].spec.type)));
    for (const ColumnEntry& entry : head.columns) {
      transforms.insert(static_cast<int>(entry.transform));
      compressions.insert(static_cast<int>(entry.compression));
    }
  }
  EXPECT_EQ(transforms, (std::set<int>{0, 1, 2, 3, 4, 5, 6, 7, 8, 9}));
  EXPECT_EQ(compressions, (std::set<int>{0, 1, 2}));
  EXPECT_EQ(positions,
            (std::set<std::string>{"xint32", "xint64", "mortonuint64"}));
}

}  // namespace
}  // namespace mapsieve::core
