// Of large chunks what is wanted is read, and that is checked.

#include "server/engine/chunk_reader.h"

#include <filesystem>
#include <memory>
#include <random>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/base/bytes.h"
#include "core/codec/block_head.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/engine/product_chunk.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/memory_blob_store.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr IngestLimits kOneChunk = {.block_bytes = 1 << 26,
                                    .bucket_bytes = 1 << 28,
                                    .chunk_bytes = 1 << 24,
                                    .chunk_count = 100'000};
constexpr int64_t kColumnBytes = 10'000 * 8;

/// Points of one tile of level 12, with columns "a", "b" and "c" of
/// kColumnBytes that no compression makes smaller.
core::LatticeCloud LargeTile() {
  std::mt19937_64 random(17);
  core::LatticeCloud cloud;
  for (int i = 0; i < 10'000; ++i) {
    cloud.positions.push_back({static_cast<int64_t>(random() % 4096),
                               static_cast<int64_t>(random() % 4096),
                               static_cast<int64_t>(random() % 4096)});
  }
  for (const char* const name : {"a", "b", "c"}) {
    core::Column column({name, core::ScalarType::kUint64}, cloud.size());
    for (size_t i = 0; i < cloud.size(); ++i) column.Set(i, random());
    EXPECT_TRUE(cloud.attributes.Add(std::move(column)).ok());
  }
  return cloud;
}

/// Counts the bytes that are read of blobs in memory.
class MeteredBlobs final : public storage::BlobStore {
 public:
  explicit MeteredBlobs(int64_t& read_bytes) : read_bytes_(read_bytes) {}

  absl::StatusOr<storage::BlobId> PutIfAbsent(
      std::span<const std::byte> bytes) override {
    return blobs_.PutIfAbsent(bytes);
  }
  absl::StatusOr<std::vector<std::byte>> Get(
      const storage::BlobId& id) const override {
    auto bytes = blobs_.Get(id);
    if (bytes.ok()) read_bytes_ += std::ssize(*bytes);
    return bytes;
  }
  absl::Status GetRange(const storage::BlobId& id, int64_t offset,
                        std::span<std::byte> room) const override {
    read_bytes_ += std::ssize(room);
    return blobs_.GetRange(id, offset, room);
  }
  std::string Location(const storage::BlobId& id) const override {
    return blobs_.Location(id);
  }
  absl::StatusOr<int64_t> Size(const storage::BlobId& id) const override {
    return blobs_.Size(id);
  }
  absl::Status Delete(const storage::BlobId& id) override {
    return blobs_.Delete(id);
  }
  absl::StatusOr<std::vector<storage::BlobId>> List(
      const storage::BlobId& after, int64_t max_count) const override {
    return blobs_.List(after, max_count);
  }

 private:
  int64_t& read_bytes_;
  mapsieve::testing::MemoryBlobStore blobs_;
};

TEST(ChunkReader, OfALargeChunkReadsNoMoreThanTheColumnsWanted) {
  int64_t read_bytes = 0;
  Workshop workshop(12, 1,
                    {.blobs = std::make_unique<MeteredBlobs>(read_bytes)});
  MAPSIEVE_ASSERT_OK(workshop.Add(LargeTile(), kOneChunk));
  const auto chunks = workshop.Chunks(storage::ChunkKind::kRaw);
  ASSERT_EQ(chunks.size(), 1U);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                workshop.store().OpenSnapshot("map"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::LatticeCloud whole,
                                ReadPoints(*snapshot, chunks[0]));
  constexpr int64_t kHead = 4096;

  read_bytes = 0;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const core::LatticeCloud with_c,
      ReadPoints(*snapshot, chunks[0], {.attributes = {{"c"}}}));
  const int64_t position_bytes = chunks[0].stored_bytes - 3 * kColumnBytes;
  EXPECT_LE(read_bytes, kHead + position_bytes + kColumnBytes);
  EXPECT_EQ(with_c.positions, whole.positions);
  ASSERT_EQ(with_c.attributes.columns().size(), 1U);
  EXPECT_EQ(with_c.attributes.columns()[0], *whole.attributes.Find("c"));

  read_bytes = 0;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::ColumnSet columns,
                                ReadColumns(*snapshot, chunks[0], {"c", "a"}));
  EXPECT_LE(read_bytes, kHead + 2 * kColumnBytes);
  ASSERT_EQ(columns.columns().size(), 2U);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const core::LatticeCloud unsorted,
      core::DecodePoints(*snapshot->ReadChunk(chunks[0])));
  for (const char* const name : {"a", "c"}) {
    EXPECT_EQ(*columns.Find(name), *unsorted.attributes.Find(name));
  }
}

class DamagedChunkReaderTest : public ::testing::Test {
 protected:
  void SetUp() override {
    MAPSIEVE_ASSERT_OK(workshop_.Add(LargeTile(), kOneChunk));
    chunk_ = workshop_.Chunks(storage::ChunkKind::kRaw).at(0);
    snapshot_ = *workshop_.store().OpenSnapshot("map");
    path_ = snapshot_->Describe(chunk_);
    path_ = path_.substr(path_.rfind(' ') + 1);
    bytes_ = storage::ReadWholeFile(path_);
    ASSERT_EQ(std::ssize(bytes_), chunk_.stored_bytes);
  }

