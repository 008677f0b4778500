#include "storage/catalogue.h"

#include <algorithm>
#include <iterator>
#include <limits>
#include <random>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/sqlite_catalogue.h"
#include "tests/storage/catalogue_conformance.h"
#include "tests/testing/memory_catalogue.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

absl::StatusOr<std::unique_ptr<Catalogue>> OpenSqlite(
    const std::string& directory) {
  return OpenSqliteCatalogue(PosixFileSystem(), directory + "/catalogue.db",
                             IfAbsent::kCreate);
}

absl::StatusOr<std::unique_ptr<Catalogue>> MakeInMemory(const std::string&) {
  return std::make_unique<testing::MemoryCatalogue>();
}

INSTANTIATE_TEST_SUITE_P(
    All, CatalogueTest,
    ::testing::Values(CatalogueImplementation{"Sqlite", OpenSqlite},
                      CatalogueImplementation{"Memory", MakeInMemory,
                                              /*lasts=*/false}),
    [](const auto& instance) { return instance.param.name; });

TEST_P(CatalogueTest, ANewMapIsEmptyAndKeepsItsSpec) {
  MapSpec spec;
  spec.id = "campus";
  spec.display_name = "Grüße";
  spec.step_nm = 2'000'000;
  spec.tile_level = 14;
  spec.crs_wkt = std::string("PROJCS[\"x\"]\0y", 13);
  spec.frame_id = "map";
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord created,
                                catalogue_->CreateMap(spec));
  EXPECT_EQ(created.spec, spec);
  EXPECT_EQ(created.newest_revision, 1);
  EXPECT_EQ(created.uid.size(), 32u);
  EXPECT_EQ(created.process_options, "");
  EXPECT_EQ(created.create_time, created.update_time);

  Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map,
                                catalogue_->GetMap("campus"));
  EXPECT_EQ(map.spec, spec);
  EXPECT_EQ(map.uid, created.uid);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RevisionRecord first,
                                catalogue_->GetRevision(map.uid, 1));
  EXPECT_EQ(first.spec.kind, RevisionKind::kCreate);
  EXPECT_EQ(first.parent, 0);
  EXPECT_EQ(first.processed_revision, 0);
  EXPECT_EQ(first.totals, RevisionTotals());
}

TEST_P(CatalogueTest, ACommitMayNameWhereTheMapLies) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord made,
                                catalogue_->CreateMap(TestMap("campus")));
  RevisionChange change;
  change.frame_id = "map";
  MAPSIEVE_ASSERT_OK(catalogue_->CommitRevision(made.uid, 1, change));
  change = {};
  change.crs_wkt = "EPSG:2056";
  MAPSIEVE_ASSERT_OK(catalogue_->CommitRevision(made.uid, 2, change));
  MAPSIEVE_ASSERT_OK(catalogue_->CommitRevision(made.uid, 3, {}));
  EXPECT_EQ(catalogue_->GetMap("campus")->spec.frame_id, "map");
  change = {};
  change.frame_id = "odom";
  MAPSIEVE_ASSERT_OK(catalogue_->CommitRevision(made.uid, 4, change));
  MAPSIEVE_ASSERT_OK(catalogue_->RollBack(made.uid, 1));
  change.crs_wkt.assign((size_t{64} << 10) + 1, 'x');
  EXPECT_THAT(
      catalogue_->CommitRevision(made.uid, 6, change),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("crs_wkt")));

  Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord map,
                                catalogue_->GetMap("campus"));
  EXPECT_EQ(map.spec.crs_wkt, "EPSG:2056");
  EXPECT_EQ(map.spec.frame_id, "odom");
}

TEST_P(CatalogueTest, AMapIdIsTakenOnce) {
  MakeMap("campus");
  EXPECT_THAT(catalogue_->CreateMap(TestMap("campus")),
              StatusIs(absl::StatusCode::kAlreadyExists, HasSubstr("campus")));
  EXPECT_THAT(catalogue_->GetMap("other"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("\"other\"")));
}

