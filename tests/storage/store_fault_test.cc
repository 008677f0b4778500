// A store whose n-th file operation fails, for every n, and whose machine then
// loses power: the old or the new state, never a mixture.

#include <algorithm>
#include <cstdlib>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/store.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::FaultFileSystem;
using ::mapsieve::testing::IsOk;
using ::testing::AnyOf;
using ::testing::ElementsAre;

using Contents = std::vector<std::string>;

// Of so many operations one is made to fail, unless all are asked for.
constexpr int64_t kStride = 7;

// How a device fails, and what a power failure leaves afterwards.
struct FaultMode {
  std::string name;
  absl::StatusCode code;
  bool lasts;
  bool takes_effect;
  FaultFileSystem::Loss loss;
};

class StoreFaultTest : public ::testing::TestWithParam<FaultMode> {
 protected:
  /// Runs `work` on a store that `prepare` filled, with the n-th operation
  /// failing, for all n until none fails; after each run the power is lost,
  /// the store opened again, and `check` called with whether `work` succeeded.
  void ForEveryOperation(
      const std::function<void(Store&)>& prepare,
      const std::function<absl::Status(Store&)>& work,
      const std::function<void(Store&, bool succeeded)>& check) {
    const int64_t stride =
        std::getenv("MAPSIEVE_EVERY_FAULT") == nullptr ? kStride : 1;
    for (int64_t n = 1;; n += stride) {
      SCOPED_TRACE("operation " + std::to_string(n));
      TemporaryDirectory directory;
      FaultFileSystem files(PosixFileSystem());
      const std::string data = directory / "data";
      const auto open = [&] {
        return Store::Open(files, data, {.reserve_bytes = 0});
      };
      bool succeeded = false;
      {
        MAPSIEVE_ASSERT_OK_AND_ASSIGN(auto store, open());
        prepare(*store);
        files.Arm({.operation = n,
                   .status = absl::Status(GetParam().code, "injected"),
                   .lasts = GetParam().lasts,
                   .takes_effect = GetParam().takes_effect});
        const absl::Status status = work(*store);
        succeeded = status.ok();
        if (!succeeded) {
          EXPECT_EQ(status.code(), GetParam().code) << status;
        }
      }
      const bool fired = files.fired();
      files.Disarm();
      files.LosePower(GetParam().loss);
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto store, open());
      check(*store, succeeded);
      if (HasFailure()) return;
      if (!fired) {
        EXPECT_TRUE(succeeded);
        return;
      }
    }
  }

  /// The raw contents of a revision of "campus"; 0: the newest.
  static Contents Read(Store& store, int64_t revision = 0) {
    const auto snapshot = store.OpenSnapshot("campus", revision);
    EXPECT_THAT(snapshot, IsOk());
    if (!snapshot.ok()) return {};
    const auto chunks = (*snapshot)->ListChunks(ChunkKind::kRaw, std::nullopt,
                                                std::nullopt, 1000);
    EXPECT_THAT(chunks, IsOk());
    Contents contents;
    for (const ChunkRef& chunk : *chunks) {
      const auto bytes = (*snapshot)->ReadChunk(chunk);
      EXPECT_THAT(bytes, IsOk());
      contents.push_back(bytes.ok() ? Text(*bytes) : "?");
    }
    return contents;
  }

  /// Commits a revision of "campus" with `added` instead of the chunks of
  /// the newest one.
  static absl::Status Replace(Store& store, const Contents& added) {
    const auto writer = store.NewBlobWriter();
    MAPSIEVE_ASSIGN_OR_RETURN(const auto snapshot,
                              store.OpenSnapshot("campus"));
    MAPSIEVE_ASSIGN_OR_RETURN(
        const auto chunks, snapshot->ListChunks(ChunkKind::kRaw, std::nullopt,
                                                std::nullopt, 1000));
    RevisionChange change;
    for (const ChunkRef& chunk : chunks) {
      change.removed.push_back(chunk.number);
    }
    int64_t x = 0;
    for (const std::string& content : added) {
      MAPSIEVE_RETURN_IF_ERROR(writer->Put(Bytes(content)).status());
      change.added.push_back(TestChunk(ChunkKind::kRaw, x++, 0, 0, content, 1));
    }
    return store.catalogue()
        .CommitRevision(snapshot->map().uid, snapshot->revision().number,
                        change)
        .status();
  }

  /// Everything that a blob store holds is what the revisions need.
  static void ExpectNoGarbageLeft(Store& store, const Contents& needed) {
    MAPSIEVE_ASSERT_OK(store.CollectGarbage());
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const GarbageReport again,
                                  store.CollectGarbage());
    EXPECT_EQ(again.deleted_blob_count, 0);
    EXPECT_EQ(Read(store), needed);
  }
};

INSTANTIATE_TEST_SUITE_P(
    All, StoreFaultTest,
    ::testing::Values(
        FaultMode{"DeviceFailsOnce", absl::StatusCode::kUnavailable, false,
                  false, FaultFileSystem::Loss::kEverything},
        FaultMode{"DeviceFailsForGood", absl::StatusCode::kUnavailable, true,
                  false, FaultFileSystem::Loss::kContent},
        FaultMode{"DeviceLies", absl::StatusCode::kUnavailable, false, true,
                  FaultFileSystem::Loss::kContent},
        FaultMode{"DiskFull", absl::StatusCode::kResourceExhausted, true, false,
                  FaultFileSystem::Loss::kEverything}),
    [](const auto& instance) { return instance.param.name; });

