#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <optional>
#include <utility>
#include <vector>

#include "core/cloud/merge_duplicates.h"
#include "core/sampling/random_sample.h"
#include "core/sampling/spatial_budget.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

struct Labeled {
  std::vector<LatticePoint> positions;
  std::vector<Label> labels;
};

Labeled LabeledScene(int count, uint64_t seed) {
  Labeled scene;
  scene.positions =
      DistinctPoints(testing::SceneCloud(count, 3, seed).positions);
  for (const LatticePoint& q : scene.positions) {
    scene.labels.push_back(q.z > 1500  ? Label::kJunction
                           : q.x > 400 ? Label::kCurve
                                       : Label::kSurface);
  }
  return scene;
}

TEST(SampleUnderBudget, GivesExactlyTheBudgetOrEverything) {
  const Labeled scene = LabeledScene(5000, 1);
  const auto total = static_cast<int64_t>(scene.positions.size());
  for (const int64_t budget : {int64_t{0}, int64_t{1}, int64_t{2}, int64_t{7},
                               int64_t{100}, total - 1, total, total + 50}) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const CellSample sample,
        SampleUnderBudget(scene.positions, scene.labels, budget));
    EXPECT_EQ(static_cast<int64_t>(sample.rows.size()),
              std::min(budget, total));
    EXPECT_EQ(sample.centroids.size(), sample.rows.size());
    EXPECT_TRUE(std::is_sorted(sample.rows.begin(), sample.rows.end()));
    EXPECT_EQ(std::adjacent_find(sample.rows.begin(), sample.rows.end()),
              sample.rows.end());
  }
}

TEST(SampleUnderBudget, KeepsTheSharesOfTheLabels) {
  const Labeled scene = LabeledScene(20000, 2);
  LabelCounts before{};
  for (const Label label : scene.labels) ++before[static_cast<size_t>(label)];
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const CellSample sample,
      SampleUnderBudget(scene.positions, scene.labels, 1000));
  LabelCounts after{};
  for (const uint32_t row : sample.rows) {
    ++after[static_cast<size_t>(scene.labels[row])];
  }
  for (size_t l = 1; l < kLabelCount; ++l) {
    const double share = 1000.0 * static_cast<double>(before[l]) /
                         static_cast<double>(scene.positions.size());
    EXPECT_NEAR(static_cast<double>(after[l]), share, 3) << l;
  }
}

TEST(SampleUnderBudget, WeightsGiveTheSharesThatLabelsCanFill) {
  const Labeled scene = LabeledScene(20000, 2);
  LabelCounts counts{};
  for (const Label label : scene.labels) ++counts[static_cast<size_t>(label)];
  const auto total = static_cast<int64_t>(scene.labels.size());
  for (const LabelWeights& weights :
       {LabelWeights{0, 1, 1, 1}, LabelWeights{0, 1, 10, 100},
        LabelWeights{0, 1e6, 1e-3, 0.5}, LabelWeights{5, 3, 2, 1}}) {
    for (const int64_t budget :
         {int64_t{0}, int64_t{1}, int64_t{2}, int64_t{1000}, total / 2,
          total - 1, total, total + 9}) {
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(
          const CellSample sample,
          SampleUnderBudget(scene.positions, scene.labels, budget, weights));
      LabelCounts shares{};
      for (const uint32_t row : sample.rows) {
        ++shares[static_cast<size_t>(scene.labels[row])];
      }
      EXPECT_EQ(static_cast<int64_t>(sample.rows.size()),
                std::min(budget, total));
      // No label that could take more has less by weight than another one.
      for (size_t a = 1; a < kLabelCount; ++a) {
        for (size_t b = 1; b < kLabelCount; ++b) {
          if (shares[a] == counts[a]) continue;
          EXPECT_GE(static_cast<double>(shares[a] + 4) / weights[a],
                    static_cast<double>(shares[b] - 4) / weights[b])
              << budget << " " << a << " " << b;
        }
      }
    }
  }
}

TEST(SampleUnderBudget, StopsWhenAsked) {
  const Labeled scene = LabeledScene(20000, 2);
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THAT(SampleUnderBudget(scene.positions, scene.labels, 10'000,
                                std::nullopt, stop.get_token()),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("cancelled")));
}

