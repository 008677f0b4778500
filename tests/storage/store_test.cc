#include "storage/store.h"

#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/memory_blob_store.h"
#include "tests/testing/memory_catalogue.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::FaultFileSystem;
using ::mapsieve::testing::IsOk;
using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class StoreTest : public ::testing::Test {
 protected:
  void SetUp() override { Open(); }

  void Open(const StoreOptions& options = {.reserve_bytes = 0}) {
    store_.reset();
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(store_, Store::Open(files_, data_, options));
  }
  MapRecord MakeMap(const std::string& id) {
    const auto map = store_->catalogue().CreateMap(TestMap(id));
    EXPECT_THAT(map, IsOk());
    return map.value_or(MapRecord());
  }
  /// Commits a revision that adds raw chunks of these contents, one a tile.
  void Commit(const MapRecord& map, const std::vector<std::string>& contents) {
    const auto writer = store_->NewBlobWriter();
    RevisionChange change;
    for (const std::string& content : contents) {
      MAPSIEVE_ASSERT_OK(writer->Put(Bytes(content)));
      change.added.push_back(
          TestChunk(ChunkKind::kRaw, next_tile_++, 0, 0, content, 1));
    }
    const auto newest = store_->catalogue().GetMap(map.spec.id);
    MAPSIEVE_ASSERT_OK(newest);
    MAPSIEVE_ASSERT_OK(store_->catalogue().CommitRevision(
        map.uid, newest->newest_revision, change));
  }
  std::vector<std::string> Contents(const ReadSnapshot& snapshot) {
    const auto chunks =
        snapshot.ListChunks(ChunkKind::kRaw, std::nullopt, std::nullopt, 1000);
    EXPECT_THAT(chunks, IsOk());
    std::vector<std::string> contents;
    for (const ChunkRef& chunk : *chunks) {
      const auto bytes = snapshot.ReadChunk(chunk);
      EXPECT_THAT(bytes, IsOk());
      contents.push_back(bytes.ok() ? Text(*bytes) : "?");
    }
    return contents;
  }
  GarbageReport Collect() {
    const auto report = store_->CollectGarbage();
    EXPECT_THAT(report, IsOk());
    return report.value_or(GarbageReport());
  }
  std::string PathOfBlob(const std::string& content) {
    const BlobId id = ContentHash(TextBytes(content));
    return data_ + "/blobs/" + id.substr(0, 2) + "/" + id;
  }

  TemporaryDirectory directory_;
  const std::string data_ = directory_ / "data";
  FaultFileSystem files_{PosixFileSystem()};
  std::unique_ptr<Store> store_;
  int next_tile_ = 0;
};

TEST_F(StoreTest, ASnapshotReadsItsRevisionForEver) {
  const MapRecord map = MakeMap("campus");
  Commit(map, {"a", "b"});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto old, store_->OpenSnapshot("campus"));
  Commit(map, {"c"});
  EXPECT_EQ(old->revision().number, 2);
  EXPECT_EQ(old->map().uid, map.uid);
  EXPECT_THAT(Contents(*old), ElementsAre("a", "b"));
  EXPECT_THAT(Contents(**store_->OpenSnapshot("campus")),
              ElementsAre("a", "b", "c"));
  EXPECT_THAT(Contents(**store_->OpenSnapshot("campus", 2)),
              ElementsAre("a", "b"));
  EXPECT_THAT(Contents(**store_->OpenSnapshot("campus", 1)), IsEmpty());
  EXPECT_THAT(store_->OpenSnapshot("campus", 4),
              StatusIs(absl::StatusCode::kOutOfRange, _));
  EXPECT_THAT(store_->OpenSnapshot("campus", -1),
              StatusIs(absl::StatusCode::kOutOfRange, _));
  EXPECT_THAT(store_->OpenSnapshot("other"),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(store_->OpenSnapshot("../x"),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
}

TEST_F(StoreTest, ASnapshotAnswersForItsTiles) {
  const MapRecord map = MakeMap("campus");
  Commit(map, {"a", "bb"});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                store_->OpenSnapshot("campus"));
  Commit(map, {"c"});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto tiles,
      snapshot->ListTiles(ChunkKind::kRaw, std::nullopt, std::nullopt, 10));
  ASSERT_EQ(tiles.size(), 2u);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto chunks,
      snapshot->ListTileChunks(ChunkKind::kRaw, tiles[1].tile));
  ASSERT_EQ(chunks.size(), 1u);
  EXPECT_EQ(chunks[0].stored_bytes, 2);
}

