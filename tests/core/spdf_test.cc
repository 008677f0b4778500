#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <random>
#include <set>

#include "core/cloud/merge_duplicates.h"
#include "core/geometry/morton.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/kernels.h"
#include "tests/testing/brute_force_filter.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;
namespace clouds = ::mapsieve::testing;

struct Answer {
  std::vector<LatticePoint> positions;
  LabelColumns columns;
  SpdfSummary summary;
};

Answer Filter(const LatticeCloud& cloud, const SpdfOptions& options,
              Executor& executor = InlineExecutor()) {
  const auto result = FilterCloud(cloud, options, {.executor = &executor});
  EXPECT_THAT(result, clouds::IsOk());
  Answer answer{{}, result->columns, result->summary};
  for (const uint32_t row : result->rows) {
    answer.positions.push_back(cloud.positions[row]);
  }
  return answer;
}

void ExpectSame(const Answer& a, const Answer& b) {
  ASSERT_EQ(a.positions.size(), b.positions.size());
  EXPECT_TRUE(a.positions == b.positions);
  EXPECT_TRUE(a.columns == b.columns);
  EXPECT_EQ(a.summary.max_confidence, b.summary.max_confidence);
}

/// Small clouds of every kind, for oracles and properties.
std::vector<std::pair<std::string, LatticeCloud>> SmallClouds() {
  LatticeCloud duplicates = clouds::SceneCloud(200, 0.3, 3);
  duplicates = clouds::Concatenated(duplicates, duplicates);
  LatticeCloud isolated = clouds::SceneCloud(150, 0.2, 4);
  isolated.positions.push_back({50000, 0, 0});
  isolated.positions.push_back({900000, 12345, -70000});
  return {
      {"scene", clouds::SceneCloud(700, 0.5, 1)},
      {"dense scene", clouds::SceneCloud(700, 0.15, 2)},
      {"plane", clouds::PlaneCloud(500, 0.3, 5)},
      {"line", clouds::LineCloud(300, 0.5, 6)},
      {"volume", clouds::VolumeCloud(600, 0.2, 7)},
      {"grid", clouds::GridCloud(8, 40)},
      {"duplicates", duplicates},
      {"isolated", isolated},
      {"one point", clouds::PlaneCloud(1, 1, 8)},
      {"two points", clouds::PlaneCloud(2, 0.1, 9)},
      {"far apart", clouds::Concatenated(
                        clouds::SceneCloud(150, 0.2, 10),
                        clouds::Shifted(clouds::SceneCloud(150, 0.2, 11),
                                        {2'000'000'000, -1'000'000'000, 500}))},
  };
}

TEST(Spdf, EqualsBruteForceBitForBit) {
  for (const auto& [name, cloud] : SmallClouds()) {
    const std::vector<LatticePoint> points = DistinctPoints(cloud.positions);
    for (const DensityRule rule : {DensityRule::kPaper, DensityRule::kQuota}) {
      for (const auto& [k, label_k] : {std::pair(6, 0), std::pair(20, 127),
                                       std::pair(50, 0), std::pair(50, 20)}) {
        SCOPED_TRACE(name + " " + std::string(DensityRuleName(rule)) + " k " +
                     std::to_string(k) + " and " + std::to_string(label_k));
        const SpdfOptions options = {.neighbor_count = k,
                                     .label_neighbor_count = label_k,
                                     .density_radius_m = k == 20 ? 0.05 : 0.2,
                                     .rule = rule,
                                     .seed = 7};
        const auto expected =
            clouds::BruteForceFilter(points, cloud.lattice, options);
        const Answer actual = Filter(cloud, options);
        ASSERT_EQ(actual.positions.size(), expected.positions.size());
        EXPECT_TRUE(actual.positions == expected.positions);
        EXPECT_TRUE(actual.columns == expected.columns);
      }
    }
  }
}

