#include "core/spdf/tile_update.h"

#include <cstring>
#include <map>
#include <random>
#include <set>

#include "core/cloud/merge_duplicates.h"
#include "core/geometry/morton.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

namespace clouds = ::mapsieve::testing;
using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

/// What the filter made of one tile.
struct Filtered {
  std::vector<LatticePoint> points;
  std::vector<DeathRound> deaths;
  std::vector<uint32_t> rows;
  LabelColumns columns;

  friend bool operator==(const Filtered&, const Filtered&) = default;
};

/// A map in memory that remembers what the filter made of it.
class FilteredMap final : public TileStore, public PreviousRun {
 public:
  explicit FilteredMap(int level) : level_(level) {}

  /// Replaces the points; returns what changed.
  std::vector<TileChange> SetPoints(const std::vector<LatticePoint>& points) {
    std::map<CellKey, std::vector<LatticePoint>, CellKeyLess> fresh;
    for (const LatticePoint& q : points) {
      fresh[CellKey::Of(q, level_)].push_back(q);
    }
    std::vector<TileChange> changes;
    std::set<CellKey, CellKeyLess> keys;
    for (const auto& [key, part] : fresh) keys.insert(key);
    for (const auto& [key, tile] : tiles_) keys.insert(key);
    for (const CellKey& key : keys) {
      const Filtered old = tiles_[key];
      Filtered& tile = tiles_[key];
      tile.points = fresh[key];
      tile.deaths.clear();
      std::optional<LatticeBox> box;
      const auto touch = [&box](const LatticePoint& q) {
        box = box.has_value() ? box->Union(BoxOf(q)) : BoxOf(q);
      };
      std::map<LatticePoint, DeathRound> before;
      for (size_t i = 0; i < old.points.size(); ++i) {
        before[old.points[i]] = old.deaths[i];
      }
      for (const LatticePoint& q : tile.points) {
        const auto found = before.find(q);
        if (found == before.end()) {
          touch(q);
          tile.deaths.push_back(7);
        } else {
          tile.deaths.push_back(found->second);
          before.erase(found);
        }
      }
      for (const auto& [q, death] : before) touch(q);
      if (box.has_value()) changes.push_back({key, box});
      if (tile.points.empty()) tiles_.erase(key);
    }
    return changes;
  }

  std::vector<TileInfo> Tiles() const override {
    std::vector<TileInfo> tiles;
    for (const auto& [key, tile] : tiles_) {
      tiles.push_back({key, static_cast<int64_t>(tile.points.size())});
    }
    return tiles;
  }
  absl::StatusOr<int64_t> LoadPoints(const CellKey& key,
                                     std::span<LatticePoint> room) override {
    const std::vector<LatticePoint>& points = tiles_.at(key).points;
    std::copy(points.begin(), points.end(), room.begin());
    return static_cast<int64_t>(points.size());
  }
  absl::Status LoadPointRows(const CellKey& key, std::span<const RowRange> rows,
                             std::span<LatticePoint> room) override {
    CopyRows<LatticePoint>(tiles_.at(key).points, rows, room);
    return absl::OkStatus();
  }
  absl::Status StoreState(const CellKey& key, TileStateKind kind,
                          std::span<const std::byte> bytes) override {
    states_[kind][key].assign(bytes.begin(), bytes.end());
    return absl::OkStatus();
  }
  absl::Status LoadState(const CellKey& key, TileStateKind kind,
                         std::span<const RowRange> rows,
                         std::span<std::byte> room) override {
    std::span<const std::byte> all =
        std::as_bytes(std::span(tiles_.at(key).deaths));
    const auto of_kind = states_.find(kind);
    if (of_kind != states_.end()) {
      const auto found = of_kind->second.find(key);
      if (found != of_kind->second.end()) all = found->second;
    }
    CopyRows<std::byte>(all, rows, room, room.size() / RowCount(rows));
    return absl::OkStatus();
  }
  absl::Status Emit(const TileResult& result) override {
    Filtered& tile = tiles_.at(result.key);
    tile.deaths.assign(result.deaths.begin(), result.deaths.end());
    tile.rows.assign(result.rows.begin(), result.rows.end());
    tile.columns = {};
    tile.columns.Append(result.columns);
    answers_[result.key] = {{result.positions.begin(), result.positions.end()},
                            tile.columns};
    emitted.insert(result.key);
    return absl::OkStatus();
  }
  absl::StatusOr<LabeledSurvivors> LoadSurvivors(const CellKey& key) override {
    return answers_.at(key);
  }
  /// To be called after a run.
  void ForgetStates() { states_.clear(); }