// All of it over one pair of parts; what a caller gets to see.
std::string Live(std::unique_ptr<Store> store) {
  std::string seen;
  const auto see = [&](const auto&... values) {
    (absl::StrAppend(&seen, values, " "), ...);
  };
  Catalogue& catalogue = store->catalogue();
  const auto map = catalogue.CreateMap(TestMap("campus"));
  EXPECT_THAT(map, IsOk());
  const auto commit = [&](int64_t parent,
                          const std::vector<std::string>& contents) {
    const auto writer = store->NewBlobWriter();
    RevisionChange change;
    for (const std::string& content : contents) {
      EXPECT_THAT(writer->Put(Bytes(content)), IsOk());
      change.added.push_back(TestChunk(
          ChunkKind::kRaw, std::ssize(change.added), 0, 0, content, 1));
    }
    see(catalogue.CommitRevision(map->uid, parent, change)->number);
  };
  const auto read = [&](const std::string& id, int64_t revision) {
    const auto snapshot = store->OpenSnapshot(id, revision);
    see(static_cast<int>(snapshot.status().code()));
    if (!snapshot.ok()) return;
    const auto chunks = (*snapshot)->ListChunks(ChunkKind::kRaw, std::nullopt,
                                                std::nullopt, 100);
    EXPECT_THAT(chunks, IsOk());
    for (const ChunkRef& chunk : *chunks) {
      see(Text(*(*snapshot)->ReadChunk(chunk)));
    }
  };
  const auto collect = [&] {
    const auto report = store->CollectGarbage();
    EXPECT_THAT(report, IsOk());
    see(report->purged_map_count, report->deleted_blob_count,
        report->deleted_blob_bytes, report->deleted_upload_file_count);
  };
  commit(1, {"a", "bb"});
  commit(2, {"ccc"});
  EXPECT_THAT(store->NewBlobWriter()->Put(Bytes("nobody's")), IsOk());
  for (int64_t revision = 0; revision < 5; ++revision) read("campus", revision);
  read("other", 0);
  EXPECT_THAT(catalogue.RollBack(map->uid, 2), IsOk());
  read("campus", 0);
  const auto upload = catalogue.CreateUpload(map->uid, {.id = "u"});
  EXPECT_THAT(upload, IsOk());
  collect();
  {
    const auto kept = store->OpenSnapshot("campus");
    EXPECT_THAT(catalogue.DeleteMap("campus"), IsOk());
    collect();
  }
  read("campus", 0);
  collect();
  collect();
  return seen;
}

TEST_F(StoreTest, KeepsItsMapsInAnyCatalogueAndBlobStore) {
  const auto open = [&](const std::string& name, StoreParts parts) {
    auto store = Store::Open(files_, directory_ / name, {.reserve_bytes = 0},
                             std::move(parts));
    EXPECT_THAT(store, IsOk());
    return *std::move(store);
  };
  const std::string expected = Live(open("both", {}));
  EXPECT_THAT(expected, HasSubstr("a ccc bb"));
  EXPECT_EQ(
      Live(open("none",
                {.catalogue = std::make_unique<testing::MemoryCatalogue>(),
                 .blobs = std::make_unique<testing::MemoryBlobStore>()})),
      expected);
  EXPECT_FALSE(std::filesystem::exists(directory_ / "none/catalogue.db"));
  EXPECT_FALSE(std::filesystem::exists(directory_ / "none/blobs"));
  EXPECT_EQ(
      Live(open("blobs",
                {.catalogue = std::make_unique<testing::MemoryCatalogue>()})),
      expected);
}