TEST_P(CatalogueTest, IllFormedMapsAreRefused) {
  for (const std::string id :
       {"", "..", "../etc", "a/b", "Campus", "1st", "-a", "a-", "a b", "é",
        "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa"}) {
    EXPECT_THAT(catalogue_->CreateMap(TestMap(id)),
                StatusIs(absl::StatusCode::kInvalidArgument, _))
        << id;
    EXPECT_THAT(catalogue_->GetMap(id),
                StatusIs(absl::StatusCode::kInvalidArgument, _))
        << id;
  }
  MapSpec spec = TestMap("a");
  spec.step_nm = 0;
  EXPECT_THAT(
      catalogue_->CreateMap(spec),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("step_nm")));
  spec = TestMap("a");
  spec.tile_level = core::kMaxTileLevel + 1;
  EXPECT_THAT(
      catalogue_->CreateMap(spec),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("tile_level")));
  spec = TestMap("a");
  spec.frame_id.assign(256, 'x');
  EXPECT_THAT(catalogue_->CreateMap(spec),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("256")));
  spec = TestMap("a");
  spec.display_name.assign(129, 'x');
  EXPECT_THAT(catalogue_->CreateMap(spec),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("129")));
}

TEST_P(CatalogueTest, MapsAreListedByIdInPages) {
  for (const char* id : {"c", "a", "d", "b"}) MakeMap(id);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto first, catalogue_->ListMaps("", 3));
  ASSERT_EQ(first.size(), 3u);
  EXPECT_EQ(first[0].spec.id, "a");
  EXPECT_EQ(first[2].spec.id, "c");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto second,
                                catalogue_->ListMaps("c", 3));
  ASSERT_EQ(second.size(), 1u);
  EXPECT_EQ(second[0].spec.id, "d");
  EXPECT_THAT(catalogue_->ListMaps("", 0),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
}

