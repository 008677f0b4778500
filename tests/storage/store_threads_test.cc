// Readers, writers and the collection at the same time; TSan watches.

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <memory>
#include <random>
#include <set>
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
  void SetUp() override { Open({.reserve_bytes = 0}); }

  void Open(const StoreOptions& options) {
    store_.reset();
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        store_, Store::Open(PosixFileSystem(), data_, options));
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

  /// Makes the product of the newest revision of a map: for each raw chunk one
  /// of the same word.
  absl::Status Process(const std::string& id) {
    while (true) {
      const auto writer = store_->NewBlobWriter();
      MAPSIEVE_ASSIGN_OR_RETURN(const auto snapshot, store_->OpenSnapshot(id));
      MAPSIEVE_ASSIGN_OR_RETURN(
          const auto chunks, snapshot->ListChunks(ChunkKind::kRaw, std::nullopt,
                                                  std::nullopt, 100));
      RevisionChange change = Processing({});
      for (const ChunkRef& chunk : chunks) {
        MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes, snapshot->ReadChunk(chunk));
        const std::string content = Text(bytes) + "p";
        MAPSIEVE_RETURN_IF_ERROR(writer->Put(Bytes(content)).status());
        change.added.push_back(
            TestChunk(ChunkKind::kProduct, chunk.tile.x, 0, 0, content, 1));
      }
      const auto revision = store_->CommitRevision(
          snapshot->map().uid, snapshot->revision().number, change);
      if (!absl::IsAborted(revision.status())) return revision.status();
    }
  }

  /// Reads a revision of a map, whole; 0: the newest. Nothing if there is no
  /// such map.
  void ReadOnce(const std::string& id, int64_t revision = 0) {
    const auto snapshot = store_->OpenSnapshot(id, revision);
    if (absl::IsNotFound(snapshot.status())) return;
    if (revision != 0 && absl::IsOutOfRange(snapshot.status())) return;
    ASSERT_THAT(snapshot, IsOk());
    ReadRaw(**snapshot);
    if ((*snapshot)->revision().processed_revision == 0) return;
    const auto product = store_->OpenProduct(**snapshot);
    ASSERT_THAT(product, IsOk());
    ReadRaw(**product);
    const auto chunks = (*product)->ListChunks(ChunkKind::kProduct,
                                               std::nullopt, std::nullopt, 100);
    ASSERT_THAT(chunks, IsOk());
    EXPECT_EQ(static_cast<int64_t>(chunks->size()),
              (*product)->revision().totals.raw_chunk_count);
    for (const ChunkRef& chunk : *chunks) {
      EXPECT_THAT((*product)->ReadChunk(chunk), IsOk());
    }
  }

  void ReadRaw(const ReadSnapshot& snapshot) {
    const auto chunks =
        snapshot.ListChunks(ChunkKind::kRaw, std::nullopt, std::nullopt, 100);
    ASSERT_THAT(chunks, IsOk());
    ASSERT_EQ(static_cast<int64_t>(chunks->size()),
              snapshot.revision().totals.raw_chunk_count);
    if (chunks->empty()) return;
    EXPECT_EQ(chunks->size(), size_t{kChunkCount});
    std::string word;
    for (const ChunkRef& chunk : *chunks) {
      const auto bytes = snapshot.ReadChunk(chunk);
      ASSERT_THAT(bytes, IsOk());
      std::string text = Text(*bytes);
      text.pop_back();
      if (word.empty()) word = text;
      EXPECT_EQ(text, word);
    }
  }

  /// Names of the files under a folder of the data directory.
  std::set<std::string> FilesIn(const std::string& folder) {
    std::set<std::string> names;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(
             std::filesystem::path(data_) / folder)) {
      if (entry.is_regular_file()) names.insert(entry.path().filename());
    }
    return names;
  }

  TemporaryDirectory directory_;
  const std::string data_ = directory_ / "data";
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