TEST_F(StoreTest, EverythingSurvivesReopening) {
  const MapRecord map = MakeMap("campus");
  Commit(map, {"a", "b"});
  Open();
  EXPECT_THAT(Contents(**store_->OpenSnapshot("campus")),
              ElementsAre("a", "b"));
}

TEST_F(StoreTest, ASecondOpenerIsToldWhoHasTheDirectory) {
  EXPECT_THAT(
      Store::Open(PosixFileSystem(), data_),
      StatusIs(absl::StatusCode::kAborted,
               AllOf(HasSubstr("in use"), HasSubstr(data_ + "/lock"),
                     HasSubstr("process " + std::to_string(::getpid())))));
  // Another process is told the same.
  const pid_t child = ::fork();
  if (child == 0) {
    const auto second = Store::Open(PosixFileSystem(), data_);
    ::_exit(absl::IsAborted(second.status()) ? 0 : 1);
  }
  int outcome = -1;
  ::waitpid(child, &outcome, 0);
  EXPECT_EQ(outcome, 0);
  // The first one goes on.
  MakeMap("campus");
}

TEST_F(StoreTest, ADirectoryOfOtherThingsIsRefused) {
  const std::string other = directory_ / "photos";
  std::filesystem::create_directory(other);
  WriteWholeFile(other + "/cat.jpg", "x");
  EXPECT_THAT(
      Store::Open(files_, other),
      StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("cat.jpg")));
  EXPECT_THAT(*files_.List(other), ElementsAre("cat.jpg"));
  std::filesystem::remove(other + "/cat.jpg");
  std::filesystem::create_directory(other + "/lost+found");
  EXPECT_THAT(Store::Open(files_, other), IsOk());
}

TEST_F(StoreTest, BlobsWithoutTheirCatalogueAreNotCollected) {
  Commit(MakeMap("campus"), {"a"});
  store_.reset();
  for (const char* damage : {"removed", "emptied"}) {
    for (const auto& entry : std::filesystem::directory_iterator(data_)) {
      if (entry.path().filename().string().starts_with("catalogue")) {
        std::filesystem::remove(entry.path());
      }
    }
    if (damage == std::string("emptied")) {
      WriteWholeFile(data_ + "/catalogue.db", "");
    }
    EXPECT_THAT(Store::Open(files_, data_),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("backup")))
        << damage;
    EXPECT_TRUE(std::filesystem::exists(PathOfBlob("a")));
  }
}

TEST_F(StoreTest, OptionsAreChecked) {
  EXPECT_THAT(
      Store::Open(files_, directory_ / "d", {.reserve_bytes = -1}),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("reserve_bytes")));
  EXPECT_THAT(Store::Open(files_, directory_ / "d",
                          {.upload_lifetime = absl::ZeroDuration()}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("upload_lifetime")));
  EXPECT_THAT(
      Store::Open(files_, directory_ / "d", {.kept_revision_count = -1}),
      StatusIs(absl::StatusCode::kInvalidArgument,
               HasSubstr("kept_revision_count")));
}

TEST_F(StoreTest, AChunkThatWasDamagedNamesItsPlace) {
  Commit(MakeMap("campus"), {"content", "other"});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                store_->OpenSnapshot("campus"));
  const auto chunks =
      *snapshot->ListChunks(ChunkKind::kRaw, std::nullopt, std::nullopt, 10);
  const auto data_loss = [&](const char* what) {
    return StatusIs(
        absl::StatusCode::kDataLoss,
        AllOf(HasSubstr("map campus"), HasSubstr("tile 10-0-0-0, raw chunk"),
              HasSubstr(PathOfBlob("content")), HasSubstr(what)));
  };
  WriteWholeFile(PathOfBlob("content"), "c0ntent");
  EXPECT_THAT(snapshot->ReadChunk(chunks[0]),
              data_loss("bytes 0 to 7: expected content of hash"));
  WriteWholeFile(PathOfBlob("content"), "cont");
  EXPECT_THAT(
      snapshot->ReadChunk(chunks[0]),
      data_loss("expected 7 bytes, found the end of the file at offset 4"));
  std::filesystem::remove(PathOfBlob("content"));
  EXPECT_THAT(snapshot->ReadChunk(chunks[0]),
              data_loss("expected 7 bytes, found no file"));
  // The rest stays readable.
  EXPECT_EQ(Text(*snapshot->ReadChunk(chunks[1])), "other");
}