TEST_P(CatalogueTest, ADeletedMapIsGoneButReadableByUidUntilPurged) {
  const MapRecord map = MakeMap("campus");
  const auto chunk = TestChunk(ChunkKind::kRaw, 1, 2, 3, "points", 5);
  Commit(map, 1, Adding({chunk}));
  const UploadRecord upload = MakeUpload(map, "u");

  MAPSIEVE_ASSERT_OK(catalogue_->DeleteMap("campus"));
  EXPECT_THAT(catalogue_->GetMap("campus"),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(catalogue_->DeleteMap("campus"),
              StatusIs(absl::StatusCode::kNotFound, _));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto maps, catalogue_->ListMaps("", 10));
  EXPECT_THAT(maps, IsEmpty());
  EXPECT_THAT(catalogue_->GetUploadByUid(upload.uid),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(catalogue_->CommitRevision(map.uid, 2, Adding({chunk})),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(catalogue_->CreateUpload(map.uid, {.id = "v"}),
              StatusIs(absl::StatusCode::kNotFound, _));

  const MapRecord successor = MakeMap("campus");
  EXPECT_NE(successor.uid, map.uid);
  EXPECT_THAT(Chunks(successor, 1), IsEmpty());
  EXPECT_THAT(WithoutNumbers(Chunks(map, 2)), ElementsAre(chunk));
  EXPECT_THAT(*catalogue_->AreBlobsReferenced(std::vector{chunk.blob_id}),
              ElementsAre(true));
  EXPECT_THAT(*catalogue_->ListDeletedMaps("", 10), ElementsAre(map.uid));
  EXPECT_THAT(*catalogue_->ListDeletedMaps(map.uid, 10), IsEmpty());

  EXPECT_THAT(catalogue_->PurgeMap(successor.uid),
              StatusIs(absl::StatusCode::kFailedPrecondition, _));
  MAPSIEVE_ASSERT_OK(catalogue_->PurgeMap(map.uid));
  EXPECT_THAT(catalogue_->PurgeMap(map.uid),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(catalogue_->GetRevision(map.uid, 2),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(*catalogue_->AreBlobsReferenced(std::vector{chunk.blob_id}),
              ElementsAre(false));
  EXPECT_THAT(*catalogue_->ListDeletedMaps("", 10), IsEmpty());
}

TEST_P(CatalogueTest, ALargeMapIsPurgedWhole) {
  const MapRecord map = MakeMap("campus");
  std::vector<ChunkRef> added;
  std::vector<BlobId> blobs;
  for (int i = 0; i < 9'000; ++i) {
    added.push_back(
        TestChunk(ChunkKind::kRaw, i % 100, i / 100, 0, std::to_string(i), 1));
    blobs.push_back(added.back().blob_id);
  }
  Commit(map, 1, Adding(added));
  MAPSIEVE_ASSERT_OK(catalogue_->DeleteMap("campus"));
  MAPSIEVE_ASSERT_OK(catalogue_->PurgeMap(map.uid));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<bool> referenced,
                                catalogue_->AreBlobsReferenced(blobs));
  EXPECT_EQ(std::count(referenced.begin(), referenced.end(), true), 0);
  EXPECT_THAT(*catalogue_->ListDeletedMaps("", 10), IsEmpty());
}

TEST_P(CatalogueTest, ARevisionKeepsAllThatItsCommitSaid) {
  const MapRecord map = MakeMap("campus");
  RevisionChange change;
  change.spec.kind = RevisionKind::kProcess;
  change.spec.description = std::string("{\"a\":\0}", 7);
  change.spec.attributes = {{"intensity", core::ScalarType::kUint16},
                            {"gps_time", core::ScalarType::kFloat64}};
  change.spec.refused = {.non_finite = 3, .out_of_lattice = 4};
  ProductSummary& product = change.spec.product.emplace();
  product.options = std::string("\0\1", 2);
  product.distinct_point_count = 99;
  product.kept_counts = {1, 2, 3, 4};
  product.max_confidence = {0, 11, 222, 65535};
  change.added = {TestChunk(ChunkKind::kProduct, 0, 0, 0, "product", 8)};
  const RevisionRecord returned = Commit(map, 1, change);

  Reopen();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const RevisionRecord revision,
                                catalogue_->GetRevision(map.uid, 2));
  EXPECT_EQ(revision.spec, change.spec);
  EXPECT_EQ(revision.number, 2);
  EXPECT_EQ(revision.parent, 1);
  EXPECT_EQ(revision.processed_revision, 2);
  EXPECT_EQ(returned.spec, revision.spec);
  EXPECT_EQ(returned.totals, revision.totals);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const MapRecord after,
                                catalogue_->GetMap("campus"));
  EXPECT_EQ(after.newest_revision, 2);
  EXPECT_EQ(after.process_options, product.options);
  // The catalogue keeps microseconds.
  EXPECT_LT(absl::AbsDuration(after.update_time - returned.create_time),
            absl::Microseconds(2));
}

TEST_P(CatalogueTest, ACommitOnAnotherParentIsAbortedAndChangesNothing) {
  const MapRecord map = MakeMap("campus");
  const auto chunk = TestChunk(ChunkKind::kRaw, 0, 0, 0, "a", 1);
  Commit(map, 1, Adding({chunk}));
  for (const int64_t parent : {int64_t{0}, int64_t{1}, int64_t{3}}) {
    EXPECT_THAT(
        catalogue_->CommitRevision(
            map.uid, parent,
            Adding({TestChunk(ChunkKind::kRaw, 1, 0, 0, "b", 1)})),
        StatusIs(absl::StatusCode::kAborted, HasSubstr("revision 2 is")));
  }
  EXPECT_EQ(catalogue_->GetMap("campus")->newest_revision, 2);
  EXPECT_THAT(WithoutNumbers(Chunks(map, 2)), ElementsAre(chunk));
}

TEST_P(CatalogueTest, RevisionsAreListedNewestFirst) {
  const MapRecord map = MakeMap("campus");
  for (int64_t parent = 1; parent < 5; ++parent)
    Commit(map, parent, Adding({}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto first,
                                catalogue_->ListRevisions(map.uid, 0, 3));
  ASSERT_EQ(first.size(), 3u);
  EXPECT_EQ(first[0].number, 5);
  EXPECT_EQ(first[2].number, 3);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto rest,
                                catalogue_->ListRevisions(map.uid, 3, 10));
  ASSERT_EQ(rest.size(), 2u);
  EXPECT_EQ(rest[1].number, 1);
  EXPECT_THAT(catalogue_->GetRevision(map.uid, 6),
              StatusIs(absl::StatusCode::kOutOfRange, HasSubstr("1 to 5")));
  EXPECT_THAT(catalogue_->GetRevision(map.uid, 0),
              StatusIs(absl::StatusCode::kOutOfRange, _));
  EXPECT_THAT(catalogue_->ListRevisions("nobody", 0, 1),
              StatusIs(absl::StatusCode::kNotFound, _));
}

TEST_P(CatalogueTest, EveryRevisionShowsItsOwnChunks) {
  const MapRecord map = MakeMap("campus");
  const auto a = TestChunk(ChunkKind::kRaw, 0, 0, 0, "a", 1);
  const auto b = TestChunk(ChunkKind::kRaw, 1, 0, 0, "b", 2);
  const auto c = TestChunk(ChunkKind::kRaw, 0, 1, 0, "c", 4);
  Commit(map, 1, Adding({a, b}));
  RevisionChange change = Adding({c});
  change.removed = {Chunks(map, 2)[0].number};
  Commit(map, 2, change);
  Reopen();
  EXPECT_THAT(Chunks(map, 1), IsEmpty());
  EXPECT_THAT(WithoutNumbers(Chunks(map, 2)), ElementsAre(a, b));
  EXPECT_THAT(WithoutNumbers(Chunks(map, 3)), ElementsAre(b, c));
  EXPECT_THAT(catalogue_->ListChunks(map.uid, 4, ChunkKind::kRaw, std::nullopt,
                                     std::nullopt, 1),
              StatusIs(absl::StatusCode::kOutOfRange, _));
  // Old revisions keep their blobs.
  EXPECT_THAT(*catalogue_->AreBlobsReferenced(std::vector<BlobId>{
                  a.blob_id, b.blob_id, c.blob_id, std::string(32, '0')}),
              ElementsAre(true, true, true, false));
}

TEST_P(CatalogueTest, OnlyChunksOfTheParentCanBeRemoved) {
  const MapRecord map = MakeMap("campus");
  const MapRecord other = MakeMap("other");
  Commit(map, 1, Adding({TestChunk(ChunkKind::kRaw, 0, 0, 0, "a", 1)}));
  Commit(other, 1, Adding({TestChunk(ChunkKind::kRaw, 0, 0, 0, "b", 1)}));
  RevisionChange change;
  change.removed = {Chunks(map, 2)[0].number};
  Commit(map, 2, change);
  // Removed before; of another map; never there; twice at once.
  EXPECT_THAT(catalogue_->CommitRevision(map.uid, 3, change),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  change.removed = {Chunks(other, 2)[0].number};
  EXPECT_THAT(catalogue_->CommitRevision(map.uid, 3, change),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  EXPECT_THAT(Chunks(other, 2).size(), 1u);
  change.removed = {12345};
  EXPECT_THAT(catalogue_->CommitRevision(map.uid, 3, change),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("12345")));
  change.removed.assign(2, Chunks(other, 2)[0].number);
  EXPECT_THAT(catalogue_->CommitRevision(other.uid, 2, change),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  EXPECT_EQ(catalogue_->GetMap("other")->newest_revision, 2);
}

TEST_P(CatalogueTest, ChunksThatBreakTheRulesAreRefused) {
  const MapRecord map = MakeMap("campus");
  const auto refuse = [&](const char* what, auto&& spoil) {
    ChunkRef chunk = TestChunk(ChunkKind::kProduct, 1, 2, 3, "a", 7);
    spoil(chunk);
    EXPECT_THAT(catalogue_->CommitRevision(map.uid, 1, Adding({chunk})),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(HasSubstr("chunk 0"), HasSubstr(what))));
  };
  refuse("level", [](ChunkRef& c) { c.tile.level = 11; });
  refuse("lattice", [](ChunkRef& c) { c.tile.x = int64_t{1} << 40; });
  refuse("blob id", [](ChunkRef& c) { c.blob_id = "../../etc/passwd"; });
  refuse("point_count", [](ChunkRef& c) { c.point_count = 0; });
  refuse("stored_bytes", [](ChunkRef& c) { c.stored_bytes = -1; });
  refuse("label", [](ChunkRef& c) { c.label_counts[0] = 1; });
  refuse("label", [](ChunkRef& c) { c.kind = ChunkKind::kRaw; });
  refuse("bounds", [](ChunkRef& c) { c.bounds.max.x = c.bounds.min.x; });
  refuse("bounds", [](ChunkRef& c) { c.bounds.min.y -= 1; });
  refuse("kind", [](ChunkRef& c) { c.kind = static_cast<ChunkKind>(9); });
  RevisionChange change;
  change.spec.attributes = {{"a", core::ScalarType::kInt8},
                            {"a", core::ScalarType::kInt8}};
  EXPECT_THAT(catalogue_->CommitRevision(map.uid, 1, change),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("twice")));
  change = {};
  change.spec.kind = RevisionKind::kCreate;
  EXPECT_THAT(catalogue_->CommitRevision(map.uid, 1, change),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("kind")));
  EXPECT_EQ(catalogue_->GetMap("campus")->newest_revision, 1);
}