TEST(Spdf, EveryInstructionSetGivesTheSameBytes) {
  const LatticeCloud cloud = clouds::SceneCloud(20000, 2, 12);
  int count = 0;
  const Kernels* const* kernels = AvailableKernels(&count);
  for (const DensityRule rule : {DensityRule::kPaper, DensityRule::kQuota}) {
    const SpdfOptions options = {
        .label_neighbor_count = rule == DensityRule::kQuota ? 127 : 0,
        .density_radius_m = 0.2,
        .rule = rule};
    const Answer expected = Filter(cloud, options);
    EXPECT_LT(expected.positions.size(), cloud.size());
    for (int i = 0; i < count; ++i) {
      SCOPED_TRACE(kernels[i]->name);
      UseKernels(*kernels[i]);
      ExpectSame(Filter(cloud, options), expected);
      UseKernels(*kernels[count - 1]);
    }
  }
}

TEST(Spdf, DoesNotDependOnInputOrderOrWorkers) {
  const LatticeCloud cloud =
      clouds::WithAttributes(clouds::SceneCloud(20000, 2, 12), 13);
  const auto pool = MakeWorkerPool(3);
  for (const DensityRule rule : {DensityRule::kPaper, DensityRule::kQuota}) {
    const SpdfOptions options = {.density_radius_m = 0.2, .rule = rule};
    const Answer expected = Filter(cloud, options);
    EXPECT_LT(expected.positions.size(), cloud.size());
    ExpectSame(Filter(clouds::Shuffled(cloud, 1), options), expected);
    ExpectSame(Filter(cloud, options, *pool), expected);
  }
}