TEST_F(StoreThreadsTest, UnderFireEverythingReferredToStaysAndNothingElse) {
  Open({.reserve_bytes = 0, .kept_revision_count = 1});
  Catalogue& catalogue = store_->catalogue();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord campus,
                                catalogue.CreateMap(TestMap("campus")));
  std::atomic<int> working = 4;
  std::vector<std::jthread> threads;
  const auto work = [&](auto step) {
    threads.emplace_back([&working, step]() mutable {
      for (int i = 0; i < 40; ++i) step(i);
      --working;
    });
  };
  const auto meanwhile = [&](auto step) {
    threads.emplace_back([&working, step] {
      while (working > 0) step();
    });
  };
  // Edits, products and rollbacks; few words, so that blobs come and go and
  // come again.
  for (unsigned seed = 1; seed <= 2; ++seed) {
    work([&, random = std::mt19937(seed)](int) mutable {
      MAPSIEVE_EXPECT_OK(
          Replace("campus", "word" + std::to_string(random() % 3) + "-"));
      if (random() % 2 == 0) {
        MAPSIEVE_EXPECT_OK(Process("campus"));
      }
      if (random() % 2 == 0) return;
      const int64_t newest = catalogue.GetMap("campus")->newest_revision;
      const auto back = catalogue.RollBack(campus.uid, newest - 1);
      EXPECT_TRUE(back.ok() || absl::IsOutOfRange(back.status()))
          << back.status();
    });
  }
  // Maps of the same words.
  work([&](int) {
    MAPSIEVE_EXPECT_OK(catalogue.CreateMap(TestMap("shed")));
    MAPSIEVE_EXPECT_OK(Replace("shed", "word1-"));
    MAPSIEVE_EXPECT_OK(catalogue.DeleteMap("shed"));
  });
  // Uploads, every second one is given up.
  work([&](int i) {
    const auto upload =
        catalogue.CreateUpload(campus.uid, {.id = std::to_string(i)});
    ASSERT_THAT(upload, IsOk());
    {
      const auto writer = store_->uploads().OpenWriter(upload->uid);
      ASSERT_THAT(writer, IsOk());
      MAPSIEVE_EXPECT_OK((*writer)->Append(0, Bytes("scan")));
      MAPSIEVE_EXPECT_OK((*writer)->Commit());
    }
    MAPSIEVE_EXPECT_OK(store_->uploads().OpenReader(upload->uid));
    if (i % 2 == 0) {
      MAPSIEVE_EXPECT_OK(catalogue.DeleteUpload(upload->uid));
    }
  });
  meanwhile([&] { ReadOnce("campus"); });
  // The newest revision is there even if it expires at this moment.
  meanwhile([&] { MAPSIEVE_EXPECT_OK(store_->OpenSnapshot("campus")); });
  meanwhile([&] {
    ReadOnce("campus", catalogue.GetMap("campus")->newest_revision - 1);
    ReadOnce("shed");
  });
  meanwhile([&] { MAPSIEVE_EXPECT_OK(store_->CollectGarbage()); });
  meanwhile([&] { MAPSIEVE_EXPECT_OK(store_->ExpireRevisions()); });
  threads.clear();
  MAPSIEVE_ASSERT_OK(store_->CollectGarbage());

  const MapRecord map = *catalogue.GetMap("campus");
  ReadOnce("campus");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto revisions,
                                catalogue.ListRevisions(map.uid, 0, 1000));
  EXPECT_GT(revisions.size(), 100u);
  EXPECT_LE(std::count_if(revisions.begin(), revisions.end(),
                          [](const auto& r) { return !r.is_expired; }),
            2);
  std::set<std::string> referenced;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto chunks,
                                catalogue.ListAllChunks(map.uid, 0, 1000));
  for (const ChunkRef& chunk : chunks) referenced.insert(chunk.blob_id);
  EXPECT_EQ(FilesIn("blobs"), referenced);
  std::set<std::string> staged;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto uploads,
                                catalogue.ListUploads(map.uid, "", 1000));
  for (const UploadRecord& upload : uploads) staged.insert(upload.uid);
  EXPECT_EQ(staged.size(), 20u);
  EXPECT_EQ(FilesIn("uploads"), staged);
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