TEST(SampleUnderBudget, TakesThePointNearestToTheCentroidOfItsCell) {
  // One label, one cell: the point nearest to the mean of all.
  const std::vector<LatticePoint> positions =
      DistinctPoints(testing::VolumeCloud(300, 1, 3).positions);
  const std::vector<Label> labels(positions.size(), Label::kCurve);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CellSample sample,
                                SampleUnderBudget(positions, labels, 1));
  Point3 mean;
  for (const LatticePoint& q : positions) {
    mean.x += static_cast<double>(q.x) / static_cast<double>(positions.size());
    mean.y += static_cast<double>(q.y) / static_cast<double>(positions.size());
    mean.z += static_cast<double>(q.z) / static_cast<double>(positions.size());
  }
  EXPECT_NEAR(sample.centroids[0].x, mean.x, 1e-6);
  EXPECT_NEAR(sample.centroids[0].z, mean.z, 1e-6);
  const auto distance = [&](const LatticePoint& q) {
    return std::hypot(static_cast<double>(q.x) - mean.x,
                      static_cast<double>(q.y) - mean.y,
                      static_cast<double>(q.z) - mean.z);
  };
  for (const LatticePoint& q : positions) {
    EXPECT_LE(distance(positions[sample.rows[0]]), distance(q) + 1e-9);
  }
}

TEST(SampleUnderBudget, SpreadsAUniformSurfaceEvenly) {
  const std::vector<LatticePoint> positions =
      DistinctPoints(testing::PlaneCloud(40000, 2, 4).positions);
  const std::vector<Label> labels(positions.size(), Label::kSurface);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CellSample sample,
                                SampleUnderBudget(positions, labels, 1600));
  std::array<int, 16> per_quarter{};
  for (const uint32_t row : sample.rows) {
    const LatticePoint& q = positions[row];
    ++per_quarter[static_cast<size_t>((q.x + 2000) / 1001 * 4 +
                                      (q.y + 2000) / 1001)];
  }
  for (const int count : per_quarter) EXPECT_NEAR(count, 100, 25);
}

/// Points of a cell in Morton order and log2 of the cell's volume.
struct OracleCell {
  std::vector<LatticePoint> points;
  int log_volume = 0;
  /// The halves along the first bit, of z, y and x, in which points differ.
  std::array<std::vector<LatticePoint>, 2> halves;
};

OracleCell MakeOracleCell(std::vector<LatticePoint> points) {
  OracleCell cell{.points = std::move(points)};
  for (int bit = 63; bit >= 0; --bit) {
    int part = 3;
    for (const auto axis :
         {&LatticePoint::z, &LatticePoint::y, &LatticePoint::x}) {
      cell.halves = {};
      for (const LatticePoint& q : cell.points) {
        const bool is_set = (q.*axis >> bit & 1) != 0;
        // Negative numbers, whose sign bit is set, come first.
        cell.halves[is_set == (bit < 63) ? 1 : 0].push_back(q);
      }
      if (!cell.halves[0].empty() && !cell.halves[1].empty()) {
        cell.log_volume = 3 * bit + part;
        return cell;
      }
      --part;
    }
  }
  return cell;
}

/// Compares with a division by definition, of most points times v^volume_power.
void ExpectHalvesByPointsTimesVolume(CellSplit split, double volume_power) {
  const std::vector<LatticePoint> positions =
      DistinctPoints(testing::SceneCloud(400, 3, 7).positions);
  const std::vector<Label> labels(positions.size(), Label::kSurface);
  std::vector<OracleCell> cells = {MakeOracleCell(positions)};
  while (cells.size() < 120) {
    size_t widest = 0;
    double largest = 0;
    for (size_t c = 0; c < cells.size(); ++c) {
      if (cells[c].points.size() < 2) continue;
      const double width = static_cast<double>(cells[c].points.size()) *
                           std::exp2(cells[c].log_volume * volume_power);
      if (width > largest * (1 + 1e-9)) {
        largest = width;
        widest = c;
      }
    }
    const auto place = cells.begin() + static_cast<ptrdiff_t>(widest);
    const OracleCell cell = std::move(*place);
    *place = MakeOracleCell(cell.halves[1]);
    cells.insert(place, MakeOracleCell(cell.halves[0]));

    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const CellSample sample,
        SampleUnderBudget(positions, labels, static_cast<int64_t>(cells.size()),
                          std::nullopt, {}, split));
    // Both are in Morton order.
    ASSERT_EQ(sample.rows.size(), cells.size());
    for (size_t c = 0; c < cells.size(); ++c) {
      ASSERT_NE(std::find(cells[c].points.begin(), cells[c].points.end(),
                          positions[sample.rows[c]]),
                cells[c].points.end())
          << cells.size() << " cells, cell " << c;
    }
  }
}