  /// No tile had survivors.
  void ForgetAnswers() {
    for (auto& [key, answer] : answers_) answer = {};
  }

  const std::map<CellKey, Filtered, CellKeyLess>& tiles() const {
    return tiles_;
  }
  std::set<CellKey, CellKeyLess> emitted;

 private:
  const int level_;
  std::map<CellKey, Filtered, CellKeyLess> tiles_;
  std::map<CellKey, LabeledSurvivors, CellKeyLess> answers_;
  std::map<TileStateKind,
           std::map<CellKey, std::vector<std::byte>, CellKeyLess>>
      states_;
};

struct Case {
  DensityRule rule;
  int level;
  int64_t max_unit_points;
  /// Of the scene.
  int point_count = 6000;
  double extent_m = 1.5;
};

class UpdateTilesTest : public ::testing::TestWithParam<Case> {};

/// Removes the points of a ball, or adds jittered copies of them.
std::vector<LatticePoint> Edited(std::vector<LatticePoint> points,
                                 std::mt19937_64& random) {
  const LatticePoint center = points[random() % points.size()];
  const auto radius = static_cast<int64_t>(40 + random() % 300);
  const bool removes = random() % 2 == 0;
  const auto is_near = [&](const LatticePoint& q) {
    const int64_t dx = q.x - center.x;
    const int64_t dy = q.y - center.y;
    const int64_t dz = q.z - center.z;
    return dx * dx + dy * dy + dz * dz <= radius * radius;
  };
  if (removes) {
    std::erase_if(points, is_near);
  } else {
    const auto jitter = [&random] {
      return static_cast<int64_t>(random() % 31) - 15;
    };
    const std::vector<LatticePoint> old = points;
    for (const LatticePoint& q : old) {
      if (!is_near(q)) continue;
      points.push_back({q.x + jitter(), q.y + jitter(), q.z + jitter()});
    }
  }
  return DistinctPoints(points);
}

TEST_P(UpdateTilesTest, GivesWhatFilteringFromScratchGives) {
  const Case& c = GetParam();
  const SpdfOptions options = {
      .label_neighbor_count = c.rule == DensityRule::kQuota ? 127 : 0,
      .density_radius_m = 0.2,
      .reach_m = 0.5,
      .rule = c.rule};
  const TilingOptions tiling = {.max_unit_points = c.max_unit_points};
  const Lattice lattice;
  std::mt19937_64 random(91);
  FilteredMap map(c.level);
  std::vector<LatticePoint> points = DistinctPoints(
      clouds::SceneCloud(c.point_count, c.extent_m, 90).positions);
  map.SetPoints(points);
  MAPSIEVE_ASSERT_OK(FilterTiles(map, lattice, options, tiling, {}));
  size_t emitted = 0;
  size_t tiles = 0;
  for (int edit = 0; edit < 4; ++edit) {
    SCOPED_TRACE(edit);
    points = Edited(std::move(points), random);
    map.ForgetStates();
    map.emitted.clear();
    const std::vector<TileChange> changes = map.SetPoints(points);
    const auto before = map.tiles();
    const auto summary =
        UpdateTiles(map, map, changes, lattice, options, tiling, {});
    MAPSIEVE_ASSERT_OK(summary);
    EXPECT_EQ(summary->emitted_tile_count,
              static_cast<int64_t>(map.emitted.size()));
    emitted += map.emitted.size();
    tiles += map.tiles().size();

    FilteredMap scratch(c.level);
    scratch.SetPoints(points);
    MAPSIEVE_ASSERT_OK(FilterTiles(scratch, lattice, options, tiling, {}));
    ASSERT_EQ(map.tiles().size(), scratch.tiles().size());
    for (const auto& [key, expected] : scratch.tiles()) {
      SCOPED_TRACE(key.ToString());
      EXPECT_TRUE(map.tiles().at(key) == expected);
      if (!map.emitted.contains(key)) {
        EXPECT_TRUE(before.at(key) == map.tiles().at(key));
      }
    }
  }
  EXPECT_GT(emitted, 0u);
  // Small tiles are not all within reach of an edit.
  if (c.level <= 9) {
    EXPECT_LT(emitted, tiles);
  }
}

