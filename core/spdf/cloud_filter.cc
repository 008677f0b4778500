#include "core/spdf/cloud_filter.h"

#include <algorithm>
#include <map>
#include <string>
#include <string_view>
#include <utility>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"

namespace mapsieve::core {
namespace {

/// Eight such tiles around the origin, or along a border, are still one unit.
constexpr int kMemoryTileLevel = 29;

/// Distinct points of a cloud as tiles so large that there is mostly one.
class MemoryTileStore final : public TileStore {
 public:
  MemoryTileStore(const LatticeCloud& cloud, std::vector<uint32_t> rows,
                  FilteredCloud& result)
      : rows_(std::move(rows)), result_(result) {
    points_.reserve(rows_.size());
    for (const uint32_t row : rows_) points_.push_back(cloud.positions[row]);
    for (size_t i = 0; i < points_.size(); ++i) {
      const CellKey key = CellKey::Of(points_[i], kMemoryTileLevel);
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
    const auto begin =
        points_.begin() + static_cast<ptrdiff_t>(begins_.at(key));
    auto end = begin;
    while (end != points_.end() && CellKey::Of(*end, kMemoryTileLevel) == key) {
      ++end;
    }
    return std::vector<LatticePoint>(begin, end);
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
    if (result_.columns.size() == 0) {
      result_.columns = std::move(result.columns);
      return absl::OkStatus();
    }
    for (size_t i = 0; i < result.columns.size(); ++i) {
      result_.columns.Append(result.columns, i);
    }
    return absl::OkStatus();
  }

 private:
  std::vector<uint32_t> rows_;
  std::vector<LatticePoint> points_;
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
  MemoryTileStore store(cloud, MergeDuplicates(cloud), result);
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
