#include <atomic>
#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/base/bulk_vector.h"
#include "core/base/bytes.h"
#include "core/base/executor.h"
#include "core/base/hash.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

TEST(WorkerPool, RunsEveryTaskOnce) {
  for (const int workers : {1, 2, 5}) {
    const auto pool = MakeWorkerPool(workers);
    EXPECT_EQ(pool->worker_count(), workers);
    for (const int64_t count : {0, 1, 3, 1000}) {
      std::vector<std::atomic<int>> calls(static_cast<size_t>(count));
      pool->ParallelFor(count,
                        [&](int64_t i) { ++calls[static_cast<size_t>(i)]; });
      for (const auto& n : calls) EXPECT_EQ(n.load(), 1);
    }
  }
}

TEST(WorkerPool, ExceptionLeavesAfterAllTasksAndThePoolLivesOn) {
  const auto pool = MakeWorkerPool(3);
  EXPECT_THROW(pool->ParallelFor(100,
                                 [](int64_t i) {
                                   if (i == 7)
                                     throw std::runtime_error("seven");
                                 }),
               std::runtime_error);
  std::atomic<int> sum = 0;
  pool->ParallelFor(10, [&](int64_t i) { sum += static_cast<int>(i); });
  EXPECT_EQ(sum.load(), 45);
}

TEST(ExecutionContext, ReportsAStopAsCancelled) {
  std::stop_source source;
  const ExecutionContext context{.stop = source.get_token()};
  MAPSIEVE_EXPECT_OK(context.CheckStop());
  source.request_stop();
  EXPECT_THAT(context.CheckStop(),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("cancelled")));
}

TEST(Hash, MatchesPublishedXxh3Values) {
  EXPECT_EQ(Hash64({}), 0x2d06800538d394c2u);
  EXPECT_EQ(ContentHash({}), "99aa06d3014798d86001c324468d497f");

  // The bytes of xxHash's own tests, long enough for its vector code.
  std::vector<std::byte> bytes(2367);
  uint64_t state = 2654435761;
  for (std::byte& byte : bytes) {
    byte = static_cast<std::byte>(state >> 56);
    state *= 11400714785074694797u;
  }
  const auto first = std::span(bytes).first(2048);
  EXPECT_EQ(Hash64(first), 0xdd59e2c3a5f038e0u);
  EXPECT_EQ(ContentHash(first), "f736557fd47073a5dd59e2c3a5f038e0");
  EXPECT_EQ(Hash64(bytes), 0xcb37aeb9e5d361edu);
  EXPECT_EQ(ContentHash(bytes), "e89c0f6ff369b427cb37aeb9e5d361ed");
}

TEST(Hash, ContentHasherDoesNotDependOnThePieces) {
  const std::string text(100000, 'x');
  ContentHasher hasher;
  hasher.Update(TextBytes(text).subspan(0, 17));
  hasher.Update(TextBytes(text).subspan(17));
  EXPECT_EQ(hasher.HexDigest(), ContentHash(TextBytes(text)));
}

TEST(ByteReader, NamesTheFieldAndTheOffsetBeyondTheEnd) {
  ByteWriter writer;
  writer.Put<uint16_t>(0x1234);
  writer.PutShortText("name");
  ByteReader reader(writer.bytes());
  EXPECT_EQ(reader.Take<uint16_t>("version").value(), 0x1234);
  EXPECT_EQ(reader.TakeShortText("column name").value(), "name");
  EXPECT_THAT(reader.Take<uint32_t>("point count"),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("point count at offset 8: expected 4 bytes, "
                                 "have 0")));
}

TEST(Annotate, NamesTheContextOnce) {
  const absl::Status named = Annotate(absl::DataLossError("short"), "a.las");
  EXPECT_THAT(named, StatusIs(absl::StatusCode::kDataLoss,
                              ::testing::StrEq("a.las: short")));
  EXPECT_EQ(Annotate(named, "a.las"), named);
  MAPSIEVE_EXPECT_OK(Annotate(absl::OkStatus(), "a.las"));
}

TEST(BulkVector, HoldsItsElementsAcrossTheSizeOfHugePages) {
  BulkVector<int32_t> values;
  constexpr int32_t kCount = 3'000'000;
  for (int32_t i = 0; i < kCount; ++i) values.push_back(i);
  BulkVector<int32_t> copy = values;
  copy.resize(10);
  copy.shrink_to_fit();
  copy.resize(12, 7);
  EXPECT_EQ(copy.back(), 7);
  EXPECT_EQ(copy[9], 9);
  for (int32_t i = 0; i < kCount; ++i) {
    ASSERT_EQ(values[static_cast<size_t>(i)], i);
  }
}

}  // namespace
}  // namespace mapsieve
