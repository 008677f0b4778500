// The small parts of the engine.

#include <atomic>
#include <memory>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "gtest/gtest.h"
#include "server/engine/memory_pool.h"
#include "server/engine/opaque_records.h"
#include "server/engine/product_chunk.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine {
namespace {

using mapsieve::testing::StatusIs;
using ::testing::AllOf;
using ::testing::HasSubstr;

TEST(MemoryPool, GivesWhatItHasAndTakesItBack) {
  MemoryPool pool(100);
  Reservation mine(pool);
  MAPSIEVE_ASSERT_OK(mine.Grow(60, "mine"));
  {
    Reservation other(pool);
    MAPSIEVE_ASSERT_OK(other.Grow(40, "other"));
    EXPECT_THAT(
        mine.Grow(1, "mine"),
        StatusIs(absl::StatusCode::kResourceExhausted,
                 AllOf(HasSubstr("mine needs 1 bytes"), HasSubstr("0 of 100"),
                       HasSubstr("holding 40"), HasSubstr("try again later"))));
  }
  MAPSIEVE_EXPECT_OK(mine.Grow(40, "mine"));
  EXPECT_THAT(mine.Grow(1, "mine"),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("holding 0: ask for less")));
}

TEST(MemoryPool, WhoHoldsNothingWaitsForOthers) {
  MemoryPool pool(100, absl::Minutes(1));
  auto other = std::make_unique<Reservation>(pool);
  MAPSIEVE_ASSERT_OK(other->Grow(70, "other"));
  Reservation mine(pool);
  std::atomic<bool> granted = false;
  std::thread waiting([&] {
    MAPSIEVE_EXPECT_OK(mine.Grow(80, "mine"));
    granted = true;
  });
  absl::SleepFor(absl::Milliseconds(20));
  other->Shrink(40);
  absl::SleepFor(absl::Milliseconds(20));
  EXPECT_FALSE(granted);
  other.reset();
  waiting.join();
  EXPECT_TRUE(granted);
  // At once: waiting cannot help, or two could wait for each other.
  Reservation third(pool);
  EXPECT_THAT(third.Grow(101, "third"),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("third needs 101 bytes")));
  MAPSIEVE_ASSERT_OK(third.Grow(10, "third"));
  EXPECT_THAT(third.Grow(20, "third"),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("beside the 10 it holds")));
}

TEST(MemoryPool, NobodyWaitsForEver) {
  MemoryPool pool(100, absl::Milliseconds(30));
  Reservation other(pool);
  MAPSIEVE_ASSERT_OK(other.Grow(70, "other"));
  Reservation mine(pool);
  EXPECT_THAT(mine.Grow(80, "mine"),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("holding 70: try again later")));
  MemoryPool patient(100, absl::Minutes(1));
  Reservation all(patient);
  MAPSIEVE_ASSERT_OK(all.Grow(100, "all"));
  Reservation none(patient);
  std::stop_source stop;
  std::thread stopping([&] {
    absl::SleepFor(absl::Milliseconds(20));
    stop.request_stop();
  });
  EXPECT_THAT(none.Grow(1, "none", stop.get_token()),
              StatusIs(absl::StatusCode::kCancelled, "cancelled"));
  stopping.join();
  EXPECT_THAT(none.Grow(1, "none", stop.get_token()),
              StatusIs(absl::StatusCode::kCancelled, "cancelled"));
}

template <typename T, typename Parse>
void ExpectRoundTrip(const T& record, const std::string& bytes,
                     const Parse& parse) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const T read, parse(bytes));
  EXPECT_EQ(read, record);
  for (size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_THAT(parse(bytes.substr(0, size)),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("stored")));
  }
  EXPECT_THAT(parse(bytes + "x"), StatusIs(absl::StatusCode::kDataLoss,
                                           HasSubstr("1 bytes too many")));
  std::string newer = bytes;
  newer[0] = 4;
  EXPECT_THAT(parse(newer), StatusIs(absl::StatusCode::kDataLoss,
                                     HasSubstr("version 4, expected at most")));
}