  std::span<const std::byte> block() const {
    return std::as_bytes(std::span(bytes_));
  }

  /// Reads column `name` of the chunk, whose file is `bytes` now.
  absl::Status ReadDamaged(const std::string& bytes, const std::string& name) {
    storage::WriteWholeFile(path_, bytes);
    return ReadColumns(*snapshot_, chunk_, {name}).status();
  }

  /// Damage that names the file.
  auto IsLoss(const std::string& what) const {
    return StatusIs(absl::StatusCode::kDataLoss,
                    AllOf(HasSubstr(path_), HasSubstr(what)));
  }

  Workshop workshop_{12};
  storage::ChunkRef chunk_;
  std::shared_ptr<const storage::ReadSnapshot> snapshot_;
  std::string path_;
  std::string bytes_;
};

TEST_F(DamagedChunkReaderTest, DamageOfHeadAndWantedColumnsIsDataLoss) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::BlockHead head,
                                core::ReadBlockHead(block()));
  std::vector<std::pair<size_t, std::string>> places;
  for (size_t at = 0; at < head.head_bytes; at += 13)
    places.push_back({at, "b"});
  size_t begin = head.head_bytes;
  for (const core::ColumnEntry& entry : head.columns) {
    for (const size_t at : {size_t{0}, entry.stored_bytes / size_t{2},
                            entry.stored_bytes - size_t{1}}) {
      places.push_back({begin + at, entry.spec.name});
    }
    begin += entry.stored_bytes;
  }
  for (const auto& [at, column] : places) {
    SCOPED_TRACE(at);
    std::string damaged = bytes_;
    damaged[at] = static_cast<char>(damaged[at] ^ 4);
    for (const std::string name : {"a", "b", "c"}) {
      const absl::Status status = ReadDamaged(damaged, name);
      if (at < head.head_bytes || column == name) {
        EXPECT_THAT(status, IsLoss("expected content of hash"));
      } else {
        // It is not what is damaged.
        MAPSIEVE_EXPECT_OK(status);
      }
    }
    const absl::Status whole = ReadPoints(*snapshot_, chunk_).status();
    EXPECT_THAT(whole, IsLoss("expected content of hash"));
    const bool is_attribute = column.size() == 1 && column[0] < 'x';
    const absl::Status positions = ReadPositions(*snapshot_, chunk_).status();
    if (at < head.head_bytes || !is_attribute) {
      EXPECT_THAT(positions, IsLoss("expected content of hash"));
    } else {
      MAPSIEVE_EXPECT_OK(positions);
    }
  }
}

TEST_F(DamagedChunkReaderTest, OneThatIsCutOffOrGoneIsDataLoss) {
  EXPECT_THAT(ReadDamaged(bytes_.substr(0, 2000), "b"),
              IsLoss("found the end of the file at offset 2000"));
  EXPECT_THAT(ReadDamaged(bytes_.substr(0, bytes_.size() - 1), "c"),
              IsLoss("found the end of the file"));
  std::filesystem::remove(path_);
  EXPECT_THAT(ReadColumns(*snapshot_, chunk_, {"b"}), IsLoss("found no file"));
}

TEST_F(DamagedChunkReaderTest, AnotherBlockInItsPlaceIsDataLoss) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::BlockHead head,
                                core::ReadBlockHead(block()));
  const auto with_head = [&](const core::BlockHead& other) {
    const std::vector<std::byte> bytes = core::FormatBlockHead(other);
    return std::string(reinterpret_cast<const char*>(bytes.data()),
                       bytes.size()) +
           bytes_.substr(head.head_bytes);
  };
  ASSERT_EQ(with_head(head), bytes_);
  core::BlockHead moved = head;
  moved.min.x += 1;
  EXPECT_THAT(ReadDamaged(with_head(moved), "b"),
              IsLoss("expected content of hash"));
}

TEST(ProductChunk, ANumberThatIsNoLabelOrNoDepthIsDataLoss) {
  const auto check = [](std::string_view name, uint8_t largest) {
    // Wherever it lies.
    for (const size_t row : {size_t{0}, size_t{70}, size_t{99}}) {
      core::Column column({std::string(name), core::ScalarType::kUint8}, 100);
      column.Set<uint8_t>(row, largest);
      core::ColumnSet columns;
      columns.columns() = {column};
      const auto read = [&] {
        return name == kDepthColumn ? DepthsOf(columns).status()
                                    : CountLabels(columns).status();
      };
      MAPSIEVE_EXPECT_OK(read());
      columns.columns()[0].Set(row, static_cast<uint8_t>(largest + 1));
      EXPECT_THAT(read(),
                  StatusIs(absl::StatusCode::kDataLoss,
                           HasSubstr("of point " + std::to_string(row) + " ")));
    }
  };
  check(kLabelColumn, core::kLabelCount - 1);
  check(kDepthColumn, core::kMaxDepth);
}

}  // namespace
}  // namespace mapsieve::engine::testing