TEST_F(StoreTest, CollectionRemovesWhatNothingRefersTo) {
  const MapRecord map = MakeMap("campus");
  Commit(map, {"a", "b"});
  {
    // A commit that never came.
    MAPSIEVE_ASSERT_OK(store_->NewBlobWriter()->Put(Bytes("orphan")));
  }
  const GarbageReport report = Collect();
  EXPECT_EQ(report.deleted_blob_count, 1);
  EXPECT_EQ(report.deleted_blob_bytes, 6);
  EXPECT_FALSE(std::filesystem::exists(PathOfBlob("orphan")));
  EXPECT_THAT(Contents(**store_->OpenSnapshot("campus")),
              ElementsAre("a", "b"));
  EXPECT_EQ(Collect().deleted_blob_count, 0);
}

TEST_F(StoreTest, BlobsOfAWriterAtWorkAreSafe) {
  const MapRecord map = MakeMap("campus");
  auto writer = store_->NewBlobWriter();
  MAPSIEVE_ASSERT_OK(writer->Put(Bytes("new")));
  EXPECT_EQ(Collect().deleted_blob_count, 0);
  // Two writers rely on one blob: it stays until both are gone.
  auto second = store_->NewBlobWriter();
  MAPSIEVE_ASSERT_OK(second->Put(Bytes("new")));
  MAPSIEVE_ASSERT_OK(second->Put(Bytes("new")));
  writer.reset();
  EXPECT_EQ(Collect().deleted_blob_count, 0);
  second.reset();
  EXPECT_EQ(Collect().deleted_blob_count, 1);
}

TEST_F(StoreTest, ADeletedMapLivesAsLongAsItsReaders) {
  const MapRecord map = MakeMap("campus");
  Commit(map, {"a", "shared"});
  Commit(MakeMap("other"), {"shared"});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(auto snapshot, store_->OpenSnapshot("campus"));
  auto second = snapshot;
  MAPSIEVE_ASSERT_OK(store_->catalogue().DeleteMap("campus"));
  EXPECT_THAT(store_->OpenSnapshot("campus"),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_EQ(Collect().purged_map_count, 0);
  snapshot.reset();
  EXPECT_EQ(Collect().purged_map_count, 0);
  EXPECT_THAT(Contents(*second), ElementsAre("a", "shared"));
  second.reset();
  const GarbageReport report = Collect();
  EXPECT_EQ(report.purged_map_count, 1);
  EXPECT_EQ(report.deleted_blob_count, 1);
  EXPECT_FALSE(std::filesystem::exists(PathOfBlob("a")));
  EXPECT_THAT(Contents(**store_->OpenSnapshot("other")), ElementsAre("shared"));
}

TEST_F(StoreTest, ExpiredRevisionsLiveAsLongAsTheirReaders) {
  Open({.reserve_bytes = 0, .kept_revision_count = 1});
  const MapRecord map = MakeMap("campus");
  const auto replace = [&](const std::string& content) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto snapshot,
                                  store_->OpenSnapshot("campus"));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto chunks,
        snapshot->ListChunks(ChunkKind::kRaw, std::nullopt, std::nullopt, 10));
    RevisionChange change;
    for (const ChunkRef& chunk : chunks) change.removed.push_back(chunk.number);
    const auto writer = store_->NewBlobWriter();
    MAPSIEVE_ASSERT_OK(writer->Put(Bytes(content)));
    change.added = {TestChunk(ChunkKind::kRaw, 0, 0, 0, content, 1)};
    MAPSIEVE_ASSERT_OK(
        store_->CommitRevision(map.uid, snapshot->revision().number, change));
  };
  replace("old");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(auto old, store_->OpenSnapshot("campus"));
  replace("between");
  replace("new");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const GarbageReport report,
                                store_->ExpireRevisions());
  EXPECT_EQ(report.expired_revision_count, 3);
  EXPECT_EQ(report.deleted_blob_count, 1);
  EXPECT_FALSE(std::filesystem::exists(PathOfBlob("between")));
  EXPECT_THAT(Contents(*old), ElementsAre("old"));
  EXPECT_THAT(store_->OpenSnapshot("campus", 2),
              StatusIs(absl::StatusCode::kOutOfRange,
                       AllOf(HasSubstr("expired"), HasSubstr("kept is 4"))));
  EXPECT_EQ(Collect().deleted_blob_count, 0);
  EXPECT_THAT(Contents(*old), ElementsAre("old"));
  old.reset();
  EXPECT_EQ(Collect().deleted_blob_count, 1);
  EXPECT_FALSE(std::filesystem::exists(PathOfBlob("old")));
  EXPECT_THAT(Contents(**store_->OpenSnapshot("campus")), ElementsAre("new"));
}