TEST(Spdf, VotesDoNotSeeAShift) {
  const LatticePoint offset = {5'000'000'000, -5'000'000'000, 5'000'000'123};
  const LatticeCloud cloud = clouds::SceneCloud(3000, 0.8, 14);
  SpdfOptions options = {.max_round_count = 0};
  const Answer here = Filter(cloud, options);
  const Answer there = Filter(clouds::Shifted(cloud, offset), options);
  ASSERT_EQ(here.positions.size(), there.positions.size());
  std::map<std::array<int64_t, 3>, size_t> rows;
  for (size_t i = 0; i < here.positions.size(); ++i) {
    const LatticePoint& q = here.positions[i];
    rows[{q.x, q.y, q.z}] = i;
  }
  size_t different = 0;
  for (size_t i = 0; i < there.positions.size(); ++i) {
    const LatticePoint& q = there.positions[i];
    const size_t row =
        rows.at({q.x - offset.x, q.y - offset.y, q.z - offset.z});
    if (there.columns.label[i] != here.columns.label[row] ||
        there.columns.lambda[i] != here.columns.lambda[row]) {
      ++different;
    }
  }
  EXPECT_EQ(different, 0u);
}

/// For each point of `a`, its row in `b`, whose points are those of `a` moved
/// by `move`.
template <typename Move>
std::vector<size_t> MatchRows(const Answer& a, const Answer& b, Move move) {
  std::map<std::array<int64_t, 3>, size_t> rows;
  for (size_t i = 0; i < b.positions.size(); ++i) {
    const LatticePoint& q = b.positions[i];
    rows[{q.x, q.y, q.z}] = i;
  }
  std::vector<size_t> result;
  for (const LatticePoint& q : a.positions) {
    const LatticePoint m = move(q);
    result.push_back(rows.at({m.x, m.y, m.z}));
  }
  return result;
}

/// True for the points whose votes no tie at the k-th neighbour touches, their
/// own or a voter's: there the tie rule, which names axes, decides nothing.
std::vector<bool> UntouchedByTies(const std::vector<LatticePoint>& points,
                                  int k, int64_t reach_d2) {
  std::vector<std::vector<std::pair<int64_t, size_t>>> near(points.size());
  std::vector<bool> tied(points.size());
  for (size_t i = 0; i < points.size(); ++i) {
    for (size_t j = 0; j < points.size(); ++j) {
      const int64_t dx = points[i].x - points[j].x;
      const int64_t dy = points[i].y - points[j].y;
      const int64_t dz = points[i].z - points[j].z;
      const int64_t d2 = dx * dx + dy * dy + dz * dz;
      if (i != j && d2 <= reach_d2) near[i].emplace_back(d2, j);
    }
    std::sort(near[i].begin(), near[i].end());
    const auto last = static_cast<size_t>(k);
    if (near[i].size() > last) {
      tied[i] = near[i][last - 1].first == near[i][last].first;
      near[i].resize(last);
    }
  }
  std::vector<bool> untouched(points.size());
  for (size_t i = 0; i < points.size(); ++i) {
    untouched[i] = !tied[i] && std::none_of(near[i].begin(), near[i].end(),
                                            [&](const auto& neighbor) {
                                              return tied[neighbor.second];
                                            });
  }
  return untouched;
}

TEST(Spdf, AxisPermutationAndQuarterTurnMoveTheVotesAlong) {
  const LatticeCloud cloud = clouds::SceneCloud(2000, 0.64, 16);
  const SpdfOptions options = {.max_round_count = 0};
  const Answer before = Filter(cloud, options);
  const std::vector<bool> untouched =
      UntouchedByTies(before.positions, options.neighbor_count,
                      MakeSpdfConstants(options, cloud.lattice).reach_d2);
  EXPECT_GT(std::count(untouched.begin(), untouched.end(), true), 1000);
  const auto permute = [](const LatticePoint& q) {
    return LatticePoint{q.z, q.x, q.y};
  };
  const auto turn = [](const LatticePoint& q) {
    return LatticePoint{-q.y, q.x, q.z};
  };
  const auto check = [&](auto move) {
    const Answer after = Filter(clouds::Mapped(cloud, move), options);
    const std::vector<size_t> rows = MatchRows(before, after, move);
    for (size_t i = 0; i < rows.size(); ++i) {
      if (!untouched[i]) continue;
      const auto& lambda = before.columns.lambda[i];
      std::array<float, 3> saliency = {lambda[0] - lambda[1],
                                       lambda[1] - lambda[2], lambda[2]};
      std::sort(saliency.begin(), saliency.end());
      if (saliency[2] - saliency[1] < 1e-5f) continue;
      ASSERT_EQ(before.columns.label[i], after.columns.label[rows[i]]);
      // The normal's direction is defined where λ1 stands alone.
      if (lambda[0] - lambda[1] < 1e-3f) continue;
      const auto n = DecodeOctahedral(before.columns.normal[i]);
      const auto m = DecodeOctahedral(after.columns.normal[rows[i]]);
      // Moves a direction through integers, which `move` takes.
      const auto moved =
          move(LatticePoint{std::lround(n[0] * 1e6f), std::lround(n[1] * 1e6f),
                            std::lround(n[2] * 1e6f)});
      const double dot = 1e-6 * (static_cast<double>(moved.x) * m[0] +
                                 static_cast<double>(moved.y) * m[1] +
                                 static_cast<double>(moved.z) * m[2]);
      // Both are rounded to 0.06 degrees.
      ASSERT_NEAR(std::abs(dot), 1, 3e-6);
    }
  };
  check(permute);
  check(turn);
}

TEST(Spdf, ManyCopiesOfAPointCountOnce) {
  LatticeCloud cloud = clouds::PlaneCloud(4000, 1, 17);
  const SpdfOptions options = {.density_radius_m = 0.2};
  const Answer without = Filter(cloud, options);
  for (int i = 0; i < 500; ++i) cloud.positions.push_back(cloud.positions[7]);
  ExpectSame(Filter(cloud, options), without);
}

TEST(Spdf, EmptyCloudGivesAnEmptyAnswer) {
  const auto result = FilterCloud(LatticeCloud(), SpdfOptions());
  MAPSIEVE_ASSERT_OK(result);
  EXPECT_TRUE(result->rows.empty());
}

TEST(Spdf, APointWithoutVotesHasNoLabelAndIsAnOutlier) {
  LatticeCloud cloud = clouds::PlaneCloud(500, 0.5, 18);
  cloud.positions.push_back({100000, 0, 0});
  const auto result = FilterCloud(cloud, SpdfOptions());
  MAPSIEVE_ASSERT_OK(result);
  EXPECT_EQ(result->summary.label_counts[0], 1);
  for (const uint32_t i : result->Inliers(0.0)) {
    EXPECT_NE(cloud.positions[result->rows[i]].x, 100000);
  }
}

TEST(Spdf, AMillionPointsInOneVoxelAreOnePoint) {
  LatticeCloud cloud;
  cloud.positions.assign(1'000'000, {5, 6, 7});
  const auto result = FilterCloud(cloud, SpdfOptions());
  MAPSIEVE_ASSERT_OK(result);
  EXPECT_EQ(result->summary.point_count, 1);
  EXPECT_EQ(result->rows.size(), 1u);
}

TEST(Spdf, CancelsOnRequest) {
  std::stop_source source;
  source.request_stop();
  EXPECT_THAT(FilterCloud(clouds::SceneCloud(1000, 1, 1), SpdfOptions(),
                          {.stop = source.get_token()}),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("cancelled")));
}