constexpr core::SpdfOptions kOptions = {.neighbor_count = 33,
                                        .label_neighbor_count = 77,
                                        .vote_scale_m2 = 0.123,
                                        .density_radius_m = 0.77,
                                        .reach_m = 1.5,
                                        .max_round_count = 3,
                                        .rule = core::DensityRule::kQuota,
                                        .seed = -9,
                                        .outlier_share = 0.25};

UploadReport MakeUploadReport() {
  return {.revision = 3,
          .added_point_count = 5'000'000'000,
          .refused = {.non_finite = 1, .out_of_lattice = 2},
          .block_count = 7,
          .tile_count = 8,
          .bounds = Bounds{{-1, -2, -3}, {4, 5, 6}},
          .census = PointCensus{.duplicate_point_count = 6'000'000'000,
                                .overlapping_point_count = 11,
                                .density_cell_level = 10,
                                .density_histogram = {5, 0, 7}},
          .warnings = {{"crs_differs", "one"}, {"unit_not_metre", ""}}};
}

TEST(OpaqueRecords, ComeBackAsTheyWere) {
  ExpectRoundTrip(kOptions, FormatSpdfOptions(kOptions), ParseSpdfOptions);
  const UploadNotes notes = {.source = {.crs_wkt = std::string(100, 'w'),
                                        .frame_id = "map",
                                        .unit = "foot",
                                        .coordinate_step = 0.01},
                             .report = MakeUploadReport()};
  ExpectRoundTrip(notes, FormatUploadNotes(notes), ParseUploadNotes);
  UploadNotes open = notes;
  open.source.crs_wkt.assign(65'536, 'w');
  open.report.census->overlapping_point_count.reset();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadNotes read,
                                ParseUploadNotes(FormatUploadNotes(open)));
  EXPECT_EQ(read, open);
  const UploadNotes nothing;
  ExpectRoundTrip(nothing, FormatUploadNotes(nothing), ParseUploadNotes);
  const ProcessReport run = {.revision = 9,
                             .distinct_point_count = 100,
                             .point_count = 50,
                             .label_counts = {0, 10, 15, 25},
                             .outlier_count = 4,
                             .round_count = 6,
                             .updated_tile_count = 5};
  ExpectRoundTrip(run, FormatProcessReport(run), ParseProcessReport);
  const JobSpec finalize = {.verb = OperationVerb::kFinalizeUpload,
                            .map_uid = "map",
                            .upload_id = "id",
                            .upload_uid = "uid"};
  ExpectRoundTrip(finalize, FormatJobSpec(finalize), ParseJobSpec);
  const JobSpec process = {.verb = OperationVerb::kProcessMap,
                           .map_uid = "map",
                           .options = kOptions};
  ExpectRoundTrip(process, FormatJobSpec(process), ParseJobSpec);
  const JobSpec repair = {.verb = OperationVerb::kRepairMap, .map_uid = "map"};
  ExpectRoundTrip(repair, FormatJobSpec(repair), ParseJobSpec);
  for (const std::optional<RegionShape>& region :
       {std::optional<RegionShape>(),
        std::optional<RegionShape>(Box{{-1, -2, -3}, {4, 5, 6.5}}),
        std::optional<RegionShape>(Sphere{{1, 2, 3}, 0.1})}) {
    JobSpec replace = finalize;
    replace.region = region;
    ExpectRoundTrip(replace, FormatJobSpec(replace), ParseJobSpec);
    const JobSpec deletion = {.verb = OperationVerb::kDeleteRegion,
                              .map_uid = "map",
                              .region = region,
                              .edit_uid = "edit",
                              .base_revision = 17};
    ExpectRoundTrip(deletion, FormatJobSpec(deletion), ParseJobSpec);
    const EditRecord edit = {.edit_uid = "edit",
                             .upload_id = "id",
                             .region = region,
                             .added_point_count = 5,
                             .removed_point_count = 6,
                             .tile_count = 7};
    ExpectRoundTrip(edit, FormatEditRecord(edit), ParseEditRecord);
  }
}

