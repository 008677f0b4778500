#include <algorithm>
#include <iterator>
#include <map>
#include <random>
#include <set>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/catalogue.h"
#include "tests/storage/catalogue_conformance.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr ChunkKind kKinds[] = {ChunkKind::kRaw, ChunkKind::kProduct};
using TileLess = core::CellKeyLess;

// All that a revision is, kept whole for each.
struct ModelRevision {
  std::map<ChunkKind, std::vector<ChunkRef>> chunks;
  /// Tiles whose points changed after the product was made.
  std::set<core::CellKey, TileLess> stale;
  int64_t processed_revision = 0;
  std::string options;
  RevisionTotals totals;
  bool is_expired = false;
};

bool HasRaw(const ModelRevision& revision, const core::CellKey& tile) {
  const auto found = revision.chunks.find(ChunkKind::kRaw);
  return found != revision.chunks.end() &&
         std::any_of(found->second.begin(), found->second.end(),
                     [&](const ChunkRef& c) { return c.tile == tile; });
}

class RandomHistory {
 public:
  /// One of `product_odds` changes makes a product.
  RandomHistory(uint64_t seed, int64_t product_odds)
      : random_(seed), product_odds_(product_odds) {
    revisions_.resize(2);  // 0 is none; 1 is empty.
  }

  int64_t Draw(int64_t count) {
    return static_cast<int64_t>(random_() % static_cast<uint64_t>(count));
  }
  ChunkRef DrawChunk(ChunkKind kind) {
    // Few contents, so that blobs are shared.
    const int64_t content = Draw(40);
    return TestChunk(kind, Draw(3), Draw(2), 0, std::to_string(content),
                     content + 1);
  }

  /// A change of the newest revision, whose chunks are `present`.
  RevisionChange DrawChange(const std::vector<ChunkRef>& present) {
    RevisionChange change;
    const bool has_product = Draw(product_odds_) == 0;
    const ChunkKind kind = has_product ? ChunkKind::kProduct : ChunkKind::kRaw;
    for (int64_t i = Draw(5); i > 0; --i) {
      change.added.push_back(DrawChunk(kind));
    }
    if (has_product) {
      change.spec.kind = RevisionKind::kProcess;
      change.spec.product.emplace().options = std::to_string(Draw(3));
      change.removes_product = Draw(2) == 0;
      if (change.removes_product) return change;
    }
    for (const ChunkRef& chunk : present) {
      if (chunk.kind == kind && Draw(4) == 0) {
        change.removed.push_back(chunk.number);
      }
    }
    return change;
  }

  std::vector<ModelRevision>& revisions() { return revisions_; }

 private:
  std::mt19937_64 random_;
  const int64_t product_odds_;
  std::vector<ModelRevision> revisions_;
};

// The model's own way from one revision to the next.
void Apply(const RevisionChange& change, int64_t number,
           const ModelRevision& product_of, ModelRevision& revision) {
  const auto touch = [&](const ChunkRef& chunk) {
    if (chunk.kind == ChunkKind::kRaw) revision.stale.insert(chunk.tile);
  };
  for (auto& [kind, chunks] : revision.chunks) {
    std::erase_if(chunks, [&](const ChunkRef& chunk) {
      const bool gone =
          std::count(change.removed.begin(), change.removed.end(),
                     chunk.number) > 0 ||
          (change.removes_product && chunk.kind == ChunkKind::kProduct);
      if (gone) touch(chunk);
      return gone;
    });
  }
  for (const ChunkRef& chunk : change.added) {
    revision.chunks[chunk.kind].push_back(chunk);
    touch(chunk);
  }
  if (change.spec.product.has_value()) {
    revision.processed_revision = number;
    revision.options = change.spec.product->options;
    revision.stale.clear();
  }
  std::erase_if(revision.stale, [&](const core::CellKey& tile) {
    return !HasRaw(revision, tile) && !HasRaw(product_of, tile);
  });
}

// Expires revisions in the model.
void Expire(int64_t kept_count, std::vector<ModelRevision>& revisions) {
  const auto newest = static_cast<int64_t>(revisions.size()) - 1;
  std::set<int64_t> products;
  for (int64_t n = std::max<int64_t>(1, newest - kept_count + 1); n <= newest;
       ++n) {
    products.insert(revisions[static_cast<size_t>(n)].processed_revision);
  }
  for (int64_t n = 1; n <= newest - kept_count; ++n) {
    if (products.contains(n)) continue;
    revisions[static_cast<size_t>(n)].is_expired = true;
  }
}

