#include "core/codec/points_codec.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/bytes.h"
#include "core/codec/block_head.h"
#include "core/codec/block_parts.h"
#include "core/geometry/morton.h"
#include "tests/codec/codec_test_util.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr int64_t kFarthest = kLatticeLimit - 1;

void ExpectSame(const LatticeCloud& actual, const LatticeCloud& expected) {
  EXPECT_EQ(actual.lattice, expected.lattice);
  EXPECT_EQ(actual.positions, expected.positions);
  EXPECT_EQ(actual.attributes, expected.attributes);
}

void ExpectRoundTrip(const LatticeCloud& cloud) {
  for (const Compression compression : kCompressions) {
    SCOPED_TRACE(static_cast<int>(compression));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto block, EncodePoints(cloud, {.compression = compression}));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud back, DecodePoints(block));
    ExpectSame(back, cloud);
  }
}

LatticeCloud At(std::vector<LatticePoint> positions) {
  LatticeCloud cloud;
  cloud.positions = std::move(positions);
  return cloud;
}

std::string FirstColumn(const LatticeCloud& cloud, Compression compression) {
  const auto block = EncodePoints(cloud, {.compression = compression}).value();
  const ColumnEntry entry = ReadBlockHead(block).value().columns[0];
  return absl::StrCat(entry.spec.name, " ",
                      ToAbsl(ScalarTypeName(entry.spec.type)));
}

