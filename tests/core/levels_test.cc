#include "core/spdf/levels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <map>
#include <random>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "core/base/hash.h"
#include "core/cloud/merge_duplicates.h"
#include "core/spdf/cloud_filter.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;
namespace clouds = ::mapsieve::testing;

/// Level by level, every pair of points.
std::vector<uint8_t> BruteForceDepths(const std::vector<LatticePoint>& points,
                                      const Lattice& lattice,
                                      const SpdfOptions& options) {
  const auto priority = [&](const LatticePoint& q) {
    const int64_t key[4] = {q.x, q.y, q.z, options.seed};
    return std::pair(HashIntegers(key), q);
  };
  std::vector<uint8_t> depths(points.size(), 0);
  for (int level = 1; level <= kMaxDepth; ++level) {
    const double radius = options.density_radius_m * std::pow(2, level);
    const double limit =
        std::floor(radius * radius / lattice.step() / lattice.step());
    std::vector<size_t> kept;
    for (size_t i = 0; i < points.size(); ++i) {
      if (depths[i] != level - 1) continue;
      int better = 0;
      for (size_t j = 0; j < points.size(); ++j) {
        if (depths[j] != level - 1) continue;
        const auto x = static_cast<double>(points[i].x - points[j].x);
        const auto y = static_cast<double>(points[i].y - points[j].y);
        const auto z = static_cast<double>(points[i].z - points[j].z);
        better += x * x + y * y + z * z <= limit &&
                  priority(points[j]) < priority(points[i]);
      }
      if (better < options.neighbor_count) kept.push_back(i);
    }
    for (const size_t i : kept) depths[i] = static_cast<uint8_t>(level);
  }
  return depths;
}

std::vector<LatticePoint> Distinct(const LatticeCloud& cloud) {
  return DistinctPoints(cloud.positions);
}

/// A scene whose coordinates are `factor` times as large.
LatticeCloud Scaled(LatticeCloud cloud, int64_t factor) {
  return clouds::Mapped(std::move(cloud), [factor](const LatticePoint& q) {
    return LatticePoint{factor * q.x, factor * q.y, factor * q.z};
  });
}

/// Clouds, and radii that reach from a part of them to more than all: some
/// within kMaxRadiusSteps, some beyond.
std::vector<std::tuple<std::string, LatticeCloud, double>> Cases() {
  return {
      {"scene", clouds::SceneCloud(700, 0.5, 1), 0.01},
      {"dense scene", clouds::SceneCloud(700, 0.15, 2), 0.002},
      {"wide scene", Scaled(clouds::SceneCloud(700, 0.5, 3), 200), 3.0},
      {"volume", clouds::VolumeCloud(600, 0.2, 4), 0.02},
      {"line", clouds::LineCloud(400, 0.5, 5), 0.005},
      {"grid", clouds::GridCloud(8, 40), 0.04},
      {"one point", clouds::PlaneCloud(1, 1, 6), 0.2},
      {"far apart",
       clouds::Concatenated(
           clouds::SceneCloud(150, 0.2, 10),
           clouds::Shifted(clouds::SceneCloud(150, 0.2, 11),
                           {2'000'000'000, -1'000'000'000, 500})),
       0.01},
  };
}

TEST(Levels, EqualBruteForce) {
  for (const auto& [name, cloud, radius_m] : Cases()) {
    for (const int k : {6, 20}) {
      SCOPED_TRACE(absl::StrCat(name, " k ", k));
      const SpdfOptions options = {
          .neighbor_count = k, .density_radius_m = radius_m, .seed = 9};
      const std::vector<LatticePoint> points = Distinct(cloud);
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(
          const std::vector<uint8_t> depths,
          ComputeDepths(points, cloud.lattice, options));
      EXPECT_EQ(depths, BruteForceDepths(points, cloud.lattice, options));
      // Not a case in which all points are alike.
      if (points.size() > 100) {
        EXPECT_NE(*std::min_element(depths.begin(), depths.end()),
                  *std::max_element(depths.begin(), depths.end()));
      }
    }
  }
}

TEST(Levels, OfARuleQuotaCloudAreRuleQuotaAtTwiceTheRadius) {
  const LatticeCloud cloud = clouds::SceneCloud(5000, 0.8, 20);
  SpdfOptions options = {.density_radius_m = 0.05, .rule = DensityRule::kQuota};
  LatticeCloud level = {.lattice = cloud.lattice, .positions = Distinct(cloud)};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const FilteredCloud finest,
                                FilterCloud(level, options));
  level = level.Select(finest.rows);
  std::vector<LatticePoint> all = level.positions;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<uint8_t> depths,
                                ComputeDepths(all, cloud.lattice, options));
  for (int depth = 1; depth <= 4; ++depth) {
    options.density_radius_m *= 2;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const FilteredCloud coarser,
                                  FilterCloud(level, options));
    level = level.Select(coarser.rows);
    std::vector<LatticePoint> expected;
    for (size_t i = 0; i < all.size(); ++i) {
      if (depths[i] >= depth) expected.push_back(all[i]);
    }
    EXPECT_TRUE(level.positions == expected) << "depth " << depth;
  }
}

