#include "storage/blob_store.h"

#include <filesystem>
#include <functional>
#include <memory>
#include <set>

#include "core/base/hash.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/local_blob_store.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/memory_blob_store.h"
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

/// A BlobStore and what it needs to live.
struct OpenedStore {
  std::unique_ptr<SpaceReserve> reserve;
  std::unique_ptr<BlobStore> blobs;
};

struct BlobStoreImplementation {
  std::string name;
  /// Opens the store that lives in a directory, or makes it.
  std::function<OpenedStore(const std::string&)> open;
  /// Whether it is there again when it was closed.
  bool lasts = true;
};

OpenedStore OpenLocal(FileSystem& files, const std::string& directory) {
  OpenedStore opened;
  opened.reserve = std::make_unique<SpaceReserve>(files, directory, 0);
  auto store = OpenLocalBlobStore(files, directory + "/blobs", *opened.reserve);
  EXPECT_THAT(store, IsOk());
  if (store.ok()) opened.blobs = *std::move(store);
  return opened;
}

/// What GetRange fills `size` bytes with.
absl::StatusOr<std::string> RangeOf(const BlobStore& blobs, const BlobId& id,
                                    int64_t offset, size_t size) {
  std::vector<std::byte> room(size);
  MAPSIEVE_RETURN_IF_ERROR(blobs.GetRange(id, offset, room));
  return std::string(Text(room));
}

// What every implementation of BlobStore does.
class BlobStoreTest : public ::testing::TestWithParam<BlobStoreImplementation> {
 protected:
  void SetUp() override { Reopen(); }
  void Reopen() {
    if (opened_.blobs != nullptr && !GetParam().lasts) return;
    opened_ = {};
    opened_ = GetParam().open(directory_.path());
    ASSERT_NE(opened_.blobs, nullptr);
  }
  BlobStore& blobs() { return *opened_.blobs; }

  TemporaryDirectory directory_;
  OpenedStore opened_;
};

OpenedStore OpenLocalDirectory(const std::string& directory) {
  return OpenLocal(PosixFileSystem(), directory);
}

OpenedStore MakeInMemory(const std::string&) {
  return {.blobs = std::make_unique<testing::MemoryBlobStore>()};
}

INSTANTIATE_TEST_SUITE_P(
    All, BlobStoreTest,
    ::testing::Values(BlobStoreImplementation{"Local", OpenLocalDirectory},
                      BlobStoreImplementation{"Memory", MakeInMemory,
                                              /*lasts=*/false}),
    [](const auto& instance) { return instance.param.name; });

TEST_P(BlobStoreTest, ABlobIsNamedByItsContentAndStays) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const BlobId id,
                                blobs().PutIfAbsent(Bytes("points")));
  EXPECT_EQ(id, ContentHash(TextBytes("points")));
  Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto bytes, blobs().Get(id));
  EXPECT_EQ(Text(bytes), "points");
  EXPECT_EQ(*blobs().Size(id), 6);
  EXPECT_EQ(*blobs().PutIfAbsent(Bytes("points")), id);
  EXPECT_THAT(*blobs().List("", 10), ElementsAre(id));
}

TEST_P(BlobStoreTest, AnEmptyBlobIsABlob) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const BlobId id, blobs().PutIfAbsent({}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto bytes, blobs().Get(id));
  EXPECT_THAT(bytes, IsEmpty());
}

TEST_P(BlobStoreTest, RangesMustLieInside) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const BlobId id,
                                blobs().PutIfAbsent(Bytes("0123456789")));
  EXPECT_EQ(*RangeOf(blobs(), id, 3, 4), "3456");
  EXPECT_EQ(*RangeOf(blobs(), id, 0, 10), "0123456789");
  EXPECT_EQ(*RangeOf(blobs(), id, 10, 0), "");
  for (const auto& [offset, size] : std::vector<std::pair<int64_t, size_t>>{
           {0, 11}, {11, 0}, {-1, 2}, {1, 10}, {INT64_MAX, 1}}) {
    EXPECT_THAT(RangeOf(blobs(), id, offset, size),
                StatusIs(absl::StatusCode::kOutOfRange, _))
        << offset << " " << size;
  }
}