TEST_F(StoreTest, AFailedSnapshotPinsNothing) {
  MakeMap("campus");
  EXPECT_THAT(store_->OpenSnapshot("campus", 9),
              StatusIs(absl::StatusCode::kOutOfRange, _));
  MAPSIEVE_ASSERT_OK(store_->catalogue().DeleteMap("campus"));
  EXPECT_EQ(Collect().purged_map_count, 1);
}

TEST_F(StoreTest, CollectionForgetsIdleUploads) {
  Open({.reserve_bytes = 0, .upload_lifetime = absl::Milliseconds(20)});
  const MapRecord map = MakeMap("campus");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const UploadRecord upload,
      store_->catalogue().CreateUpload(map.uid, {.id = "u"}));
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                  store_->uploads().OpenWriter(upload.uid));
    MAPSIEVE_ASSERT_OK(writer->Append(0, Bytes("abc")));
    MAPSIEVE_ASSERT_OK(writer->Commit());
  }
  absl::SleepFor(absl::Milliseconds(40));
  const GarbageReport report = Collect();
  EXPECT_EQ(report.expired_upload_count, 1);
  EXPECT_EQ(report.deleted_upload_file_count, 1);
  EXPECT_THAT(*files_.List(data_ + "/uploads"), IsEmpty());
}

TEST_F(StoreTest, ACollectionCanBeStopped) {
  Commit(MakeMap("campus"), {"a"});
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THAT(store_->CollectGarbage(stop.get_token()),
              StatusIs(absl::StatusCode::kCancelled, _));
  EXPECT_THAT(Contents(**store_->OpenSnapshot("campus")), ElementsAre("a"));
}

TEST_F(StoreTest, ScratchLastsAsLongAsItsOwner) {
  const std::string scratch_path = data_ + "/scratch";
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto one, store_->NewScratch());
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto two, store_->NewScratch());
    MAPSIEVE_ASSERT_OK(one->Write("15-1--2-3-deaths", Bytes("first, long")));
    MAPSIEVE_ASSERT_OK(one->Write("15-1--2-3-deaths", Bytes("second")));
    MAPSIEVE_ASSERT_OK(two->Write("15-1--2-3-deaths", Bytes("other")));
    EXPECT_EQ(Text(*one->Read("15-1--2-3-deaths")), "second");
    EXPECT_EQ(Text(*two->Read("15-1--2-3-deaths")), "other");
    EXPECT_THAT(one->Read("never"), StatusIs(absl::StatusCode::kNotFound, _));
    MAPSIEVE_ASSERT_OK(one->Remove("15-1--2-3-deaths"));
    MAPSIEVE_ASSERT_OK(one->Remove("15-1--2-3-deaths"));
    EXPECT_THAT(one->Read("15-1--2-3-deaths"),
                StatusIs(absl::StatusCode::kNotFound, _));
    for (const char* name : {"", "../x", "a/b", ".", "A"}) {
      EXPECT_THAT(one->Write(name, {}),
                  StatusIs(absl::StatusCode::kInvalidArgument, _));
    }
  }
  EXPECT_THAT(*files_.List(scratch_path), IsEmpty());
  // What a process that died left behind.
  std::filesystem::create_directories(scratch_path + "/7");
  WriteWholeFile(scratch_path + "/7/x", "rest");
  Open();
  EXPECT_FALSE(std::filesystem::exists(scratch_path));
}