TEST(SampleUnderBudget, TheWidestCellIsHalvedFirst) {
  ExpectHalvesByPointsTimesVolume(CellSplit::kWidest, 2.0 / 3);
}

TEST(SampleUnderBudget, MidwayCountsPointsTimesTheEdge) {
  ExpectHalvesByPointsTimesVolume(CellSplit::kMidway, 1.0 / 3);
}

TEST(SampleUnderBudget, TakesAPowerOfASurfacesDensity) {
  // Sixteen times as dense on the left.
  const LatticeCloud cloud = testing::Concatenated(
      testing::Shifted(testing::PlaneCloud(48000, 2, 8), {-2001, 0, 0}),
      testing::Shifted(testing::PlaneCloud(3000, 2, 9), {2001, 0, 0}));
  const std::vector<LatticePoint> positions = DistinctPoints(cloud.positions);
  const std::vector<Label> labels(positions.size(), Label::kSurface);
  const auto ratio = [&](CellSplit split, int64_t budget) {
    const CellSample sample =
        *SampleUnderBudget(positions, labels, budget, std::nullopt, {}, split);
    const auto left =
        std::count_if(sample.rows.begin(), sample.rows.end(),
                      [&](uint32_t row) { return positions[row].x < 0; });
    return static_cast<double>(left) /
           static_cast<double>(sample.rows.size() - static_cast<size_t>(left));
  };
  double widest = 0;
  double midway = 0;
  double fullest = 0;
  const std::array<int64_t, 4> budgets = {400, 566, 800, 1131};
  for (const int64_t budget : budgets) {
    widest += ratio(CellSplit::kWidest, budget) / budgets.size();
    midway += ratio(CellSplit::kMidway, budget) / budgets.size();
    fullest += ratio(CellSplit::kFullest, budget) / budgets.size();
  }
  EXPECT_NEAR(widest, 4, 0.8);
  EXPECT_NEAR(midway, std::pow(16, 2.0 / 3), 1.2);
  EXPECT_NEAR(fullest, 16, 3);
}

TEST(SampleUnderBudget, RefusesUnequalLengthsAndNegativeBudgets) {
  const std::vector<LatticePoint> positions = {{0, 0, 0}};
  EXPECT_THAT(SampleUnderBudget(positions, {}, 1),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("1 positions but 0 labels")));
  const std::vector<Label> labels = {Label::kCurve};
  EXPECT_THAT(SampleUnderBudget(positions, labels, -1),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("-1")));
  const std::vector<uint16_t> confidences = {1, 2};
  EXPECT_THAT(SampleUnderBudget(positions, labels, 1, std::nullopt, {},
                                CellSplit::kFullest, confidences),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("1 positions but 2 confidences")));
}

TEST(RandomSample, DrawsTheSamePointsWhateverTheOrder) {
  LatticeCloud cloud;
  cloud.positions = DistinctPoints(testing::VolumeCloud(3000, 1, 5).positions);
  const LatticeCloud shuffled = testing::Shuffled(cloud, 6);
  const auto draw = [](const LatticeCloud& c) {
    std::vector<LatticePoint> points =
        c.Select(RandomSample(c.positions, 500, 9)).positions;
    return DistinctPoints(points);
  };
  EXPECT_EQ(draw(cloud).size(), 500u);
  EXPECT_EQ(draw(cloud), draw(shuffled));
  EXPECT_NE(RandomSample(cloud.positions, 500, 9),
            RandomSample(cloud.positions, 500, 10));
  EXPECT_EQ(RandomSample(cloud.positions, 1 << 20, 9).size(), cloud.size());
}

}  // namespace
}  // namespace mapsieve::core
