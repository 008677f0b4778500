// Prints, as markdown, what the filter of the simulated campus costs on one
// thread when it is cut into tiles, over what it costs as a whole, in one run:
// for several tile edges, tile by tile and in units of tiles.
//   tiling_table [--repeats N] [--reach M] [POINTS]
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "client/lab/simulate.h"
#include "core/base/heap.h"
#include "core/cloud/merge_duplicates.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/tile_filter.h"
#include "tests/bench/bench_util.h"

namespace mapsieve::bench {
namespace {

struct TableOptions {
  core::SpdfOptions spdf = {.density_radius_m = 0.2};
  int64_t point_count = 4'650'000;
  int repeats = 3;
};

/// Distinct points in Morton order as tiles of a level; states in memory, the
/// answer is dropped.
class BenchTiles final : public core::TileStore {
 public:
  BenchTiles(const std::vector<core::LatticePoint>& points, int level)
      : points_(points) {
    for (size_t begin = 0, end = 0; begin < points.size(); begin = end) {
      const core::CellKey key = core::CellKey::Of(points[begin], level);
      while (end < points.size() &&
             core::CellKey::Of(points[end], level) == key) {
        ++end;
      }
      tiles_.push_back({key, static_cast<int64_t>(end - begin)});
      begins_[key] = begin;
    }
  }

  std::vector<core::TileInfo> Tiles() const override { return tiles_; }
  absl::StatusOr<int64_t> LoadPoints(
      const core::CellKey& key, std::span<core::LatticePoint> room) override {
    const auto begin =
        points_.begin() + static_cast<ptrdiff_t>(begins_.at(key));
    std::copy_n(begin, room.size(), room.begin());
    return static_cast<int64_t>(room.size());
  }
  absl::Status LoadPointRows(const core::CellKey& key,
                             std::span<const core::RowRange> rows,
                             std::span<core::LatticePoint> room) override {
    core::CopyRows<core::LatticePoint>(
        std::span(points_).subspan(begins_.at(key)), rows, room);
    return absl::OkStatus();
  }
  absl::Status StoreState(const core::CellKey& key, core::TileStateKind kind,
                          std::span<const std::byte> bytes) override {
    states_[kind][key].assign(bytes.begin(), bytes.end());
    return absl::OkStatus();
  }
  absl::Status LoadState(const core::CellKey& key, core::TileStateKind kind,
                         std::span<const core::RowRange> rows,
                         std::span<std::byte> room) override {
    core::CopyRows<std::byte>(states_.at(kind).at(key), rows, room,
                              room.size() / core::RowCount(rows));
    return absl::OkStatus();
  }
  absl::Status Emit(const core::TileResult& /*result*/) override {
    return absl::OkStatus();
  }

 private:
  template <typename T>
  using ByTile = std::unordered_map<core::CellKey, T, core::CellKeyHash>;

  const std::vector<core::LatticePoint>& points_;
  std::vector<core::TileInfo> tiles_;
  ByTile<size_t> begins_;
  std::map<core::TileStateKind, ByTile<std::vector<std::byte>>> states_;
};

std::vector<core::LatticePoint> Campus(int64_t point_count) {
  core::RefusedCounts refused;
  return core::DistinctPoints(
      core::Quantize({SimulatedPoints({.point_count = point_count}), {}},
                     core::Lattice(), refused)
          .positions);
}

struct Run {
  double seconds = 0;
  int64_t vote_count = 0;
  size_t tile_count = 0;
};

Run Filter(const std::vector<core::LatticePoint>& points, int level,
           const core::SpdfOptions& spdf, const core::TilingOptions& tiling) {
  Run run;
  run.seconds = Seconds([&] {
    BenchTiles tiles(points, level);
    run.tile_count = tiles.Tiles().size();
    run.vote_count =
        ValueOrDie(core::FilterTiles(tiles, core::Lattice(), spdf, tiling, {}))
            .vote_count;
  });
  return run;
}

void PrintTable(const TableOptions& options) {
  const std::vector<core::LatticePoint> points = Campus(options.point_count);
  const auto size = static_cast<int64_t>(points.size());
  const core::Lattice lattice;
  constexpr std::array kLevels = {13, 14, 15, 16};
  struct Units {
    const char* name;
    core::TilingOptions tiling;
  };
  const std::array kUnits = {Units{"a tile, rounds in lock-step", {1, 0}},
                             Units{"an eighth of the points", {size / 8}},
                             Units{"half of the points", {size / 2}}};
  std::vector<double> whole;
  std::vector<double> seconds[kLevels.size()][kUnits.size()];
  Run run;
  int64_t whole_votes = 0;
  int64_t votes[kLevels.size()][kUnits.size()];
  size_t tiles[kLevels.size()];
  for (int i = 0; i < options.repeats; ++i) {
    run = Filter(points, kLevels.back(), options.spdf, {size});
    whole.push_back(run.seconds);
    whole_votes = run.vote_count;
    for (size_t l = 0; l < kLevels.size(); ++l) {
      for (size_t u = 0; u < kUnits.size(); ++u) {
        run = Filter(points, kLevels[l], options.spdf, kUnits[u].tiling);
        seconds[l][u].push_back(run.seconds);
        votes[l][u] = run.vote_count;
        tiles[l] = run.tile_count;
      }
    }
  }
  std::printf("%lld points, as a whole: %.2f s\n\n",
              static_cast<long long>(size), Median(whole));
  std::printf(
      "| tile edge m | tiles | a unit is | time over the whole's | votes over "
      "the whole's |\n|---|---|---|---|---|\n");
  for (size_t l = 0; l < kLevels.size(); ++l) {
    for (size_t u = 0; u < kUnits.size(); ++u) {
      std::printf(
          "| %.1f | %zu | %s | %.2f | %.2f |\n",
          std::ldexp(lattice.step(), kLevels[l]), tiles[l], kUnits[u].name,
          Median(seconds[l][u]) / Median(whole),
          static_cast<double>(votes[l][u]) / static_cast<double>(whole_votes));
    }
  }
}

}  // namespace
}  // namespace mapsieve::bench

int main(int argc, char** argv) {
  mapsieve::ReturnFreedBlocks();
  mapsieve::bench::TableOptions options;
  for (int i = 1; i < argc; ++i) {
    const std::string_view arg = argv[i];
    if (arg == "--repeats" && i + 1 < argc) {
      options.repeats = std::atoi(argv[++i]);
    } else if (arg == "--reach" && i + 1 < argc) {
      options.spdf.reach_m = std::atof(argv[++i]);
    } else {
      options.point_count = std::atoll(argv[i]);
    }
  }
  if (options.point_count < 1 || options.repeats < 1) {
    std::fprintf(stderr, "usage: %s [--repeats N] [--reach M] [POINTS]\n",
                 argv[0]);
    return 2;
  }
  mapsieve::bench::PrintTable(options);
}