TEST_F(StoreTest, ScratchGivesPartsOfWhatItHolds) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto scratch, store_->NewScratch());
  std::string all;
  for (int i = 0; all.size() < 30000; ++i) absl::StrAppend(&all, i, " ");
  MAPSIEVE_ASSERT_OK(scratch->Write("x", Bytes(all)));
  // With gaps small and large, and none.
  const std::vector<ByteRange> parts = {
      {0, 1}, {5, 9}, {9, 12}, {4000, 4001}, {9000, 9000}, {20000, 30000}};
  std::string expected;
  for (const ByteRange& part : parts) {
    expected += all.substr(static_cast<size_t>(part.begin),
                           static_cast<size_t>(part.end - part.begin));
  }
  std::string found(expected.size(), ' ');
  const auto room =
      std::as_writable_bytes(std::span(found.data(), found.size()));
  MAPSIEVE_ASSERT_OK(scratch->ReadParts("x", parts, room));
  EXPECT_EQ(found, expected);
  const auto end = static_cast<int64_t>(all.size());
  EXPECT_THAT(
      scratch->ReadParts("x", std::vector<ByteRange>{{end - 1, end + 1}}, room),
      StatusIs(absl::StatusCode::kDataLoss, HasSubstr("expected 2 bytes")));
  EXPECT_THAT(scratch->ReadParts("never", parts, room),
              StatusIs(absl::StatusCode::kNotFound, _));
}

TEST_F(StoreTest, AFullDiskStopsWritersNotReaders) {
  const MapRecord map = MakeMap("campus");
  Commit(map, {"a"});
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const UploadRecord upload,
      store_->catalogue().CreateUpload(map.uid, {.id = "u"}));
  Open({.reserve_bytes = 1000});
  files_.SetFreeBytes(1002);
  EXPECT_EQ(*store_->FreeBytes(), 1002);
  const auto full = StatusIs(absl::StatusCode::kResourceExhausted,
                             HasSubstr("free some space"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                store_->uploads().OpenWriter(upload.uid));
  EXPECT_THAT(writer->Append(0, Bytes("abc")), full);
  EXPECT_THAT(store_->NewBlobWriter()->Put(Bytes("abc")), full);
  EXPECT_THAT((*store_->NewScratch())->Write("x", Bytes("abc")), full);
  EXPECT_THAT((*store_->NewScratch())->Append("x", Bytes("abc")), full);
  EXPECT_THAT(store_->OpenRunScratch(map.uid)->Write("x", Bytes("abc")), full);
  EXPECT_THAT(store_->CheckSpace(3), full);
  EXPECT_THAT(
      store_->CommitRevision(
          map.uid, 2, Adding({TestChunk(ChunkKind::kRaw, 9, 0, 0, "a", 1)})),
      full);
  // What takes away goes on.
  MAPSIEVE_EXPECT_OK(store_->CheckSpace(2));
  MAPSIEVE_EXPECT_OK(store_->CommitRevision(map.uid, 2, {}));
  const MapRecord other = MakeMap("other");
  Commit(other, {});
  MAPSIEVE_EXPECT_OK(store_->catalogue().DeleteMap("other"));
  EXPECT_EQ(Collect().purged_map_count, 1);
  EXPECT_THAT(Contents(**store_->OpenSnapshot("campus")), ElementsAre("a"));
  // Space returns, and all goes on.
  files_.SetFreeBytes(2000);
  MAPSIEVE_EXPECT_OK(writer->Append(0, Bytes("abc")));
  MAPSIEVE_EXPECT_OK(writer->Commit());
}

}  // namespace
}  // namespace mapsieve::storage