// Ideal shapes -------------------------------------------------------------

/// Share of the survivors at points that `where` selects which have `label`.
template <typename Where>
double LabelShare(const Answer& answer, Label label, Where where) {
  int selected = 0;
  int matching = 0;
  for (size_t i = 0; i < answer.positions.size(); ++i) {
    if (!where(answer.positions[i])) continue;
    ++selected;
    if (answer.columns.label[i] == label) ++matching;
  }
  EXPECT_GT(selected, 20);
  return static_cast<double>(matching) / selected;
}

bool IsInner(const LatticePoint& q, int64_t limit) {
  return std::abs(q.x) < limit && std::abs(q.y) < limit &&
         std::abs(q.z) < limit;
}

/// Largest angle in degrees between `axis` and the decoded vectors.
template <typename Axis, typename Where>
double LargestAngle(const Answer& answer,
                    std::span<const OctahedralVector> vectors, Axis axis,
                    Where where) {
  double largest = 0;
  for (size_t i = 0; i < answer.positions.size(); ++i) {
    if (!where(answer.positions[i])) continue;
    const auto v = DecodeOctahedral(vectors[i]);
    const std::array<double, 3> a = axis(answer.positions[i]);
    const double dot = std::abs(a[0] * v[0] + a[1] * v[1] + a[2] * v[2]);
    largest = std::max(largest, std::acos(std::min(dot, 1.0)) * 180 / M_PI);
  }
  return largest;
}

TEST(IdealShapes, APlaneIsASurfaceWithItsNormal) {
  const Answer answer =
      Filter(clouds::PlaneCloud(20000, 2, 20), {.density_radius_m = 0.2});
  const auto inner = [](const LatticePoint& q) { return IsInner(q, 1700); };
  EXPECT_EQ(LabelShare(answer, Label::kSurface, inner), 1.0);
  EXPECT_LT(LargestAngle(
                answer, answer.columns.normal,
                [](const LatticePoint&) {
                  return std::array<double, 3>{0, 0, 1};
                },
                inner),
            0.01);
}

TEST(IdealShapes, ALineIsACurveWithItsTangent) {
  const Answer answer =
      Filter(clouds::LineCloud(3000, 3, 21), {.density_radius_m = 0.2});
  const auto inner = [](const LatticePoint& q) { return IsInner(q, 2700); };
  EXPECT_EQ(LabelShare(answer, Label::kCurve, inner), 1.0);
  EXPECT_LT(LargestAngle(
                answer, answer.columns.tangent,
                [](const LatticePoint&) {
                  return std::array<double, 3>{1, 0, 0};
                },
                inner),
            0.01);
}

TEST(IdealShapes, AnEdgeIsACurveAlongItAndSurfacesBesideIt) {
  const Answer answer =
      Filter(clouds::EdgeCloud(40000, 2, 22), {.density_radius_m = 0.2});
  const auto on_edge = [](const LatticePoint& q) {
    return std::abs(q.x) < 1600 && q.y < 20 && q.z < 20;
  };
  const auto beside = [](const LatticePoint& q) {
    return std::abs(q.x) < 1600 && q.y + q.z > 600 && q.y + q.z < 1600;
  };
  EXPECT_GT(LabelShare(answer, Label::kCurve, on_edge), 0.9);
  EXPECT_GT(LabelShare(answer, Label::kSurface, beside), 0.99);
}