TEST_P(CatalogueTest, TotalsFollowEveryChange) {
  const MapRecord map = MakeMap("campus");
  const auto raw0 = TestChunk(ChunkKind::kRaw, 0, 0, 0, "aaaa", 10);
  const auto raw1 = TestChunk(ChunkKind::kRaw, 0, 0, 0, "bbb", 20);
  const auto raw2 = TestChunk(ChunkKind::kRaw, -1, 0, 2, "cc", 40);
  RevisionTotals totals = Commit(map, 1, Adding({raw0, raw1, raw2})).totals;
  EXPECT_EQ(totals.raw_point_count, 70);
  EXPECT_EQ(totals.raw_chunk_count, 3);
  EXPECT_EQ(totals.stored_bytes, 9);
  EXPECT_EQ(totals.tile_count, 2);
  EXPECT_EQ(totals.stale_tile_count, 2);
  EXPECT_EQ(totals.bounds, (core::LatticeBox{{-1024, 0, 0}, {1, 1, 2049}}));

  const auto product = TestChunk(ChunkKind::kProduct, 0, 0, 0, "p", 5);
  totals = Commit(map, 2, Processing({product})).totals;
  EXPECT_EQ(totals.product_point_count, 5);
  EXPECT_EQ(totals.product_chunk_count, 1);
  EXPECT_EQ(totals.label_counts, (core::LabelCounts{0, 0, 5, 0}));
  EXPECT_EQ(totals.stored_bytes, 10);
  EXPECT_EQ(totals.stale_tile_count, 0);

  // One tile changes.
  totals = Commit(map, 3, Adding({TestChunk(ChunkKind::kRaw, 0, 0, 0, "d", 1)}))
               .totals;
  EXPECT_EQ(totals.raw_point_count, 71);
  EXPECT_EQ(totals.stale_tile_count, 1);
  EXPECT_EQ(totals.tile_count, 2);
  EXPECT_EQ(catalogue_->GetRevision(map.uid, 4)->processed_revision, 3);

  // The other one loses its points: its product is stale until the next run.
  RevisionChange change;
  change.spec.kind = RevisionKind::kDeleteRegion;
  for (const ChunkRef& chunk : Chunks(map, 4)) {
    if (chunk.tile.x == -1) change.removed.push_back(chunk.number);
  }
  totals = Commit(map, 4, change).totals;
  EXPECT_EQ(totals.tile_count, 1);
  EXPECT_EQ(totals.stale_tile_count, 2);
  EXPECT_EQ(totals.bounds, (core::LatticeBox{{0, 0, 0}, {1, 1, 1}}));

  totals = Commit(map, 5, Processing({product, product})).totals;
  EXPECT_EQ(totals.tile_count, 1);
  EXPECT_EQ(totals.stale_tile_count, 0);
  EXPECT_EQ(totals.product_point_count, 10);
  EXPECT_EQ(totals.label_counts, (core::LabelCounts{0, 0, 10, 0}));
  EXPECT_EQ(totals.stored_bytes, 4 + 3 + 1 + 2);

  // Everything goes.
  change.removed.clear();
  for (const ChunkRef& chunk : Chunks(map, 6)) {
    change.removed.push_back(chunk.number);
  }
  change.removes_product = true;
  totals = Commit(map, 6, change).totals;
  totals.stale_tile_count = 0;
  EXPECT_EQ(totals, RevisionTotals());
  EXPECT_EQ(catalogue_->GetRevision(map.uid, 2)->totals.raw_point_count, 70);
}

