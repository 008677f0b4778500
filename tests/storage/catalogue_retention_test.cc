#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/catalogue.h"
#include "tests/storage/catalogue_conformance.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::UnorderedElementsAre;

ChunkRef Raw(const std::string& content) {
  return TestChunk(ChunkKind::kRaw, 0, 0, 0, content, 1);
}

/// The whole map is replaced by a point of `content`.
RevisionChange Replacing(const std::vector<ChunkRef>& present,
                         const std::string& content) {
  RevisionChange change = Adding({Raw(content)});
  for (const ChunkRef& chunk : present) change.removed.push_back(chunk.number);
  return change;
}

TEST_P(CatalogueTest, TheNewestRevisionsAndTheirProductsAreKept) {
  const MapRecord map = MakeMap("campus");
  Commit(map, 1, Adding({Raw("a")}));
  Commit(map, 2, Processing({TestChunk(ChunkKind::kProduct, 0, 0, 0, "p", 1)}));
  for (int64_t parent = 3; parent < 6; ++parent) {
    Commit(map, parent, Replacing(Chunks(map, parent), std::to_string(parent)));
  }
  EXPECT_EQ(catalogue_->GetMap("campus")->oldest_revision, 1);
  EXPECT_THAT(catalogue_->ExpireRevisions(map.uid, 0),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  EXPECT_EQ(catalogue_->ExpireRevisions(map.uid, 6).value_or(-1), 0);
  // 1, 2 and 4; 3 made the product of the newest ones.
  EXPECT_EQ(catalogue_->ExpireRevisions(map.uid, 2).value_or(-1), 3);
  EXPECT_EQ(catalogue_->ExpireRevisions(map.uid, 2).value_or(-1), 0);
  Reopen();
  EXPECT_EQ(catalogue_->GetMap("campus")->oldest_revision, 3);
  for (const int64_t kept : {3, 5, 6}) {
    MAPSIEVE_EXPECT_OK(catalogue_->GetKeptRevision(map.uid, kept));
  }
  for (const int64_t expired : {1, 2, 4}) {
    EXPECT_THAT(catalogue_->GetKeptRevision(map.uid, expired),
                StatusIs(absl::StatusCode::kOutOfRange,
                         AllOf(HasSubstr("expired"), HasSubstr("kept is 3"))));
    EXPECT_TRUE(catalogue_->GetRevision(map.uid, expired)->is_expired);
  }
  EXPECT_EQ(catalogue_->ListRevisions(map.uid, 0, 100)->size(), 6u);
  EXPECT_THAT(catalogue_->GetKeptRevision(map.uid, 7),
              StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("1 to 6")));
  // A pinned revision keeps its references; 5 and 6 hold others.
  EXPECT_THAT(ForgetAll(map, {4}), IsEmpty());
  EXPECT_THAT(ForgetAll(map, {}), ElementsAre(Raw("3").blob_id));
  EXPECT_THAT(WithoutNumbers(Chunks(map, 3)), ElementsAre(Raw("a")));
  EXPECT_EQ(catalogue_->CountAllChunks(map.uid).value_or(-1), 4);
  EXPECT_THAT(catalogue_->ForgetExpired("nobody", {}),
              StatusIs(absl::StatusCode::kNotFound, _));
}

TEST_P(CatalogueTest, APinKeepsTheProductOfItsRevision) {
  const MapRecord map = MakeMap("campus");
  Commit(map, 1, Adding({Raw("a")}));
  const auto p = TestChunk(ChunkKind::kProduct, 0, 0, 0, "p", 1);
  const auto q = TestChunk(ChunkKind::kProduct, 0, 0, 0, "q", 1);
  Commit(map, 2, Processing({p}));
  Commit(map, 3, Replacing(Chunks(map, 3), "b"));
  Commit(map, 4, Processing({q}));
  EXPECT_EQ(catalogue_->ExpireRevisions(map.uid, 1).value_or(-1), 4);
  EXPECT_THAT(ForgetAll(map, {4}), IsEmpty());
  EXPECT_THAT(WithoutNumbers(Chunks(map, 3, ChunkKind::kProduct)),
              ElementsAre(p));
  EXPECT_THAT(ForgetAll(map, {}),
              UnorderedElementsAre(p.blob_id, Raw("a").blob_id));
}

