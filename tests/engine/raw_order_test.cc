// In which order the points of raw chunks are stored and read.

#include <algorithm>
#include <random>
#include <string>
#include <vector>

#include "core/codec/points_codec.h"
#include "core/geometry/morton.h"
#include "gtest/gtest.h"
#include "server/engine/chunk_reader.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::LatticeCloud;
using storage::ChunkKind;

constexpr IngestLimits kLimits = {.block_bytes = 1 << 26,
                                  .bucket_bytes = 1 << 28,
                                  .chunk_bytes = 100'000,
                                  .chunk_count = 100'000};

/// Random points of a cube of 4 m, with a time that only the order tells.
LatticeCloud Scan(bool has_time) {
  std::mt19937_64 random(1);
  LatticeCloud cloud;
  for (int i = 0; i < 9000; ++i) {
    cloud.positions.push_back({static_cast<int64_t>(random() % 4000),
                               static_cast<int64_t>(random() % 4000),
                               static_cast<int64_t>(random() % 4000)});
  }
  if (!has_time) return cloud;
  core::Column time({"time", core::ScalarType::kFloat64}, cloud.size());
  double now = 1e5;
  for (size_t i = 0; i < cloud.size(); ++i) {
    now += static_cast<double>(1 + random() % 1000) * 1e-6;
    time.Set(i, now);
  }
  EXPECT_TRUE(cloud.attributes.Add(std::move(time)).ok());
  return cloud;
}

bool InMortonOrder(const LatticeCloud& cloud) {
  return std::is_sorted(
      cloud.positions.begin(), cloud.positions.end(),
      [](const core::LatticePoint& a, const core::LatticePoint& b) {
        return core::MortonLess(a, b);
      });
}

TEST(RawOrder, IsThatOfTheUploadWhereThatIsSmaller) {
  for (const bool has_time : {false, true}) {
    SCOPED_TRACE(has_time);
    Workshop workshop(12);
    MAPSIEVE_ASSERT_OK(workshop.Add(Scan(has_time), kLimits));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                  workshop.store().OpenSnapshot("map"));
    const auto chunks = workshop.Chunks(ChunkKind::kRaw);
    EXPECT_GT(chunks.size(), 1u);
    for (const storage::ChunkRef& chunk : chunks) {
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto block,
                                    snapshot->ReadChunk(chunk));
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud stored,
                                    core::DecodePoints(block));
      EXPECT_EQ(InMortonOrder(stored), !has_time);
      if (has_time) {
        const core::Column& time = *stored.attributes.Find("time");
        for (size_t i = 1; i < stored.size(); ++i) {
          EXPECT_LT(time.Get<double>(i - 1), time.Get<double>(i));
        }
      }
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const LatticeCloud read,
                                    ReadPoints(*snapshot, chunk));
      EXPECT_TRUE(InMortonOrder(read));
      EXPECT_EQ(read.size(), stored.size());
    }
  }
}

}  // namespace
}  // namespace mapsieve::engine::testing