TEST(OpaqueRecords, OptionsOfVersion1AreReadAndEqualNoneOfToday) {
  core::SpdfOptions options = kOptions;
  options.label_neighbor_count = 0;
  std::string older = FormatSpdfOptions(options);
  ASSERT_EQ(older[0], 2);
  older[0] = 1;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::SpdfOptions read,
                                ParseSpdfOptions(older));
  EXPECT_EQ(read, options);
}

// Or every product of an older program would be made anew.
TEST(OpaqueRecords, OptionsWithDefaultLabelNeighboursAreThoseOfVersion2) {
  std::string with = FormatSpdfOptions(kOptions);
  ASSERT_EQ(with[0], 3);
  with[0] = 2;
  with.resize(with.size() - sizeof(int32_t));
  core::SpdfOptions options = kOptions;
  options.label_neighbor_count = 0;
  EXPECT_EQ(FormatSpdfOptions(options), with);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::SpdfOptions read,
                                ParseSpdfOptions(with));
  EXPECT_EQ(read, options);
}

TEST(OpaqueRecords, NotesOfVersion1HaveNoCensus) {
  UploadNotes notes;
  notes.report = MakeUploadReport();
  notes.report.census.reset();
  notes.report.warnings.clear();
  std::string older = FormatUploadNotes(notes);
  ASSERT_EQ(older[0], 2);
  older[0] = 1;
  // No census, no warnings, three empty texts and a number.
  older.resize(older.size() - (1 + 2 + 4 + 2 + 2 + 8));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadNotes read,
                                ParseUploadNotes(older));
  EXPECT_EQ(read, notes);
}

TEST(OpaqueRecords, OutcomeHoldsTheResultOfItsVerb) {
  const absl::Time start = absl::FromUnixMicros(1'700'000'000'123'456);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const JobOutcome none,
                                ParseJobOutcome(FormatJobOutcome({start, {}})));
  EXPECT_EQ(none.start_time, start);
  EXPECT_TRUE(std::holds_alternative<std::monostate>(none.result));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const JobOutcome upload,
      ParseJobOutcome(FormatJobOutcome({start, MakeUploadReport()})));
  EXPECT_EQ(std::get<UploadReport>(upload.result), MakeUploadReport());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const JobOutcome process,
      ParseJobOutcome(FormatJobOutcome({start, ProcessReport{.revision = 2}})));
  EXPECT_EQ(std::get<ProcessReport>(process.result).revision, 2);
  const DeleteReport report = {
      .revision = 3, .removed_point_count = 4, .tile_count = 5};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const JobOutcome deletion,
      ParseJobOutcome(FormatJobOutcome({start, report})));
  EXPECT_EQ(std::get<DeleteReport>(deletion.result), report);
  const RepairReport repaired = {.damaged_chunk_count = 3,
                                 .repaired_chunk_count = 1,
                                 .raw_chunk_count = 1,
                                 .obstacle = "revision 2"};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const JobOutcome repair,
      ParseJobOutcome(FormatJobOutcome({start, repaired})));
  EXPECT_EQ(std::get<RepairReport>(repair.result), repaired);
}

TEST(ProductChunk, RefusesColumnsThatAreNone) {
  core::LabelColumns labels;
  labels.label = {core::Label::kCurve, core::Label::kNone};
  labels.confidence = {7, 0};
  labels.lambda = {{3, 2, 1}, {0, 0, 0}};
  labels.normal = {5, 6};
  labels.tangent = {7, 8};
  core::LatticeCloud points;
  points.positions = {{1, 1, 1}, {2, 2, 2}};
  core::LatticeCloud product = MakeProductCloud(points, labels.All());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const core::LabelCounts counts,
                                CountLabels(product.attributes));
  EXPECT_EQ(counts, (core::LabelCounts{1, 0, 1, 0}));
  EXPECT_THAT(FindProductColumn(product.attributes, kNormalColumn,
                                core::ScalarType::kFloat32),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("expected float32, found uint32")));
  EXPECT_THAT(CountLabels(points.attributes),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("found none")));
  product.attributes.Find(kLabelColumn)->Set<uint8_t>(1, 4);
  EXPECT_THAT(CountLabels(product.attributes),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("point 1 of a product chunk: expected at "
                                 "most 3, found 4")));
}

}  // namespace
}  // namespace mapsieve::engine