TEST(IdealShapes, ACornerIsAJunctionAtItsTipWithCurvesAlongItsEdges) {
  // Even samples: near a tip few points decide, and chance shows.
  for (const int64_t spacing : {30, 50}) {
    LatticeCloud cloud;
    for (int64_t a = 0; a < 2000; a += spacing) {
      for (int64_t b = 0; b < 2000; b += spacing) {
        cloud.positions.insert(cloud.positions.end(),
                               {{a, b, 0}, {a, 0, b}, {0, a, b}});
      }
    }
    const Answer answer = Filter(cloud, {.max_round_count = 0});
    for (size_t i = 0; i < answer.positions.size(); ++i) {
      const LatticePoint& q = answer.positions[i];
      const Label label = answer.columns.label[i];
      const int64_t farthest = std::max({q.x, q.y, q.z});
      const int off_axis = (q.x > 0) + (q.y > 0) + (q.z > 0);
      if (farthest == 0) {
        EXPECT_EQ(label, Label::kJunction);
      }
      if (farthest > 400 && farthest < 1500) {
        if (off_axis == 1) {
          EXPECT_EQ(label, Label::kCurve);
        } else if (std::min({q.x + q.y, q.y + q.z, q.x + q.z}) > 400) {
          EXPECT_EQ(label, Label::kSurface);
        }
      }
    }
  }
}

TEST(IdealShapes, ASphereIsASurfaceWithRadialNormals) {
  const Answer answer =
      Filter(clouds::SphereCloud(60000, 1.5, 24), {.density_radius_m = 0.2});
  const auto all = [](const LatticePoint&) { return true; };
  EXPECT_GT(LabelShare(answer, Label::kSurface, all), 0.995);
  EXPECT_LT(LargestAngle(
                answer, answer.columns.normal,
                [](const LatticePoint& q) {
                  const double length = std::hypot(q.x, q.y, q.z);
                  return std::array<double, 3>{
                      static_cast<double>(q.x) / length,
                      static_cast<double>(q.y) / length,
                      static_cast<double>(q.z) / length};
                },
                all),
            5);
}

TEST(IdealShapes, ANoiseVolumeIsJunctions) {
  const Answer answer =
      Filter(clouds::VolumeCloud(30000, 0.8, 25), {.density_radius_m = 0.2});
  const auto inner = [](const LatticePoint& q) { return IsInner(q, 500); };
  // 50 random neighbours are seldom as even as the volume they come from.
  EXPECT_GT(LabelShare(answer, Label::kJunction, inner), 0.75);
}

// Tiles --------------------------------------------------------------------

/// Tiles of any level over a cloud in memory, each visit from its own store.
class SmallTiles : public TileStore {
 public:
  SmallTiles(const LatticeCloud& cloud, int level) {
    for (const LatticePoint& q : DistinctPoints(cloud.positions)) {
      points_[CellKey::Of(q, level)].push_back(q);
    }
  }
  std::vector<TileInfo> Tiles() const override {
    std::vector<TileInfo> tiles;
    for (const auto& [key, points] : points_) {
      tiles.push_back({key, static_cast<int64_t>(points.size())});
    }
    return tiles;
  }
  absl::StatusOr<int64_t> LoadPoints(const CellKey& key,
                                     std::span<LatticePoint> room) override {
    const std::vector<LatticePoint>& points = points_.at(key);
    std::copy(points.begin(), points.end(), room.begin());
    return static_cast<int64_t>(points.size());
  }
  absl::Status LoadPointRows(const CellKey& key, std::span<const RowRange> rows,
                             std::span<LatticePoint> room) override {
    CopyRows<LatticePoint>(points_.at(key), rows, room);
    return absl::OkStatus();
  }
  absl::Status StoreState(const CellKey& key, TileStateKind kind,
                          std::span<const std::byte> bytes) override {
    states_[{static_cast<int>(kind), key.x, key.y, key.z}].assign(bytes.begin(),
                                                                  bytes.end());
    return absl::OkStatus();
  }
  absl::Status LoadState(const CellKey& key, TileStateKind kind,
                         std::span<const RowRange> rows,
                         std::span<std::byte> room) override {
    CopyRows<std::byte>(
        states_.at({static_cast<int>(kind), key.x, key.y, key.z}), rows, room,
        room.size() / RowCount(rows));
    return absl::OkStatus();
  }
  absl::Status Emit(const TileResult& result) override {
    const auto& points = points_.at(result.key);
    for (size_t i = 0; i < result.rows.size(); ++i) {
      EXPECT_EQ(result.positions[i], points[result.rows[i]]);
      answer.positions.push_back(result.positions[i]);
    }
    answer.columns.Append(result.columns);
    return absl::OkStatus();
  }

  Answer answer;

