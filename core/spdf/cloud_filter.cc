#include "core/spdf/cloud_filter.h"

#include <algorithm>
#include <array>
#include <bit>
#include <functional>
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
constexpr int kMaxMemoryTileLevel = 28;

/// The finest level, at most kMaxMemoryTileLevel, at which the points, in
/// Morton order, lie in at most kMaxMemoryTiles cells.
int ChooseTileLevel(std::span<const LatticePoint> positions,
                    std::span<const uint32_t> rows, Executor& executor) {
  // How many neighbours in the order part at each level.
  using Counts = std::array<int64_t, kMaxCellLevel + 2>;
  constexpr size_t kTaskRows = 1 << 16;
  std::vector<Counts> counts(PartCount(rows.size(), kTaskRows));
  ForEachPart(
      executor, rows.size(), kTaskRows,
      [&](size_t part, size_t begin, size_t end) {
        for (size_t i = std::max(begin, size_t{1}); i < end; ++i) {
          const LatticePoint& a = positions[rows[i - 1]];
          const LatticePoint& b = positions[rows[i]];
          const auto differing =
              static_cast<uint64_t>((a.x ^ b.x) | (a.y ^ b.y) | (a.z ^ b.z));
          const int level = 64 - std::countl_zero(differing);
          ++counts[part]
                  [static_cast<size_t>(std::min(level, kMaxCellLevel + 1))];
        }
      });
  Counts parting{};
  for (const Counts& part : counts) {
    std::transform(part.begin(), part.end(), parting.begin(), parting.begin(),
                   std::plus<>());
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
                  Executor& executor, FilteredCloud& result)
      : cloud_(cloud), rows_(std::move(rows)), result_(result) {
    // Untouched room costs nothing, growing would copy.
    ReserveBulk(result_.rows, rows_.size());
    result_.columns.Reserve(rows_.size());
    const int level = ChooseTileLevel(cloud.positions, rows_, executor);
    for (auto begin = rows_.begin(); begin != rows_.end();) {
      const CellKey key = CellKey::Of(cloud.positions[*begin], level);
      const auto end =
          std::partition_point(begin, rows_.end(), [&](uint32_t row) {
            return CellKey::Of(cloud.positions[row], level) == key;
          });
      tiles_.push_back({key, end - begin});
      parts_[key] = {static_cast<size_t>(begin - rows_.begin()),
                     static_cast<size_t>(end - rows_.begin())};
      begin = end;
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

  absl::Status StoreState(const CellKey& key, TileStateKind kind,
                          std::span<const std::byte> bytes) override {
    states_[kind][key].assign(bytes.begin(), bytes.end());
    return absl::OkStatus();
  }

  absl::StatusOr<std::vector<std::byte>> LoadState(
      const CellKey& key, TileStateKind kind) override {
    return states_.at(kind).at(key);
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

FilteredCloud FilteredCloud::WithoutOutliers(double outlier_share) const {
  const std::vector<uint32_t> inliers = Inliers(outlier_share);
  FilteredCloud kept{.columns = columns.Select(inliers), .summary = summary};
  kept.rows.reserve(inliers.size());
  for (const uint32_t i : inliers) kept.rows.push_back(rows[i]);
  return kept;
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