/// Points in tiles of any level, whatever a run stores kept apart.
class SmallLevelStore final : public LevelStore {
 public:
  SmallLevelStore(const std::vector<LatticePoint>& points, int level) {
    for (const LatticePoint& q : points) {
      cells_[0][CellKey::Of(q, level)].push_back(q);
    }
  }
  std::vector<TileInfo> Tiles() const override {
    std::vector<TileInfo> tiles;
    for (const auto& [key, points] : cells_[0]) {
      // At most so many.
      tiles.push_back({key, static_cast<int64_t>(points.size()) + 1});
    }
    return tiles;
  }
  absl::StatusOr<int64_t> LoadPoints(int level, const CellKey& cell,
                                     std::span<LatticePoint> room) override {
    if (level == failing_level) return absl::UnavailableError("disk");
    const auto& points = cells_[static_cast<size_t>(level)].at(cell);
    EXPECT_LE(points.size(), room.size());
    std::copy(points.begin(), points.end(), room.begin());
    return static_cast<int64_t>(points.size());
  }
  absl::Status StorePoints(int level, const CellKey& cell,
                           std::span<const LatticePoint> points) override {
    EXPECT_TRUE(cells_[static_cast<size_t>(level)]
                    .emplace(cell, std::vector(points.begin(), points.end()))
                    .second);
    return absl::OkStatus();
  }
  absl::Status EmitDepths(const CellKey& tile, int level,
                          std::span<const uint8_t> depths) override {
    EXPECT_TRUE(emitted_tiles.insert(tile).second);
    emitted.insert(emitted.end(), depths.begin(), depths.end());
    size_t next = 0;
    for (const LatticePoint& q : cells_[0].at(tile)) {
      // Of finer levels as they were.
      const auto before = depths_before.find(q);
      if (level > 0 && before != depths_before.end() &&
          before->second < level) {
        depth_of[q] = before->second;
      } else if (next < depths.size()) {
        depth_of[q] = depths[next++];
      }
    }
    EXPECT_EQ(next, depths.size());
    from_level_count += level > 0 ? 1 : 0;
    return absl::OkStatus();
  }

  /// In the order of the points, if all tiles were emitted.
  std::vector<uint8_t> emitted;
  std::set<CellKey, CellKeyLess> emitted_tiles;
  std::map<LatticePoint, uint8_t> depth_of;
  /// In a run from previous levels, those of then.
  std::map<LatticePoint, uint8_t> depths_before;
  /// Tiles that were emitted from a level on.
  size_t from_level_count = 0;
  int failing_level = -1;

 private:
  std::array<std::map<CellKey, std::vector<LatticePoint>, CellKeyLess>,
             kMaxDepth + 1>
      cells_;
};

TEST(Levels, DoNotDependOnTilesUnitsOrWorkers) {
  const auto pool = MakeWorkerPool(3);
  // The last one has levels beyond kMaxRadiusSteps.
  for (const auto& [cloud, radius_m] :
       {std::pair(clouds::SceneCloud(2500, 1.2, 30), 0.02),
        std::pair(clouds::Shifted(clouds::SceneCloud(2500, 1.2, 31),
                                  {5100, 7200, -4100}),
                  0.02),
        std::pair(Scaled(clouds::SceneCloud(1500, 1.2, 32), 500), 4.0)}) {
    const SpdfOptions options = {.neighbor_count = 10,
                                 .density_radius_m = radius_m};
    const std::vector<LatticePoint> points = Distinct(cloud);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(
        const std::vector<uint8_t> expected,
        ComputeDepths(points, cloud.lattice, options));
    const int fine = radius_m < 1 ? 7 : 16;
    for (const auto& [level, max_unit_points] :
         {std::pair(fine, int64_t{1}), std::pair(fine + 1, int64_t{300}),
          std::pair(fine + 2, int64_t{1}), std::pair(21, int64_t{1}),
          std::pair(fine + 3, int64_t{100000})}) {
      SCOPED_TRACE(absl::StrCat("level ", level, " of ", radius_m));
      SmallLevelStore store(points, level);
      MAPSIEVE_ASSERT_OK(ComputeDepths(
          store, nullptr, cloud.lattice, options,
          {.max_unit_points = max_unit_points},
          {.executor = max_unit_points > 1 ? pool.get() : &InlineExecutor()}));
      EXPECT_EQ(store.emitted, expected);
    }
  }
}