 protected:
  std::map<std::array<int64_t, 4>, std::vector<std::byte>> states_;

 private:
  std::map<CellKey, std::vector<LatticePoint>, CellKeyLess> points_;
};

/// Tiles whose run ends in the middle of a visit.
class InterruptedTiles final : public SmallTiles {
 public:
  using SmallTiles::SmallTiles;

  absl::Status StoreState(const CellKey& key, TileStateKind kind,
                          std::span<const std::byte> bytes) override {
    if (visits_left == 0) return absl::UnavailableError("killed");
    return SmallTiles::StoreState(key, kind, bytes);
  }
  absl::Status FinishVisit(std::span<const std::byte> record) override {
    --visits_left;
    records.emplace_back(record.begin(), record.end());
    finished_states_ = states_;
    return absl::OkStatus();
  }
  std::vector<std::vector<std::byte>> FinishedVisits() override {
    states_ = finished_states_;
    return records;
  }

  int visits_left = 0;
  std::vector<std::vector<std::byte>> records;

 private:
  std::map<std::array<int64_t, 4>, std::vector<std::byte>> finished_states_;
};

TEST(FilterTiles, GoesOnAfterTheLastFinishedVisit) {
  const LatticeCloud cloud = clouds::SceneCloud(3000, 1.2, 33);
  for (const auto& [rule, max_halo_share] :
       {std::pair(DensityRule::kPaper, 0.0),
        std::pair(DensityRule::kPaper, 1e9),
        std::pair(DensityRule::kQuota, 0.0)}) {
    const SpdfOptions options = {
        .density_radius_m = 0.2, .reach_m = 0.5, .rule = rule};
    const Answer expected = Filter(cloud, options);
    const TilingOptions tiling = {.max_unit_points = 700,
                                  .max_halo_share = max_halo_share};
    const auto run = [&](InterruptedTiles& tiles) {
      return FilterTiles(tiles, cloud.lattice, options, tiling, {});
    };
    InterruptedTiles whole(cloud, 9);
    whole.visits_left = 1'000'000;
    MAPSIEVE_ASSERT_OK(run(whole));
    ASSERT_GE(whole.records.size(), 6u);
    for (size_t n = 0; n < whole.records.size();
         n += 1 + whole.records.size() / 10) {
      SCOPED_TRACE(absl::StrCat("after visit ", n));
      InterruptedTiles tiles(cloud, 9);
      tiles.visits_left = static_cast<int>(n);
      EXPECT_THAT(run(tiles), StatusIs(absl::StatusCode::kUnavailable,
                                       HasSubstr("killed")));
      EXPECT_EQ(tiles.records.size(), n);
      tiles.visits_left = 1'000'000;
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(tiles.answer.summary, run(tiles));
      ExpectSame(tiles.answer, expected);
      // No visit was made twice.
      EXPECT_EQ(tiles.records, whole.records);
    }
  }
}