TEST_P(CatalogueTest, ANewProductReplacesTheOldOne) {
  const MapRecord map = MakeMap("campus");
  const auto raw = TestChunk(ChunkKind::kRaw, 0, 0, 0, "raw", 3);
  const auto p1 = TestChunk(ChunkKind::kProduct, 0, 0, 0, "p1", 1);
  const auto p2 = TestChunk(ChunkKind::kProduct, 0, 0, 0, "p2", 2);
  Commit(map, 1, Adding({raw}));
  Commit(map, 2, Processing({p1}));
  Commit(map, 3, Processing({p2}));
  EXPECT_THAT(WithoutNumbers(Chunks(map, 3, ChunkKind::kProduct)),
              ElementsAre(p1));
  EXPECT_THAT(WithoutNumbers(Chunks(map, 4, ChunkKind::kProduct)),
              ElementsAre(p2));
  EXPECT_THAT(WithoutNumbers(Chunks(map, 4)), ElementsAre(raw));
}

TEST_P(CatalogueTest, ChunksComeInMortonOrderInPagesAndByRegion) {
  const MapRecord map = MakeMap("campus");
  std::mt19937_64 random(7);
  std::vector<ChunkRef> added;
  for (int i = 0; i < 300; ++i) {
    const auto coordinate = [&] {
      return static_cast<int64_t>(random() % 21) - 10;
    };
    const int64_t x = coordinate();
    const int64_t y = coordinate();
    added.push_back(TestChunk(ChunkKind::kRaw, x, y, coordinate() / 4,
                              std::to_string(i), i + 1));
  }
  // Cells at the very ends of the lattice take part.
  constexpr int64_t kEnd = core::kLatticeLimit >> 10;
  added.push_back(TestChunk(ChunkKind::kRaw, -kEnd, -kEnd, -kEnd, "low", 1));
  added.push_back(
      TestChunk(ChunkKind::kRaw, kEnd - 1, kEnd - 1, kEnd - 1, "high", 1));
  Commit(map, 1, Adding(added));

  // Numbers follow the order of adding: a stable sort is the answer.
  std::stable_sort(added.begin(), added.end(),
                   [](const ChunkRef& a, const ChunkRef& b) {
                     return core::CellKeyLess()(a.tile, b.tile);
                   });
  EXPECT_EQ(WithoutNumbers(Chunks(map, 2)), added);

  std::vector<ChunkRef> paged;
  std::optional<ChunkPosition> after;
  while (true) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const auto page, catalogue_->ListChunks(map.uid, 2, ChunkKind::kRaw,
                                                std::nullopt, after, 7));
    if (page.empty()) break;
    paged.insert(paged.end(), page.begin(), page.end());
    after = ChunkPosition{page.back().tile, page.back().number};
  }
  EXPECT_EQ(WithoutNumbers(paged), added);

  constexpr int64_t kMost = std::numeric_limits<int64_t>::max();
  std::vector<core::LatticeBox> regions = {
      {{-1024, -2048, 0}, {2049, 1024, 1}},
      {{0, 0, 0}, {1, 1, 1}},
      {{1, 0, 0}, {1024, 1, 1}},
      {{5, 5, 5}, {5, 9, 9}},
      {{-kMost - 1, -kMost - 1, -kMost - 1}, {kMost, kMost, kMost}},
      {{kMost - 1, kMost - 1, kMost - 1}, {kMost, kMost, kMost}}};
  for (int i = 0; i < 50; ++i) {
    core::LatticeBox box;
    for (auto axis : {&core::LatticePoint::x, &core::LatticePoint::y,
                      &core::LatticePoint::z}) {
      box.min.*axis = static_cast<int64_t>(random() % 20000) - 10000;
      box.max.*axis = box.min.*axis + static_cast<int64_t>(random() % 8000);
    }
    regions.push_back(box);
  }
  for (const core::LatticeBox& region : regions) {
    std::vector<ChunkRef> expected;
    std::copy_if(
        added.begin(), added.end(), std::back_inserter(expected),
        [&](const ChunkRef& chunk) { return chunk.bounds.Intersects(region); });
    EXPECT_EQ(WithoutNumbers(Chunks(map, 2, ChunkKind::kRaw, region)),
              expected);

    std::vector<core::CellKey> tiles;
    std::optional<core::CellKey> after_tile;
    int64_t points = 0;
    while (true) {
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(
          const auto page, catalogue_->ListTiles(map.uid, 2, ChunkKind::kRaw,
                                                 region, after_tile, 5));
      if (page.empty()) break;
      for (const TileSummary& tile : page) {
        tiles.push_back(tile.tile);
        points += tile.point_count;
      }
      after_tile = page.back().tile;
    }
    std::vector<core::CellKey> expected_tiles;
    int64_t expected_points = 0;
    for (const ChunkRef& chunk : expected) {
      if (expected_tiles.empty() || expected_tiles.back() != chunk.tile) {
        expected_tiles.push_back(chunk.tile);
      }
      expected_points += chunk.point_count;
    }
    EXPECT_EQ(tiles, expected_tiles);
    EXPECT_EQ(points, expected_points);
  }
}