// Seeds from 10 on expire revisions in between.
TEST_P(CatalogueTest, ARollbackEqualsItsTargetAndLeavesEveryRevisionAsItWas) {
  for (const uint64_t seed : {1, 2, 3, 10, 11, 12, 13}) {
    RandomHistory history(seed, seed < 10 ? 3 : 8);
    int refused_count = 0;
    auto& model = history.revisions();
    const MapRecord map = MakeMap("m" + std::to_string(seed));
    int rollback_count = 0;
    while (model.size() < 90) {
      const auto newest = static_cast<int64_t>(model.size()) - 1;
      ModelRevision next = model.back();
      // The numbers that the catalogue has given.
      std::vector<ChunkRef> present;
      for (const ChunkKind kind : kKinds) {
        next.chunks[kind] = Chunks(map, newest, kind);
        present.insert(present.end(), next.chunks[kind].begin(),
                       next.chunks[kind].end());
      }
      RevisionRecord made;
      if (seed >= 10 && history.Draw(5) == 0) {
        const int64_t kept_count = 1 + history.Draw(8);
        MAPSIEVE_ASSERT_OK(catalogue_->ExpireRevisions(map.uid, kept_count));
        ForgetAll(map, {});
        Expire(kept_count, model);
        // Those of kept revisions are there, and no others.
        std::set<int64_t> kept;
        for (size_t number = 1; number < model.size(); ++number) {
          if (model[number].is_expired) continue;
          for (const ChunkKind kind : kKinds) {
            for (const ChunkRef& chunk :
                 Chunks(map, static_cast<int64_t>(number), kind)) {
              kept.insert(chunk.number);
            }
          }
        }
        EXPECT_EQ(catalogue_->CountAllChunks(map.uid).value_or(-1),
                  static_cast<int64_t>(kept.size()));
      }
      if (history.Draw(4) == 0) {
        const int64_t target =
            seed >= 10 ? newest - history.Draw(std::min<int64_t>(newest, 12))
                       : 1 + history.Draw(newest);
        MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RevisionRecord before,
                                      catalogue_->GetRevision(map.uid, newest));
        const bool is_repeat =
            target == newest || before.restored_revision == target;
        if (model[static_cast<size_t>(target)].is_expired && !is_repeat) {
          ++refused_count;
          EXPECT_THAT(
              catalogue_->RollBack(map.uid, target),
              StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("expired")));
          continue;
        }
        MAPSIEVE_ASSERT_OK_AND_ASSIGN(made,
                                      catalogue_->RollBack(map.uid, target));
        if (is_repeat) {
          ASSERT_EQ(made.number, newest);
          continue;
        }
        ++rollback_count;
        next = model[static_cast<size_t>(target)];
        EXPECT_EQ(made.spec.kind, RevisionKind::kRollback);
        EXPECT_EQ(made.spec.description, "");
        EXPECT_EQ(made.restored_revision, target);
        EXPECT_EQ(made.totals, next.totals);
      } else {
        const RevisionChange change = history.DrawChange(present);
        made = Commit(map, newest, change);
        Apply(change, newest + 1,
              model[static_cast<size_t>(next.processed_revision)], next);
        next.totals = made.totals;
        // Where a chunk lies in the order of its tile follows its number.
        for (auto& [kind, chunks] : next.chunks) {
          std::stable_sort(chunks.begin(), chunks.end(),
                           [](const ChunkRef& a, const ChunkRef& b) {
                             return TileLess()(a.tile, b.tile);
                           });
          chunks = WithoutNumbers(chunks);
        }
      }
      ASSERT_EQ(made.number, newest + 1);
      EXPECT_EQ(catalogue_->GetRevision(map.uid, made.number)->create_time,
                made.create_time);
      EXPECT_EQ(made.processed_revision, next.processed_revision);
      EXPECT_EQ(made.totals.stale_tile_count,
                static_cast<int64_t>(next.stale.size()))
          << made.number;
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord now,
                                    catalogue_->GetMap(map.spec.id));
      EXPECT_EQ(now.newest_revision, made.number);
      EXPECT_EQ(now.process_options, next.options);
      model.push_back(std::move(next));
    }
    EXPECT_GT(rollback_count, 5);
    EXPECT_EQ(refused_count > 0, seed >= 10);
    Reopen();
    for (size_t number = 1; number < model.size(); ++number) {
      const auto revision = static_cast<int64_t>(number);
      for (const ChunkKind kind : kKinds) {
        if (model[number].is_expired) continue;
        EXPECT_EQ(WithoutNumbers(Chunks(map, revision, kind)),
                  model[number].chunks[kind])
            << "revision " << number;
      }
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RevisionRecord record,
                                    catalogue_->GetRevision(map.uid, revision));
      EXPECT_EQ(record.totals, model[number].totals);
      EXPECT_EQ(record.is_expired, model[number].is_expired);
    }
  }
}