INSTANTIATE_TEST_SUITE_P(
    RulesAndTiles, UpdateTilesTest,
    ::testing::Values(
        Case{DensityRule::kPaper, 9, 1}, Case{DensityRule::kPaper, 9, 1500},
        Case{DensityRule::kPaper, 10, 1}, Case{DensityRule::kPaper, 12, 100000},
        Case{DensityRule::kQuota, 9, 1}, Case{DensityRule::kQuota, 10, 1500},
        // Larger than what an edit reaches: parts of tiles are filtered.
        Case{DensityRule::kPaper, 12, 1, 20000, 5.0},
        Case{DensityRule::kPaper, 13, 50000, 20000, 5.0},
        Case{DensityRule::kQuota, 12, 5000, 20000, 5.0}));

TEST(UpdateTiles, OfASmallChangeInALargeTileVotesLittle) {
  FilteredMap map(13);
  std::vector<LatticePoint> points =
      DistinctPoints(clouds::SceneCloud(20000, 6.0, 94).positions);
  map.SetPoints(points);
  const SpdfOptions options = {.density_radius_m = 0.2, .reach_m = 0.5};
  const auto whole = FilterTiles(map, Lattice(), options, {}, {});
  MAPSIEVE_ASSERT_OK(whole);
  points.erase(points.begin() + 5000, points.begin() + 5010);
  map.ForgetStates();
  const std::vector<TileChange> changes = map.SetPoints(points);
  const auto update =
      UpdateTiles(map, map, changes, Lattice(), options, {}, {});
  MAPSIEVE_ASSERT_OK(update);
  EXPECT_GT(update->emitted.vote_count, 0);
  EXPECT_LT(update->emitted.vote_count, whole->vote_count / 4);
}

TEST(UpdateTiles, FailsWhereTheResultOfBeforeLacksAPoint) {
  FilteredMap map(13);
  std::vector<LatticePoint> points =
      DistinctPoints(clouds::SceneCloud(2000, 6.0, 95).positions);
  map.SetPoints(points);
  MAPSIEVE_ASSERT_OK(FilterTiles(map, Lattice(), {}, {}, {}));
  points.pop_back();
  map.ForgetStates();
  const std::vector<TileChange> changes = map.SetPoints(points);
  map.ForgetAnswers();
  EXPECT_THAT(UpdateTiles(map, map, changes, Lattice(), {}, {}, {}),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("lacks the point at lattice coordinates")));
}

TEST(UpdateTiles, WithoutChangesEmitsNothing) {
  FilteredMap map(9);
  map.SetPoints(DistinctPoints(clouds::SceneCloud(2000, 1.0, 92).positions));
  MAPSIEVE_ASSERT_OK(FilterTiles(map, Lattice(), {}, {}, {}));
  map.emitted.clear();
  MAPSIEVE_ASSERT_OK(UpdateTiles(map, map, {}, Lattice(), {}, {}, {}));
  EXPECT_TRUE(map.emitted.empty());
}

TEST(UpdateTiles, EmitsATileWhoseAttributesChangedAndNoOther) {
  FilteredMap map(9);
  map.SetPoints(DistinctPoints(clouds::SceneCloud(2000, 1.0, 93).positions));
  MAPSIEVE_ASSERT_OK(FilterTiles(map, Lattice(), {}, {}, {}));
  map.emitted.clear();
  const CellKey key = map.Tiles().front().key;
  const std::vector<TileChange> changes = {{key, std::nullopt}};
  MAPSIEVE_ASSERT_OK(UpdateTiles(map, map, changes, Lattice(), {}, {}, {}));
  EXPECT_EQ(map.emitted.size(), 1u);
  EXPECT_TRUE(map.emitted.contains(key));
}

}  // namespace
}  // namespace mapsieve::core
