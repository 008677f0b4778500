#include "server/engine/tile_check.h"

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/integer_root.h"
#include "core/spdf/levels.h"
#include "server/engine/chunk_reader.h"
#include "server/engine/product_chunk.h"

namespace mapsieve::engine {
namespace {

using core::CellKey;
using core::LatticeBox;
using core::LatticeCloud;
using core::LatticePoint;
using storage::ChunkKind;
using storage::ChunkRef;
using storage::ReadSnapshot;

/// Of the filter, and of the cloud it is given.
constexpr int64_t kCheckBytesPerPoint = 200;

/// How far from a tile points have a say in it, in steps.
struct Halo {
  /// In which of its points survive; each round looks one reach farther.
  int64_t survival = 0;
  /// In the labels of the survivors: their voters, and the voters' voters.
  int64_t votes = 0;

  static Halo Of(const core::SpdfOptions& options,
                 const core::Lattice& lattice) {
    const core::SpdfConstants constants = MakeSpdfConstants(options, lattice);
    const bool quota = options.rule == core::DensityRule::kQuota;
    return {.survival = quota ? int64_t{constants.density_steps}
                              : int64_t{options.max_round_count} *
                                    constants.reach_steps,
            .votes = int64_t{2} * constants.reach_steps};
  }
};

/// The coarsest level of detail that the survivors within `margin` steps of a
/// tile decide in it.
int DecidedDepth(const core::SpdfOptions& options, const core::Lattice& lattice,
                 int64_t margin) {
  int depth = 0;
  while (depth < core::kMaxDepth) {
    margin -= core::CeilRoot(LevelRadiusD2(options, lattice, depth + 1));
    if (margin < 0) break;
    ++depth;
  }
  return depth;
}

absl::StatusOr<std::vector<LatticePoint>> LoadPointsIn(
    const ReadSnapshot& snapshot, const LatticeBox& box,
    Reservation& reservation) {
  constexpr int64_t kPageSize = 1000;
  std::vector<LatticePoint> points;
  std::optional<CellKey> after;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<storage::TileSummary> tiles,
        snapshot.ListTiles(ChunkKind::kRaw, box, after, kPageSize));
    if (tiles.empty()) return points;
    after = tiles.back().tile;
    for (const storage::TileSummary& tile : tiles) {
      MAPSIEVE_RETURN_IF_ERROR(reservation.Grow(
          tile.point_count * kCheckBytesPerPoint, "the comparison of a tile"));
      MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<LatticePoint> all,
                                ReadDistinctPoints(snapshot, tile.tile));
      std::copy_if(all.begin(), all.end(), std::back_inserter(points),
                   [&](const LatticePoint& q) { return box.Contains(q); });
    }
  }
}

std::string Place(const LatticePoint& q) {
  return absl::StrCat("the point at lattice coordinates ", q.x, ", ", q.y, ", ",
                      q.z);
}

/// `expected` has no depths, `depths` are its, up to `max_depth`.
absl::StatusOr<std::string> FirstDifference(const LatticeCloud& stored,
                                            const LatticeCloud& expected,
                                            const std::vector<uint8_t>& depths,
                                            int max_depth) {
  const auto [a, b] =
      std::mismatch(stored.positions.begin(), stored.positions.end(),
                    expected.positions.begin(), expected.positions.end());
  if (a != stored.positions.end() || b != expected.positions.end()) {
    const bool is_extra =
        b == expected.positions.end() ||
        (a != stored.positions.end() && core::MortonLess(*a, *b));
    return absl::StrCat("it holds ", stored.size(), " points, expected ",
                        expected.size(), ": ", Place(is_extra ? *a : *b),
                        is_extra ? " should not be there" : " is missing");
  }
  for (const core::Column& column : expected.attributes.columns()) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const core::Column* const other,
        FindProductColumn(stored.attributes, column.name(), column.type()));
    const auto at = std::mismatch(column.bytes().begin(), column.bytes().end(),
                                  other->bytes().begin())
                        .first;
    if (at == column.bytes().end()) continue;
    const auto row =
        static_cast<size_t>(at - column.bytes().begin()) / column.value_size();
    return absl::StrCat(
        "column ", column.name(), ": ", Place(expected.positions[row]), " has ",
        other->GetAsDouble(row), ", expected ", column.GetAsDouble(row));
  }
  if (stored.size() == 0) return std::string();
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<uint8_t> stored_depths,
                            DepthsOf(stored.attributes));
  for (size_t i = 0; i < depths.size(); ++i) {
    const int found = std::min<int>(stored_depths[i], max_depth);
    const int wanted = std::min<int>(depths[i], max_depth);
    if (found == wanted) continue;
    return absl::StrCat("depth: ", Place(expected.positions[i]), " has ",
                        stored_depths[i], ", expected ", wanted,
                        wanted == max_depth ? " or more" : "");
  }
  return std::string();
}

}  // namespace

absl::StatusOr<TileCheck> CheckTile(const ReadSnapshot& snapshot,
                                    const core::SpdfOptions& options,
                                    const CellKey& tile,
                                    Reservation& reservation,
                                    const ExecutionContext& context) {
  const core::Lattice lattice(snapshot.map().spec.step_nm);
  const Halo halo = Halo::Of(options, lattice);
  LatticeCloud cloud = {.lattice = lattice};
  MAPSIEVE_ASSIGN_OR_RETURN(
      cloud.positions,
      LoadPointsIn(snapshot, tile.box().Grown(halo.survival + halo.votes),
                   reservation));
  MAPSIEVE_ASSIGN_OR_RETURN(const core::FilteredCloud filtered,
                            core::FilterCloud(cloud, options, context));
  const LatticeCloud survivors = cloud.Select(filtered.rows);
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<uint8_t> depths,
      core::ComputeDepths(survivors.positions, lattice, options, context));

  std::vector<uint32_t> inside;
  std::vector<uint8_t> inside_depths;
  for (uint32_t i = 0; i < survivors.size(); ++i) {
    if (CellKey::Of(survivors.positions[i], tile.level) != tile) continue;
    inside.push_back(i);
    inside_depths.push_back(depths[i]);
  }
  const LatticeCloud expected = MakeProductCloud(
      survivors.Select(inside), filtered.columns.Select(inside).All());
  MAPSIEVE_ASSIGN_OR_RETURN(const LatticeCloud stored,
                            ReadProduct(snapshot, tile));
  MAPSIEVE_ASSIGN_OR_RETURN(
      std::string difference,
      FirstDifference(stored, expected, inside_depths,
                      DecidedDepth(options, lattice, halo.votes)));
  return TileCheck{.point_count = static_cast<int64_t>(inside.size()),
                   .difference = std::move(difference)};
}

}  // namespace mapsieve::engine
