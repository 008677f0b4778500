#include "core/spdf/cloud_filter.h"

#include <algorithm>
#include <array>
#include <bit>
#include <map>
#include <string>
#include <string_view>
#include <utility>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"

namespace mapsieve::core {
namespace {

/// A cloud is cut into at most so many tiles: what is copied tile by tile is
/// then small beside the cloud.
constexpr int64_t kMaxMemoryTiles = 1024;
/// Eight such tiles around the origin, or along a border, are still one unit.
constexpr int kMaxMemoryTileLevel = 29;

/// The finest level, at most kMaxMemoryTileLevel, at which the points, in
/// Morton order, lie in at most kMaxMemoryTiles cells.
int ChooseTileLevel(std::span<const LatticePoint> positions,
                    std::span<const uint32_t> rows) {
  // How many neighbours in the order part at each level.
  std::array<int64_t, kMaxCellLevel + 2> parting{};
  for (size_t i = 1; i < rows.size(); ++i) {
    const LatticePoint& a = positions[rows[i - 1]];
    const LatticePoint& b = positions[rows[i]];
    const auto differing =
        static_cast<uint64_t>((a.x ^ b.x) | (a.y ^ b.y) | (a.z ^ b.z));
    const int level = 64 - std::countl_zero(differing);
    ++parting[static_cast<size_t>(std::min(level, kMaxCellLevel + 1))];
  }
  int64_t cells = 1;
  int level = kMaxCellLevel;
  for (; level > kMaxMemoryTileLevel; --level) {
    cells += parting[static_cast<size_t>(level)];
  }
  while (level > 0 &&
         cells + parting[static_cast<size_t>(level)] <= kMaxMemoryTiles) {
    cells += parting[static_cast<size_t>(level)];
    --level;
  }
  return level;
}

/// Distinct points of a cloud as tiles that are one unit.
class MemoryTileStore final : public TileStore {
 public:
  MemoryTileStore(const LatticeCloud& cloud, std::vector<uint32_t> rows,
                  FilteredCloud& result)
      : cloud_(cloud), rows_(std::move(rows)), result_(result) {
    // Untouched room costs nothing, growing would copy.
    result_.rows.reserve(rows_.size());
    result_.columns.Reserve(rows_.size());
    const int level = ChooseTileLevel(cloud.positions, rows_);
    for (size_t i = 0; i < rows_.size(); ++i) {
      const CellKey key = CellKey::Of(cloud.positions[rows_[i]], level);
      if (tiles_.empty() || !(tiles_.back().key == key)) {
        tiles_.push_back({.key = key});
        begins_[key] = i;
      }
      ++tiles_.back().point_count;
    }
  }

  std::vector<TileInfo> Tiles() const override { return tiles_; }

  absl::StatusOr<std::vector<LatticePoint>> LoadPoints(
      const CellKey& key) override {
    std::vector<LatticePoint> points;
    points.reserve(rows_.size() / tiles_.size());
    for (size_t i = begins_.at(key); i < rows_.size(); ++i) {
      const LatticePoint& q = cloud_.positions[rows_[i]];
      if (!(CellKey::Of(q, key.level) == key)) break;
      points.push_back(q);
    }
    return points;
  }

  absl::Status StoreState(const CellKey& key, TileStateKind kind,
                          std::span<const std::byte> bytes) override {
    states_[kind][key].assign(bytes.begin(), bytes.end());
    return absl::OkStatus();
  }

  absl::StatusOr<std::vector<std::byte>> LoadState(
      const CellKey& key, TileStateKind kind) override {
    return states_[kind][key];
  }

  absl::Status Emit(TileResult result) override {
    const size_t begin = begins_.at(result.key);
    for (const uint32_t row : result.rows) {
      result_.rows.push_back(rows_[begin + row]);
    }
    result_.columns.AppendRange(result.columns, 0, result.columns.size());
    return absl::OkStatus();
  }

 private:
  const LatticeCloud& cloud_;
  std::vector<uint32_t> rows_;
  std::vector<TileInfo> tiles_;
  std::map<CellKey, size_t, CellKeyLess> begins_;
  std::map<TileStateKind,
           std::map<CellKey, std::vector<std::byte>, CellKeyLess>>
      states_;
  FilteredCloud& result_;
};

}  // namespace

std::vector<uint32_t> FilteredCloud::Inliers(double outlier_share) const {
  const OutlierTest test(summary.max_confidence, outlier_share);
  std::vector<uint32_t> inliers;
  for (uint32_t i = 0; i < rows.size(); ++i) {
    if (test.Keeps(columns.label[i], columns.confidence[i])) {
      inliers.push_back(i);
    }
  }
  return inliers;
}

absl::StatusOr<FilteredCloud> FilterCloud(const LatticeCloud& cloud,
                                          const SpdfOptions& options,
                                          const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate(cloud.lattice));
  FilteredCloud result;
  MemoryTileStore store(cloud, MergeDuplicates(cloud, *context.executor),
                        result);
  const TilingOptions tiling = {.max_unit_points =
                                    static_cast<int64_t>(cloud.size())};
  MAPSIEVE_ASSIGN_OR_RETURN(
      result.summary,
      FilterTiles(store, cloud.lattice, options, tiling, context));
  return result;
}

std::string NameBeside(std::string_view name,
                       std::span<const std::string_view> taken) {
  constexpr std::string_view kPrefix = "input_";
  std::string_view bare = name;
  while (bare.starts_with(kPrefix)) bare.remove_prefix(kPrefix.size());
  std::string result;
  if (std::find(taken.begin(), taken.end(), bare) != taken.end()) {
    result = kPrefix;
  }
  return result.append(name);
}

LatticeCloud MakeLabeledCloud(const LatticeCloud& cloud,
                              std::span<const uint32_t> rows,
                              const LabelColumns& columns) {
  LatticeCloud result{.lattice = cloud.lattice};
  result.positions.reserve(rows.size());
  for (const uint32_t row : rows) {
    result.positions.push_back(cloud.positions[row]);
  }
  Column label({"label", ScalarType::kUint8}, rows.size());
  Column confidence({"confidence", ScalarType::kFloat32}, rows.size());
  Column normal[3] = {Column({"nx", ScalarType::kFloat32}, rows.size()),
                      Column({"ny", ScalarType::kFloat32}, rows.size()),
                      Column({"nz", ScalarType::kFloat32}, rows.size())};
  for (size_t i = 0; i < rows.size(); ++i) {
    label.Set(i, static_cast<uint8_t>(columns.label[i]));
    confidence.Set(i, ConfidenceValue(columns.confidence[i]));
    const std::array<float, 3> n = DecodeOctahedral(columns.normal[i]);
    for (size_t a = 0; a < 3; ++a) normal[a].Set(i, n[a]);
  }
  std::vector<Column>& out = result.attributes.columns();
  out = {std::move(label), std::move(confidence), std::move(normal[0]),
         std::move(normal[1]), std::move(normal[2])};
  for (const Column& column : cloud.attributes.columns()) {
    Column selected = column.Select(rows);
    selected.Rename(NameBeside(column.name(), kLabelColumnNames));
    out.push_back(std::move(selected));
  }
  return result;
}

}  // namespace mapsieve::core