TEST_P(CatalogueTest, ARollbackKnowsWhatExpiredRevisionsChanged) {
  const MapRecord map = MakeMap("campus");
  Commit(map, 1, Adding({Raw("a")}));
  const auto product = TestChunk(ChunkKind::kProduct, 0, 0, 0, "p", 1);
  Commit(map, 2, Processing({product}));
  Commit(map, 3, Adding({Raw("x")}));
  RevisionChange change;
  change.removed = {Chunks(map, 4).back().number};
  // The points are those of the product, and yet they changed.
  EXPECT_EQ(Commit(map, 4, change).totals.stale_tile_count, 1);
  EXPECT_EQ(catalogue_->ExpireRevisions(map.uid, 1).value_or(-1), 3);
  EXPECT_THAT(ForgetAll(map, {}), ElementsAre(Raw("x").blob_id));
  EXPECT_EQ(Commit(map, 5, Processing({product})).totals.stale_tile_count, 0);
  EXPECT_EQ(catalogue_->RollBack(map.uid, 5)->totals.stale_tile_count, 1);
  // Counted anew from the tiles.
  EXPECT_EQ(Commit(map, 7, {}).totals.stale_tile_count, 1);
}

TEST_P(CatalogueTest, UploadsOfExpiredRevisionsAreKnown) {
  const MapRecord map = MakeMap("campus");
  const auto finalize = [&](const std::string& id, int64_t parent) {
    const UploadRecord upload = MakeUpload(map, id);
    Finalize(map, parent, upload, Adding({Raw(id)}));
    return upload.uid;
  };
  const std::string a = finalize("a", 1);
  const std::string b = finalize("b", 2);
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 2));
  // The newest, 4, equals 2: b is out, though the rest is expired.
  EXPECT_EQ(catalogue_->ExpireRevisions(map.uid, 1).value_or(-1), 3);
  ForgetAll(map, {});
  EXPECT_EQ(catalogue_->RollBack(map.uid, 2)->number, 4);
  EXPECT_EQ(MakeUpload(map, "a").uid, a);
  EXPECT_NE(MakeUpload(map, "b").uid, b);
}

TEST_P(CatalogueTest, ReclaimableIsWhatOlderRevisionsAloneHold) {
  const MapRecord map = MakeMap("campus");
  const auto measure = [&] {
    return catalogue_->MeasureReclaimable(map.uid).value_or(-1);
  };
  Commit(map, 1, Adding({Raw("1"), Raw("22"), Raw("333")}));
  EXPECT_EQ(measure(), 0);
  // Its product keeps what it was made of.
  Commit(map, 2,
         Processing({TestChunk(ChunkKind::kProduct, 0, 0, 0, "4444", 1)}));
  Commit(map, 3, Replacing(Chunks(map, 3), "22"));
  EXPECT_EQ(measure(), 0);
  Commit(map, 4, Processing({}));
  EXPECT_EQ(measure(), 1 + 3 + 4);
  // A blob counts once, however many referred to it, and not if another map
  // does.
  Commit(map, 5, Adding({Raw("1")}));
  RevisionChange change;
  change.removed = {Chunks(map, 6).back().number};
  Commit(map, 6, change);
  Commit(map, 7, Processing({}));
  EXPECT_EQ(measure(), 1 + 3 + 4);
  Commit(MakeMap("other"), 1, Adding({Raw("333")}));
  EXPECT_EQ(measure(), 1 + 4);
  MAPSIEVE_EXPECT_OK(catalogue_->ExpireRevisions(map.uid, 1));
  ForgetAll(map, {});
  EXPECT_EQ(measure(), 0);
  EXPECT_THAT(catalogue_->MeasureReclaimable("nobody"),
              StatusIs(absl::StatusCode::kNotFound, _));
}

}  // namespace
}  // namespace mapsieve::storage