TEST_P(CatalogueTest, ARollbackToNoRevisionOrNoMapIsRefused) {
  const MapRecord map = MakeMap("campus");
  Commit(map, 1, Adding({}));
  for (const int64_t number : {-1, 0, 3}) {
    EXPECT_THAT(catalogue_->RollBack(map.uid, number),
                StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("1 to 2")));
  }
  EXPECT_THAT(catalogue_->RollBack("nobody", 1),
              StatusIs(absl::StatusCode::kNotFound, _));
  MAPSIEVE_ASSERT_OK(catalogue_->DeleteMap("campus"));
  EXPECT_THAT(catalogue_->RollBack(map.uid, 1),
              StatusIs(absl::StatusCode::kNotFound, _));
  RevisionChange change;
  change.spec.kind = RevisionKind::kRollback;
  EXPECT_THAT(catalogue_->CommitRevision(MakeMap("b").uid, 1, change),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("kind")));
}

TEST_P(CatalogueTest, TilesChangeWhereReferencesDiffer) {
  const MapRecord map = MakeMap("campus");
  const auto a = TestChunk(ChunkKind::kRaw, 0, 0, 0, "a", 1);
  const auto b = TestChunk(ChunkKind::kRaw, 1, 0, 0, "b", 1);
  const auto c = TestChunk(ChunkKind::kRaw, 0, 1, 0, "c", 1);
  const auto p = TestChunk(ChunkKind::kProduct, 1, 0, 0, "p", 1);
  Commit(map, 1, Adding({a, b}));
  RevisionChange change = Adding({c, p});
  change.removed = {Chunks(map, 2)[0].number};
  Commit(map, 2, change);
  const auto changed = [&](int64_t one, int64_t other, ChunkKind kind) {
    return *catalogue_->ListChangedTiles(map.uid, one, other, kind,
                                         std::nullopt, 10);
  };
  EXPECT_THAT(changed(1, 2, ChunkKind::kRaw), ElementsAre(a.tile, b.tile));
  EXPECT_THAT(changed(2, 3, ChunkKind::kRaw), ElementsAre(a.tile, c.tile));
  EXPECT_THAT(changed(3, 2, ChunkKind::kRaw), ElementsAre(a.tile, c.tile));
  EXPECT_THAT(changed(1, 3, ChunkKind::kRaw), ElementsAre(b.tile, c.tile));
  EXPECT_THAT(changed(2, 3, ChunkKind::kProduct), ElementsAre(p.tile));
  EXPECT_THAT(changed(3, 3, ChunkKind::kRaw), IsEmpty());
  EXPECT_THAT(*catalogue_->ListChangedTiles(map.uid, 2, 3, ChunkKind::kRaw,
                                            std::nullopt, 1),
              ElementsAre(a.tile));
  EXPECT_THAT(
      *catalogue_->ListChangedTiles(map.uid, 2, 3, ChunkKind::kRaw, a.tile, 10),
      ElementsAre(c.tile));
  for (const auto& [one, other] : {std::pair{0, 2}, {2, 4}}) {
    EXPECT_THAT(catalogue_->ListChangedTiles(map.uid, one, other,
                                             ChunkKind::kRaw, std::nullopt, 10),
                StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("1 to 3")));
  }
}

TEST_P(CatalogueTest, ARepeatedRollbackMakesNothing) {
  const MapRecord map = MakeMap("campus");
  const auto chunk = TestChunk(ChunkKind::kRaw, 0, 0, 0, "a", 1);
  Commit(map, 1, Adding({chunk}));
  EXPECT_EQ(catalogue_->RollBack(map.uid, 2)->number, 2);
  EXPECT_EQ(catalogue_->RollBack(map.uid, 1)->number, 3);
  EXPECT_EQ(catalogue_->RollBack(map.uid, 1)->number, 3);
  EXPECT_EQ(catalogue_->RollBack(map.uid, 3)->number, 3);
  EXPECT_THAT(Chunks(map, 3), IsEmpty());
  EXPECT_EQ(catalogue_->RollBack(map.uid, 2)->number, 4);
  EXPECT_THAT(WithoutNumbers(Chunks(map, 4)), ElementsAre(chunk));
}