TEST_P(BlobStoreTest, AbsentBlobsAreNotFound) {
  const BlobId id(32, 'a');
  EXPECT_THAT(blobs().Get(id), StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(blobs().GetRange(id, 0, {}),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(blobs().Size(id), StatusIs(absl::StatusCode::kNotFound, _));
  MAPSIEVE_EXPECT_OK(blobs().Delete(id));
}

TEST_P(BlobStoreTest, IdsThatAreNoneAreRefused) {
  for (const BlobId& id :
       {std::string(), std::string("../../etc/passwd"), std::string(31, 'a'),
        std::string(33, 'a'), std::string(32, 'A'), std::string(32, '/'),
        std::string(32, '\0'), "aa/../" + std::string(26, 'a')}) {
    EXPECT_THAT(blobs().Get(id),
                StatusIs(absl::StatusCode::kInvalidArgument, _));
    EXPECT_THAT(blobs().GetRange(id, 0, {}),
                StatusIs(absl::StatusCode::kInvalidArgument, _));
    EXPECT_THAT(blobs().Size(id),
                StatusIs(absl::StatusCode::kInvalidArgument, _));
    EXPECT_THAT(blobs().Delete(id),
                StatusIs(absl::StatusCode::kInvalidArgument, _));
    if (!id.empty()) {
      EXPECT_THAT(blobs().List(id, 1),
                  StatusIs(absl::StatusCode::kInvalidArgument, _));
    }
  }
  EXPECT_THAT(blobs().List("", 0),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
}

TEST_P(BlobStoreTest, ADeletedBlobIsGoneAndCanComeBack) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const BlobId id,
                                blobs().PutIfAbsent(Bytes("points")));
  MAPSIEVE_ASSERT_OK(blobs().Delete(id));
  EXPECT_THAT(blobs().Get(id), StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(*blobs().List("", 10), IsEmpty());
  MAPSIEVE_ASSERT_OK(blobs().PutIfAbsent(Bytes("points")));
  EXPECT_EQ(Text(*blobs().Get(id)), "points");
}

TEST_P(BlobStoreTest, PagesListEveryBlobOnceInOrder) {
  std::set<BlobId> expected;
  for (int i = 0; i < 100; ++i) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const BlobId id, blobs().PutIfAbsent(Bytes(std::to_string(i))));
    expected.insert(id);
  }
  std::vector<BlobId> listed;
  while (true) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto page, blobs().List(listed.empty() ? "" : listed.back(), 7));
    if (page.empty()) break;
    EXPECT_LE(page.size(), 7u);
    listed.insert(listed.end(), page.begin(), page.end());
  }
  EXPECT_EQ(listed, std::vector<BlobId>(expected.begin(), expected.end()));
}

class LocalBlobStoreTest : public ::testing::Test {
 protected:
  std::string PathOf(const BlobId& id) const {
    return directory_.path() + "/blobs/" + id.substr(0, 2) + "/" + id;
  }

  TemporaryDirectory directory_;
  FaultFileSystem files_{PosixFileSystem()};
};

TEST_F(LocalBlobStoreTest, DamageIsToldAndPutHealsIt) {
  const auto store = OpenLocal(files_, directory_.path());
  const std::string content = "many points of a tile";
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const BlobId id,
                                store.blobs->PutIfAbsent(Bytes(content)));
  for (size_t i = 0; i < content.size(); ++i) {
    std::string flipped = content;
    flipped[i] = static_cast<char>(flipped[i] ^ 1);
    for (const std::string& damaged :
         {flipped, content.substr(0, i), content + flipped}) {
      WriteWholeFile(PathOf(id), damaged);
      EXPECT_THAT(store.blobs->Get(id),
                  StatusIs(absl::StatusCode::kDataLoss,
                           AllOf(HasSubstr(PathOf(id)), HasSubstr(id))));
    }
  }
  MAPSIEVE_ASSERT_OK(store.blobs->PutIfAbsent(Bytes(content)));
  EXPECT_EQ(Text(*store.blobs->Get(id)), content);
}