/// Points with their depths as the levels before those of another store.
class SmallPreviousLevels final : public PreviousLevels {
 public:
  SmallPreviousLevels(const std::map<LatticePoint, uint8_t>& depth_of,
                      std::set<CellKey, CellKeyLess> changed, int tile_level)
      : changed_(std::move(changed)) {
    for (const auto& [q, depth] : depth_of) {
      for (size_t level = 0; level <= depth; ++level) {
        levels_[level][CellKey::Of(q, tile_level)].push_back(q);
      }
    }
    for (auto& level : levels_) {
      for (auto& [tile, points] : level) {
        std::sort(points.begin(), points.end(),
                  [](const LatticePoint& a, const LatticePoint& b) {
                    return MortonLess(a, b);
                  });
      }
    }
  }

  std::vector<CellKey> ChangedTiles() const override {
    return {changed_.begin(), changed_.end()};
  }
  int64_t CountAtMost(int level, const CellKey& tile) const override {
    const auto& tiles = levels_[static_cast<size_t>(level)];
    const auto found = tiles.find(tile);
    if (found == tiles.end()) return 0;
    return static_cast<int64_t>(found->second.size()) + 2;
  }
  absl::StatusOr<int64_t> Load(int level, const CellKey& tile,
                               std::span<LatticePoint> room) override {
    if (level == failing_level) return absl::UnavailableError("old disk");
    const auto& points = levels_[static_cast<size_t>(level)].at(tile);
    EXPECT_LE(points.size(), room.size());
    std::copy(points.begin(), points.end(), room.begin());
    return static_cast<int64_t>(points.size());
  }

  int failing_level = -1;

 private:
  std::array<std::map<CellKey, std::vector<LatticePoint>, CellKeyLess>,
             kMaxDepth + 1>
      levels_;
  const std::set<CellKey, CellKeyLess> changed_;
};

/// A scene after an edit: some points within `radius` of a place gone, others
/// new there.
std::vector<LatticePoint> Edited(const std::vector<LatticePoint>& points,
                                 int64_t radius, std::mt19937_64& random) {
  const LatticePoint center = points[random() % points.size()];
  LatticeCloud edited;
  for (const LatticePoint& q : points) {
    const bool is_near =
        std::abs(q.x - center.x) < radius && std::abs(q.y - center.y) < radius;
    if (is_near && random() % 2 == 0) continue;
    edited.positions.push_back(q);
    if (is_near && random() % 2 == 0) {
      edited.positions.push_back({q.x + 3, q.y - 5, q.z + 2});
    }
  }
  return Distinct(edited);
}