TEST_P(CatalogueTest, AnUploadThatWasRolledBackBeginsAnew) {
  const MapRecord map = MakeMap("campus");
  const UploadRecord a = MakeUpload(map, "a");
  Finalize(map, 1, a);
  const UploadRecord b = MakeUpload(map, "b");
  Finalize(map, 2, b);
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 2).status());
  EXPECT_EQ(MakeUpload(map, "a").uid, a.uid);
  const UploadRecord again = MakeUpload(map, "b");
  EXPECT_NE(again.uid, b.uid);
  EXPECT_EQ(again.state, UploadState::kActive);
  Finalize(map, 4, again);
  EXPECT_EQ(MakeUpload(map, "b").uid, again.uid);
  // Back to where the first one had brought the points in.
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 3).status());
  const UploadRecord first = MakeUpload(map, "b");
  EXPECT_EQ(first.state, UploadState::kFinalized);
  EXPECT_EQ(first.revision, 3);
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 5).status());
  EXPECT_EQ(MakeUpload(map, "b").revision, 5);
}

TEST_P(CatalogueTest, AnUploadBegunAnewEndsWhereARollbackBringsItsPoints) {
  const MapRecord map = MakeMap("campus");
  const UploadRecord upload = MakeUpload(map, "a");
  Finalize(map, 1, upload, {.upload_report = "report"});
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 1).status());
  const UploadRecord anew = MakeUpload(map, "a");
  EXPECT_EQ(anew.state, UploadState::kActive);
  const UploadRecord other = MakeUpload(map, "b");
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 2).status());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadRecord ended,
                                catalogue_->GetUpload(map.uid, "a"));
  EXPECT_EQ(ended.uid, anew.uid);
  EXPECT_EQ(ended.state, UploadState::kFinalized);
  EXPECT_EQ(ended.revision, 2);
  EXPECT_EQ(ended.report, "report");
  EXPECT_EQ(catalogue_->GetUpload(map.uid, "b")->state, UploadState::kActive);

  // One that is to be added once more, since it was forgotten, is left alone.
  MAPSIEVE_ASSERT_OK(catalogue_->DeleteUpload(anew.uid));
  EXPECT_EQ(MakeUpload(map, "a").state, UploadState::kActive);
  Commit(map, 4, Adding({}));
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 2).status());
  EXPECT_EQ(catalogue_->GetUpload(map.uid, "a")->state, UploadState::kActive);
}

TEST_P(CatalogueTest, AForgottenUploadIsNotTakenForTheNextOneOfItsId) {
  const MapRecord map = MakeMap("campus");
  const auto make = [&](const std::string& hash) {
    const auto upload =
        catalogue_->CreateUpload(map.uid, {.id = "a", .content_hash = hash});
    EXPECT_THAT(upload, testing::IsOk());
    return upload.value_or(UploadRecord());
  };
  const std::string first(32, '1');
  const std::string second(32, '2');
  const UploadRecord forgotten = make(first);
  Finalize(map, 1, forgotten);
  MAPSIEVE_ASSERT_OK(catalogue_->DeleteUpload(forgotten.uid));

  // The points of the first come back, those of the second were never added.
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 1).status());
  const UploadRecord next = make(second);
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 2).status());
  EXPECT_EQ(catalogue_->GetUpload(map.uid, "a")->state, UploadState::kActive);

  // The points of the second go, those of the first stay.
  Finalize(map, 4, next);
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(map.uid, 4).status());
  const UploadRecord again = make(second);
  EXPECT_EQ(again.state, UploadState::kActive);
  EXPECT_NE(again.uid, next.uid);
}

TEST_P(CatalogueTest, AnUploadThatCameTwiceIsTheLaterOne) {
  const MapRecord map = MakeMap("campus");
  std::string last;
  for (int64_t parent = 1; parent <= 2; ++parent) {
    const UploadRecord upload = MakeUpload(map, "a");
    EXPECT_NE(upload.uid, last);
    last = upload.uid;
    Finalize(map, parent, upload);
    if (parent == 1) {
      MAPSIEVE_ASSERT_OK(catalogue_->DeleteUpload(upload.uid));
    }
  }
  EXPECT_EQ(MakeUpload(map, "a").uid, last);
  EXPECT_EQ(MakeUpload(map, "a").revision, 3);
}

}  // namespace
}  // namespace mapsieve::storage