TEST(FilterTiles, TheAnswerDoesNotDependOnTilesOrUnits) {
  // Shifted so that the ground lies on a tile face, and not.
  for (const LatticePoint& offset :
       {LatticePoint{0, 0, 0}, LatticePoint{5100, 7200, -4100}}) {
    const LatticeCloud cloud =
        clouds::Shifted(clouds::Concatenated(clouds::SceneCloud(4000, 1.2, 30),
                                             clouds::PlaneCloud(2000, 1.2, 31)),
                        offset);
    for (const auto& [rule, rounds] :
         {std::pair(DensityRule::kPaper, 0), std::pair(DensityRule::kPaper, 10),
          std::pair(DensityRule::kQuota, 10)}) {
      const SpdfOptions options = {
          .label_neighbor_count = rule == DensityRule::kQuota ? 127 : 0,
          .density_radius_m = 0.2,
          .reach_m = 0.5,
          .max_round_count = rounds,
          .rule = rule};
      const Answer expected = Filter(cloud, options);
      // In lock-step, and all rounds at once.
      for (const auto& [level, tiling] :
           {std::pair(8, TilingOptions{1, 0}),
            std::pair(9, TilingOptions{700, 0}),
            std::pair(10, TilingOptions{1, 0}),
            std::pair(10, TilingOptions{3000, 1e9}),
            std::pair(9, TilingOptions{700, 1e9}),
            std::pair(11, TilingOptions{100'000, 0})}) {
        SCOPED_TRACE(absl::StrCat("level ", level, " rounds ", rounds, " rule ",
                                  static_cast<int>(rule), " share ",
                                  tiling.max_halo_share));
        SmallTiles tiles(cloud, level);
        const auto summary =
            FilterTiles(tiles, cloud.lattice, options, tiling, {});
        MAPSIEVE_ASSERT_OK(summary);
        tiles.answer.summary = *summary;
        ExpectSame(tiles.answer, expected);
        EXPECT_EQ(summary->label_counts, expected.summary.label_counts);
        EXPECT_EQ(summary->round_count, expected.summary.round_count);
      }
    }
  }
}

TEST(FilterTiles, ProgressNeverGoesBackAndEndsAtTheTotal) {
  struct Sink final : ProgressSink {
    void Report(int64_t done, int64_t total) override {
      EXPECT_GE(done, last);
      EXPECT_LE(done, total);
      last = done;
      last_total = total;
    }
    int64_t last = 0;
    int64_t last_total = 0;
  } sink;
  const LatticeCloud cloud = clouds::SceneCloud(3000, 1.2, 32);
  SmallTiles tiles(cloud, 10);
  MAPSIEVE_ASSERT_OK(FilterTiles(tiles, cloud.lattice, SpdfOptions(),
                                 {.max_unit_points = 500},
                                 {.progress = &sink}));
  EXPECT_GT(sink.last, 0);
  EXPECT_EQ(sink.last, sink.last_total);
}

// Rule quota ---------------------------------------------------------------

std::set<std::array<int64_t, 3>> Kept(const LatticeCloud& cloud, double rho,
                                      int k) {
  std::set<std::array<int64_t, 3>> kept;
  const Answer answer = Filter(cloud, {.neighbor_count = k,
                                       .density_radius_m = rho,
                                       .rule = DensityRule::kQuota});
  for (const LatticePoint& q : answer.positions) kept.insert({q.x, q.y, q.z});
  return kept;
}

TEST(Quota, IsNestedInRadiusAndCount) {
  const LatticeCloud cloud = clouds::SceneCloud(8000, 0.8, 40);
  const auto fine = Kept(cloud, 0.1, 20);
  const auto coarse = Kept(cloud, 0.2, 20);
  const auto sparse = Kept(cloud, 0.2, 10);
  EXPECT_LT(coarse.size(), fine.size());
  EXPECT_LT(sparse.size(), coarse.size());
  EXPECT_TRUE(
      std::includes(fine.begin(), fine.end(), coarse.begin(), coarse.end()));
  EXPECT_TRUE(std::includes(coarse.begin(), coarse.end(), sparse.begin(),
                            sparse.end()));
}

TEST(Quota, AnAddedPointOnlyRemovesPointsWithinTheRadius) {
  LatticeCloud cloud = clouds::SceneCloud(5000, 0.6, 41);
  const auto before = Kept(cloud, 0.2, 20);
  const LatticePoint added = {100, 3, 5};
  cloud.positions.push_back(added);
  const auto after = Kept(cloud, 0.2, 20);
  for (const auto& q : before) {
    if (after.contains(q)) continue;
    EXPECT_LE(std::hypot(q[0] - added.x, q[1] - added.y, q[2] - added.z), 200);
  }
  for (const auto& q : after) {
    const bool is_added = q[0] == added.x && q[1] == added.y && q[2] == added.z;
    EXPECT_TRUE(is_added || before.contains(q));
  }
}

TEST(Quota, ReachesTheTargetDensityOnAPlane) {
  // 10 times the target k / (pi rho^2) = 398 points per square metre.
  const double target = 50 / (M_PI * 0.2 * 0.2);
  const auto count = static_cast<int>(10 * target * 16);
  const auto kept = Kept(clouds::PlaneCloud(count, 2, 42), 0.2, 50);
  const auto inner = std::count_if(kept.begin(), kept.end(), [](const auto& q) {
    return std::abs(q[0]) < 1600 && std::abs(q[1]) < 1600;
  });
  EXPECT_NEAR(static_cast<double>(inner) / (3.2 * 3.2) / target, 1, 0.05);
}

}  // namespace
}  // namespace mapsieve::core