TEST_F(LocalBlobStoreTest, FilesThatAreNoBlobsAreNotListed) {
  const auto store = OpenLocal(files_, directory_.path());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const BlobId id,
                                store.blobs->PutIfAbsent(Bytes("a")));
  WriteWholeFile(PathOf(id) + ".bak", "x");
  WriteWholeFile(directory_ / "blobs/README", "x");
  // In the wrong folder.
  const std::string stray = (id[0] == '0' ? "1" : "0") + std::string(31, '0');
  WriteWholeFile(
      std::filesystem::path(PathOf(id)).replace_filename(stray).string(), "x");
  EXPECT_THAT(*store.blobs->List("", 10), ElementsAre(id));
}

TEST_F(LocalBlobStoreTest, UnfinishedFilesAreRemovedWhenOpened) {
  OpenLocal(files_, directory_.path());
  WriteWholeFile(directory_ / "blobs/tmp/17", "half a bl");
  OpenLocal(files_, directory_.path());
  EXPECT_THAT(*files_.List(directory_ / "blobs/tmp"), IsEmpty());
}

TEST_F(LocalBlobStoreTest, AFullDiskIsToldAndLeavesNothing) {
  const auto store = OpenLocal(files_, directory_.path());
  MAPSIEVE_ASSERT_OK(store.blobs->PutIfAbsent(Bytes("first")));
  // Fails in turn the open, the write and the sync of the new file.
  for (int operation = 2; operation <= 5; ++operation) {
    files_.Arm({.operation = operation,
                .status = absl::ResourceExhaustedError("no space"),
                .lasts = false});
    EXPECT_THAT(store.blobs->PutIfAbsent(Bytes("second")),
                StatusIs(absl::StatusCode::kResourceExhausted, _));
    EXPECT_TRUE(files_.fired());
    EXPECT_EQ(store.blobs->List("", 10)->size(), 1u);
    EXPECT_THAT(*files_.List(directory_ / "blobs/tmp"), IsEmpty());
  }
  files_.Disarm();
  files_.SetFreeBytes(3);
  EXPECT_THAT(store.blobs->PutIfAbsent(Bytes("second")),
              StatusIs(absl::StatusCode::kResourceExhausted, _));
  files_.SetFreeBytes(1000);
  MAPSIEVE_EXPECT_OK(store.blobs->PutIfAbsent(Bytes("second")));
}

TEST_F(LocalBlobStoreTest, AnyFailureAndPowerLossLeaveAllOrNothing) {
  const std::string content(1000, 'p');
  const BlobId id = ContentHash(TextBytes(content));
  for (const auto loss :
       {FaultFileSystem::Loss::kEverything, FaultFileSystem::Loss::kContent}) {
    for (const bool takes_effect : {false, true}) {
      for (int64_t n = 1;; ++n) {
        TemporaryDirectory directory;
        FaultFileSystem files(PosixFileSystem());
        BlobId before;
        bool acknowledged = false;
        {
          const auto store = OpenLocal(files, directory.path());
          before = *store.blobs->PutIfAbsent(Bytes("before"));
          files.Arm({.operation = n,
                     .status = absl::UnavailableError("device"),
                     .takes_effect = takes_effect});
          // Twice: the second one finds what the first has left.
          store.blobs->PutIfAbsent(Bytes(content)).IgnoreError();
          acknowledged = store.blobs->PutIfAbsent(Bytes(content)).ok();
        }
        files.Disarm();
        files.LosePower(loss);
        const auto store = OpenLocal(files, directory.path());
        EXPECT_EQ(Text(*store.blobs->Get(before)), "before");
        const auto bytes = store.blobs->Get(id);
        if (acknowledged || bytes.ok()) {
          ASSERT_THAT(bytes, IsOk()) << "operation " << n;
          EXPECT_EQ(Text(*bytes), content);
        } else {
          EXPECT_THAT(bytes, StatusIs(absl::StatusCode::kNotFound, _));
        }
        EXPECT_THAT(*files.List(directory / "blobs/tmp"), IsEmpty());
        MAPSIEVE_EXPECT_OK(store.blobs->PutIfAbsent(Bytes(content)));
        EXPECT_EQ(Text(*store.blobs->Get(id)), content);
        if (!files.fired()) {
          EXPECT_TRUE(acknowledged);
          EXPECT_GT(n, 10);
          break;
        }
      }
    }
  }
}

}  // namespace
}  // namespace mapsieve::storage