TEST(EncodePoints, RoundTripsCloudsOfAllTypes) {
  uint64_t seed = 0;
  for (const size_t count : {0, 1, 2, 3, 7, 8, 9, 100, 1500, 20'000}) {
    for (const int64_t spread :
         {int64_t{0}, int64_t{3}, int64_t{5000}, int64_t{1} << 19,
          int64_t{1} << 25, int64_t{1} << 35}) {
      if (count > 5000 && spread != 5000) continue;
      SCOPED_TRACE(::testing::Message() << count << " points, " << spread);
      const LatticeCloud cloud =
          RandomCloud(++seed, count, spread, {331'050'000, -5'183'020'000, 0});
      ExpectRoundTrip(cloud);
      ExpectRoundTrip(InMortonOrder(cloud));
    }
  }
}

TEST(EncodePoints, RoundTripsEveryTransform) {
  for (const size_t count : {30, 20'000}) {
    for (const bool sorted : {false, true}) {
      ExpectRoundTrip(VariedCloud(count, sorted));
    }
  }
}

TEST(EncodePoints, RoundTripsTheCornersOfTheLattice) {
  std::vector<LatticePoint> corners;
  for (const int64_t x : {-kFarthest, kFarthest}) {
    for (const int64_t y : {-kFarthest, kFarthest}) {
      for (const int64_t z : {-kFarthest, kFarthest}) {
        corners.push_back({x, y, z});
        ExpectRoundTrip(At({{x, y, z}}));
        ExpectRoundTrip(At({{x, y, z}, {0, 0, 0}}));
      }
    }
  }
  ExpectRoundTrip(At(corners));
}

TEST(EncodePoints, KeepsDuplicates) {
  const LatticePoint q{-5, 7, 123'456'789};
  LatticeCloud cloud = At(std::vector<LatticePoint>(500, q));
  cloud.positions.push_back({-5, 7, 123'456'790});
  ExpectRoundTrip(cloud);
}

TEST(EncodePoints, KeepsEveryBitPatternOfFloats) {
  const std::vector<uint64_t> doubles = {0x7ff8000000000000,
                                         0xfff8000000000001,
                                         0x7ff0000000000001,
                                         0x7ff4dead0000beef,
                                         0x8000000000000000,
                                         0x7ff0000000000000,
                                         1};
  const std::vector<uint64_t> floats = {0x7fc00000, 0xffc00001, 0x7f800001,
                                        0x7fa0dead, 0x80000000, 0x7f800000,
                                        1};
  LatticeCloud cloud;
  cloud.positions.resize(doubles.size());
  AddColumn(cloud, "double", ScalarType::kFloat64,
            [&](size_t i) { return doubles[i]; });
  AddColumn(cloud, "float", ScalarType::kFloat32,
            [&](size_t i) { return floats[i]; });
  ExpectRoundTrip(cloud);
}

TEST(EncodePoints, KeepsMissingApartFromZero) {
  LatticeCloud cloud = At(std::vector<LatticePoint>(11));
  AddColumn(cloud, "some", ScalarType::kInt16, [](size_t) { return 0; });
  cloud.attributes.Find("some")->SetMissing(0);
  cloud.attributes.Find("some")->SetMissing(10);
  Column all({"all", ScalarType::kFloat64});
  all.AppendMissing(11);
  MAPSIEVE_ASSERT_OK(cloud.attributes.Add(all));
  ExpectRoundTrip(cloud);
}

TEST(EncodePoints, KeepsTheOrderOfColumnsAndAnyName) {
  LatticeCloud cloud = At({{1, 2, 3}});
  for (const std::string& name :
       {std::string("z"), std::string("morton"), std::string("a"),
        std::string("\xff\0\n", 3), std::string(kMaxColumnNameBytes, 'n')}) {
    AddColumn(cloud, name, ScalarType::kUint8, [](size_t) { return 5; });
  }
  ExpectRoundTrip(cloud);
}

TEST(EncodePoints, GivesTheSameBytesEveryTime) {
  const LatticeCloud cloud = VariedCloud(5000, true);
  for (const Compression compression : kCompressions) {
    const EncodeOptions options{.compression = compression};
    EXPECT_EQ(EncodePoints(cloud, options).value(),
              EncodePoints(cloud, options).value());
  }
}

TEST(EncodePoints, UsesMortonCodesWherePointsAreInOrderAndNear) {
  const LatticeCloud unsorted = RandomCloud(1, 1000, 1 << 19, {5, 6, 7});
  const LatticeCloud sorted = InMortonOrder(unsorted);
  EXPECT_EQ(FirstColumn(sorted, Compression::kLz4), "morton uint64");
  EXPECT_EQ(FirstColumn(sorted, Compression::kZstd), "morton uint64");
  EXPECT_EQ(FirstColumn(sorted, Compression::kNone), "x int32");
  EXPECT_EQ(FirstColumn(unsorted, Compression::kLz4), "x int32");
  const LatticeCloud wide = RandomCloud(1, 1000, 1 << 21);
  EXPECT_EQ(FirstColumn(InMortonOrder(wide), Compression::kLz4), "x int32");
  const LatticeCloud wider = RandomCloud(1, 1000, int64_t{1} << 32);
  EXPECT_EQ(FirstColumn(InMortonOrder(wider), Compression::kLz4), "x int64");
}

TEST(EncodePoints, UsesMortonCodesInAWholeCell) {
  constexpr int64_t kEdge = int64_t{1} << kMortonAxisBits;
  for (const int64_t corner : {int64_t{0}, -kEdge, 7 * kEdge, -kLatticeLimit}) {
    const int64_t low = std::max(corner, -kFarthest);
    const int64_t high = corner + kEdge - 1;
    const LatticeCloud cloud =
        At({{low, low, low}, {low, high, low}, {high, high, high}});
    EXPECT_EQ(FirstColumn(cloud, Compression::kLz4), "morton uint64");
    ExpectRoundTrip(cloud);
    LatticeCloud beyond = cloud;
    beyond.positions.back().z += 1;
    EXPECT_EQ(FirstColumn(beyond, Compression::kLz4), "x int32");
    ExpectRoundTrip(beyond);
  }
}

TEST(EncodePoints, WritesAxesAsInt32UpToTheirWidest) {
  const int64_t widest = std::numeric_limits<int32_t>::max();
  const LatticeCloud narrow = At({{-5, 0, 0}, {widest - 5, 0, 0}});
  EXPECT_EQ(FirstColumn(narrow, Compression::kNone), "x int32");
  ExpectRoundTrip(narrow);
  const LatticeCloud wide = At({{-5, 0, 0}, {widest - 4, 0, 0}});
  EXPECT_EQ(FirstColumn(wide, Compression::kNone), "x int64");
  ExpectRoundTrip(wide);
}

TEST(EncodePoints, WithThePlanOfOtherPointsIsAboutAsSmall) {
  for (const bool sorted : {false, true}) {
    const EncodePlan plan = PlanEncoding(VariedCloud(4000, sorted));
    EXPECT_EQ(plan.axes.empty(), sorted);
    for (const size_t count : {0, 1, 100, 30'000}) {
      const LatticeCloud cloud = VariedCloud(count, sorted);
      const auto planned = EncodePoints(cloud, {.plan = &plan}).value();
      ExpectSame(DecodePoints(planned).value(), cloud);
      const size_t chosen = EncodePoints(cloud).value().size();
      EXPECT_LE(planned.size(), chosen + chosen / 50) << count;
    }
  }
}

TEST(EncodePoints, DoesWithoutAPlanThatDoesNotSuit) {
  const LatticeCloud cloud = VariedCloud(20'000, false);
  const auto chosen = EncodePoints(cloud).value();
  EncodePlan plan = PlanEncoding(cloud);
  EXPECT_EQ(EncodePoints(cloud, {.plan = &plan}).value(), chosen);
  for (auto* entries : {&plan.axes, &plan.attributes}) {
    for (auto& [name, entry] : *entries) {
      entry.transforms = {Transform::kPlain};
      entry.max_value_bytes = 0;
    }
  }
  EXPECT_EQ(EncodePoints(cloud, {.plan = &plan}).value(), chosen);
  // Halves are not for values of one byte.
  plan.attributes.at("noise") = {{Transform::kHalvesCoded}, 8};
  EXPECT_EQ(EncodePoints(cloud, {.plan = &plan}).value(), chosen);
  EncodePlan nothing;
  EXPECT_EQ(EncodePoints(cloud, {.plan = &nothing}).value(), chosen);
  // Which is not asked where values take what was expected.
  nothing.attributes["noise"] = {{Transform::kShuffle}, 1};
  const auto shuffled = EncodePoints(cloud, {.plan = &nothing}).value();
  const BlockHead head = ReadBlockHead(shuffled).value();
  EXPECT_EQ(head.attributes()[0].spec.name, "noise");
  EXPECT_EQ(head.attributes()[0].transform, Transform::kShuffle);
}

TEST(PlanEncoding, ForSpeedTriesLessAndIsSomewhatLarger) {
  for (const bool sorted : {false, true}) {
    const LatticeCloud cloud = VariedCloud(30'000, sorted);
    const EncodePlan plan =
        PlanEncoding(cloud, Compression::kLz4, PlanAim::kSpeed);
    for (const auto* entries : {&plan.axes, &plan.attributes}) {
      for (const auto& [name, entry] : *entries) {
        EXPECT_EQ(entry.transforms.size(), 1u) << name;
      }
    }
    const auto fast = EncodePoints(cloud, {.plan = &plan}).value();
    ExpectSame(DecodePoints(fast).value(), cloud);
    const size_t small = EncodePoints(cloud).value().size();
    EXPECT_LE(fast.size(), small + small / 20);
  }
}

TEST(PlanEncoding, LeavesOutColumnsOfOneValue) {
  LatticeCloud cloud = At({{0, 5, 0}, {9, 5, 2}, {1, 5, 4}});
  AddColumn(cloud, "same", ScalarType::kUint16, [](size_t) { return 7; });
  AddColumn(cloud, "other", ScalarType::kUint16, [](size_t i) { return i; });
  const EncodePlan plan = PlanEncoding(cloud);
  EXPECT_EQ(plan.axes.size(), 2u);
  EXPECT_FALSE(plan.axes.contains("y"));
  EXPECT_EQ(plan.attributes.size(), 1u);
  EXPECT_TRUE(plan.attributes.contains("other"));
}

TEST(EncodePoints, WithoutCompressionIsPlain) {
  const auto block =
      EncodePoints(VariedCloud(1000, true), {.compression = Compression::kNone})
          .value();
  const BlockHead head = ReadBlockHead(block).value();
  for (const ColumnEntry& entry : head.columns) {
    EXPECT_EQ(entry.transform, Transform::kPlain) << entry.spec.name;
    EXPECT_EQ(entry.compression, Compression::kNone) << entry.spec.name;
  }
}

TEST(EncodePoints, SuitsTheTransformToTheColumn) {
  const auto block = EncodePoints(VariedCloud(20'000, true)).value();
  std::map<std::string, Transform> transforms;
  const BlockHead head = ReadBlockHead(block).value();
  for (const ColumnEntry& entry : head.columns) {
    transforms[entry.spec.name] = entry.transform;
  }
  EXPECT_EQ(transforms["morton"], Transform::kAscendingCoded);
  EXPECT_EQ(transforms["noise"], Transform::kPlain);
  EXPECT_EQ(transforms["intensity"], Transform::kShuffle);
  EXPECT_EQ(transforms["beam"], Transform::kDeltaShuffle);
  EXPECT_EQ(transforms["offset"], Transform::kDeltaCoded);
  EXPECT_EQ(transforms["time"], Transform::kAscendingCoded);
}

TEST(EncodePoints, RefusesWhatABlockCannotHold) {
  const auto expect_refused = [](const LatticeCloud& cloud,
                                 const std::string& message) {
    EXPECT_THAT(
        EncodePoints(cloud),
        StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(message)));
  };
  for (const int64_t q :
       {kLatticeLimit, -kLatticeLimit, std::numeric_limits<int64_t>::min(),
        std::numeric_limits<int64_t>::max()}) {
    expect_refused(At({{0, 0, 0}, {0, q, 0}}), absl::StrCat("coordinate ", q));
  }
  LatticeCloud cloud = At({{0, 0, 0}});
  cloud.lattice = Lattice(0);
  expect_refused(cloud, "step");
  cloud.lattice = Lattice(kMaxStepNm + 1);
  expect_refused(cloud, "step");
  cloud.lattice = Lattice();
  AddColumn(cloud, "", ScalarType::kUint8, [](size_t) { return 1; });
  expect_refused(cloud, "name");
  Column& column = cloud.attributes.columns().back();
  column.Rename(std::string(kMaxColumnNameBytes + 1, 'n'));
  expect_refused(cloud, "name");
  column.Rename("short");
  column.Resize(2);
  expect_refused(cloud, "attribute \"short\": expected 1 values, have 2");
  column.Resize(1);
  MAPSIEVE_EXPECT_OK(EncodePoints(cloud));
  AddColumn(cloud, "short", ScalarType::kInt8, [](size_t) { return 1; });
  expect_refused(cloud, "two attributes are named \"short\"");
}

TEST(EncodePoints, RefusesTooManyColumns) {
  LatticeCloud cloud = At({{0, 0, 0}});
  for (size_t i = 0; i < kMaxBlockColumns - 3; ++i) {
    AddColumn(cloud, std::to_string(i), ScalarType::kUint8,
              [](size_t) { return 1; });
  }
  ExpectRoundTrip(cloud);
  AddColumn(cloud, "more", ScalarType::kUint8, [](size_t) { return 1; });
  EXPECT_THAT(EncodePoints(cloud),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("attributes, have 1022")));
}

TEST(DecodePoints, ReadsChosenColumnsWithoutTouchingTheOthers) {
  const LatticeCloud cloud = RandomCloud(4, 500, 1000);
  BlockParts parts = BlockParts::Of(EncodePoints(cloud).value());
  auto block = parts.Join();
  // Damages every attribute but two.
  size_t at = parts.head.head_bytes;
  for (size_t i = 0; i < parts.head.columns.size(); ++i) {
    const ColumnEntry& entry = parts.head.columns[i];
    if (i >= parts.head.position_column_count() &&
        entry.spec.name != "column 3" && entry.spec.name != "column 8") {
      block[at] ^= std::byte{1};
    }
    at += entry.stored_bytes;
  }
  EXPECT_THAT(DecodePoints(block), StatusIs(absl::StatusCode::kDataLoss,
                                            HasSubstr("column \"column 1\"")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const LatticeCloud chosen,
      DecodePoints(block, {.attributes = {{"column 8", "none", "column 3"}}}));
  EXPECT_EQ(chosen.positions, cloud.positions);
  ASSERT_EQ(chosen.attributes.columns().size(), 2u);
  EXPECT_EQ(chosen.attributes.columns()[0], *cloud.attributes.Find("column 3"));
  EXPECT_EQ(chosen.attributes.columns()[1], *cloud.attributes.Find("column 8"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const LatticeCloud bare,
      DecodePoints(block, {.attributes = std::vector<std::string>{}}));
  EXPECT_EQ(bare.positions, cloud.positions);
  EXPECT_TRUE(bare.attributes.columns().empty());
}

TEST(DecodeColumns, ReadsThemWithoutTouchingAnythingElse) {
  const LatticeCloud cloud = RandomCloud(4, 500, 1000);
  BlockParts parts = BlockParts::Of(EncodePoints(cloud).value());
  auto block = parts.Join();
  // Damages the positions and every attribute but two.
  size_t at = parts.head.head_bytes;
  for (const ColumnEntry& entry : parts.head.columns) {
    if (entry.spec.name != "column 3" && entry.spec.name != "column 8") {
      block[at] ^= std::byte{1};
    }
    at += entry.stored_bytes;
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const ColumnSet chosen,
      DecodeColumns(block, {"column 8", "none", "column 3"}));
  ASSERT_EQ(chosen.columns().size(), 2u);
  EXPECT_EQ(chosen.columns()[0], *cloud.attributes.Find("column 3"));
  EXPECT_EQ(chosen.columns()[1], *cloud.attributes.Find("column 8"));
  EXPECT_THAT(
      DecodeColumns(block, {"column 1"}),
      StatusIs(absl::StatusCode::kDataLoss, HasSubstr("column \"column 1\"")));
  block.pop_back();
  EXPECT_THAT(DecodeColumns(block, {"column 3"}),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("expected")));
}

TEST(FindParts, NamesAllThatIsReadOfWantedColumns) {
  const std::vector<std::string> wanted = {"column 8", "none", "column 3",
                                           "column 4"};
  for (const LatticeCloud& cloud :
       {RandomCloud(4, 500, 1000), InMortonOrder(RandomCloud(5, 500, 1000)),
        RandomCloud(6, 0, 1000)}) {
    const auto block = EncodePoints(cloud).value();
    for (const auto positions :
         {BlockPositions::kWanted, BlockPositions::kNotWanted}) {
      const BlockHead head = ReadBlockHead(block).value();
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(
          const std::vector<BlockPart> parts,
          FindParts(std::span(block).first(head.head_bytes), wanted,
                    positions));
      std::vector<std::byte> sparse(block.size(), std::byte{0xa5});
      std::copy_n(block.begin(), head.head_bytes, sparse.begin());
      size_t last = head.head_bytes - 1;
      for (const auto& [begin, end] : parts) {
        EXPECT_GT(begin, last);
        EXPECT_LT(begin, end);
        last = end;
        std::copy(block.begin() + static_cast<ptrdiff_t>(begin),
                  block.begin() + static_cast<ptrdiff_t>(end),
                  sparse.begin() + static_cast<ptrdiff_t>(begin));
      }
      if (positions == BlockPositions::kWanted) {
        const auto actual = DecodePoints(sparse, {.attributes = wanted});
        MAPSIEVE_ASSERT_OK(actual.status());
        ExpectSame(*actual, *DecodePoints(block, {.attributes = wanted}));
      } else {
        const auto actual = DecodeColumns(sparse, wanted);
        MAPSIEVE_ASSERT_OK(actual.status());
        EXPECT_EQ(actual->columns(), DecodeColumns(block, wanted)->columns());
        if (cloud.size() > 0) {
          EXPECT_FALSE(DecodePoints(sparse, {.attributes = wanted}).ok());
          EXPECT_FALSE(DecodeColumns(sparse, {"column 1"}).ok());
        }
      }
    }
    EXPECT_THAT(
        FindParts(std::span(block).first(100), wanted, BlockPositions::kWanted),
        StatusIs(absl::StatusCode::kOutOfRange, _));
  }
}

TEST(DecodePoints, CountsTheMemoryOfTheWantedColumns) {
  LatticeCloud cloud = At(std::vector<LatticePoint>(100));
  AddColumn(cloud, "a", ScalarType::kFloat64, [](size_t) { return 0; });
  AddColumn(cloud, "b", ScalarType::kUint16, [](size_t) { return 0; });
  cloud.attributes.Find("b")->SetMissing(50);
  const auto block = EncodePoints(cloud).value();
  EXPECT_EQ(ReadBlockHeader(block)->decoded_bytes, 100 * (24 + 8 + 2 + 1));
  MAPSIEVE_EXPECT_OK(DecodePoints(block, {.max_decoded_bytes = 3500}));
  EXPECT_THAT(DecodePoints(block, {.max_decoded_bytes = 3499}),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       AllOf(HasSubstr("3500"), HasSubstr("3499"))));
  const std::vector<std::string> b = {"b"};
  MAPSIEVE_EXPECT_OK(
      DecodePoints(block, {.attributes = b, .max_decoded_bytes = 2700}));
  EXPECT_FALSE(
      DecodePoints(block, {.attributes = b, .max_decoded_bytes = 2699}).ok());
}

TEST(ReadBlockHeader, SaysWhatTheBlockHolds) {
  LatticeCloud cloud = At({{5, -7, 9}, {-1, 8, 3}});
  cloud.lattice = Lattice(250'000);
  AddColumn(cloud, "t", ScalarType::kFloat64, [](size_t) { return 1; });
  AddColumn(cloud, "class", ScalarType::kUint8, [](size_t) { return 1; });
  const auto block = EncodePoints(cloud).value();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const BlockHeader header,
                                ReadBlockHeader(block));
  EXPECT_EQ(header.step_nm, 250'000);
  EXPECT_EQ(header.point_count, 2);
  EXPECT_EQ(header.block_bytes, static_cast<int64_t>(block.size()));
  EXPECT_EQ(header.min, (LatticePoint{-1, -7, 3}));
  EXPECT_EQ(header.max, (LatticePoint{5, 8, 9}));
  EXPECT_THAT(header.columns,
              ElementsAre(ColumnSpec{"t", ScalarType::kFloat64},
                          ColumnSpec{"class", ScalarType::kUint8}));
}

TEST(ReadBlockHeader, NeedsTheHeadOnly) {
  const auto block = EncodePoints(VariedCloud(200, false)).value();
  const size_t head_bytes = ReadBlockHead(block)->head_bytes;
  for (size_t size = 0; size < head_bytes; ++size) {
    EXPECT_THAT(ReadBlockHeader(std::span(block).first(size)),
                StatusIs(absl::StatusCode::kOutOfRange,
                         HasSubstr(absl::StrCat("have ", size))));
  }
  MAPSIEVE_EXPECT_OK(ReadBlockHeader(std::span(block).first(head_bytes)));
}

TEST(ReadBlockHeader, PutsAnEmptyBlockAtTheOrigin) {
  const auto block = EncodePoints(LatticeCloud()).value();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const BlockHeader header,
                                ReadBlockHeader(block));
  EXPECT_EQ(header.point_count, 0);
  EXPECT_EQ(header.min, LatticePoint());
  EXPECT_EQ(header.max, LatticePoint());
}

TEST(ReadBlockLength, SplitsAStreamOfBlocks) {
  std::vector<std::byte> stream;
  std::vector<LatticeCloud> clouds;
  for (const size_t count : {3, 0, 500, 1}) {
    clouds.push_back(RandomCloud(count, count, 100));
    const auto block = EncodePoints(clouds.back()).value();
    stream.insert(stream.end(), block.begin(), block.end());
  }
  std::span<const std::byte> rest = stream;
  for (const LatticeCloud& cloud : clouds) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const int64_t length, ReadBlockLength(rest.first(kBlockPrefixBytes)));
    ASSERT_LE(static_cast<size_t>(length), rest.size());
    const auto block = rest.first(static_cast<size_t>(length));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud back, DecodePoints(block));
    ExpectSame(back, cloud);
    rest = rest.subspan(block.size());
  }
  EXPECT_TRUE(rest.empty());
}

TEST(SplitBlocks, GivesTheBlocksBackToBack) {
  const auto first = EncodePoints(VariedCloud(100, true)).value();
  const auto second = EncodePoints(VariedCloud(0, true)).value();
  std::vector<std::byte> bytes = first;
  EXPECT_TRUE(SplitBlocks({}).value().empty());
  bytes.insert(bytes.end(), second.begin(), second.end());
  bytes.insert(bytes.end(), first.begin(), first.end());
  const auto blocks = SplitBlocks(bytes).value();
  ASSERT_EQ(blocks.size(), 3u);
  for (const size_t i : {0, 2}) {
    EXPECT_TRUE(std::equal(blocks[i].begin(), blocks[i].end(), first.begin(),
                           first.end()));
  }
  EXPECT_EQ(blocks[1].size(), second.size());
  EXPECT_EQ(blocks[1].data(), bytes.data() + first.size());
}

TEST(SplitBlocks, RefusesWhatIsNoBlockWithItsOffset) {
  const auto block = EncodePoints(VariedCloud(100, true)).value();
  std::vector<std::byte> bytes = block;
  bytes.insert(bytes.end(), block.begin(), block.end());
  const std::string offset = absl::StrCat("offset ", block.size());
  for (const size_t lost : {size_t{1}, block.size() - 1}) {
    EXPECT_THAT(SplitBlocks(std::span(bytes).first(bytes.size() - lost)),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr(offset)));
  }
  bytes[block.size()] ^= std::byte{1};
  EXPECT_THAT(SplitBlocks(bytes), StatusIs(absl::StatusCode::kDataLoss, _));
}

TEST(ReadBlockLength, RefusesWhatIsNoBlock) {
  const auto block = EncodePoints(LatticeCloud()).value();
  const auto prefix = std::span(block).first(kBlockPrefixBytes);
  MAPSIEVE_EXPECT_OK(ReadBlockLength(prefix));
  EXPECT_THAT(ReadBlockLength(prefix.first(15)),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("block bytes")));
  const auto expect_refused = [&](size_t at, int byte, const char* message) {
    std::vector<std::byte> other(prefix.begin(), prefix.end());
    other[at] = static_cast<std::byte>(byte);
    EXPECT_THAT(ReadBlockLength(other),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr(message)));
  };
  expect_refused(0, 'P', "magic bytes MSPB");
  expect_refused(4, 0, "expected version 1 to 2, have 0");
  expect_refused(4, 3, "expected version 1 to 2, have 3");
  expect_refused(6, 0, "columns");
  expect_refused(7, 16, "columns");
  expect_refused(8, 0, "bytes of the block");
  expect_refused(13, 1, "bytes of the block");
}

#ifdef MAPSIEVE_TEST_DATA

/// The PLY files of this folder: float x, y, z and intensity.
LatticeCloud ReadScan(const std::string& name) {
  std::ifstream file(MAPSIEVE_TEST_DATA "/registration/small_gicp/" + name,
                     std::ios::binary);
  std::string line;
  while (std::getline(file, line) && line != "end_header") {
  }
  PointCloud cloud;
  Column intensity({"intensity", ScalarType::kFloat32});
  float values[4];
  while (file.read(reinterpret_cast<char*>(values), sizeof(values))) {
    cloud.positions.push_back({values[0], values[1], values[2]});
    intensity.Append(values[3]);
  }
  EXPECT_TRUE(cloud.attributes.Add(std::move(intensity)).ok());
  RefusedCounts refused;
  return Quantize(cloud, Lattice(), refused);
}

TEST(EncodePoints, PutsAScanAtOneMillimetreInto18Point5BitsAPoint) {
  for (const char* name : {"source.ply", "target.ply"}) {
    const LatticeCloud scan = InMortonOrder(ReadScan(name));
    ASSERT_GT(scan.size(), 69'000u);
    ExpectRoundTrip(scan);
    for (const Compression compression :
         {Compression::kLz4, Compression::kZstd}) {
      LatticeCloud geometry;
      geometry.positions = scan.positions;
      const size_t bits =
          8 * EncodePoints(geometry, {.compression = compression})->size();
      EXPECT_LT(2 * bits, 37 * scan.size()) << name;
    }
  }
}

#endif  // MAPSIEVE_TEST_DATA

}  // namespace
}  // namespace mapsieve::core