TEST_P(CatalogueTest, ATileSumsItsChunks) {
  const MapRecord map = MakeMap("campus");
  ChunkRef a = TestChunk(ChunkKind::kProduct, 1, 1, 1, "aa", 3);
  ChunkRef b = TestChunk(ChunkKind::kProduct, 1, 1, 1, "b", 4);
  b.bounds = {{1030, 1031, 1032}, {1040, 1041, 1042}};
  const auto elsewhere = TestChunk(ChunkKind::kProduct, 2, 1, 1, "c", 1);
  Commit(
      map, 1,
      Adding({a, b, elsewhere, TestChunk(ChunkKind::kRaw, 1, 1, 1, "r", 9)}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto tiles, catalogue_->ListTiles(map.uid, 2, ChunkKind::kProduct,
                                              std::nullopt, std::nullopt, 10));
  ASSERT_EQ(tiles.size(), 2u);
  TileSummary expected;
  expected.tile = a.tile;
  expected.chunk_count = 2;
  expected.point_count = 7;
  expected.stored_bytes = 3;
  expected.label_counts = {0, 0, 7, 0};
  expected.bounds = {{1024, 1024, 1024}, {1040, 1041, 1042}};
  EXPECT_EQ(tiles[0], expected);

  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto chunks,
      catalogue_->ListTileChunks(map.uid, 2, ChunkKind::kProduct, a.tile));
  EXPECT_THAT(WithoutNumbers(chunks), ElementsAre(a, b));
  EXPECT_THAT(*catalogue_->ListTileChunks(map.uid, 2, ChunkKind::kProduct,
                                          {10, 7, 7, 7}),
              IsEmpty());
  EXPECT_THAT(
      catalogue_->ListTileChunks(map.uid, 2, ChunkKind::kRaw, {99, 0, 0, 0}),
      StatusIs(absl::StatusCode::kInvalidArgument, _));
}

}  // namespace
}  // namespace mapsieve::storage