TEST(Levels, OfChangedPointsAreMadeFromThoseBefore) {
  const auto pool = MakeWorkerPool(2);
  const SpdfOptions options = {.neighbor_count = 10, .density_radius_m = 0.01};
  std::mt19937_64 random(50);
  size_t skipped_tiles = 0;
  size_t partial_tiles = 0;
  for (const int tile_level : {5, 7, 9}) {
    std::vector<LatticePoint> points =
        Distinct(clouds::SceneCloud(2000, 2.0, 51));
    std::map<LatticePoint, uint8_t> depth_of;
    SmallLevelStore first(points, tile_level);
    MAPSIEVE_ASSERT_OK(
        ComputeDepths(first, nullptr, Lattice(), options, {}, {}));
    depth_of = first.depth_of;
    constexpr int kEdits = 10;
    for (int edit = 0; edit < kEdits; ++edit) {
      SCOPED_TRACE(absl::StrCat("tile level ", tile_level, " edit ", edit));
      // The last edit takes everything away, but for one point.
      const std::vector<LatticePoint> now =
          edit + 1 < kEdits ? Edited(points, edit % 3 == 0 ? 100 : 4, random)
                            : std::vector<LatticePoint>{points.back()};
      std::set<CellKey, CellKeyLess> changed;
      // A tile may be said to have changed though it has not.
      changed.insert(CellKey::Of(points.front(), tile_level));
      const std::set<LatticePoint> before(points.begin(), points.end());
      const std::set<LatticePoint> after(now.begin(), now.end());
      std::vector<LatticePoint> differing;
      std::set_symmetric_difference(before.begin(), before.end(), after.begin(),
                                    after.end(), std::back_inserter(differing));
      for (const LatticePoint& q : differing) {
        changed.insert(CellKey::Of(q, tile_level));
      }
      SmallPreviousLevels previous(depth_of, changed, tile_level);
      SmallLevelStore store(now, tile_level);
      store.depths_before = depth_of;
      MAPSIEVE_ASSERT_OK(ComputeDepths(
          store, &previous, Lattice(), options,
          {.max_unit_points = edit % 2 == 0 ? 1 : 100'000},
          {.executor = edit % 2 == 0 ? &InlineExecutor() : pool.get()}));

      SmallLevelStore scratch(now, tile_level);
      MAPSIEVE_ASSERT_OK(
          ComputeDepths(scratch, nullptr, Lattice(), options, {}, {}));
      for (const TileInfo& tile : scratch.Tiles()) {
        skipped_tiles += store.emitted_tiles.contains(tile.key) ? 0 : 1;
        EXPECT_TRUE(store.emitted_tiles.contains(tile.key) ||
                    !changed.contains(tile.key));
      }
      partial_tiles += store.from_level_count;
      std::map<LatticePoint, uint8_t> expected = scratch.depth_of;
      for (const auto& [q, depth] : expected) {
        const bool is_emitted =
            store.emitted_tiles.contains(CellKey::Of(q, tile_level));
        ASSERT_EQ(is_emitted ? store.depth_of.at(q) : depth_of.at(q), depth);
      }
      points = now;
      depth_of = std::move(expected);
    }
  }
  EXPECT_GT(skipped_tiles, 1000u);
  EXPECT_GT(partial_tiles, 10u);
}

TEST(Levels, OfNoPointsAfterSomeAreEmpty) {
  const std::vector<LatticePoint> points =
      Distinct(clouds::SceneCloud(300, 0.5, 60));
  SmallLevelStore before(points, 8);
  MAPSIEVE_ASSERT_OK(
      ComputeDepths(before, nullptr, Lattice(), SpdfOptions(), {}, {}));
  SmallPreviousLevels previous(before.depth_of, before.emitted_tiles, 8);
  SmallLevelStore store({}, 8);
  MAPSIEVE_ASSERT_OK(
      ComputeDepths(store, &previous, Lattice(), SpdfOptions(), {}, {}));
  EXPECT_TRUE(store.emitted_tiles.empty());
  previous.failing_level = 2;
  SmallLevelStore again(points, 8);
  EXPECT_THAT(ComputeDepths(again, &previous, Lattice(), SpdfOptions(), {}, {}),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("old disk")));
}

TEST(Levels, OfNoPointsAreEmpty) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<uint8_t> depths,
                                ComputeDepths({}, Lattice(), SpdfOptions()));
  EXPECT_TRUE(depths.empty());
}

TEST(Levels, RefuseBadOptionsAndPassOnErrors) {
  const std::vector<LatticePoint> points =
      Distinct(clouds::SceneCloud(300, 0.5, 40));
  EXPECT_THAT(
      ComputeDepths(points, Lattice(), SpdfOptions{.density_radius_m = -1}),
      StatusIs(absl::StatusCode::kInvalidArgument,
               HasSubstr("density_radius_m")));
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THAT(ComputeDepths(points, Lattice(), SpdfOptions(),
                            {.stop = stop.get_token()}),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("")));
  for (const int level : {0, 1, kMaxDepth}) {
    SmallLevelStore store(points, 10);
    store.failing_level = level;
    EXPECT_THAT(ComputeDepths(store, nullptr, Lattice(), SpdfOptions(), {}, {}),
                StatusIs(absl::StatusCode::kUnavailable, HasSubstr("disk")));
  }
}

TEST(Levels, ASpacingPicksTheCoarsestLevelThatIsFineEnough) {
  const SpdfOptions options = {.neighbor_count = 50, .density_radius_m = 0.2};
  // k points in a disk of the radius: each has a square of this edge.
  const double finest = 0.2 * std::sqrt(3.14159265358979 / 50);
  EXPECT_NEAR(LevelSpacing(options, 0), finest, 1e-12);
  EXPECT_NEAR(LevelSpacing(options, 3), 8 * finest, 1e-12);
  EXPECT_EQ(LevelOfSpacing(options, 0.01), 0);
  EXPECT_EQ(LevelOfSpacing(options, 1.999 * finest), 0);
  EXPECT_EQ(LevelOfSpacing(options, 2.001 * finest), 1);
  EXPECT_EQ(LevelOfSpacing(options, 100 * finest), 6);
  EXPECT_EQ(LevelOfSpacing(options, 1e300), kMaxDepth);
}

}  // namespace
}  // namespace mapsieve::core
