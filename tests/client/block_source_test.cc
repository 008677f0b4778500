#include "client/api/block_source.h"

#include "core/codec/points_codec.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

/// Counts how often its blocks are made.
class CountedBlocks final : public BlockSource {
 public:
  absl::Status Rewind() override {
    next_ = 0;
    return absl::OkStatus();
  }
  absl::StatusOr<std::vector<std::byte>> NextBlock() override {
    if (next_ == kBlocks) return std::vector<std::byte>();
    ++made;
    return std::vector<std::byte>(kBlockBytes, std::byte(next_++));
  }
  core::RefusedCounts refused() const override { return {.non_finite = 3}; }

  static constexpr int kBlocks = 5;
  static constexpr size_t kBlockBytes = 100;
  int made = 0;

 private:
  int next_ = 0;
};

void ExpectAllBlocks(BlockSource& source) {
  MAPSIEVE_ASSERT_OK(source.Rewind());
  for (int i = 0; i < CountedBlocks::kBlocks; ++i) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<std::byte> block,
                                  source.NextBlock());
    EXPECT_EQ(block,
              std::vector<std::byte>(CountedBlocks::kBlockBytes, std::byte(i)));
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<std::byte> end,
                                source.NextBlock());
  EXPECT_TRUE(end.empty());
  EXPECT_EQ(source.refused().non_finite, 3);
}

TEST(CloudBlocks, HaveFewPointsIfTheyAreWide) {
  core::LatticeCloud cloud;
  cloud.positions.resize(70'000);
  EXPECT_EQ(UploadBlockPoints({}), 65536u);
  for (int i = 0; i < 30; ++i) {
    MAPSIEVE_ASSERT_OK(cloud.attributes.Add(core::Column(
        {absl::StrCat("a", i), core::ScalarType::kFloat64}, cloud.size())));
  }
  CloudBlocks blocks(cloud);
  MAPSIEVE_ASSERT_OK(blocks.Rewind());
  size_t points = 0;
  while (points < cloud.size()) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<std::byte> block,
                                  blocks.NextBlock());
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const core::LatticeCloud part,
        core::DecodePoints(block, {.max_decoded_bytes = 4 << 20}));
    ASSERT_GT(part.size(), 10'000u);
    points += part.size();
  }
  EXPECT_EQ(points, cloud.size());
}

TEST(KeptBlocks, AreMadeOnceIfTheyFit) {
  CountedBlocks source;
  KeptBlocks kept(source, 500);
  for (int pass = 0; pass < 3; ++pass) ExpectAllBlocks(kept);
  EXPECT_EQ(source.made, CountedBlocks::kBlocks);
}

TEST(KeptBlocks, AreMadeAgainIfTheyDoNotFit) {
  CountedBlocks source;
  KeptBlocks kept(source, 499);
  for (int pass = 0; pass < 3; ++pass) ExpectAllBlocks(kept);
  EXPECT_EQ(source.made, 3 * CountedBlocks::kBlocks);
}

TEST(KeptBlocks, ARewindInTheMiddleStartsAgain) {
  CountedBlocks source;
  KeptBlocks kept(source, 500);
  MAPSIEVE_ASSERT_OK(kept.Rewind());
  MAPSIEVE_ASSERT_OK(kept.NextBlock());
  ExpectAllBlocks(kept);
  ExpectAllBlocks(kept);
  EXPECT_EQ(source.made, 1 + CountedBlocks::kBlocks);
}

}  // namespace
}  // namespace mapsieve::client