TEST_P(StoreFaultTest, ACommitIsOldOrNew) {
  ForEveryOperation(
      [](Store& store) {
        MAPSIEVE_ASSERT_OK(store.catalogue().CreateMap(TestMap("campus")));
        MAPSIEVE_ASSERT_OK(Replace(store, {"a", "b"}));
      },
      [](Store& store) {
        return Replace(store, {"b", "c", "d"});
      },
      [](Store& store, bool succeeded) {
        EXPECT_EQ(Read(store, 2), (Contents{"a", "b"}));
        const Contents now = Read(store);
        if (succeeded) {
          EXPECT_THAT(now, ElementsAre("b", "c", "d"));
        } else {
          EXPECT_THAT(now,
                      AnyOf(ElementsAre("a", "b"), ElementsAre("b", "c", "d")));
        }
        ExpectNoGarbageLeft(store, now);
        MAPSIEVE_EXPECT_OK(Replace(store, {"c"}));
        EXPECT_THAT(Read(store), ElementsAre("c"));
      });
}

TEST_P(StoreFaultTest, ACollectionRemovesNothingThatIsNeeded) {
  ForEveryOperation(
      [](Store& store) {
        Catalogue& catalogue = store.catalogue();
        MAPSIEVE_ASSERT_OK(catalogue.CreateMap(TestMap("campus")));
        MAPSIEVE_ASSERT_OK(Replace(store, {"old", "dropped"}));
        MAPSIEVE_ASSERT_OK(catalogue.DeleteMap("campus"));
        MAPSIEVE_ASSERT_OK(catalogue.CreateMap(TestMap("campus")));
        MAPSIEVE_ASSERT_OK(Replace(store, {"old", "new"}));
        MAPSIEVE_ASSERT_OK(store.NewBlobWriter()->Put(Bytes("orphan")));
      },
      [](Store& store) { return store.CollectGarbage().status(); },
      [](Store& store, bool) {
        EXPECT_THAT(Read(store), ElementsAre("old", "new"));
        ExpectNoGarbageLeft(store, {"old", "new"});
      });
}

TEST_P(StoreFaultTest, AnUploadKeepsWhatWasAcknowledged) {
  int64_t acknowledged = 0;
  const std::string all = "0123456789";
  const auto send = [&](Store& store) -> absl::Status {
    MAPSIEVE_ASSIGN_OR_RETURN(const MapRecord map,
                              store.catalogue().GetMap("campus"));
    MAPSIEVE_ASSIGN_OR_RETURN(
        const UploadRecord upload,
        store.catalogue().CreateUpload(map.uid, {.id = "u"}));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto writer,
                              store.uploads().OpenWriter(upload.uid));
    while (writer->written_bytes() < 10) {
      const int64_t at = writer->written_bytes();
      MAPSIEVE_RETURN_IF_ERROR(
          writer->Append(at, Bytes(all.substr(static_cast<size_t>(at), 4))));
      MAPSIEVE_ASSIGN_OR_RETURN(acknowledged, writer->Commit());
    }
    return absl::OkStatus();
  };
  const auto staged = [](Store& store) -> absl::StatusOr<std::string> {
    MAPSIEVE_ASSIGN_OR_RETURN(const MapRecord map,
                              store.catalogue().GetMap("campus"));
    const auto upload = store.catalogue().GetUpload(map.uid, "u");
    if (absl::IsNotFound(upload.status())) return "";
    MAPSIEVE_RETURN_IF_ERROR(upload.status());
    if (upload->committed_bytes == 0) return "";
    MAPSIEVE_ASSIGN_OR_RETURN(const auto reader,
                              store.uploads().OpenReader(upload->uid));
    MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes,
                              reader->Read(0, reader->size()));
    return Text(bytes);
  };
  ForEveryOperation(
      [&](Store& store) {
        acknowledged = 0;
        MAPSIEVE_ASSERT_OK(store.catalogue().CreateMap(TestMap("campus")));
      },
      send,
      [&](Store& store, bool) {
        // A commit that failed may have happened.
        const auto have = staged(store);
        MAPSIEVE_ASSERT_OK(have);
        const auto size = static_cast<int64_t>(have->size());
        EXPECT_EQ(*have, all.substr(0, have->size()));
        EXPECT_GE(size, acknowledged);
        EXPECT_LE(size, std::min<int64_t>(acknowledged + 4, 10));
        // The client goes on.
        MAPSIEVE_EXPECT_OK(send(store));
        EXPECT_EQ(*staged(store), all);
      });
}

TEST_P(StoreFaultTest, AStoreThatFailedToOpenOpensLater) {
  for (int64_t n = 1;; ++n) {
    SCOPED_TRACE("operation " + std::to_string(n));
    TemporaryDirectory directory;
    FaultFileSystem files(PosixFileSystem());
    const std::string data = directory / "data";
    files.Arm({.operation = n,
               .status = absl::Status(GetParam().code, "injected"),
               .lasts = GetParam().lasts,
               .takes_effect = GetParam().takes_effect});
    {
      const auto store = Store::Open(files, data, {.reserve_bytes = 0});
      if (!files.fired()) {
        MAPSIEVE_EXPECT_OK(store);
      } else if (store.ok()) {
        // SQLite can do without these.
        EXPECT_THAT(files.fault_kind(), AnyOf("open", "read", "size")) << n;
      }
    }
    const bool fired = files.fired();
    files.Disarm();
    files.LosePower(GetParam().loss);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto store, Store::Open(files, data, {.reserve_bytes = 0}));
    MAPSIEVE_ASSERT_OK(store->catalogue().CreateMap(TestMap("campus")));
    MAPSIEVE_ASSERT_OK(Replace(*store, {"a"}));
    EXPECT_THAT(Read(*store), ElementsAre("a"));
    if (!fired) {
      EXPECT_GT(n, 5);
      return;
    }
  }
}

}  // namespace
}  // namespace mapsieve::storage
