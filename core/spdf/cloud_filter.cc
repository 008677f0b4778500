#include "core/spdf/cloud_filter.h"

#include <algorithm>
#include <array>
#include <map>
#include <string>
#include <string_view>
#include <utility>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/spdf/memory_tiles.h"

namespace mapsieve::core {
namespace {

/// Distinct points of a cloud as tiles that are one unit.
class MemoryTileStore final : public TileStore {
 public:
  MemoryTileStore(const LatticeCloud& cloud, std::vector<uint32_t> rows,
                  Executor& executor, FilteredCloud& result)
      : cloud_(cloud), rows_(std::move(rows)), result_(result) {
    // Untouched room costs nothing, growing would copy.
    ReserveBulk(result_.rows, rows_.size());
    result_.columns.Reserve(rows_.size());
    for (const MemoryTile& tile : MakeMemoryTiles(
             rows_.size(),
             [&](size_t i) -> const LatticePoint& {
               return cloud.positions[rows_[i]];
             },
             executor)) {
      tiles_.push_back({tile.key, static_cast<int64_t>(tile.end - tile.begin)});
      parts_[tile.key] = {tile.begin, tile.end};
    }
  }

  std::vector<TileInfo> Tiles() const override { return tiles_; }

  absl::StatusOr<int64_t> LoadPoints(const CellKey& key,
                                     std::span<LatticePoint> room) override {
    const auto [begin, end] = parts_.at(key);
    for (size_t i = begin; i < end; ++i) {
      room[i - begin] = cloud_.positions[rows_[i]];
    }
    return static_cast<int64_t>(end - begin);
  }

  absl::Status LoadPointRows(const CellKey& key, std::span<const RowRange> rows,
                             std::span<LatticePoint> room) override {
    const size_t begin = parts_.at(key).first;
    auto to = room.begin();
    for (const RowRange& part : rows) {
      for (size_t i = part.begin; i < part.end; ++i) {
        *to++ = cloud_.positions[rows_[begin + i]];
      }
    }
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
    CopyRows<std::byte>(states_.at(kind).at(key), rows, room,
                        room.size() / RowCount(rows));
    return absl::OkStatus();
  }

  absl::Status Emit(const TileResult& result) override {
    const size_t begin = parts_.at(result.key).first;
    for (const uint32_t row : result.rows) {
      result_.rows.push_back(rows_[begin + row]);
    }
    result_.columns.Append(result.columns);
    return absl::OkStatus();
  }

 private:
  const LatticeCloud& cloud_;
  std::vector<uint32_t> rows_;
  std::vector<TileInfo> tiles_;
  /// Each tile's part [first, second) of rows_.
  std::map<CellKey, std::pair<size_t, size_t>, CellKeyLess> parts_;
  std::map<TileStateKind,
           std::map<CellKey, std::vector<std::byte>, CellKeyLess>>
      states_;
  FilteredCloud& result_;
};

}  // namespace

std::vector<uint32_t> FilteredCloud::Inliers(const OutlierTest& test) const {
  std::vector<uint32_t> inliers;
  for (uint32_t i = 0; i < rows.size(); ++i) {
    if (test.Keeps(columns.label[i], columns.confidence[i])) {
      inliers.push_back(i);
    }
  }
  return inliers;
}

std::vector<uint32_t> FilteredCloud::Inliers(double outlier_share) const {
  return Inliers(OutlierTest(summary.max_confidence, outlier_share));
}

FilteredCloud FilteredCloud::WithoutOutliers(const OutlierTest& test) const {
  const std::vector<uint32_t> inliers = Inliers(test);
  FilteredCloud kept{.columns = columns.Select(inliers), .summary = summary};
  kept.rows.reserve(inliers.size());
  for (const uint32_t i : inliers) kept.rows.push_back(rows[i]);
  return kept;
}

FilteredCloud FilteredCloud::WithoutOutliers(double outlier_share) const {
  return WithoutOutliers(OutlierTest(summary.max_confidence, outlier_share));
}

absl::StatusOr<FilteredCloud> FilterCloud(const LatticeCloud& cloud,
                                          const SpdfOptions& options,
                                          const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate(cloud.lattice));
  FilteredCloud result;
  MemoryTileStore store(cloud, MergeDuplicates(cloud, *context.executor),
                        *context.executor, result);
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
