// Readers, writers and the collection at the same time; TSan watches.

#include <atomic>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/store.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::IsOk;

constexpr int kChunkCount = 4;

class StoreThreadsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        store_, Store::Open(PosixFileSystem(), directory_ / "data",
                            {.reserve_bytes = 0}));
  }

  /// Replaces all chunks of a map by new ones. A revision r then holds
  /// kChunkCount chunks whose contents all begin with the same word.
  absl::Status Replace(const std::string& id, const std::string& word) {
    Catalogue& catalogue = store_->catalogue();
    while (true) {
      const auto writer = store_->NewBlobWriter();
      MAPSIEVE_ASSIGN_OR_RETURN(const auto snapshot, store_->OpenSnapshot(id));
      MAPSIEVE_ASSIGN_OR_RETURN(
          const auto chunks, snapshot->ListChunks(ChunkKind::kRaw, std::nullopt,
                                                  std::nullopt, 100));
      RevisionChange change;
      for (const ChunkRef& chunk : chunks) {
        change.removed.push_back(chunk.number);
      }
      for (int i = 0; i < kChunkCount; ++i) {
        const std::string content = word + std::to_string(i);
        MAPSIEVE_ASSIGN_OR_RETURN(const BlobId blob,
                                  writer->Put(Bytes(content)));
        change.added.push_back(TestChunk(ChunkKind::kRaw, i, 0, 0, content, 1));
      }
      const auto revision = catalogue.CommitRevision(
          snapshot->map().uid, snapshot->revision().number, change);
      if (!absl::IsAborted(revision.status())) return revision.status();
    }
  }

  /// Reads the newest revision of a map, whole.
  void ReadOnce(const std::string& id) {
    const auto snapshot = store_->OpenSnapshot(id);
    if (absl::IsNotFound(snapshot.status())) return;
    ASSERT_THAT(snapshot, IsOk());
    const auto chunks = (*snapshot)->ListChunks(ChunkKind::kRaw, std::nullopt,
                                                std::nullopt, 100);
    ASSERT_THAT(chunks, IsOk());
    if (chunks->empty()) {
      EXPECT_EQ((*snapshot)->revision().number, 1);
      return;
    }
    EXPECT_EQ(chunks->size(), size_t{kChunkCount});
    std::string word;
    for (const ChunkRef& chunk : *chunks) {
      const auto bytes = (*snapshot)->ReadChunk(chunk);
      ASSERT_THAT(bytes, IsOk());
      std::string text = Text(*bytes);
      text.pop_back();
      if (word.empty()) word = text;
      EXPECT_EQ(text, word);
    }
  }

  TemporaryDirectory directory_;
  std::unique_ptr<Store> store_;
};

TEST_F(StoreThreadsTest, ReadersSeeWholeRevisionsWhileAllElseGoesOn) {
  MAPSIEVE_ASSERT_OK(store_->catalogue().CreateMap(TestMap("campus")));
  std::atomic<bool> done = false;
  std::atomic<int> commits = 0;
  std::vector<std::jthread> threads;
  for (int writer = 0; writer < 2; ++writer) {
    threads.emplace_back([&, writer] {
      std::mt19937 random(static_cast<unsigned>(writer));
      for (int i = 0; i < 30; ++i) {
        // Few words: writers meet each other's blobs, and those that the
        // collection is about to remove.
        const std::string word = "word" + std::to_string(random() % 3) + "-";
        MAPSIEVE_EXPECT_OK(Replace("campus", word));
        // What nobody commits.
        MAPSIEVE_EXPECT_OK(
            store_->NewBlobWriter()->Put(Bytes("lost" + std::to_string(i))));
        ++commits;
      }
      if (commits == 60) done = true;
    });
  }
  for (int reader = 0; reader < 2; ++reader) {
    threads.emplace_back([&] {
      while (!done) ReadOnce("campus");
    });
  }
  threads.emplace_back([&] {
    while (!done) MAPSIEVE_EXPECT_OK(store_->CollectGarbage());
  });
  threads.clear();
  EXPECT_EQ(store_->catalogue().GetMap("campus")->newest_revision, 61);
  ReadOnce("campus");
}

TEST_F(StoreThreadsTest, MapsComeAndGoUnderTheirReaders) {
  std::atomic<bool> done = false;
  std::vector<std::jthread> threads;
  threads.emplace_back([&] {
    for (int i = 0; i < 30; ++i) {
      MAPSIEVE_EXPECT_OK(store_->catalogue().CreateMap(TestMap("campus")));
      MAPSIEVE_EXPECT_OK(Replace("campus", "same"));
      MAPSIEVE_EXPECT_OK(store_->catalogue().DeleteMap("campus"));
    }
    done = true;
  });
  for (int reader = 0; reader < 2; ++reader) {
    threads.emplace_back([&] {
      while (!done) ReadOnce("campus");
    });
  }
  threads.emplace_back([&] {
    while (!done) MAPSIEVE_EXPECT_OK(store_->CollectGarbage());
  });
  threads.clear();
  MAPSIEVE_ASSERT_OK(store_->CollectGarbage());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto deleted,
                                store_->catalogue().ListDeletedMaps("", 10));
  EXPECT_EQ(deleted.size(), 0u);
}

TEST_F(StoreThreadsTest, UploadsGoOnSideBySide) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const MapRecord map, store_->catalogue().CreateMap(TestMap("campus")));
  std::vector<std::jthread> threads;
  for (int client = 0; client < 4; ++client) {
    threads.emplace_back([&, client] {
      const auto upload = store_->catalogue().CreateUpload(
          map.uid, {.id = std::to_string(client)});
      ASSERT_THAT(upload, IsOk());
      std::string expected;
      for (int session = 0; session < 3; ++session) {
        const auto writer = store_->uploads().OpenWriter(upload->uid);
        ASSERT_THAT(writer, IsOk());
        for (int i = 0; i < 5; ++i) {
          const std::string bytes(100, static_cast<char>('a' + client));
          const auto at = static_cast<int64_t>(expected.size());
          MAPSIEVE_EXPECT_OK((*writer)->Append(at, Bytes(bytes)));
          MAPSIEVE_EXPECT_OK((*writer)->Commit());
          expected += bytes;
        }
      }
      const auto reader = store_->uploads().OpenReader(upload->uid);
      ASSERT_THAT(reader, IsOk());
      EXPECT_EQ(Text(*(*reader)->Read(0, (*reader)->size())), expected);
    });
  }
  threads.clear();
  EXPECT_EQ(store_->catalogue().ListUploads(map.uid, "", 10)->size(), 4u);
}

}  // namespace
}  // namespace mapsieve::storage
